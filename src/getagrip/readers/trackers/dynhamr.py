"""Dyn-HaMR's ``*_world_results.npz``: MANO's parameters in a world, and the camera in it, for every track.

``root_orient`` (B, T, 3), ``pose_body`` (B, T, 15, 3), ``betas`` (B, 10), ``trans`` (B, T, 3) [m], ``is_right``
(B, T); ``cam_R`` (B, T, 3, 3) and ``cam_t`` (B, T, 3), world to camera; ``intrins`` (fx, fy, cx, cy) [px]. A left hand
is MANO's right hand, moved, then mirrored in x. Every frame of a track has a hand; files do not mark interpolated
hands. The layout is that of Dyn-HaMR's published code and of NVIDIA's reader.
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
from getagrip.hands.model import SIDE_MIRROR, Side
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
from getagrip.readers.trackers.hamer_demo import MANO_WRIST_M
from getagrip.readers.trackers.read_hands import load_mano
from getagrip.readers.trackers.records import Sample, record_numbers
from getagrip.readers.trackers.tracker import Tracker, frames_of_images, only_file


@dataclass(frozen=True)
class DynHaMR(Tracker):
    """Dyn-HaMR's hands in a world, transformed to its camera."""

    name = "Dyn-HaMR"
    takes = "its *_world_results.npz"
    looks_for = "root_orient, pose_body, trans, cam_R and cam_t, in *_world_results.npz"
    layouts = ("*_world_results.npz", "smooth_fit/*_world_results.npz")

    def recognises(self, sample: Sample) -> str:
        keys = ("root_orient", "pose_body", "trans", "cam_R", "cam_t", "is_right")
        return "Dyn-HaMR's results in the world" if sample.has(*keys) else ""

    def read(self, paths: Sequence[Path], request: Request) -> Estimates:
        path = only_file(paths[-1:], "hands")  # later numbers in names are later iterations of the fit
        record = records.read_tracker_record(path)
        hands, T = np.shape(record["is_right"]) if np.ndim(record.get("is_right", 0)) == 2 else (0, 0)
        if not hands or not T:
            raise InputError(path, "is_right", "no such array", "an array (hands, frames)")
        each: dict[str, ndarray] = {
            key: record_numbers(path, record, key, (hands, T, *shape)).reshape(hands, T, *shape)
            for key, shape in DYNHAMR_SHAPES.items()
        }
        betas = record_numbers(path, record, "betas", (hands, 10), (hands, T, 10)).reshape(hands, -1, 10)
        fx, _, cx, cy = record_numbers(path, record, "intrins", (4,))
        if min(fx, cx, cy) <= 0:
            raise InputError(path, "intrins", f"{fx:g}, {cx:g}, {cy:g}", "fx, fy, cx and cy above 0 [px]")
        depth = estimated(f"its translation, its focal length {fx:.6g} px divided out and the clip's put in")
        frames, found = frames_of_images(path, record, T, request), list[Estimate]()
        for hand in np.flatnonzero((each["is_right"].mean(axis=1) > 0.5) == (request.side == "right")):
            for n, frame in enumerate(frames):
                if frame is None:
                    continue
                shape = betas[hand, min(n, betas.shape[1] - 1)]
                R = se3.exp_so3(each["root_orient"][hand, n])
                pose, t = se3.exp_so3(each["pose_body"][hand, n]), each["trans"][hand, n]
                if request.side == "left":
                    R, pose, t = mirror_rotation(R), mirror_rotation(pose), t * SIDE_MIRROR
                T_cam_world = se3.rigid(each["cam_R"][hand, n], each["cam_t"][hand, n])
                R, t = world_to_camera_mano(T_cam_world, R, t, mano_root_joint(request.mano, request.side, shape))
                if not t[2] > 0:
                    raise InputError(path, "trans", f"a hand at the depth {t[2]:.3g} m", "hands before the camera")
                weak = WeakPerspective.of_translation(t, float(fx), np.array([cx, cy]))
                t = weak.resized(np.array(request.size) / (2.0 * np.array([cx, cy]))).before(request.camera(frame))
                found.append(Estimate(path, frame, depth, HandParameters(R, se3.log_so3(pose).reshape(45), shape, t)))
        return Estimates(request.side, tuple(found))


DYNHAMR_SHAPES = {
    "root_orient": (3,), "pose_body": (15, 3), "trans": (3,), "is_right": (), "cam_R": (3, 3), "cam_t": (3,),
}  # fmt: skip


def world_to_camera_mano(
    T_cam_world: Float[ndarray, "4 4"], R: Float[ndarray, "3 3"], t: Float[ndarray, "3"], root: Float[ndarray, "3"]
) -> tuple[Float[ndarray, "3 3"], Float[ndarray, "3"]]:
    """Transform MANO's global rotation and translation [m] from a world to a camera.

    MANO rotates a hand about its root joint: X_world = R (X - root) + root + t.
    """
    moved = se3.transform(T_cam_world, (root + t)[None])[0]
    return np.asarray(T_cam_world[:3, :3] @ R), np.asarray(moved - root)


def mano_root_joint(folder: Path | None, side: Side, betas: Float[ndarray, "10"]) -> Float[ndarray, "3"]:
    """Return the root joint of MANO's hand [m], the right hand mirrored for left ones; the mean hand without files."""
    model = load_mano(folder, "right")
    root = MANO_WRIST_M if model is None else model.model.with_shape(betas).joints[0]
    return np.asarray(root if side == "right" else root * SIDE_MIRROR)
