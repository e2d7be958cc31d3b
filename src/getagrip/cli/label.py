"""``getagrip label``: 6D poses of the object in all videos of a folder, from drafts to a dataset's files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

from tyro.conf import Positional, arg

from getagrip.cli.command import Command
from getagrip.cli.draft import DRAFT_ANNOTATOR, Draft
from getagrip.cli.export import Export
from getagrip.errors import UsageError
from getagrip.geometry.lens import Lens
from getagrip.io.options import Flag, Folder, OptionalFolder
from getagrip.io.terminal import format_count, print_note, print_result

if TYPE_CHECKING:
    from getagrip.studio.jobs import RequestedMesh
    from getagrip.studio.project import Project
    from getagrip.studio.store.marks import Grasp
    from getagrip.studio.store.tasks import Task

MAX_WORK_GAP_S = 30.0
"""Longer pauses between two changes are not counted as work [s]."""
EFFORT_FILE, AGREEMENT_FILE = "effort.csv", "agreement.csv"


class Effort(NamedTuple):
    """The work that a grasp's labels were: what stands drawn, all changes, and their time without pauses [s]."""

    grasp: str
    drawn: int
    frames: int
    changes: int
    active_s: float

    def __str__(self) -> str:
        drawn = format_count(self.drawn, "stroke or outline", "strokes and outlines")
        what = f"{drawn} on {format_count(self.frames, 'frame')}, {format_count(self.changes, 'change')}"
        return f"{self.grasp}: {what} in {self.active_s / 60:.1f} min without pauses"


class PoseAgreement(NamedTuple):
    """Agreement of the poses of one object by two people, in the camera: medians over the frames of both."""

    first: str
    """The grasp's name, which begins with the annotator's."""
    second: str
    frames: int
    apart_mm: float
    """Distance of the object's middle."""
    turned_deg: float

    def __str__(self) -> str:
        off = f"{self.apart_mm:.1f} mm and {self.turned_deg:.1f} degrees apart"
        return f"{self.first} and {self.second}: {off}, the medians of {format_count(self.frames, 'frame')}"


