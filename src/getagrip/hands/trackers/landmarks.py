"""2D landmarks of any tracker, as of MediaPipe, OpenPose, ViTPose or COCO-WholeBody, lifted to hands before the camera.

One file for all frames: ``joints_2d`` (T, 21, 2) [px of the clip's images], or (T, 21, 3) with the confidence, or with
``joints_2d_confidence`` (T, 21); NaN or null where not seen. ``world_landmarks`` (T, 21, 3) beside them, as of
MediaPipe, are the same about the hand's middle, in the camera's axes [m]; their depths are used. All of these trackers
have one order: wrist, then thumb, index, middle, ring and pinky, each from the palm to the tip. A .csv has ``frame``,
``x0``, ``y0`` to ``x20``, ``y20``, optionally ``c0`` to ``c20``. Or OpenPose's ``*_keypoints.json``, one per image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from tyro.conf import arg

from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.camera import backproject, project
from getagrip.hands.clicked_hands import ASSUMED_SCALE_NOTE
from getagrip.hands.lifted_hands import hands_from_landmarks
from getagrip.hands.trackers import landmark_files, records
from getagrip.hands.trackers.estimates import Estimate, Estimates, Request
from getagrip.hands.trackers.recognition import Sample
from getagrip.hands.trackers.tracker import Tracker, frames_of_rows, only_file
from getagrip.io import arrays, files
from getagrip.io.arguments import one_of
from getagrip.provenance import assumed

LANDMARKS_DEPTH_SOURCE = assumed("from the size of the generic hand and the clip's focal length")
MAX_NORMALISED_COORDINATE = 1.5
"""Coordinates up to here are shares of the image's sides, as MediaPipe gives them."""
WORLD_LANDMARKS_KEY = "world_landmarks"
MAX_LANDMARK_DEPTH_M = 0.5
"""No landmark is farther from the hand's middle [m]."""
OPENPOSE_SUFFIX = "_keypoints"
"""At the end of the names of OpenPose's files."""


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
        if landmark_files.is_mediapipe(sample.keys) or landmark_files.is_mmpose(sample.keys):
            return "MediaPipe's results" if landmark_files.is_mediapipe(sample.keys) else "MMPose's (ViTPose's)"
        return "2D landmarks" if "joints_2d" in sample.keys and "hand_pose" not in sample.keys else ""

    def read(self, paths: Sequence[Path], request: Request) -> Estimates:
        """Read the lifted hand in the clip's frames that have landmarks, or few frames between them."""
        seen, path, side_assumed = np.zeros((len(request.frames), 21, 4)), paths[0], False
        keys = frozenset[str]() if path.suffix.lower() == ".csv" else Sample(path).keys
        if landmark_files.is_mediapipe(keys) or landmark_files.is_mmpose(keys):
            swapped = None if self.sides is None else self.sides == "swapped"
            names, points, side_assumed = landmark_files.read_landmarks(paths, request.side, swapped)
            rows = {"frames": names} if names else {}
        elif path.stem.endswith(OPENPOSE_SUFFIX):
            read = [
                (path.stem.removesuffix(OPENPOSE_SUFFIX), _read_openpose_hand(path, request.side)) for path in paths
            ]
            rows = {"frames": [name for name, _ in read]}
            points = np.insert(np.array([found for _, found in read]), 3, np.nan, axis=-1)
        else:
            path = only_file(paths, "landmarks")
            rows = dict(
                _read_landmark_csv(path) if path.suffix.lower() == ".csv" else records.read_tracker_record(path)
            )
            found = records.seen_joints(path, rows, _count_landmark_frames(path, rows))
            if found is None:
                raise InputError(path, "joints_2d", "no such key", "the landmarks (T, 21, 2) [px]")
            points = np.insert(found, 3, _read_world_depths(path, rows, found.shape), axis=-1)
        for row, frame in enumerate(frames_of_rows(path, rows, len(points), request)):
            if frame is not None and seen[frame].any():
                got = f"a second row of frame {files.printable(request.frames[frame])}, row {row}"
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
        given = files.shorten_value(rows[WORLD_LANDMARKS_KEY]) if value is None else f"the shape {value.shape}"
        raise InputError(path, WORLD_LANDMARKS_KEY, given, f"numbers of shape {shape}")
    return np.asarray(value[..., 2], dtype=float)


def lift_image_landmarks(
    path: Path, seen: Float[ndarray, "T 21 4"], request: Request, side_assumed: bool = False
) -> Estimates:
    """Lift landmarks in the clip's images to hands: x, y, confidence and depth about the hand's middle [m].

    All are zero where there is no hand, depths NaN where unknown. Coordinates that are all small are shares of the
    image's sides.
    """
    there = seen[..., 2] > 0.0
    if not there.any():
        return Estimates(request.side, ())
    deepest = np.abs(seen[there][np.isfinite(seen[there][:, 3]), 3]).max(initial=0.0)
    if deepest > MAX_LANDMARK_DEPTH_M:
        raise InputError(
            path,
            WORLD_LANDMARKS_KEY,
            f"a depth of {deepest:.3g}",
            f"metres about the hand's middle, up to {MAX_LANDMARK_DEPTH_M}",
        )
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
    scale += "; coordinates up to 1 taken as shares of the image" if shares else ""
    return Estimates(request.side, tuple(hands), scale=scale, scale_assumed=True)


def _count_landmark_frames(path: Path, rows: records.Record) -> int:
    """How many frames there are. Raises ``InputError``."""
    try:
        return len(rows.get("joints_2d", ()))
    except TypeError as error:
        raise InputError(path, "joints_2d", files.shorten_value(rows["joints_2d"]), "an array (T, 21, 2)") from error


def _read_openpose_hand(path: Path, side: str) -> Float[ndarray, "21 3"]:
    """Read the hand of a side in an OpenPose file, of the person with the surest one; zeros without any."""
    people = records.read_tracker_record(path).get(records.PEOPLE_KEY, [])
    best = np.zeros((21, 3))
    for person in people if isinstance(people, list) else []:
        values = person.get(f"hand_{side}_keypoints_2d") if isinstance(person, dict) else None
        if values:
            hand = records.record_numbers(path, person, f"hand_{side}_keypoints_2d", (63,)).reshape(21, 3)
            best = max(best, hand, key=lambda each: float(each[:, 2].sum()))
    return best


def _read_landmark_csv(path: Path) -> records.Record:
    """Read a table of landmarks. Raises ``InputError``."""
    heads, rows = files.csv_rows(path, files.read_bytes(path, records.MAX_RECORD_BYTES), "a table of landmarks")
    columns = [f"{axis}{joint}" for joint in range(21) for axis in "xy"]
    missing = next((name for name in ("frame", *columns) if name not in heads), None)
    if missing or not rows:
        raise InputError(
            path, missing or "", "no such column" if missing else "no rows", "frame, x0, y0, ..., x20, y20"
        )

    def number(where: str, row: dict[str, str], key: str) -> float:
        try:
            return float(row[key] or "nan")
        except ValueError as error:
            raise InputError(path, where + key, files.shorten_value(row[key]), "a number") from error

    points = np.array([[number(*each, name) for name in columns] for each in rows]).reshape(-1, 21, 2)
    of_confidence = [f"c{k}" for k in range(21)] if "c0" in heads else []
    confidence = np.array([[number(*each, name) for name in of_confidence] for each in rows])
    found = {"frames": [row["frame"] for _, row in rows], "joints_2d": points}
    return found | ({"joints_2d_confidence": np.nan_to_num(confidence)} if of_confidence else {})
