"""2D landmarks as trackers write them: MediaPipe's results and MMPose's (ViTPose's) predictions, as JSON.

- **MediaPipe**: ``hand_landmarks`` (or ``landmarks``), for each hand 21 of ``{"x", "y"}`` as shares of the image's
  sides, with ``handedness``; or ``multi_hand_landmarks`` and ``multi_handedness`` of its older interface. World
  landmarks beside them, ``hand_world_landmarks`` and so on, give the depth of each about the hand's middle [m].
- **MMPose**: ``instances`` with ``keypoints`` [px] and ``keypoint_scores``: COCO-WholeBody's 133, or a hand's 21.

A file is of one image, named like it, or lists its images: records with ``frame``, ``frame_id`` or ``frame_index``, or
in the order of the clip's frames; ``instance_info`` may hold the list.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import InputError, MissingOptionError
from getagrip.hands.model import Side
from getagrip.hands.trackers import records
from getagrip.hands.trackers.records import Record
from getagrip.io import arrays

MEDIAPIPE_LANDMARK_KEYS = ("hand_landmarks", "handLandmarks", "landmarks", "multi_hand_landmarks")
MEDIAPIPE_WORLD_KEYS = (
    "hand_world_landmarks", "handWorldLandmarks", "worldLandmarks", "world_landmarks", "multi_hand_world_landmarks",
)  # fmt: skip
HANDEDNESS = ("handedness", "handednesses", "multi_handedness")
IMAGE_NAME_KEYS = ("frame", "frame_id", "frame_index", "image", "file_name")
OPPOSITE_SIDE: dict[str, str] = {"left": "right", "right": "left"}
WHOLE_BODY = {133: {"left": slice(91, 112), "right": slice(112, 133)}}
"""Rows of each hand among COCO-WholeBody's keypoints."""


class DetectedHand(NamedTuple):
    """A hand in an image: x, y, confidence, depth about its middle [m] (NaN: unknown); its side, empty if unnamed."""

    points: Float[ndarray, "21 4"]
    side: str
    in_mirror: bool = False
    """True if the side may be that of the mirrored image."""

    def may_be(self, side: Side, swapped: bool | None) -> bool:
        """Return whether it may be the hand of a side; ``swapped`` as in ``read_landmarks``."""
        if not self.side or (self.in_mirror and swapped is None):
            return True
        return self.side == (OPPOSITE_SIDE[side] if self.in_mirror and swapped else side)


def is_mediapipe(keys: frozenset[str]) -> bool:
    """Return whether a file with these keys holds MediaPipe's results."""
    return bool(keys & {*MEDIAPIPE_LANDMARK_KEYS}) and bool(keys & {*HANDEDNESS})


def is_mmpose(keys: frozenset[str]) -> bool:
    """Return whether a file with these keys holds MMPose's predictions."""
    return {"keypoints", "keypoint_scores"} <= keys


def read_landmarks(
    paths: Sequence[Path], side: Side, swapped: bool | None
) -> tuple[list[str], Float[ndarray, "T 21 4"], bool]:
    """Read the landmarks of one side's hand: the names of images, or none where their order counts, and the points.

    Zeros where there is no such hand. ``swapped``: True if Left in the files means a right hand. Also return whether
    the side is assumed. Raises ``InputError``, and ``UsageError`` where it must be stated whether sides are swapped.
    """
    named, hands = list[str](), list[list[DetectedHand]]()
    for path in paths:
        images = _list_landmark_images(path)
        for name, content in images:
            named.append(path.stem if name is None and len(images) == 1 else name or "")
            hands.append(_read_mediapipe_hands(path, content) or _read_mmpose_hands(path, content))
    named = [] if len(paths) == 1 and not any(named[1:]) and len(named) > 1 else named
    in_mirror = [hand for seen in hands for hand in seen if hand.in_mirror and hand.side]
    if swapped is None and len({hand.side for hand in in_mirror}) > 1:
        raise MissingOptionError(
            "missing --sides (named or swapped): MediaPipe names hands as in a mirror: in images that were not "
            "flipped, its Left is the right hand"
        )
    chosen = np.zeros((len(hands), 21, 4))
    for row, seen in enumerate(hands):
        if of_side := [hand.points for hand in seen if hand.may_be(side, swapped)]:
            chosen[row] = max(of_side, key=lambda points: float(points[:, 2].sum()))
    return named, chosen, bool(in_mirror) and swapped is None


