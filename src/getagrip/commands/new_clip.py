"""``getagrip clip new``: a clip from the user's own video, masks, hands and mesh, as far as they are there.

A clip can be made in steps: without hands or masks it is written with its images, for which an estimator or a
segmentation can then be run; what is missing is listed, with how to get it.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from getagrip.commands.command import Command, FirstNumber, Labels, OptionalSide
from getagrip.commands.own_mesh import MeshOptions, read_own_mesh
from getagrip.errors import InputError, UsageError
from getagrip.geometry.distortion import Distortion
from getagrip.geometry.lens import Lens
from getagrip.io import files
from getagrip.io.arguments import Flag, Folder, OptionalFile
from getagrip.io.terminal import warn

if TYPE_CHECKING:
    from jaxtyping import Int, UInt8
    from numpy import ndarray

    from getagrip.clip import Clip, HandTrack
    from getagrip.clip.mask_request import MaskReader
    from getagrip.clip.segment_files import SegmentList
    from getagrip.hands.trackers import TrackedHands
    from getagrip.provenance import Provenance

MAX_CLIP_FRAMES = 20_000
"""Most frames of a clip; a stable grasp of minutes."""
INCOMPLETE_EXIT_STATUS = 3
"""Exit status where the clip is made, and lacks masks or hands, or most frames lack a hand, or its camera seems to be
of other images."""


MISSING_OPTION_HINTS = {
    "interval": "--interval START END: the frames between which the grasp is stable, counted from 1; "
    "getagrip annotate {video} --out DIR finds them; or all frames, for reconstruct --find-grasps",
    "side": "--side left|right: the hand that holds the object",
    "mesh": "--mesh FILE: the object's shape (.obj, .ply, .stl, .glb), a CAD, a scan, or what an image-to-3D tool "
    "makes of a frame; or --mesh KIND, as plate, for a shape of this package's own; with --size-mm or --diameter-mm if "
    "its size is known",
    "camera": "--K FX FY CX CY from a calibration, or --focal PX; --guess-focal if there is none: depth and size are "
    "then guesses, too",
}
"""How to get what a clip cannot be made without."""
NEXT_STEP_HINTS = {
    "masks": "masks of the object and the hand: SAM 2 or any segmentation of {out}/frames, as PNG labels, COCO "
    "or .npz; then getagrip import masks PATH --object LABEL --hand LABEL --clip {out}. Without a segmentation: "
    "getagrip annotate {video} --out DIR (docs/annotate.md)",
    "hands": "run an estimator on {out}/frames (docs/estimators.md); then getagrip import hands FILE... --from ... "
    "--clip {out}. Without an estimator: click joints in getagrip annotate {video} --out DIR (docs/annotate.md)",
}
"""How to get what can be added later; the page of ``annotate`` makes both at once."""


@dataclass(frozen=True, kw_only=True)
class NewClip(Command):
    """Make a clip of your own video, at once or in steps. What is still missing is listed, with how to get it."""

    video: Annotated[Positional[Path], arg(metavar="VIDEO|FOLDER")]
    """The video, undistorted or with --distortion; or a folder of its images, in the order of their numbers."""
    out: Folder
    """The clip's folder; its name is the clip's."""
    interval: Annotated[tuple[int, int] | None, arg(metavar="START END", help_behavior_hint="")] = None
    """First and last frame of the stable grasp or of the timeline, counted from 1."""
    side: OptionalSide = None
    """Side of the hand."""
    shape: Annotated[MeshOptions, arg(name="")] = field(default_factory=MeshOptions)
    category: Annotated[str | None, arg(metavar="WORD", help_behavior_hint="(default: KIND, or object)")] = None
    """Category of the object, in a word."""
    masks: Annotated[Path | None, arg(metavar="PATH", help_behavior_hint="")] = None
    """Masks, as for import masks, which can add them later."""
    mask_first: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: START)")] = None
    """The number that the masks give to frame START."""
    mask_images: Annotated[str, arg(metavar="NAME", help_behavior_hint="(default: all)")] = ""
    """Folder, or pattern of names, of the mask images to use, if there are several for a frame."""
    object: Labels = ()
    """Labels of the object in the masks."""
    ignore: Labels = ()
    """Labels of whatever hides the object, in the masks."""
    hand: Labels = ()
    """Labels of the hand that holds the object, in the masks. Its pixels are ignored as well, and --hands are refined
    against them."""
    hands: OptionalFile = None
    """A hand.npz, as import hands --out writes it; import hands can also add hands later."""
    hand_first: FirstNumber = None
    """The number that --hands gives to the first frame, if it counts from another start."""
    segments: OptionalFile = None
    """Segments of the clip, as annotate writes them; import segments can add them later."""
    still_camera: Flag = False
    """State that the camera did not move: the camera frame is then the world."""
    lens: Annotated[Lens, arg(name="")] = field(default_factory=Lens)
    """The camera. Not needed if the hand file has it."""
    distorted: Annotated[Distortion, arg(name="")] = field(default_factory=Distortion)
    images: Annotated[str, arg(metavar="NAME", help_behavior_hint="(default: all)")] = ""
    """Pattern of names of the images to use (rgb_*), if a folder has several sets of them."""
    fps: Annotated[float | None, arg(metavar="RATE", help_behavior_hint="(default: 30)")] = None
    """Frames per second of a folder of images; a video has its frames' own times."""
    overwrite: Flag = False
    """Replace a clip that is there already."""

    def run(self) -> int:
        """Write a clip.

        Returns 0 if it is complete, 3 if masks or hands are missing or there is a warning about its camera, 2 if
        required options are missing. Raises ``InputError`` for files that do not fit, ``UsageError`` where the folder
        exists, unless it is that of a clip to be overwritten.
        """
        import numpy as np

        from getagrip.clip import Clip
        from getagrip.clip.footage import footage_interval, size_and_rate
        from getagrip.clip.plausible import check_in_view
        from getagrip.clip.segment_files import add_segments
        from getagrip.clip.writing import missing_hand_provenance
        from getagrip.commands.hand_file import HandFile, camera_of
        from getagrip.commands.import_masks import report_masks

        if self.out.exists() and not self.overwrite:
            raise UsageError(f"{self.out}: exists already; --overwrite replaces it")
        if not files.is_portable_name(self.out.name):
            raise UsageError(f"--out must be a folder whose name can be the clip's (got {self.out})")
        size, fps = size_and_rate(self.video, self.fps, self.images)
        print(f"video: {size[0]} x {size[1]}, {fps:.6g} frames per second")
        hands = None if self.hands is None else HandFile.of(self.hands)
        has = {
            "interval": self.interval is not None,
            "side": self.side is not None,
            "mesh": self.shape.mesh is not None,
            "camera": self.lens.is_set or (hands is not None and hands.K is not None),
        }
        missing = [key for key, there in has.items() if not there]
        for key in missing:
            print(f"missing: {key}: {MISSING_OPTION_HINTS[key].format(video=self.video)}", file=sys.stderr)
        if missing or self.interval is None or self.side is None:
            return 2
        numbers = _interval_frame_numbers(self.interval)
        footage = footage_interval(self.video, numbers, size, fps, self.fps is not None, self.images)
        names = footage.names
        K, camera = camera_of(self.lens, hands, size)
        images, camera = footage.images(), replace(camera, text=camera.text + self.distorted.words)
        if self.distorted.words:
            images = map(self.distorted.removal(K, size), images)
        found = read_own_mesh(self.shape)
        found_hands = None if hands is None else hands.at(names, self.side, self.hand_first)
        of_hands: Provenance = {"hands": "none yet"}
        if hands is not None and found_hands is not None:
            check_in_view(hands.path, found_hands.track, np.tile(K, (len(found_hands.found), 1, 1)), size)
            of_hands = found_hands.provenance | missing_hand_provenance(names, found_hands.found)
        clip = Clip(
            folder=self.out,
            name=self.out.name,
            category=self.category or self.shape.kind or "object",
            side=self.side,
            fps=footage.fps,
            frames=names,
            times=footage.times,
            size=size,
            K=np.tile(K, (len(numbers), 1, 1)),
            mesh=found.mesh,
            scale="known" if found.sized else "free",
            hand=_empty_hand_track(len(numbers)),
            provenance={
                "source": f"{self.video.name}, frames {numbers[0]} to {numbers[-1]}",
                "camera": camera,
                **({"times": footage.rate} if footage.rate else {}),
                **found.provenance,
                "masks": _masks_source(self),
                **of_hands,
            },
        )
        clip = add_segments(clip, _read_new_segments(self, self.out))
        reader = None if self.masks is None else _open_clip_masks(self, names, size)
        visible = _write_new_clip(clip, found_hands, images, reader, self.out, self.overwrite)
        unsure = report_masks(reader, clip.frames, visible) if reader else 0
        return _print_new_clip(clip, self, found_hands, self.out) or unsure