@dataclass(frozen=True, kw_only=True)
class Label(Command):
    """Label the object's 6D pose in all videos of a folder: draft the hands, mark the object, reconstruct, export.

    End the page by Ctrl-C: what is labelled is then reconstructed, unless it was on the page, and exported.
    """

    videos: Annotated[Positional[Path], arg(metavar="VIDEOS")]
    """A folder of videos, each of one shot, undistorted, of one hand that holds the object."""
    object: Annotated[str, arg(metavar="MESH|KIND")]
    """The object: a mesh file, or the kind of a built-in shape, such as mug."""
    out: Folder
    """Folder of all that is made. Called again with the same folder, it goes on where it stopped."""
    size_mm: Annotated[float | None, arg(metavar="MM", help_behavior_hint="(default: unknown)")] = None
    """The largest side of the object's bounding box."""
    to: Annotated[str, arg(metavar="FORMAT")] = "bop"
    """Format of the labels, as for export --to; they are written to a folder of this name in --out."""
    only_right: Flag = False
    """Leave out of the labels what looks wrong or uncertain. Without it, it is named."""
    no_page: Flag = False
    """Do not open the page: draft, reconstruct what is labelled, and export."""
    models: OptionalFolder = None
    """Folder of the hand models (default: the cache; getagrip doctor --fetch hands)."""
    lens: Annotated[Lens, arg(name="")] = field(default_factory=Lens)
    """The camera of all videos. Without it the focal length is assumed."""
    port: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: 8765, or the next free one)")] = None
    """Port of the page on 127.0.0.1."""

    def run(self) -> int:
        """Run all steps; return 1 where one video failed, else 0. What fails of one is reported and ends no other."""
        from getagrip.cli.annotate import DATABASE, serve
        from getagrip.io import files
        from getagrip.studio.project import Project
        from getagrip.studio.store.mark_store import Store

        found, failed = self._tasks()
        for n, task in enumerate(found, start=1):
            print_result(f"{task.key}: draft {n} of {len(found)}")
            failed += not self._does(task.key, partial(self._draft, task))
        self.out.mkdir(parents=True, exist_ok=True)
        project = Project(found, Store(self.out / DATABASE), self.lens, wants_poses=True)
        try:
            for task in found:
                failed += not self._does(task.key, partial(self._mark, project, task))
            if not self.no_page:
                serve(project, self.port, DRAFT_ANNOTATOR)
            solved, efforts, grasps = [], [], []
            for grasp in project.labelled():
                shape = self._shape(project, grasp)
                if self._does(grasp.name, partial(_reconstruct_grasp, project, grasp, shape)):
                    solved.append(self.out / "results" / grasp.name)
                    grasps.append(grasp)
                    efforts.append(_measure_effort(project, grasp))
                    print_result(str(efforts[-1]))
        finally:
            project.close()
        if solved:
            folder = self.out / self.to
            files.write_csv(self.out / EFFORT_FILE, [Effort._fields, *efforts])
            print_result(str(Effort("in all", *(sum(each) for each in list(zip(*efforts, strict=True))[1:]))))
            agreements = list[PoseAgreement]()

            def compare(one: Path, other: Path) -> None:
                agreements.append(compare_results(one, other))
                print_result(str(agreements[-1]))

            for n, m in _pairs_of_people(grasps):
                self._does(grasps[m].name, partial(compare, solved[n], solved[m]))
            if agreements:
                files.write_csv(self.out / AGREEMENT_FILE, [PoseAgreement._fields, *agreements])
            export = Export(
                results=tuple(solved), to=self.to, out=folder, only_right=self.only_right, overwrite=True,
                debug=self.debug,
            )  # fmt: skip
            failed += export.run()
            which = "those that look right of " if self.only_right else ""
            print_result(f"{folder}: the labels of {which}{format_count(len(solved), 'grasp')}")
        return int(failed > 0)

    def check(self) -> None:
        super().check()
        if not self.videos.is_dir():
            raise UsageError(f"VIDEOS must be a folder of videos (got {self.videos}); for one video: getagrip draft")
        Export(results=(self.videos,), to=self.to).check()

    def _tasks(self) -> tuple[list[Task], int]:
        """Return a task for each video that opens, and how many do not. Raises ``UsageError`` without any video."""
        from getagrip.io import files
        from getagrip.readers.video import VIDEO_SUFFIXES
        from getagrip.studio.store.tasks import Task, read_tasks

        videos = files.list_files(self.videos, {suffix.lower() for suffix in VIDEO_SUFFIXES})
        if not videos:
            raise UsageError(f"missing videos in {self.videos}: files that end in {', '.join(VIDEO_SUFFIXES)}")
        stems, tasks = Counter(path.stem.casefold() for path in videos), list[Task]()

        def add(path: Path) -> None:
            key = path.stem if stems[path.stem.casefold()] == 1 else path.name
            tasks.append(replace(read_tasks(path)[0], key=key))

        opened = [self._does(path.name, partial(add, path)) for path in videos]
        return tasks, opened.count(False)

    def _does(self, name: str, do: Callable[[], None]) -> bool:
        """Do something for a video and return True; report what is wrong and return False."""
        from getagrip.batch.clips import print_outcome
        from getagrip.batch.job import failed_outcome

        try:
            do()
        except Exception as error:  # one video's trouble must not end the others
            print_outcome(failed_outcome(name, error), self.debug)
            return False
        return True

    def _draft(self, task: Task) -> None:
        """Make the draft of a video, unless it is there."""
        from getagrip.io import files
        from getagrip.studio.hands.detect_hands import DETECTED_HANDS_FOLDER, DRAFTS_FOLDER

        folder = files.folder_inside(self.out, DRAFTS_FOLDER, task.key)
        if task.path is not None and not (folder / DETECTED_HANDS_FOLDER / "hand.npz").is_file():
            Draft(
                video=task.path, object=self.object, out=folder, size_mm=self.size_mm, models=self.models,
                lens=self.lens, no_page=True,
            ).run()  # fmt: skip

    def _mark(self, project: Project, task: Task) -> None:
        """Mark the frames of the hand that was found, unless somebody has marked some."""
        from getagrip.cli.import_hands import HandFile
        from getagrip.studio.hands.detect_hands import DETECTED_HANDS_FOLDER, DRAFTS_FOLDER

        path = self.out / DRAFTS_FOLDER / task.key / DETECTED_HANDS_FOLDER / "hand.npz"
        if not path.is_file() or project.store.marks.standing(task.key):
            return
        hands = HandFile.of(path)
        if hands.numbers and hands.side:
            extent = min(hands.numbers) - 1, max(hands.numbers) - 1
            self._shape(project, project.mark_grasp(task, DRAFT_ANNOTATOR, extent, hands.side))

    def _shape(self, project: Project, grasp: Grasp) -> RequestedMesh:
        """Return the object's mesh as it was stated on the page, else as stated here, which is stored for the page."""
        from getagrip.studio.jobs import RequestedMesh

        own, known = RequestedMesh(self.object, self.size_mm), project.labelling.shape(grasp)
        if known is None:
            project.labelling.state_shape(grasp, own)
        elif known != own:
            print_note(f"{grasp.name}: the mesh is {known}, as in {self.out}; the page changes it")
        return known or own


