"""``getagrip clip new``: a clip from the user's own video, masks, hands and mesh, as far as they are there.

A clip can be made in steps: without hands or masks it is written with its images, for which an estimator or a
segmentation can then be run; what is missing is listed, with how to get it.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray

from getagrip.clip import Clip, HandTrack, read_clip, read_observed
from getagrip.clip.camera_of_image import doubt
from getagrip.clip.footage import size_and_rate, stretch
from getagrip.clip.intrinsics import Lens, intrinsics
from getagrip.clip.mask_request import MaskReader, MaskRequest
from getagrip.clip.mask_sources import open_masks
from getagrip.clip.naming import number_of
from getagrip.clip.numbering import check_numbers, renumbered
from getagrip.clip.plausible import check_in_view, check_intrinsics
from getagrip.clip.provenance import Provenance, Source, from_arrays, is_assumed, measured, of_provenance, warn_of
from getagrip.clip.reading import read_hand
from getagrip.clip.segment_files import SegmentList, read, with_segments
from getagrip.clip.writing import fill_folder, without_hand, write_hand_at
from getagrip.commands import own_mesh
from getagrip.commands.import_masks import provenance, report_masks, write_masks
from getagrip.commands.import_segments import stated
from getagrip.errors import InputError, UsageError
from getagrip.hands.model import Side
from getagrip.io import arrays, files
from getagrip.io.terminal import report

MOST_FRAMES = 20_000
"""Of a clip; a stable grasp of minutes."""
HAND_FIRST = "--hand-first"
INCOMPLETE = 3
"""Exit status where the clip is made, and lacks masks or hands, or most frames lack a hand, or its camera seems to be
of other images."""


@dataclass(frozen=True)
class Ingredients:
    """What a clip is made of; what is None is missing."""

    video: Path
    interval: tuple[int, int] | None
    """First and last frame, counted from 1."""
    side: Side | None
    category: str | None
    """What the object is; None for the kind of the mesh."""
    mesh: own_mesh.MeshRequest | None
    masks: Path | None
    mask_of_first: int | None
    """The number in the name of the first frame's mask; the frame's own where it is not given."""
    object: tuple[str, ...]
    ignore: tuple[str, ...]
    hand: tuple[str, ...]
    hands: Path | None
    lens: Lens
    segments: Path | None = None
    still_camera: bool = False
    """The camera did not move, as the user states."""
    fps: float | None = None
    """Frames per second of a folder of images; None where it is not stated."""
    hand_of_first: int | None = None
    """The number of the first frame's hand in the hand file; the frame's own where it is not given."""
    mask_images: str = ""
    """Which of the masks' images are meant where there are several of a frame."""