def _read_new_segments(new: NewClip, out: Path) -> SegmentList:
    """Read the segments and the camera's motion; empty for a clip that is one stable grasp."""
    from getagrip.clip.segment_files import SegmentList, read_segment_list
    from getagrip.commands.import_segments import add_camera_statement

    listed = SegmentList(out, "segments", [], None)
    if new.segments is not None:
        listed = read_segment_list(new.segments, [out.name, new.video.stem])
    return add_camera_statement(listed, new.still_camera)


def _interval_frame_numbers(interval: tuple[int, int]) -> Int[ndarray, "T"]:
    import numpy as np

    first, last = interval
    if not 1 <= first < last or last - first >= MAX_CLIP_FRAMES:
        expected = f"two frames' numbers from 1, the later one last, at most {MAX_CLIP_FRAMES} apart"
        raise UsageError(f"--interval must be {expected} (got {first} {last})")
    return np.arange(first, last + 1)


def _empty_hand_track(frames: int) -> HandTrack:
    """Make a hand without vertices, which is not written."""
    import numpy as np

    from getagrip.clip import HandTrack

    none = np.zeros((frames, 0, 3))
    return HandTrack(none, np.zeros((0, 3), dtype=int), np.tile(np.eye(4), (frames, 1, 1)), {})


def _masks_source(new: NewClip) -> str:
    """Return the source of masks."""
    from getagrip.commands.import_masks import masks_provenance

    if new.masks is None:
        return "none yet"
    return masks_provenance(new.masks, new.object, new.ignore, new.hand, new.mask_images)


