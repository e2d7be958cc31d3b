"""2D landmarks of any tracker, lifted to hands before the camera.

- **Arrays**, one file for all frames: ``joints_2d`` (T, 21, 2) [px of the clip's images], or (T, 21, 3) with the
  confidence, or with ``joints_2d_confidence`` (T, 21); NaN or null for unseen landmarks. ``world_landmarks``
  (T, 21, 3), as of MediaPipe, are relative to the hand's middle, in the camera's axes [m]; their depths are used. A
  .csv has ``frame``, ``x0``, ``y0`` to ``x20``, ``y20``, optionally ``c0`` to ``c20``.
- **OpenPose**: ``*_keypoints.json``, a file for each image.
- **MediaPipe**, JSON: ``hand_landmarks`` (or ``landmarks``), for each hand 21 of ``{"x", "y"}`` as fractions of the
  image's sides, with ``handedness``; or ``multi_hand_landmarks`` and ``multi_handedness`` of the older interface.
  World landmarks (``hand_world_landmarks`` ...) give the depth of each landmark relative to the hand's middle [m].
- **MMPose** (ViTPose), JSON: ``instances`` with ``keypoints`` [px] and ``keypoint_scores``: COCO-WholeBody's 133, or a
  hand's 21.

The order of landmarks is the same in all formats: wrist, then thumb, index, middle, ring and pinky, each from the palm
to the tip. A JSON file holds one image, and is named like it, or lists images: records with ``frame``, ``frame_id`` or
``frame_index``, or in the order of the clip's frames; ``instance_info`` may hold the list.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from tyro.conf import arg

from getagrip.errors import InputError, MissingOptionError
from getagrip.geometry import se3
from getagrip.geometry.camera import backproject, project
from getagrip.hands.from_2d.clicks import ASSUMED_SCALE_NOTE
from getagrip.hands.from_2d.landmarks import hands_from_landmarks
from getagrip.hands.model import Side
from getagrip.io import arrays, files
from getagrip.io.files import printable, shorten_value
from getagrip.io.options import one_of
from getagrip.provenance import assumed
from getagrip.readers.trackers import records
from getagrip.readers.trackers.estimates import Estimate, Estimates, Request
from getagrip.readers.trackers.records import Record, Sample
from getagrip.readers.trackers.tracker import Tracker, frames_of_rows, only_file

MEDIAPIPE_LANDMARK_KEYS = ("hand_landmarks", "handLandmarks", "landmarks", "multi_hand_landmarks")
MEDIAPIPE_WORLD_KEYS = (
    "hand_world_landmarks", "handWorldLandmarks", "worldLandmarks", "world_landmarks", "multi_hand_world_landmarks",
)  # fmt: skip
HANDEDNESS = ("handedness", "handednesses", "multi_handedness")
IMAGE_NAME_KEYS = ("frame", "frame_id", "frame_index", "image", "file_name")
WHOLE_BODY = {133: {"left": slice(91, 112), "right": slice(112, 133)}}
"""Rows of each hand among COCO-WholeBody's keypoints."""


class DetectedHand(NamedTuple):
    """A hand in an image: x, y, confidence, depth about its middle [m] (NaN: unknown); its side, empty if unnamed."""

    points: Float[ndarray, "21 4"]
    side: str
    in_mirror: bool = False
    """True if the side may refer to the mirrored image."""

    def may_be(self, side: Side, swapped: bool | None) -> bool:
        """Return whether the hand may be of a side; ``swapped`` as in ``read_landmarks``."""
        if not self.side or (self.in_mirror and swapped is None):
            return True
        return (self.side == side) != bool(self.in_mirror and swapped)


def is_mediapipe(keys: frozenset[str]) -> bool:
    """Return whether a file with these keys holds MediaPipe's results."""
    return bool(keys & {*MEDIAPIPE_LANDMARK_KEYS}) and bool(keys & {*HANDEDNESS})


def is_mmpose(keys: frozenset[str]) -> bool:
    """Return whether a file with these keys holds MMPose's predictions."""
    return {"keypoints", "keypoint_scores"} <= keys