HOW = {
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
LATER = {
    "masks": "masks of the object and the hand: SAM 2 or any segmentation of {out}/frames, as PNG labels, COCO "
    "or .npz; then getagrip import masks PATH --object LABEL --hand LABEL --clip {out}. Without a segmentation: "
    "getagrip annotate {video} --out DIR (docs/annotate.md)",
    "hands": "run an estimator on {out}/frames (docs/estimators.md); then getagrip import hands FILE... --from ... "
    "--clip {out}. Without an estimator: click joints in getagrip annotate {video} --out DIR (docs/annotate.md)",
}
"""How to get what can be added later; the page of ``annotate`` makes both at once."""


def new_clip(given: Ingredients, out: Path, overwrite: bool) -> int:
    """Write a clip. Returns 0 when it is complete, 3 when masks or hands are yet to come or its camera is in doubt,
    2 when the call lacks what a clip cannot be made without.

    Raises ``InputError`` for what is there and does not fit, ``UsageError`` where the folder exists, unless it is that
    of a clip to be overwritten.
    """
    if out.exists() and not overwrite:
        raise UsageError(f"{out}: exists already; --overwrite replaces it")
    if not files.is_plain_name(out.name):
        raise UsageError(f"--out: got {out}, expected a folder whose name can be the clip's")
    size, fps = size_and_rate(given.video, given.fps)
    print(f"video: {size[0]} x {size[1]}, {fps:.6g} frames per second")
    hands = None if given.hands is None else _HandFile.of(given.hands)
    has = {
        "interval": given.interval is not None,
        "side": given.side is not None,
        "mesh": given.mesh is not None,
        "camera": given.lens.given or (hands is not None and hands.K is not None),
    }
    missing = [key for key, there in has.items() if not there]
    for key in missing:
        print(f"missing: {key}: {HOW[key].format(video=given.video)}", file=sys.stderr)
    if missing or given.interval is None or given.side is None or given.mesh is None:
        return 2
    numbers = _numbers(given.interval)
    footage = stretch(given.video, numbers, size, fps, given.fps is not None)
    names = footage.names
    K, camera = _camera(given.lens, hands, size)
    found = own_mesh.own_mesh(given.mesh)
    found_hands = None if hands is None else hands.at(names, given.side, given.hand_of_first)
    of_hands: Provenance = {"hands": "none yet"}
    if hands is not None and found_hands is not None:
        check_in_view(hands.path, found_hands.track, np.tile(K, (len(found_hands.rows), 1, 1)), size)
        of_hands = found_hands.provenance | without_hand(names, found_hands.rows)
    clip = Clip(
        folder=out,
        name=out.name,
        category=given.category or given.mesh.kind or "object",
        side=given.side,
        fps=footage.fps,
        frames=names,
        times=footage.times,
        size=size,
        K=np.tile(K, (len(numbers), 1, 1)),
        mesh=found.mesh,
        scale="known" if found.sized else "free",
        hand=_no_hand(len(numbers)),
        provenance={
            "source": f"{given.video.name}, frames {numbers[0]} to {numbers[-1]}",
            "camera": camera,
            **({"times": footage.rate} if footage.rate else {}),
            **found.provenance,
            "masks": _of_masks(given),
            **of_hands,
        },
    )
    clip = with_segments(clip, _segments(given, out))
    reader = None if given.masks is None else _masks(given, names, size)
    visible = _write(clip, found_hands, footage.images(), reader, out, overwrite)
    unsure = report_masks(reader, clip.frames, visible) if reader else 0
    return _summary(clip, given, found_hands, out) or unsure


def _segments(given: Ingredients, out: Path) -> SegmentList:
    """What is known of the segments and of the camera's motion; nothing at all of a clip that is one stable grasp."""
    listed = SegmentList(out, "segments", [], None)
    if given.segments is not None:
        listed = read(given.segments, [out.name, given.video.stem])
    return stated(listed, given.still_camera)


def _numbers(interval: tuple[int, int]) -> Int[ndarray, "T"]:
    first, last = interval
    if not 1 <= first < last or last - first >= MOST_FRAMES:
        expected = f"two frames' numbers from 1, the later one last, at most {MOST_FRAMES} apart"
        raise UsageError(f"--interval: got {first} {last}, expected {expected}")
    return np.arange(first, last + 1)


def _camera(lens: Lens, hands: _HandFile | None, size: tuple[int, int]) -> tuple[Float[ndarray, "3 3"], Source]:
    """The command's camera or, without one, the hand file's."""
    if lens.given or hands is None or hands.K is None:
        return intrinsics(lens, size)
    check_intrinsics(hands.path, hands.K[None], size)
    known = hands.provenance.get("camera", measured("it does not say from where"))
    return hands.K, replace(known, text=f"the hand file's: {known}")


@dataclass(frozen=True)
class _Hands:
    """The hands in some of the clip's frames."""

    track: HandTrack
    rows: tuple[int, ...]
    """Which of the frames these are."""
    provenance: Provenance


@dataclass(frozen=True)
class _HandFile:
    """A ``hand.npz`` that may also hold frame numbers, a side and a camera."""

    path: Path
    numbers: tuple[int, ...] | None
    K: Float[ndarray, "3 3"] | None
    side: str | None
    provenance: Provenance
    """Where its hands come from."""

    @staticmethod
    def of(path: Path) -> _HandFile:
        """Raises ``InputError``."""
        given = arrays.read(path, lambda key: key in {"frames", "K", "side"} or of_provenance(key))
        side = str(given["side"]) if "side" in given and given["side"].dtype.kind == "U" else None
        K = arrays.floats(path, given, "K", (3, 3)) if "K" in given else None
        return _HandFile(path, arrays.frame_numbers(path, given), K, side, from_arrays(path, given))

    def at(self, frames: tuple[str, ...], side: Side, first: int | None) -> _Hands:
        """The hands in those of the frames that have one; ``first`` is the number of the first frame's, where hands are
        counted from another start. Raises ``InputError``, and ``UsageError`` where they seem to be."""
        if self.side not in (None, side):
            raise InputError(self.path, "side", f"a {self.side} hand", f"a {side} hand, as --side says")
        sources = {"hands": f"from {self.path.name}", **self.provenance}
        sources.pop("camera", None)
        if self.numbers is None:
            return _Hands(read_hand(self.path, len(frames)), tuple(range(len(frames))), sources)
        track = read_hand(self.path, len(self.numbers))
        names = frames if first is None else renumbered(frames, first, HAND_FIRST)
        check_numbers(names, map(str, self.numbers), self.path, "hand", HAND_FIRST if first is None else "")
        place = {number: row for row, number in enumerate(self.numbers)}
        at = [None if number is None else place.get(number) for number in map(number_of, names)]
        rows = tuple(row for row, there in enumerate(at) if there is not None)
        if len(rows) < 2:
            given = f"hands in {len(rows)} frames of the interval"
            expected = f"hands in frames {number_of(names[0])} to {number_of(names[-1])}"
            raise InputError(self.path, "frames", given, expected)
        picked = track.take(np.array([there for there in at if there is not None]))
        return _Hands(picked, rows, sources)


def _no_hand(frames: int) -> HandTrack:
    """A hand without vertices, which is not written."""
    none = np.zeros((frames, 0, 3))
    return HandTrack(none, np.zeros((0, 3), dtype=int), np.tile(np.eye(4), (frames, 1, 1)), {})


def _of_masks(given: Ingredients) -> str:
    """Where masks come from."""
    if given.masks is None:
        return "none yet"
    return provenance(given.masks, given.object, given.ignore, given.hand, given.mask_images)


def _masks(given: Ingredients, names: tuple[str, ...], size: tuple[int, int]) -> MaskReader:
    """A reader of the masks of the clip's frames."""
    assert given.masks is not None
    if given.mask_of_first is not None:
        names = renumbered(names, given.mask_of_first, "--mask-first")
    ask_first = "--mask-first" if given.mask_of_first is None else ""
    labels = given.object, given.ignore, given.hand
    request = MaskRequest(names, size, *labels, ask_first, given.mask_images, "--mask-images")
    return open_masks(given.masks, request)


def _write(
    clip: Clip,
    hands: _Hands | None,
    images: Iterator[UInt8[ndarray, "H W 3"]],
    masks: MaskReader | None,
    out: Path,
    overwrite: bool,
) -> int:
    """Write the clip, its images and masks one by one, and read it again: a clip that is written is valid.

    Returns in how many frames masks show the object.
    """
    visible = 0
    with files.new_folder(out, ("clip.json",) if overwrite else ()) as new:
        fill_folder(new, clip, None, images)
        if masks:
            visible = write_masks(masks, clip.frames, new / "masks")
        if hands:
            write_hand_at(hands.track, clip.frames, hands.rows, new / "hand.npz")
            _check(new, masks is not None, out)
    return visible


def _check(made: Path, masks: bool, out: Path) -> None:
    """Read the clip as everybody will. Raises ``InputError``, in the name of the folder that it is to have."""
    try:
        clip = read_clip(made)
        if masks:
            read_observed(clip)
    except InputError as error:
        inside = error.path.relative_to(made) if error.path.is_relative_to(made) else error.path
        raise InputError(out / inside, error.key, error.given, error.expected) from error


def _summary(clip: Clip, given: Ingredients, hands: _Hands | None, out: Path) -> int:
    """Print what was made, what is a guess and what is missing; 3 where something is."""
    print(f"{out}: {len(clip)} frames")
    if hands and len(hands.rows) < len(clip):
        bare = len(clip) - len(hands.rows)
        print(
            f"warning: no hand in {bare} of {len(clip)} frames, which are left out until they have one; "
            f"getagrip import hands ... --clip {out} --overwrite",
            file=sys.stderr,
        )
    for key, text in clip.provenance.items():
        if is_assumed(text):
            report(warn_of(key, text))
    if doubted := doubt(clip.K, clip.size):
        report(f"warning: camera: {doubted}")
    missing = [key for key, there in (("masks", given.masks), ("hands", given.hands)) if there is None]
    for key in missing:
        print(f"missing: {key}: {LATER[key].format(out=out, video=given.video)}", file=sys.stderr)
    few_hands = hands is not None and 2 * len(hands.rows) < len(clip)
    return INCOMPLETE if missing or doubted or few_hands else 0
