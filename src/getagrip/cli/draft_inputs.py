"""Hands and masks of a draft that are not made here: a user's files, or those of an estimator that is run for it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.cli.import_hands import HandFile
from getagrip.clip.depth import check_depth_shape
from getagrip.clip.match_frames import number_of, renumber_frames
from getagrip.clip.read_arrays import check_in_view
from getagrip.errors import InputError, MissingOptionError, UsageError, unknown_choice_error
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.hands.model import Side
from getagrip.io import arrays, files
from getagrip.provenance import Source
from getagrip.readers.depth_files import DEPTH_FORMATS, open_depth
from getagrip.readers.footage import Footage
from getagrip.readers.masks.mask_request import MaskRequest
from getagrip.readers.masks.mask_sources import open_masks
from getagrip.readers.trackers import TRACKERS, Request, TrackedHands, read_tracked_hands
from getagrip.readers.trackers.hawor import HaWoR
from getagrip.studio.hands import HandLandmarks
from getagrip.studio.hands.detect_hands import (
    DETECTED_HANDS_FOLDER,
    INPUTS_KEY,
    DetectedHands,
    HandDetectionFiles,
)
from getagrip.studio.jobs import ESTIMATORS, DepthFiles, check_estimator, estimators_making, run_estimator
from getagrip.studio.masks.polygon_drafts import trace_polygons
from getagrip.studio.store.labels import FrameLabels

Corners = tuple[float, float, float, float]
"""Left, top, right and bottom of a box [px]."""


@dataclass(frozen=True)
class VideoInterval:
    """Frames of a video, from 0, both ends included, and its camera."""

    footage: Footage
    first: int
    last: int
    K: Float[ndarray, "3 3"]
    camera: Source

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the frames in a clip."""
        return tuple(self.footage.name(n) for n in range(self.first, self.last + 1))

    def numbered(self, boxes: Mapping[int, Corners]) -> dict[str, Corners]:
        """Return boxes by the names of the images that ``write_images`` writes."""
        return {f"{_frame_number_in_name(self.names[n - self.first], n):06d}": box for n, box in boxes.items()}

    def request(self, side: Side, names: tuple[str, ...] | None = None) -> Request:
        """Make the request for the hand in all frames, under other names if these are given."""
        many = np.tile(self.K, (self.last - self.first + 1, 1, 1))
        return Request(side, names or self.names, many, self.footage.size, ask_first="" if names else "--interval")

    def write_images(self, folder: Path) -> Path:
        """Write the frames as JPEG, named by the numbers of their names."""
        folder.mkdir()
        for n, name in enumerate(self.names, start=self.first):
            files.write_bytes(folder / f"{_frame_number_in_name(name, n):06d}.jpg", self.footage.jpeg(n, whole=True))
        return folder


def _frame_number_in_name(name: str, n: int) -> int:
    """Return the number in a frame's name, or its place from 1."""
    number = number_of(name)
    return n + 1 if number is None else number


def check_source(option: str, given: str) -> None:
    """Raise ``UsageError`` for what is neither a file nor an estimator that is set up."""
    names = estimators_making(option)
    if given in names:
        check_estimator(given)
    elif not Path(given).exists():
        raise unknown_choice_error(f"--{option}", given, [*names, "a file or folder that exists"])


def open_depth_images(path: Path, form: str, first: int | None, stretch: VideoInterval) -> DepthFiles:
    """Return depth images of a video's frames. Raises ``InputError`` and ``UsageError`` where they are not.

    The first of them is read, so that one that does not fit is refused before any work.
    """
    names = stretch.names if first is None else renumber_frames(stretch.names, first, "--depth-first")
    if form not in DEPTH_FORMATS:
        raise unknown_choice_error("--depth-from", form, DEPTH_FORMATS)
    reader = open_depth(path, form, names, "--depth-first" if first is None else "", counted=first is not None)
    check_depth_shape(*reader.read(reader.known[0])[:2], stretch.footage.size)
    return DepthFiles(reader, stretch.names, DEPTH_FORMATS[form].source, f"from {path.name}, {form}")


