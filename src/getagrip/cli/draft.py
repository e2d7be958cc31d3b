"""``getagrip draft``: find the hands in a video, and serve the page on which the object is marked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, UseAppendAction, arg
from tyro.constructors import PrimitiveConstructorSpec

from getagrip.cli.command import Command, Labels, OptionalSide
from getagrip.cli.view_options import ViewOptions, named_argument, write_undistorted
from getagrip.errors import GetagripError, UsageError
from getagrip.geometry.lens import Lens
from getagrip.io.options import Flag, OptionalFolder
from getagrip.io.terminal import format_count, print_note

if TYPE_CHECKING:
    from getagrip.cli.draft_inputs import VideoInterval
    from getagrip.readers.footage import Footage
    from getagrip.studio.detect_grasps import DraftedGrasps
    from getagrip.studio.hands import HandLandmarks
    from getagrip.studio.hands.detect_hands import DetectedHands
    from getagrip.studio.jobs import DepthFiles, RequestedMesh
    from getagrip.studio.store.labels import FrameLabels
    from getagrip.studio.store.labels import Labels as DrawnLabels

MAX_DRAFT_FRAMES = 3000
"""Largest number of frames of a draft: two networks are run on each."""
MIN_BOX_FILL_FRACTION = 0.05
"""Least share of its box that an object fills."""
DRAFT_ANNOTATOR = "draft"
"""Name of the annotator whose marks a draft starts with."""


def parse_box(words: list[str]) -> tuple[float, float, float, float]:
    """Parse left, top, width and height in one word. Raises ``ValueError``."""
    box = tuple(float(number) for number in words[0].split(","))
    if len(box) != 4 or min(box[2:]) <= 0.0:
        raise ValueError("a box is X,Y,W,H, its width and height above 0")
    return box[0], box[1], box[2], box[3]


BOX_ARGUMENT: PrimitiveConstructorSpec[tuple[float, ...] | None] = PrimitiveConstructorSpec(
    nargs=1,
    metavar="X,Y,W,H",
    instance_from_str=parse_box,
    is_instance=lambda value: value is None or (isinstance(value, tuple) and len(value) == 4),
    str_from_instance=lambda value: [",".join(f"{x:g}" for x in value or ())],
)


NamedBox = Annotated[
    tuple[str, tuple[float, float, float, float]], named_argument("NAME=X,Y,W,H", lambda text: parse_box([text]))
]


@dataclass(frozen=True, kw_only=True)
class Draft(Command):
    """Find the hand in a video, and open the page on which you mark the object. It is a draft: check the hands."""

    video: Annotated[Positional[Path], arg(metavar="VIDEO|FOLDER|IMAGE")]
    """The video of one shot, undistorted; or a folder of its images; or a single image."""
    object: Annotated[str, arg(metavar="MESH|KIND")]
    """The object in the hand: a mesh file, or the kind of a built-in shape, such as mug or glass (no handle)."""
    out: Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(default: VIDEO-draft)")] = None
    """Folder of all files that are made; annotate can go on in it."""
    size_mm: Annotated[float | None, arg(metavar="MM", help_behavior_hint="(default: unknown)")] = None
    """The largest side of the object's bounding box."""
    interval: Annotated[tuple[int, int] | None, arg(metavar="FIRST LAST", help_behavior_hint="(default: all)")] = None
    """The frames in which the object is held, counted from 1."""
    side: OptionalSide = None
    """The hand that holds the object (default: what it looks like)."""
    object_box: Annotated[tuple[float, float, float, float] | None, BOX_ARGUMENT, arg(help_behavior_hint="")] = None
    """Box around the object in the first frame [px]. The hand nearest to it is used, and what stands out from the
    background in it is marked as the object."""
    masks: Annotated[str | None, arg(metavar="sam2|sam3|FILE", help_behavior_hint="(default: marked on the page)")] = (
        None
    )
    """The object's masks: a file or folder, as for import masks; or the estimator that is run to make them
    (docs/estimators.md)."""
    mask_word: Annotated[str | None, arg(metavar="WORD", help_behavior_hint="(default: KIND)")] = None
    """With --masks sam3: what the object is, in a word or a few."""
    mask_object: Labels = ()
    """With --masks FILE: labels of the object. Not needed if there is only one."""
    mask_hand: Labels = ()
    """With --masks FILE: labels of the hand that holds it."""
    hands: Annotated[str | None, arg(metavar="hamer|wilor|hawor|FILE", help_behavior_hint="(default: found here)")] = (
        None
    )
    """The hands: a hand file, as import hands --out writes it; other files, with --hands-from; or the estimator that is
    run to make them."""
    hands_from: Annotated[str | None, arg(metavar="NAME", help_behavior_hint="")] = None
    """With --hands FILE: the program that wrote it, as for import hands --from."""
    depth: Annotated[Path | None, arg(metavar="PATH", help_behavior_hint="")] = None
    """Depth images of the video's frames, as for import depth. A sensor's tell the hand's distance and size."""
    depth_from: Annotated[str | None, arg(metavar="NAME", help_behavior_hint="")] = None
    """With --depth: the program or format of its files, as for import depth --from."""
    depth_first: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: the frame's)")] = None
    """With --depth: the number that its files give to the first frame, if they count from another start."""
    find_grasps: Flag = False
    """Mark the stable grasps that are found in the interval by fits to masks and hand, as segment --from-masks does.
    This needs --masks or --object-box."""
    all_frames: Flag = False
    """Take all frames with the hand. By default, without --interval, the frames in which it reaches for the object or
    leaves it are left out."""
    no_page: Flag = False
    """Do not open the page. With --object-box or --masks, make the masks of all frames and a clip, reconstruct it, and
    draw its report."""
    models: OptionalFolder = None
    """Folder of the hand models (default: the cache; getagrip doctor --fetch hands)."""
    lens: Annotated[Lens, arg(name="")] = field(default_factory=Lens)
    """The camera. Without it the focal length is assumed."""
    views: Annotated[ViewOptions, arg(name="")] = field(default_factory=ViewOptions)
    """Further cameras of the same grasp."""
    box_view: Annotated[tuple[NamedBox, ...], UseAppendAction, arg(help_behavior_hint="")] = ()
    """Box around the object in a view's image of the first frame [px], as --object-box. Without it a view tells of the
    hand alone."""
    port: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: 8765, or the next free one)")] = None
    """Port of the page on 127.0.0.1."""

    @property
    def folder(self) -> Path:
        """Folder of all files."""
        return self.out or self.video.with_name(f"{self.video.stem}-draft")

    @property
    def _word(self) -> str | None:
        """Return what the object is, in words, if it is known: a mesh's file name says nothing."""
        return self.mask_word or (self.object if not Path(self.object).suffix else None)

    def check(self) -> None:
        super().check()
        for name, (given, needed) in {
            "hands-from": (self.hands_from, self.hands),
            "mask-object": (self.mask_object, self.masks),
            "mask-hand": (self.mask_hand, self.masks),
            "find-grasps": (self.find_grasps, self.masks or self.object_box),
            "depth": (self.depth, self.depth_from),
            "depth-from": (self.depth_from, self.depth),
            "depth-first": (self.depth_first is not None, self.depth),
        }.items():
            if given and not needed:
                missing = {"hands-from": "--hands FILE", "find-grasps": "--masks or --object-box"}
                missing |= {"depth": "--depth-from NAME", "depth-from": "--depth PATH", "depth-first": "--depth PATH"}
                raise UsageError(f"missing {missing.get(name, '--masks FILE')}: --{name} needs it")
        self.views.check()
        if unknown := next((name for name, _ in self.box_view if name not in self.views.names), None):
            raise UsageError(f"--box-view must be of a --view (got {unknown})")
        if self.views.view and self.lens.is_set:
            raise UsageError("--K cannot be used with --cameras, which has the camera of the video")
        if self.mask_word and self.masks != "sam3":
            raise UsageError("missing --masks sam3: --mask-word needs it")
        if self.masks == "sam3" and self.object_box is None and self._word is None:
            raise UsageError("missing --mask-word or --object-box: sam3 starts from a word or a box about the object")
        if self.all_frames and self.find_grasps:
            raise UsageError("choose one of --all-frames and --find-grasps")
        if self.masks == "sam2" and self.object_box is None:
            raise UsageError("missing --object-box: sam2 starts from a box about the object in the first frame")
        for name, source in {"masks": self.masks, "hands": self.hands}.items():
            if source is not None:
                from getagrip.cli.draft_inputs import check_source

                check_source(name, source)

    def run(self) -> int:
        """Find hands, write them, and serve the page.

        Raises ``InputError`` for a mesh, video or models that cannot be read, ``UsageError`` where there is no hand or
        the video is cut.
        """
        from getagrip.cli import calls
        from getagrip.cli.annotate import DATABASE, serve
        from getagrip.studio.project import Project
        from getagrip.studio.store.export_all import reconstruct_labelled_grasps
        from getagrip.studio.store.labels import Labels as Drawn
        from getagrip.studio.store.mark_store import Store
        from getagrip.studio.store.tasks import read_tasks

        shape = self._shape()
        video = self._source()
        task = read_tasks(video, None)[0]
        self.folder.mkdir(parents=True, exist_ok=True)
        project = Project([task], Store(self.folder / DATABASE), self.lens_stated)
        try:
            footage = project.footage(task)
            stretch = self.stretch(footage)
            project.labelling.depth = self._depth(stretch)
            found = self.write_hands(stretch, self.inputs(stretch, video))
            if self.views.view:
                from getagrip.cli.draft_views import draft_views

                project.labelling.views = draft_views(self, stretch, found).add_to
            drawn = self.drawn(stretch, found)
            whole = (found.frames[0], found.frames[-1])
            labels = Drawn(
                video.name, footage.size, found.side, footage.fps, *whole, _labels_within_extent(drawn, whole)
            )
            extents = [whole]
            if self.find_grasps or (drawn and self.interval is None and not self.all_frames):
                grasps = self._grasps(stretch, found, labels, shape, video)
                labels, extents = grasps.labels, grasps.extents or [whole]
            labelled = []
            for extent in extents:
                marked = project.mark_grasp(task, DRAFT_ANNOTATOR, extent, found.side)
                project.labelling.state_shape(marked, shape)
                if frames := _labels_within_extent(labels.frames, extent):
                    own = replace(labels, first=extent[0], last=extent[1], frames=frames)
                    labelled.append(grasp := project.import_labels(own, DRAFT_ANNOTATOR))
                    if older := len(project.labelling.labels(grasp).frames) - len(frames):
                        print_note(
                            f"{self.folder} has labels of {format_count(older, 'other frame')} already, "
                            "which count, too"
                        )
            if self.no_page:
                if drawn:
                    return reconstruct_labelled_grasps(project, labelled, shape, calls.run_call)
                print_note("nothing is reconstructed: give --object-box or --masks, or mark the object on the page")
                return 0
            print("the grasp is marked: mark the object on the page; it is reconstructed there")
            serve(project, self.port, DRAFT_ANNOTATOR)
            return 0
        finally:
            project.close()

    def write_hands(self, stretch: VideoInterval, inputs: str) -> DetectedHands:
        """Find the hands and write them, unless they were found before by the same ``inputs``. Raises as ``run``."""
        from getagrip.cli.draft_inputs import read_own_hands
        from getagrip.io.terminal import progress_bar
        from getagrip.studio.hands.detect_hands import DETECTED_HANDS_FOLDER, write_detected_hands

        made = self.folder / DETECTED_HANDS_FOLDER
        if (found := read_own_hands(self.folder, inputs, stretch)) is not None:
            print(f"{made}: the {found.side} hand in {len(found.frames)} frames, found before by the same options")
            return found
        found = self._find(stretch)
        self._say_sources(found)
        if len(found.frames) == 1:
            (frame,) = found.frames
            raise UsageError(
                f"the {found.side} hand is found in {stretch.footage.name(frame)} only, of {len(stretch.names)} "
                "frames: a grasp has two or more; give --interval with frames that show the hand and fingers well, "
                "or hands of another estimator by --hands"
            )
        with progress_bar() as bar:
            job = bar.add_task("the hand's masks", total=len(found.landmarks))
            update = lambda n: bar.update(job, completed=n)  # noqa: E731
            write_detected_hands(self.folder, replace(found, inputs=inputs), stretch.footage.image, update)
        between = len(found.frames) - len(found.landmarks)
        guessed = f", interpolated in {between} of them" if between > 0 else ""
        print(f"{made}: the {found.side} hand in {len(found.frames)} of {len(stretch.names)} frames{guessed}")
        return found

    def inputs(self, stretch: VideoInterval, video: Path) -> str:
        """Return a checksum of all that the hands are found by; empty for hands of a file, which are read again."""
        from getagrip import __version__
        from getagrip.studio.jobs import estimators_making
        from getagrip.studio.store.export_clip import footage_checksum

        if self.hands is not None and self.hands not in estimators_making("hands"):
            return ""
        options = (self.side, self.object_box, self.hands, stretch.first, stretch.last, stretch.K.tolist())
        about = (__version__, footage_checksum(video), str(self.models or ""), *options)
        return sha256(repr(about).encode()).hexdigest()

    def _source(self) -> Path:
        """Return the footage; of a single image, a folder with it twice, since a clip has two frames or more."""
        from getagrip.io import files
        from getagrip.readers.video import IMAGE_SUFFIXES

        folder = self.video.is_dir()
        names = sorted(path for path in self.video.iterdir() if path.name[0] != ".") if folder else [self.video]
        images = [path for path in names if path.suffix.lower() in IMAGE_SUFFIXES and path.is_file()]
        if len(images) != 1:
            return self._undistorted()
        if self.views.view:
            raise UsageError(f"--view cannot be used with a single image ({self.video})")
        (image,) = images
        twice = files.folder_inside(self.folder, "image") / self.video.stem
        twice.mkdir(parents=True, exist_ok=True)
        for name in ("000001", "000002"):
            files.write_bytes(twice / f"{name}{image.suffix}", files.read_bytes(image))
        print_note("a single image: it is taken twice; nothing is known of motion")
        return twice

    def _undistorted(self) -> Path:
        """Return the footage or, where the calibrated lens distorts, images without distortion."""
        if (rig := self.views.rig) is None:
            return self.video
        from getagrip.readers.video import size_and_rate

        _, removal, _ = rig.undistortion(rig.own, size_and_rate(self.video, None)[0])
        return self.video if removal is None else write_undistorted(self.video, removal, self.folder)

    def _grasps(
        self, stretch: VideoInterval, found: DetectedHands, labels: DrawnLabels, shape: RequestedMesh, video: Path
    ) -> DraftedGrasps:
        """Find the frames of the grasps, and say which. Raises as run."""
        from getagrip.cli import calls
        from getagrip.studio.detect_grasps import find_grasps, trim_reach
        from getagrip.studio.hands import detect_hands

        joints = dict(zip(found.frames, found.hand.joints_2d if found.hand.joints_2d is not None else (), strict=False))
        if self.find_grasps:
            grasps = find_grasps(labels, video, stretch.footage, self.folder, shape, joints, calls.run_call)
        else:
            hand = detect_hands.HandDetectionFiles(self.folder / detect_hands.DETECTED_HANDS_FOLDER).mask
            box = None if self.object_box is None or self.masks is not None else (stretch.first, self.object_box)
            grasps = trim_reach(labels, stretch.footage.image, joints, hand, box)
        if grasps.said:
            print_note(grasps.said)
        return grasps

    def drawn(self, stretch: VideoInterval, found: DetectedHands) -> dict[int, FrameLabels]:
        """Return what is known of the object: masks that are given, or what stands out in the box. Raises as run."""
        from getagrip.cli.draft_inputs import read_mask_polygons, run_draft_estimator
        from getagrip.io.terminal import progress_bar
        from getagrip.studio.hands import detect_hands
        from getagrip.studio.jobs import estimators_making
        from getagrip.studio.masks.box_prompt import (
            empty_side,
            first_mask_finding,
            segment_box_by_motion,
            track_box,
        )
        from getagrip.studio.masks.polygon_drafts import trace_polygons
        from getagrip.studio.masks.uncertain_pixels import finger_pixels
        from getagrip.studio.store.labels import OBJECT_LABEL, FrameLabels

        if self.masks is not None:
            path = Path(self.masks)
            if self.masks in estimators_making("masks"):
                values: dict[str, Sequence[object]] = {} if self.object_box is None else {"box": self.object_box}
                values |= {} if self._word is None else {"word": [self._word]}
                path = run_draft_estimator(self.masks, stretch, self.folder, values)
            with progress_bar() as bar:
                job = bar.add_task("the object's masks", total=len(stretch.names))
                update = lambda n: bar.update(job, completed=n)  # noqa: E731
                return read_mask_polygons(path, stretch, self.mask_object, self.mask_hand, update)
        if self.object_box is None:
            return {}
        n, image = found.frames[0], stretch.footage.image
        *_, (box, _) = track_box(image, self.object_box, stretch.first, n)
        if n > stretch.first:
            print_note(f"--object-box: followed to {stretch.footage.name(n)}, the first frame with a hand")
        hand = detect_hands.HandDetectionFiles(self.folder / detect_hands.DETECTED_HANDS_FOLDER)
        fingers = finger_pixels(hand.joints[n], stretch.footage.size[::-1]) if n in hand.joints else None
        labels = segment_box_by_motion(image, n, (stretch.first, stretch.last), box, hand.mask(n), fingers)
        shapes = trace_polygons(labels == OBJECT_LABEL)
        if not shapes:
            nothing = f"nothing in the box stands out from the background in {stretch.footage.name(n)}"
            raise UsageError(f"--object-box: {nothing}; mark the object on the page")
        filled = float((labels == OBJECT_LABEL).sum()) / (box[2] * box[3])
        if filled < MIN_BOX_FILL_FRACTION:
            little = f"what stands out in the box in {stretch.footage.name(n)} fills {100 * filled:.1f} % of it"
            raise UsageError(f"--object-box: {little}: that is not the object; mark it on the page, or give --masks")
        if why := first_mask_finding(image(n), labels, box, fingers):
            print_note(f"--object-box: {why} A stroke on the page corrects the mask")
        if empty := empty_side(labels, box):
            side, share = empty
            print_note(
                f"--object-box: {100 * share:.0f} % of it is empty at the {side}: is a part of the object missing?"
            )
        return {n: FrameLabels(object=tuple(shapes))}

    def _shape(self) -> RequestedMesh:
        """Return the object's mesh. It is read before minutes of work. Raises ``InputError``, ``UsageError``."""
        from getagrip.cli.new_clip import MeshOptions, read_own_mesh
        from getagrip.studio.jobs import RequestedMesh

        read_own_mesh(MeshOptions(mesh=Path(self.object), size_mm=self.size_mm))
        return RequestedMesh(self.object, self.size_mm)

    def _depth(self, stretch: VideoInterval) -> DepthFiles | None:
        from getagrip.cli.draft_inputs import open_depth_images

        if self.depth is None or self.depth_from is None:
            return None
        return open_depth_images(self.depth, self.depth_from, self.depth_first, stretch)

    def _say_sources(self, found: DetectedHands) -> None:
        """Print where the hands come from; guesses once: where a clip is made without the page, it prints them."""
        from getagrip.provenance import is_assumed

        solved = self.no_page and bool(self.masks or self.object_box)
        for key, source in found.provenance.items():
            if not (solved and is_assumed(source)):
                print_note(f"{key}: {source}")

    @cached_property
    def lens_stated(self) -> Lens:
        """The camera: as stated or calibrated, else a guess. Raises ``InputError`` and ``UsageError``."""
        if (rig := self.views.rig) is not None:
            from getagrip.cli.draft_views import lens_of_K
            from getagrip.readers.video import size_and_rate

            return lens_of_K(rig.rig.K_and_lens(rig.own, size_and_rate(self.video, None)[0])[0])
        return self.lens if self.lens.is_set else Lens(guess_focal=True)

    def _interval(self, footage: Footage) -> tuple[int, int]:
        """Return the first and last frame, from 0. Raises ``UsageError``."""
        if footage.frames < 2:
            raise UsageError(f"VIDEO must have two frames or more (got {footage.frames})")
        first, last = self.interval or (1, footage.frames)
        if not 1 <= first < last <= footage.frames or last - first >= MAX_DRAFT_FRAMES:
            allowed = f"two frames from 1 to {footage.frames}, the later one last, at most {MAX_DRAFT_FRAMES} apart"
            raise UsageError(f"--interval must be {allowed} (got {first} {last})")
        return first - 1, last - 1

    def stretch(self, footage: Footage) -> VideoInterval:
        """Return the interval and its camera. Raises ``UsageError``, also for a box beside the image."""
        from getagrip.cli.draft_inputs import VideoInterval
        from getagrip.cli.import_hands import HandFile, camera_of
        from getagrip.studio.masks.box_prompt import box_to_slices

        if self.object_box is not None:
            box_to_slices(self.object_box, footage.size)
        of_file = self.hands is not None and self.hands_from is None and Path(self.hands).suffix == ".npz"
        own = HandFile.of(Path(self.hands)) if of_file and self.hands is not None else None
        lens = self.lens if own is not None and own.K is not None else self.lens_stated
        return VideoInterval(footage, *self._interval(footage), *camera_of(lens, own, footage.size))

    def _find(self, stretch: VideoInterval) -> DetectedHands:
        """Find the hand that holds the object, or read it. Raises as ``run`` does."""
        from getagrip.cli.draft_inputs import (
            landmark_boxes,
            read_estimated_hands,
            read_found_hands,
            run_draft_estimator,
            write_boxes_file,
        )
        from getagrip.studio.detect_grasps import track_visible_box
        from getagrip.studio.hands.detect_hands import lift_detected_landmarks
        from getagrip.studio.jobs import ESTIMATORS, estimators_making

        name = self.hands if self.hands in estimators_making("hands") else None
        if self.hands is not None and name is None:
            return read_found_hands(Path(self.hands), self.hands_from, self.side, stretch)
        if name is None:
            landmarks = self._landmarks(stretch)
            return lift_detected_landmarks(landmarks, stretch.first, stretch.footage.size, stretch.K, stretch.camera)
        side, values, near = self.side, dict[str, Sequence[object]](), {}
        if "{boxes}" in ESTIMATORS[name].words:  # it has a detector of its own, too
            try:
                landmarks = self._landmarks(stretch)
                side = side or landmarks.side
                values["boxes"] = [write_boxes_file(landmark_boxes(landmarks, stretch), self.folder / "boxes.json")]
            except GetagripError as error:
                print_note(f"{name} looks for the hand itself: {error}")
        if self.object_box is not None:
            followed_boxes = track_visible_box(stretch.footage.image, self.object_box, stretch.first, stretch.last)
            near = {n: (x, y, x + w, y + h) for n, (x, y, w, h) in followed_boxes}
            values["near"] = [write_boxes_file(stretch.numbered(near), self.folder / "object-boxes.json")]
        if side is not None:
            values["side"] = [side]
        return read_estimated_hands(name, run_draft_estimator(name, stretch, self.folder, values), side, stretch, near)

    def _landmarks(self, stretch: VideoInterval) -> HandLandmarks:
        """Find the hand's landmarks. Raises as ``run`` does."""
        import numpy as np

        from getagrip.io.terminal import progress_bar
        from getagrip.studio.hands import load_models
        from getagrip.studio.hands.detect_hands import find_landmarks

        nets, interval = load_models(self.models), (stretch.first, stretch.last)
        box = None if self.object_box is None else np.array(self.object_box)
        with progress_bar() as bar:
            job = bar.add_task("looking for hands", total=len(stretch.names))
            update = lambda n: bar.update(job, completed=n)  # noqa: E731
            return find_landmarks(stretch.footage, interval, nets, self.side, box, update)


def _labels_within_extent(drawn: Mapping[int, FrameLabels], extent: tuple[int, int]) -> dict[int, FrameLabels]:
    return {n: frame for n, frame in drawn.items() if extent[0] <= n <= extent[1]}
