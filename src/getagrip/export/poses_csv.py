"""CSV: a row per frame, poses as positions and unit quaternions (w, x, y, z)."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.export.scene import AXES, Scene
from getagrip.geometry import se3
from getagrip.io import files

POSE = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")


def write(scene: Scene, folder: Path) -> dict[str, str]:
    """Write ``poses.csv`` and, where joints are known, ``joints.csv``."""
    columns = scene.poses
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(
        ["frame", "time_s", *(f"{name}_{part}" for name in columns for part in POSE), "angle_deg", "iou", "frame_kind"]
    )
    angle = np.full(len(scene.frames), np.nan) if scene.angle is None else np.degrees(scene.angle)
    poses = np.concatenate([_row(T) for T in columns.values()], axis=1)
    for n, frame in enumerate(scene.frames):
        numbers = [scene.time[n], *poses[n], angle[n], scene.iou[n]]
        rows.writerow([frame, *("" if np.isnan(x) else f"{x:.9g}" for x in numbers), scene.frame_kind[n]])
    files.write_bytes(folder / "poses.csv", text.getvalue().encode())
    about = {
        "poses.csv": f"a row per frame; {AXES}; quaternions (w, x, y, z); the object's mesh is not scaled by poses"
    }
    if (joints := scene.joints_in_camera) is not None:
        files.write_bytes(folder / "joints.csv", _joints(scene, joints).encode())
        about["joints.csv"] = "a row per frame; 21 joints in the camera frame, metres; wrist, then thumb to pinky"
    return about


def _joints(scene: Scene, joints: Float[ndarray, "T 21 3"]) -> str:
    """The joints' table."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["frame", "time_s", *(f"joint{k:02d}_{axis}_m" for k in range(joints.shape[1]) for axis in "xyz")])
    for n, frame in enumerate(scene.frames):
        rows.writerow([frame, *(f"{x:.9g}" for x in (scene.time[n], *joints[n].ravel()))])
    return text.getvalue()


def _row(T: Float[ndarray, "T 4 4"]) -> Float[ndarray, "T 7"]:
    """Position and quaternion."""
    return np.concatenate([T[:, :3, 3], se3.quaternion(T[:, :3, :3])], axis=1)