def run_draft_estimator(
    name: str, stretch: VideoInterval, folder: Path, values: Mapping[str, Sequence[object]]
) -> Path:
    """Run an estimator on the frames; return the folder of its files, which is in ``folder``.

    Raises ``UsageError`` where it fails, and where the folder exists: it is the result of minutes.
    """
    from tempfile import TemporaryDirectory

    out = folder / name
    if out.exists():
        makes = ESTIMATORS[name].makes
        raise UsageError(f"{out}: exists already: --{makes} {out} reads it; remove it to run {name} again")
    with TemporaryDirectory() as temporary:
        images = stretch.write_images(Path(temporary) / "images")
        made = Path(temporary) / "made"
        made.mkdir()
        run_estimator(name, {**values, "images": [images], "K": stretch.K[[0, 1, 0, 1], [0, 1, 2, 2]].tolist()}, made)
        with files.new_folder(out) as new:
            for path in made.rglob("*"):
                if path.is_file() and not path.is_symlink():
                    target = new / path.relative_to(made)
                    target.parent.mkdir(parents=True, exist_ok=True)
                    target.write_bytes(path.read_bytes())
    return out


def landmark_boxes(landmarks: HandLandmarks, stretch: VideoInterval) -> dict[str, Corners]:
    """Return the box about the landmarks of each frame."""
    points = {stretch.first + row: landmarks.points[row] for row in landmarks.rows}
    return stretch.numbered({n: (*each.min(axis=0).tolist(), *each.max(axis=0).tolist()) for n, each in points.items()})


def write_boxes_file(boxes: Mapping[str, Corners], path: Path) -> Path:
    """Write boxes, as the estimators' scripts take them; return the absolute path."""
    files.write_json(path, dict(boxes))
    return path.absolute()


def read_found_hands(path: Path, source: str | None, side: Side | None, stretch: VideoInterval) -> DetectedHands:
    """Read the hand in a file or folder: a hand file or, with ``source``, what ``import hands --from`` reads.

    Raises ``InputError``, and ``UsageError`` for options that are missing.
    """
    if source is None and (path.is_dir() or path.suffix != ".npz"):
        which = ", ".join(TRACKERS)
        raise UsageError(f"missing --hands-from: the program that wrote {path}: {which} (without it, a hand file .npz)")
    own = HandFile.of(path) if source is None else None
    known = side or (own.side if own is not None else None)
    if known not in ("left", "right"):
        raise UsageError(f"missing --side: {path} does not say which hand it holds")
    which_side: Side = "left" if known == "left" else "right"
    if own is not None:
        return to_found_hands(path, own.at(stretch.names, which_side, None), which_side, stretch)
    if source is None or source not in TRACKERS:
        raise unknown_choice_error("--hands-from", source, TRACKERS)
    try:
        hands = read_tracked_hands([path], TRACKERS[source], stretch.request(which_side))
    except MissingOptionError as error:
        advice = "getagrip import hands has this option: --out FILE there, --hands FILE here"
        raise UsageError(f"{error} ({advice})") from error
    return to_found_hands(path, hands, which_side, stretch)


def read_own_hands(folder: Path, inputs: str, stretch: VideoInterval) -> DetectedHands | None:
    """Read the hands that an earlier draft has found in ``folder``; None unless by the same ``inputs``."""
    path = folder / DETECTED_HANDS_FOLDER / "hand.npz"
    if not inputs or not path.is_file() or path.is_symlink():
        return None
    try:
        if str(arrays.read(path, {INPUTS_KEY}.__contains__).get(INPUTS_KEY, "")) != inputs:
            return None
        own = HandFile.of(path)
        side: Side = "left" if own.side == "left" else "right"
        places = tuple(f"{n + 1:06d}" for n in range(stretch.first, stretch.last + 1))
        found = to_found_hands(path, own.at(places, side, None), side, stretch)
        return found if set(found.frames) <= set(HandDetectionFiles(path.parent).joints) else None
    except (InputError, UsageError):  # damaged: they are found again
        return None


