"""ego-vision's result (``write_rerun_result_json``): joints in a world, and the camera in it, of every frame.

``hands_world`` holds for ``left`` and ``right`` ``joints_world`` (T, 21, 3) in OpenPose's order, NaN without a hand,
and ``infilled`` (T); ``camera_trajectory`` (T, 4, 4) is camera to world, ``intrinsics`` (T, 3, 3) or (3, 3) [px] are
ego-vision's assumption. MANO's parameters are smoothed independently of the joints, and not read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.io import arrays
from getagrip.provenance import assumed, estimated
from getagrip.readers.trackers import records
from getagrip.readers.trackers.estimates import Estimate, Estimates, Request, WeakPerspective
from getagrip.readers.trackers.read_hands import check_before_camera
from getagrip.readers.trackers.records import Sample, child, record_numbers
from getagrip.readers.trackers.tracker import Tracker, frames_of_images, only_file


@dataclass(frozen=True)
class EgoVision(Tracker):
    """ego-vision's joints in a world, transformed to its camera."""

    name = "ego-vision"
    takes = "its result (JSON)"
    looks_for = "hands_world and camera_trajectory"

    def recognises(self, sample: Sample) -> str:
        return "ego-vision's result" if sample.has("hands_world", "camera_trajectory", "joints_world") else ""

    def read(self, paths: Sequence[Path], request: Request) -> Estimates:
        path = only_file(paths, "hands")
        record = records.read_tracker_record(path)
        T_world_cam = record_numbers(path, record, "camera_trajectory", (-1, 4, 4))
        T = len(T_world_cam)
        K = np.broadcast_to(record_numbers(path, record, "intrinsics", (T, 3, 3), (3, 3)), (T, 3, 3))
        hand = child(path, child(path, record, "hands_world"), request.side)
        there, joints = _read_egovision_joints(path, hand, T)
        filled = record_numbers(path, hand, "infilled", (T,)) > 0.5 if "infilled" in hand else np.zeros(T, dtype=bool)
        joints = se3.transform(se3.inverse(T_world_cam[there]), joints)
        if len(joints):
            check_before_camera(path, joints)
        rows, found = frames_of_images(path, {}, T, request), []
        for n, points in zip(np.flatnonzero(there), joints, strict=True):
            if (frame := rows[n]) is None:
                continue
            focal = float(K[n, 0, 0])
            if not focal > 0:
                raise InputError(path, "intrinsics", f"the focal length {focal:g} in row {n}", "above 0 [px]")
            weak = WeakPerspective.of_translation(points[0], focal, K[n, :2, 2])
            moved = points - points[0] + weak.before(request.camera(frame))
            how = f"its focal length {focal:.4g} px divided out and the clip's put in"
            depth = assumed(f"a hand that it has filled in; {how}") if filled[n] else estimated(f"its joints; {how}")
            found.append(Estimate(path, frame, depth, None, moved))
        return Estimates(request.side, tuple(found), scale="the joints, as ego-vision has them")


def _read_egovision_joints(path: Path, hand: records.Record, frames: int) -> tuple[ndarray, Float[ndarray, "N 21 3"]]:
    """Return the mask of frames with a hand, and the joints in these frames [m]. Raises ``InputError``."""
    value = arrays.from_lists(records.without_none(hand.get("joints_world", [])))
    if value is None or value.dtype.kind not in "fiu" or value.shape != (frames, 21, 3):
        got = "no numbers" if value is None else f"the shape {value.shape}"
        raise InputError(path, "joints_world", got, f"numbers of shape {(frames, 21, 3)}")
    there = np.isfinite(value).all(axis=(1, 2))
    if not there.any():
        return there, np.zeros((0, 21, 3))
    return there, record_numbers(path, {"joints_world": value[there]}, "joints_world", (int(there.sum()), 21, 3))