def read_landmarks(
    paths: Sequence[Path], side: Side, swapped: bool | None
) -> tuple[list[str], Float[ndarray, "T 21 4"], bool]:
    """Read the landmarks of one side's hand.

    Returns the images' names (empty where their order counts), the points (zeros in images without the hand), and
    whether the side is assumed. ``swapped``: True if Left in the files means a right hand. Raises ``InputError``, and
    ``UsageError`` where ``swapped`` is needed.
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
    """List the images of a file: name (None if unnamed) and record."""
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
        raise InputError(path, "", shorten_value(value), "a record for each image")
    return value


def _read_mediapipe_hands(path: Path, content: Record) -> list[DetectedHand]:
    key = next((key for key in MEDIAPIPE_LANDMARK_KEYS if isinstance(content.get(key), list)), None)
    if key is None:
        return []
    listed: list[object] = next((content[key] for key in HANDEDNESS if isinstance(content.get(key), list)), [])
    labels = [_read_side_label(one) for one in listed]
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
    points = hand.get("landmark", hand.get("landmarks")) if isinstance(hand, Mapping) else hand
    rows = points if isinstance(points, list) and all(isinstance(point, Mapping) for point in points) else []
    values = arrays.from_lists([[point.get(axis) for axis in axes] for point in rows])
    if values is None or values.shape != (21, len(axes)) or values.dtype.kind not in "fiu":
        raise InputError(path, key, "another shape", f"21 landmarks with {' and '.join(axes)} for each hand")
    if not np.isfinite(values).all():
        raise InputError(path, key, "a number that is not finite", "21 landmarks of finite numbers for each hand")
    return values


def _read_side_label(value: object) -> str:
    while isinstance(value, list) and value:
        value = value[0]
    if isinstance(value, Mapping) and isinstance(value.get("classification"), list):
        return _read_side_label(value["classification"])
    if isinstance(value, Mapping):
        value = next((value[k] for k in ("category_name", "categoryName", "label", "displayName") if k in value), "")
    return str(value).lower() if str(value).lower() in ("left", "right") else ""


def _read_mmpose_hands(path: Path, content: Record) -> list[DetectedHand]:
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


LANDMARKS_DEPTH_SOURCE = assumed("from the size of the generic hand and the clip's focal length")
MAX_NORMALISED_COORDINATE = 1.5
"""Maximum coordinate that is a fraction of the image's sides, as of MediaPipe; larger ones are pixels."""
WORLD_LANDMARKS_KEY = "world_landmarks"
MAX_LANDMARK_DEPTH_M = 0.5
"""Maximum depth of a landmark relative to the hand's middle [m]."""
OPENPOSE_SUFFIX = "_keypoints"
"""Suffix of the names of OpenPose's files."""


@dataclass(frozen=True)
class Landmarks(Tracker):
    """2D landmarks, lifted to the generic hand."""

    name = "2D landmarks"
    takes = "21 of them in pixels (MediaPipe, OpenPose, ViTPose)"

    looks_for = "joints_2d; *_keypoints.json of OpenPose; hand_landmarks of MediaPipe; keypoints of MMPose"

    sides: Annotated[Literal["named", "swapped"] | None, one_of("named", "swapped"), arg(help_behavior_hint="")] = None
    """Sides in MediaPipe's files: as it names them, or swapped, if its images were not flipped."""

    def recognises(self, sample: Sample) -> str:
        if sample.path.suffix.lower() == ".csv" or sample.path.stem.endswith(OPENPOSE_SUFFIX):
            return "a table of landmarks" if sample.path.suffix.lower() == ".csv" else "OpenPose's keypoints"
        if is_mediapipe(sample.keys) or is_mmpose(sample.keys):
            return "MediaPipe's results" if is_mediapipe(sample.keys) else "MMPose's (ViTPose's)"
        return "2D landmarks" if "joints_2d" in sample.keys and "hand_pose" not in sample.keys else ""

    def read(self, paths: Sequence[Path], request: Request) -> Estimates:
        """Read the lifted hand in the clip's frames with landmarks, short gaps included."""
        seen, path, side_assumed = np.zeros((len(request.frames), 21, 4)), paths[0], False
        keys = frozenset[str]() if path.suffix.lower() == ".csv" else Sample(path).keys
        if is_mediapipe(keys) or is_mmpose(keys):
            swapped = None if self.sides is None else self.sides == "swapped"
            names, points, side_assumed = read_landmarks(paths, request.side, swapped)
            rows = {"frames": names} if names else {}
        elif path.stem.endswith(OPENPOSE_SUFFIX):
            names = [path.stem.removesuffix(OPENPOSE_SUFFIX) for path in paths]
            rows, hands = {"frames": names}, [_read_openpose_hand(path, request.side) for path in paths]
            points = np.insert(np.array(hands), 3, np.nan, axis=-1)
        else:
            path = only_file(paths, "landmarks")
            is_table = path.suffix.lower() == ".csv"
            rows = dict(_read_landmark_csv(path) if is_table else records.read_tracker_record(path))
            found = records.seen_joints(path, rows, _count_landmark_frames(path, rows))
            if found is None:
                raise InputError(path, "joints_2d", "no such key", "the landmarks (T, 21, 2) [px]")
            points = np.insert(found, 3, _read_world_depths(path, rows, found.shape), axis=-1)
        for row, frame in enumerate(frames_of_rows(path, rows, len(points), request)):
            if frame is not None and seen[frame].any():
                got = f"a second row of frame {printable(request.frames[frame])}, row {row}"
                raise InputError(path, "frames", got, "one row for each frame, of one hand")
            if frame is not None:
                seen[frame] = points[row]
        return lift_image_landmarks(path, seen, request, side_assumed)