def _reconstruct_grasp(project: Project, grasp: Grasp, shape: RequestedMesh) -> None:
    """Reconstruct a grasp, unless there is a result of its labels."""
    from getagrip.cli import calls
    from getagrip.io.terminal import progress_bar
    from getagrip.studio.store.export_all import JobOnBar

    if not project.labelling.is_solved(grasp, shape):
        with progress_bar() as bar:
            print_result(project.labelling.solve(grasp, shape, JobOnBar(bar, grasp.name, calls.run_call)))


def _pairs_of_people(grasps: Sequence[Grasp]) -> list[tuple[int, int]]:
    """Return places of grasps of one video and hand, by two people, that have frames in common."""
    return [
        (n, m)
        for (n, a), (m, b) in combinations(enumerate(grasps), 2)
        if a.task == b.task and a.side == b.side and a.mark.annotator != b.mark.annotator
        and max(a.extent[0], b.extent[0]) <= min(a.extent[1], b.extent[1])
    ]  # fmt: skip


def compare_results(first: Path, second: Path) -> PoseAgreement:
    """Compare the results in two folders, of one video, in the frames of both. Raises ``InputError``."""
    import numpy as np

    from getagrip.geometry import se3
    from getagrip.metrics.evaluate.results import read_result_and_clip

    posed = []
    for folder in (first, second):
        result, clip = read_result_and_clip(folder)
        T = clip.hand.T_cam_hand @ result.T_hand_obj
        middle = se3.transform(T, result.scale * clip.mesh.vertices.mean(axis=0)[None])[:, 0]
        posed.append({name: (T[n, :3, :3], middle[n]) for n, name in enumerate(result.frames)})
    both = [(posed[0][name], posed[1][name]) for name in posed[0] if name in posed[1]]
    apart = [1e3 * np.linalg.norm(one[1] - other[1]) for one, other in both]
    turned = [np.degrees(se3.angle_between(one[0], other[0])) for one, other in both]
    found = (round(float(np.median(each)), 2) if both else np.nan for each in (apart, turned))
    return PoseAgreement(first.name, second.name, len(both), *found)


def _measure_effort(project: Project, grasp: Grasp) -> Effort:
    """Measure how much work a grasp's labels were."""
    times = project.store.keyframes.times(grasp.mark.mark, grasp.mark.annotator)
    gaps = [(b - a).total_seconds() for a, b in pairwise(times)]
    worked = sum(gap for gap in gaps if gap <= MAX_WORK_GAP_S)
    frames = project.labelling.labels(grasp).frames.values()
    drawn = sum(
        len(shapes) for frame in frames for shapes in (frame.object, frame.front, frame.on, frame.off) if shapes
    )
    return Effort(grasp.name, drawn, len(frames), len(times), round(worked, 1))