def _open_clip_masks(new: NewClip, names: tuple[str, ...], size: tuple[int, int]) -> MaskReader:
    """Open a reader of the masks of the clip's frames."""
    from getagrip.clip.mask_request import MaskRequest
    from getagrip.clip.mask_sources import open_masks
    from getagrip.clip.naming import renumber_frames

    assert new.masks is not None
    if new.mask_first is not None:
        names = renumber_frames(names, new.mask_first, "--mask-first")
    ask_first = "--mask-first" if new.mask_first is None else ""
    labels = new.object, new.ignore, new.hand
    request = MaskRequest(names, size, *labels, ask_first, not ask_first, new.mask_images, "--mask-images")
    return open_masks(new.masks, request)


def _write_new_clip(
    clip: Clip,
    hands: TrackedHands | None,
    images: Iterator[UInt8[ndarray, "H W 3"]],
    masks: MaskReader | None,
    out: Path,
    overwrite: bool,
) -> int:
    """Write the clip, its images and masks one by one, and read it again: a clip that is written is valid.

    Returns in how many frames masks show the object.
    """
    from getagrip.clip.writing import write_clip_contents, write_hand_at
    from getagrip.commands.import_masks import write_reader_masks

    visible = 0
    with files.new_folder(out, ("clip.json",) if overwrite else ()) as new:
        write_clip_contents(new, replace(clip, folder=None), None, images)  # an older clip may be in its folder
        if masks:
            visible = write_reader_masks(masks, clip.frames, new / "masks")
        if hands:
            write_hand_at(hands.track, clip.frames, hands.found, new / "hand.npz")
            _check_written_clip(new, masks is not None, out)
    return visible


def _check_written_clip(made: Path, masks: bool, out: Path) -> None:
    """Read the clip as everybody will. Raises ``InputError``, in the name of the folder that it is to have."""
    from getagrip.clip import read_clip, read_observed

    try:
        clip = read_clip(made)
        if masks:
            read_observed(clip)
    except InputError as error:
        inside = error.path.relative_to(made) if error.path.is_relative_to(made) else error.path
        raise InputError(out / inside, error.key, error.got, error.expected) from error


def _print_new_clip(clip: Clip, new: NewClip, hands: TrackedHands | None, out: Path) -> int:
    """Print what was made, what is a guess and what is missing; 3 where something is."""
    from getagrip.clip.intrinsics import camera_warning
    from getagrip.provenance import is_assumed

    print(f"{out}: {len(clip)} frames")
    if hands and len(hands.found) < len(clip):
        bare = len(clip) - len(hands.found)
        warn(
            f"no hand in {bare} of {len(clip)} frames, which are left out until they have one; "
            f"getagrip import hands ... --clip {out} --overwrite"
        )
    for key, text in clip.provenance.items():
        if is_assumed(text):
            warn(f"{key}: {text}")
    if warning := camera_warning(clip.K, clip.size):
        warn(f"camera: {warning}")
    missing = [key for key, there in (("masks", new.masks), ("hands", new.hands)) if there is None]
    for key in missing:
        print(f"missing: {key}: {NEXT_STEP_HINTS[key].format(out=out, video=new.video)}", file=sys.stderr)
    few_hands = hands is not None and 2 * len(hands.found) < len(clip)
    return INCOMPLETE_EXIT_STATUS if missing or warning or few_hands else 0