def read_estimated_hands(
    name: str, out: Path, side: Side | None, stretch: VideoInterval, near: Mapping[int, Corners]
) -> DetectedHands:
    """Read what an estimator has written. Raises ``InputError``.

    Without a side, of two hands the one that is nearer to the object's boxes in the frames of ``near``, else the one in
    more frames.
    """
    if ESTIMATORS[name].reader != "hawor":
        return read_found_hands(out / "hand.npz", None, side, stretch)
    names = tuple(f"{n:06d}" for n in range(len(stretch.names)))  # it counts from 0, with a folder for each side
    sides: tuple[Side, ...] = ("left", "right") if side is None else (side,)
    found = []
    for each in sides:
        path = out / ("0" if each == "left" else "1")
        if side is not None or path.is_dir():
            hands = read_tracked_hands([path], HaWoR(float(stretch.K[0, 0])), stretch.request(each, names))
            found.append(to_found_hands(path, hands, each, stretch))
    if not found:
        raise InputError(out, "", "no hand", "a folder 0 (left) or 1 (right)")
    return min(found, key=lambda one: (_mean_box_distance(one, near), -len(one.frames)))


def _mean_box_distance(hands: DetectedHands, near: Mapping[int, Corners]) -> float:
    """Return the mean distance of a hand's joints from the object's boxes [px]; infinite where it is not known."""
    off = []
    for n, (x0, y0, x1, y1) in near.items():
        if n in hands.landmarks:
            points = hands.landmarks[n]
            off.append(float(np.linalg.norm(points - np.clip(points, [x0, y0], [x1, y1]), axis=1).mean()))
    return float(np.mean(off)) if off else np.inf


def to_found_hands(path: Path, hands: TrackedHands, side: Side, stretch: VideoInterval) -> DetectedHands:
    """Return hands as if they had been found here: their joints, seen or projected, are drawn on the page."""
    track, frames = hands.track, tuple(stretch.first + row for row in hands.found)
    check_in_view(path, track, np.tile(stretch.K, (len(frames), 1, 1)), stretch.footage.size)
    landmarks: dict[int, Float[ndarray, "21 2"]] = {}
    if track.joints is not None:
        points = project(stretch.K, se3.transform(track.T_cam_hand, track.joints))
        landmarks = dict(zip(frames, points, strict=True))
        confidence = np.zeros(points.shape[:2]) if track.joints_2d_confidence is None else track.joints_2d_confidence
        if track.joints_2d is not None:
            points = np.where(confidence[..., None] > 0.0, track.joints_2d, points)
        track = replace(track, joints_2d=points, joints_2d_confidence=confidence)  # without confidence only drawn
    return DetectedHands(track, side, frames, landmarks, stretch.K, {**hands.provenance, "camera": stretch.camera})


def read_mask_polygons(
    path: Path, stretch: VideoInterval, labels: Sequence[str], hand: Sequence[str], done: Callable[[int], None]
) -> dict[int, FrameLabels]:
    """Read masks of the frames, as polygons. Raises ``InputError``, and ``UsageError`` for labels."""
    request = MaskRequest(stretch.names, stretch.footage.size, tuple(labels), (), tuple(hand))
    drawn: dict[int, FrameLabels] = {}
    try:
        reader = open_masks(path, request)
        for row in range(len(stretch.names)):
            masks = reader(row)
            done(row + 1)
            if masks is not None:
                seen = None if masks.hand is None else tuple(trace_polygons(masks.hand))
                front = masks.ignore if masks.hand is None else masks.ignore & ~masks.hand
                shapes = tuple(trace_polygons(masks.object)), tuple(trace_polygons(front))
                drawn[stretch.first + row] = FrameLabels(object=shapes[0], front=shapes[1] or None, hand=seen)
    except InputError as error:
        raise InputError(
            error.path, error.key, _rename_mask_options(error.got), _rename_mask_options(error.expected)
        ) from error
    except UsageError as error:
        raise UsageError(_rename_mask_options(str(error))) from error
    if not any(frame.object for frame in drawn.values()):
        raise UsageError(f"{path}: no mask shows a pixel of the object in the frames of the interval")
    return drawn


def _rename_mask_options(text: str) -> str:
    """Return what a reader of masks says, with the names that its options have here."""
    return text.replace("--object", "--mask-object").replace("--hand", "--mask-hand")