def _list_landmark_images(path: Path) -> list[tuple[str | None, Record]]:
    """Return the name of each image, None where there is none, and what the file has of it."""
    content = records.read_tracker_record(path)
    by_image = records.records_by_image(content)
    if by_image:
        return [(Path(name).stem, _require_mapping(path, one)) for name, one in by_image.items()]
    listed = next((content[key] for key in ("instance_info", records.PEOPLE_KEY, "frames") if key in content), None)
    if not isinstance(listed, list) or not listed:
        return [(None, content)]
    if "keypoints" in _require_mapping(path, listed[0]):  # of one image
        return [(None, {"instances": listed})]
    found = []
    for one in listed:
        name = next((_require_mapping(path, one)[key] for key in IMAGE_NAME_KEYS if key in one), None)
        found.append((None if name is None else Path(str(name)).stem, one))
    return found


def _require_mapping(path: Path, value: object) -> Record:
    if not isinstance(value, Mapping):
        raise InputError(path, "", "a list of other things", "a record for each image")
    return value


def _read_mediapipe_hands(path: Path, content: Record) -> list[DetectedHand]:
    """Read MediaPipe's hands in an image; none where it is not of MediaPipe."""
    key = next((key for key in MEDIAPIPE_LANDMARK_KEYS if isinstance(content.get(key), list)), None)
    if key is None:
        return []
    labels = [
        _read_side_label(one) for one in next((content[k] for k in HANDEDNESS if isinstance(content.get(k), list)), [])
    ]
    of_world = next((key for key in MEDIAPIPE_WORLD_KEYS if content.get(key) is not None), "")
    world, found = content.get(of_world), []
    if world is not None and not (isinstance(world, list) and len(world) == len(content[key])):
        raise InputError(path, of_world, "another number of hands", f"as many as in {key}")
    for n, hand in enumerate(content[key]):
        xy, side = _read_landmark_coordinates(path, key, hand, "xy"), labels[n] if n < len(labels) else ""
        depth = np.full((21, 1), np.nan) if world is None else _read_landmark_coordinates(path, of_world, world[n], "z")
        found.append(DetectedHand(np.column_stack([xy, np.ones(21), depth]), side, in_mirror=True))
    return found


def _read_landmark_coordinates(path: Path, key: str, hand: object, axes: str) -> Float[ndarray, "21 d"]:
    """Read some coordinates of a hand's landmarks."""
    points = hand.get("landmark", hand.get("landmarks")) if isinstance(hand, Mapping) else hand
    rows = points if isinstance(points, list) and all(isinstance(point, Mapping) for point in points) else []
    values = arrays.from_lists([[point.get(axis) for axis in axes] for point in rows])
    if values is None or values.shape != (21, len(axes)) or values.dtype.kind not in "fiu":
        raise InputError(path, key, "another shape", f"21 landmarks with {' and '.join(axes)} for each hand")
    if not np.isfinite(values).all():
        raise InputError(path, key, "a number that is not finite", "21 landmarks of finite numbers for each hand")
    return values


def _read_side_label(value: object) -> str:
    """Return the side that a hand's classification names, in small letters."""
    while isinstance(value, list) and value:
        value = value[0]
    if isinstance(value, Mapping) and isinstance(value.get("classification"), list):
        return _read_side_label(value["classification"])
    if isinstance(value, Mapping):
        value = next((value[k] for k in ("category_name", "categoryName", "label", "displayName") if k in value), "")
    return str(value).lower() if str(value).lower() in ("left", "right") else ""


def _read_mmpose_hands(path: Path, content: Record) -> list[DetectedHand]:
    """Read the hands of the people in an image."""
    found = []
    for one in content.get("instances", [content] if "keypoints" in content else []):
        keypoints = arrays.from_lists(_require_mapping(path, one).get("keypoints"))
        scores = arrays.from_lists(one.get("keypoint_scores"))
        count = 0 if keypoints is None else len(np.atleast_1d(keypoints))
        if keypoints is None or scores is None or keypoints.shape[1:] != (2,) or scores.shape != (count,):
            raise InputError(path, "keypoints", "another shape", "(N, 2), with keypoint_scores (N)")
        points = np.column_stack([keypoints, np.clip(scores, 0.0, 1.0), np.full(count, np.nan)]).astype(float)
        if count == 21:
            found.append(DetectedHand(points, ""))
        elif count in WHOLE_BODY:
            found += [DetectedHand(points[rows], side) for side, rows in WHOLE_BODY[count].items()]
        else:
            raise InputError(path, "keypoints", f"{count} of them", "133 (COCO-WholeBody) or a hand's 21")
    return found