def _read_world_depths(path: Path, rows: records.Record, shape: tuple[int, ...]) -> Float[ndarray, "T 21"]:
    """Read the depths of world landmarks, NaN where unknown. Raises ``InputError``."""
    if WORLD_LANDMARKS_KEY not in rows:
        return np.full(shape[:2], np.nan)
    value = arrays.from_lists(records.without_none(rows[WORLD_LANDMARKS_KEY]))
    if value is None or value.dtype.kind not in "fiu" or value.shape != shape:
        given = shorten_value(rows[WORLD_LANDMARKS_KEY]) if value is None else f"the shape {value.shape}"
        raise InputError(path, WORLD_LANDMARKS_KEY, given, f"numbers of shape {shape}")
    return np.asarray(value[..., 2], dtype=float)


def lift_image_landmarks(
    path: Path, seen: Float[ndarray, "T 21 4"], request: Request, side_assumed: bool = False
) -> Estimates:
    """Lift landmarks in the clip's images to hands: x, y, confidence and depth about the hand's middle [m].

    Frames without a hand are zero, unknown depths NaN. Coordinates that are all small are fractions of the image's
    sides. Raises ``InputError``.
    """
    there = seen[..., 2] > 0.0
    if not there.any():
        return Estimates(request.side, ())
    deepest = np.abs(seen[there][np.isfinite(seen[there][:, 3]), 3]).max(initial=0.0)
    if deepest > MAX_LANDMARK_DEPTH_M:
        expected = f"metres about the hand's middle, up to {MAX_LANDMARK_DEPTH_M}"
        raise InputError(path, WORLD_LANDMARKS_KEY, f"a depth of {deepest:.3g}", expected)
    shares = np.abs(seen[there][:, :2]).max() <= MAX_NORMALISED_COORDINATE
    if shares:
        seen = seen * [*request.size, 1.0, 1.0]
    K = request.K[0]
    as_seen = project(K, backproject(request.K, seen[..., :2]))
    found = hands_from_landmarks(as_seen, seen[..., 2], K, request.side, seen[..., 3])
    assert found.hand.joints is not None
    joints = se3.transform(found.hand.T_cam_hand, found.hand.joints)
    hands = (
        Estimate(path, frame, LANDMARKS_DEPTH_SOURCE, None, hand, seen=seen[frame, :, :3])
        for frame, hand in zip(found.rows, joints, strict=True)
    )
    scale = ASSUMED_SCALE_NOTE + (f"; that it is the {request.side} hand is a guess" if side_assumed else "")
    scale += "; coordinates up to 1 taken as fractions of the image" if shares else ""
    return Estimates(request.side, tuple(hands), scale=scale, scale_assumed=True)


def _count_landmark_frames(path: Path, rows: records.Record) -> int:
    try:
        return len(rows.get("joints_2d", ()))
    except TypeError as error:
        raise InputError(path, "joints_2d", shorten_value(rows["joints_2d"]), "an array (T, 21, 2)") from error


def _read_openpose_hand(path: Path, side: str) -> Float[ndarray, "21 3"]:
    """Read the hand of a side in an OpenPose file, of the person with the highest confidence; zeros without any."""
    people = records.read_tracker_record(path).get(records.PEOPLE_KEY, [])
    best = np.zeros((21, 3))
    for person in people if isinstance(people, list) else []:
        values = person.get(f"hand_{side}_keypoints_2d") if isinstance(person, dict) else None
        if values:
            hand = records.record_numbers(path, person, f"hand_{side}_keypoints_2d", (63,)).reshape(21, 3)
            best = max(best, hand, key=lambda each: float(each[:, 2].sum()))
    return best


def _read_landmark_csv(path: Path) -> records.Record:

    heads, rows = files.csv_rows(path, files.read_bytes(path, records.MAX_RECORD_BYTES), "a table of landmarks")
    columns = [f"{axis}{joint}" for joint in range(21) for axis in "xy"]
    missing = next((name for name in ("frame", *columns) if name not in heads), None)
    if missing or not rows:
        got = "no such column" if missing else "no rows"
        raise InputError(path, missing or "", got, "frame, x0, y0, ..., x20, y20")

    def number(where: str, row: dict[str, str], key: str) -> float:
        try:
            return float(row[key] or "nan")
        except ValueError as error:
            raise InputError(path, where + key, shorten_value(row[key]), "a number") from error

    points = np.array([[number(*each, name) for name in columns] for each in rows]).reshape(-1, 21, 2)
    of_confidence = [f"c{k}" for k in range(21)] if "c0" in heads else []
    confidence = np.array([[number(*each, name) for name in of_confidence] for each in rows])
    found = {"frames": [row["frame"] for _, row in rows], "joints_2d": points}
    return found | ({"joints_2d_confidence": np.nan_to_num(confidence)} if of_confidence else {})
