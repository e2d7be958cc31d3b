"""V2D's ``result/result.npz``: MANO's parameters before its camera, of both hands, in every frame of a video.

For each side ``hand_<side>_``: ``wrist_orient_in_camera`` (N, 3), ``finger_pose`` (N, 15, 3), ``betas`` (10),
``wrist_trans_in_camera`` (N, 3) [m], ``scale`` (N) and ``is_valid`` (N); ``camera_intrinsics`` (fx, fy, cx, cy) [px]. A
left hand is MANO's right one, mirrored in x, then moved. The layout is that of ``v2d.common.result_bundle``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.provenance import estimated
from getagrip.readers.trackers import records
from getagrip.readers.trackers.estimates import (
    Estimate,
    Estimates,
    HandParameters,
    Request,
    WeakPerspective,
    mirror_rotation,
)
from getagrip.readers.trackers.records import Sample, record_numbers
from getagrip.readers.trackers.tracker import Tracker, frames_of_images, only_file

V2D_CENTRE_TOLERANCE = 0.1
"""Maximum log ratio between twice the principal point and the size of the clip's images that is ignored."""


@dataclass(frozen=True)
class V2D(Tracker):
    """V2D's final hands."""

    name = "V2D"
    takes = "its result folder, or result.npz"
    looks_for = "hand_left_wrist_orient_in_camera, in result.npz"
    layouts = ("result.npz", "result/result.npz")

    def recognises(self, sample: Sample) -> str:
        keys = (f"hand_{side}_{key}" for side in ("left", "right") for key in V2D_SHAPES)
        return "V2D's result" if sample.has("camera_intrinsics", *keys) else ""

    def read(self, paths: Sequence[Path], request: Request) -> Estimates:
        """Read the hand of the requested side in the clip's frames with a valid hand."""
        path = only_file(paths, "hands")
        record, hand = records.read_tracker_record(path), f"hand_{request.side}_"
        N = len(record_numbers(path, record, f"{hand}is_valid", (-1,)))
        each = {key: record_numbers(path, record, hand + key, (N, *shape)) for key, shape in V2D_SHAPES.items()}
        betas = record_numbers(path, record, f"{hand}betas", (10,))
        fx, _, cx, cy = record_numbers(path, record, "camera_intrinsics", (4,))
        if min(fx, cx, cy) <= 0:
            raise InputError(path, "camera_intrinsics", f"{fx:g}, {cx:g}, {cy:g}", "fx, cx and cy above 0 [px]")
        zoom = np.array(request.size) / (2.0 * np.array([cx, cy]))
        if np.abs(np.log(zoom)).max() < V2D_CENTRE_TOLERANCE:
            zoom = np.ones(2)
        depth = estimated(f"its translation, its focal length {fx:.6g} px divided out and the clip's put in")
        found = []
        for n, frame in enumerate(frames_of_images(path, record, N, request)):
            if frame is None or each["is_valid"][n] < 0.5:
                continue
            t, scale = each["wrist_trans_in_camera"][n], float(each["scale"][n])
            if not (t[2] > 0 and scale > 0):
                got = f"the depth {t[2]:.3g} m and the scale {scale:g} in row {n}"
                raise InputError(path, hand, got, "both above 0")
            R = se3.exp_so3(each["wrist_orient_in_camera"][n])
            fingers = se3.exp_so3(each["finger_pose"][n])
            if request.side == "left":
                R, fingers = mirror_rotation(R), mirror_rotation(fingers)
            weak = WeakPerspective.of_translation(t / scale, float(fx), np.array([cx, cy]))  # as large in the image
            t = weak.resized(zoom).before(request.camera(frame))
            found.append(Estimate(path, frame, depth, HandParameters(R, se3.log_so3(fingers).reshape(45), betas, t)))
        return Estimates(request.side, tuple(found))


V2D_SHAPES = {
    "is_valid": (), "wrist_orient_in_camera": (3,), "finger_pose": (15, 3), "wrist_trans_in_camera": (3,), "scale": (),
}  # fmt: skip
