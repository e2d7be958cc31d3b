"""``getagrip draft``: find the hands in a video, and serve the page on which the object is marked."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg
from tyro.constructors import PrimitiveConstructorSpec

from getagrip.commands.command import Command, OptionalSide
from getagrip.errors import UsageError
from getagrip.geometry.lens import Lens
from getagrip.io.arguments import Flag, OptionalFolder
from getagrip.io.terminal import report

if TYPE_CHECKING:
    from getagrip.annotate.finding_hands import FoundHands
    from getagrip.annotate.footage import Footage
    from getagrip.annotate.project import Project
    from getagrip.annotate.tasks import Task

MOST_FRAMES = 3000
"""Largest number of frames of a draft: two networks are run on each."""
DRAFTER = "draft"
"""Name of the annotator whose marks a draft starts with."""


def box_of(words: list[str]) -> tuple[float, ...]:
    """Parse left, top, width and height in one word. Raises ``ValueError``."""
    box = tuple(float(number) for number in words[0].split(","))
    if len(box) != 4 or min(box[2:]) <= 0.0:
        raise ValueError("a box is X,Y,W,H, its width and height above 0")
    return box


BOX: PrimitiveConstructorSpec[tuple[float, ...] | None] = PrimitiveConstructorSpec(
    nargs=1,
    metavar="X,Y,W,H",
    instance_from_str=box_of,
    is_instance=lambda value: value is None or (isinstance(value, tuple) and len(value) == 4),
    str_from_instance=lambda value: [",".join(f"{x:g}" for x in value or ())],
)


@dataclass(frozen=True, kw_only=True)
class Draft(Command):
    """Find the hand in a video, and open the page on which you mark the object. It is a draft: check the hands."""

    video: Annotated[Positional[Path], arg(metavar="VIDEO|FOLDER")]
    """The video of one shot, undistorted; or a folder of its images."""
    object: Annotated[str, arg(metavar="MESH|KIND")]
    """The object in the hand: a mesh file, or the kind of a built-in shape, such as mug."""
    out: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(default: VIDEO-draft)")] = None
    """Folder of all files that are made; annotate can go on in it."""
    size_mm: Annotated[float | None, arg(metavar="MM", help_behavior_hint="(default: unknown)")] = None
    """The largest side of the object's bounding box."""
    interval: Annotated[tuple[int, int] | None, arg(metavar="FIRST LAST", help_behavior_hint="(default: all)")] = None
    """The frames in which the object is held, counted from 1."""
    side: OptionalSide = None
    """The hand that holds the object (default: the side that is detected in most frames)."""
    object_box: Annotated[tuple[float, float, float, float] | None, BOX, arg(help_behavior_hint="")] = None
    """Box around the object in the first frame [px]. The hand nearest to it is used, and what stands out from the
    background in it is marked as the object."""
    no_page: Flag = False
    """Write files only, without opening the page. With --object-box, also write masks of all frames and print the
    command that makes a clip."""
    models: OptionalFolder = None
    """Folder of the hand models (default: the cache; getagrip doctor --fetch hands)."""
    lens: Annotated[Lens, arg(name="")] = field(default_factory=Lens)
    """The camera. Without it the focal length is assumed."""
    port: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: 8765, or the next free one)")] = None
    """Port of the page on 127.0.0.1."""

    @property
    def folder(self) -> Path:
        """Folder of all files."""
        return self.out or self.video.with_name(f"{self.video.stem}-draft")

    def run(self) -> int:
        """Find hands, write them, and serve the page.

        Raises ``InputError`` for a video or models that cannot be read, ``UsageError`` where there is no hand or the
        video is cut.
        """
        from getagrip.annotate.finding_hands import write_found
        from getagrip.annotate.project import Project
        from getagrip.annotate.reconstruction import Shape
        from getagrip.annotate.store import Store
        from getagrip.annotate.tasks import read_tasks
        from getagrip.annotate.written_files import write_labels
        from getagrip.commands.annotate import DATABASE, serve
        from getagrip.io.terminal import progress_bar

        mesh = " ".join(Shape(self.object, self.size_mm).options)
        task = read_tasks(self.video, None)[0]
        self.folder.mkdir(parents=True, exist_ok=True)
        project = Project([task], Store(self.folder / DATABASE), self._lens)
        try:
            footage = project.footage(task)
            found = self._find(footage)
            for key, source in found.provenance.items():
                report(f"{key}: {source}")
            with progress_bar() as bar:
                job = bar.add_task("the hand's masks", total=len(found.landmarks.rows))
                made = write_found(self.folder, found, footage.image, lambda n: bar.update(job, completed=n))
            print(f"{made}: the {found.landmarks.side} hand in {len(found.frames)} of {self._count(footage)} frames")
            project.mark_grasp(task, DRAFTER, (found.frames[0], found.frames[-1]), found.landmarks.side)
            if self.object_box is not None:
                self._draw(project, task, found)
            if self.no_page:
                status = 0 if self.object_box is None else write_labels(project)
                print(f"options of clip new for the object's mesh: {mesh}")
                return status
            print(f"the grasp is marked: mark the object on the page, and reconstruct with {mesh}")
            serve(project, self.port, DRAFTER)
            return 0
        finally:
            project.close()

    def _draw(self, project: Project, task: Task, found: FoundHands) -> None:
        """Mark what stands out in the box as the object, on the first frame with a hand. Raises ``UsageError``."""
        from getagrip.annotate import found_hands
        from getagrip.annotate.drafting import traced
        from getagrip.annotate.labels import OBJECT, FrameLabels, Labels
        from getagrip.annotate.strokes import boxed

        footage, n, side = project.footage(task), found.frames[0], found.landmarks.side
        assert self.object_box is not None
        hand = found_hands.FoundHands(self.folder / found_hands.FOLDER).mask(n)
        shapes = traced(boxed(footage.image(n), self.object_box, hand) == OBJECT)
        if not shapes:
            nothing = f"nothing in the box stands out from the background in {footage.name(n)}"
            raise UsageError(f"--object-box: {nothing}; mark the object on the page")
        drawn = {n: FrameLabels(object=tuple(shapes))}
        extent = found.frames[0], found.frames[-1]
        project.import_labels(Labels(self.video.name, footage.size, side, footage.fps, *extent, drawn), DRAFTER)

    @property
    def _lens(self) -> Lens:
        return self.lens if self.lens.is_set else Lens(guess_focal=True)

    def _interval(self, footage: Footage) -> tuple[int, int]:
        """Return the first and last frame, from 0. Raises ``UsageError``."""
        first, last = self.interval or (1, footage.frames)
        if not 1 <= first < last <= footage.frames or last - first >= MOST_FRAMES:
            allowed = f"two frames from 1 to {footage.frames}, the later one last, at most {MOST_FRAMES} apart"
            raise UsageError(f"--interval must be {allowed} (got {first} {last})")
        return first - 1, last - 1

    def _count(self, footage: Footage) -> int:
        first, last = self._interval(footage)
        return last - first + 1

    def _find(self, footage: Footage) -> FoundHands:
        """Find the hand that holds the object. Raises as ``run`` does."""
        import numpy as np

        from getagrip.annotate.finding_hands import find_hands
        from getagrip.clip.intrinsics import intrinsics
        from getagrip.io.terminal import progress_bar
        from getagrip.landmarks import load

        nets, interval = load(self.models), self._interval(footage)
        K, camera = intrinsics(self._lens, footage.size)
        boxes = None if self.object_box is None else {interval[0]: np.array(self.object_box)}
        with progress_bar() as bar:
            job = bar.add_task("looking for hands", total=self._count(footage))
            return find_hands(
                footage, interval, nets, K, camera, self.side, boxes, lambda n: bar.update(job, completed=n)
            )
