"""CSV: a row per frame, poses as positions and unit quaternions (w, x, y, z)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.export.scene import CAMERA_AXES_NOTE, Scene, csv_text
from getagrip.geometry import se3
from getagrip.io import files
from getagrip.io.terminal import escape_cell

POSE_CSV_COLUMNS = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")


def write(scene: Scene, folder: Path) -> dict[str, str]:
    """Write ``poses.csv`` and, for hands with joints, ``joints.csv`` and ``other_joints.csv``."""
    columns = {name: _pose_rows(T) for name, T in scene.poses.items()}
    for other in scene.hands[1:]:
        columns["T_cam_other_hand"] = np.where(other.known[:, None], _pose_rows(other.T_cam_hand), np.nan)
    numbers = (f"{name}_{part}" for name in columns for part in POSE_CSV_COLUMNS)
    rows: list[list[object]] = [["frame", "time_s", *numbers, "angle_deg", "iou", "frame_kind"]]
    angle = np.full(len(scene.frames), np.nan) if scene.angle is None else np.degrees(scene.angle)
    poses = np.concatenate([*columns.values()], axis=1)
    for n, frame in enumerate(scene.frames):
        cells = ("" if np.isnan(x) else f"{x:.9g}" for x in (scene.time[n], *poses[n], angle[n], scene.iou[n]))
        rows.append([escape_cell(frame), *cells, scene.frame_kind[n]])
    files.write_bytes(folder / "poses.csv", csv_text(rows))
    rigid = "quaternions (w, x, y, z); the object's mesh is not scaled by poses"
    about = {"poses.csv": f"a row per frame; {CAMERA_AXES_NOTE}; {rigid}"}
    for hand, name in zip(scene.hands, ("joints.csv", "other_joints.csv"), strict=False):
        if (joints := hand.joints_in_camera) is not None:
            files.write_bytes(folder / name, _joints_csv(scene, joints, hand.known))
            about[name] = "a row per frame; 21 joints in the camera frame, metres; wrist, then thumb to pinky"
    return about


def _joints_csv(scene: Scene, joints: Float[ndarray, "T 21 3"], known: Bool[ndarray, "T"]) -> bytes:
    names = (f"joint{k:02d}_{axis}_m" for k in range(joints.shape[1]) for axis in "xyz")
    rows = [["frame", "time_s", *names]]
    for n in np.flatnonzero(known):
        rows.append([escape_cell(scene.frames[n]), *(f"{x:.9g}" for x in (scene.time[n], *joints[n].ravel()))])
    return csv_text(rows)


def _pose_rows(T: Float[ndarray, "T 4 4"]) -> Float[ndarray, "T 7"]:
    return np.concatenate([T[:, :3, 3], se3.quaternion(T[:, :3, :3])], axis=1)
