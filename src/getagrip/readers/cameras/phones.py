"""Paths of devices: ARKit's, as 3D Scanner App saves them, and Project Aria's (MPS). Both are metric and know gravity.

- **ARKit**: a ``.json`` for each image with ``cameraPoseARFrame`` (16), camera to world row by row, its camera x right,
  y up, z backward; ``intrinsics`` (9) of the image. The world's y is up.
- **Aria MPS**: ``closed_loop_trajectory.csv``, poses of the device at about 1 kHz with gravity; the camera's place on
  the device is in ``online_calibration.jsonl`` beside it, label camera-rgb.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.io import files
from getagrip.io.files import Json
from getagrip.readers.cameras.camera_path import CameraPath, Pinhole

OPENGL_CAMERA_AXES = np.diag([1.0, -1.0, -1.0, 1.0])
MAX_ARIA_BYTES = 512 * 2**20
ARIA_RGB_LABEL = "camera-rgb"
ARIA_POSE_COLUMNS = [f"{axis}_world_device" for axis in ("tx", "ty", "tz", "qx", "qy", "qz", "qw")]
ARIA_GRAVITY_COLUMNS = [f"gravity_{axis}_world" for axis in "xyz"]
ARIA_TIME_COLUMN = "tracking_timestamp_us"


def read_arkit(path: Path) -> CameraPath | None:
    """Read a folder of 3D Scanner App; None for another."""
    found = files.list_files(path, (".json",), "frame_*") if path.is_dir() else []
    if not found:
        return None
    poses, names, pinholes = [], [], list[Pinhole]()
    for one in found:
        content = files.read_any_json(files.inside(path, one.name, "", "a frame of ARKit"))
        if not isinstance(content, dict) or "cameraPoseARFrame" not in content:
            return None
        poses.append(_finite_row(one, content, "cameraPoseARFrame", 16).reshape(4, 4) @ OPENGL_CAMERA_AXES)
        names.append(one.stem)
        if "intrinsics" in content:
            pinholes.append(Pinhole(_finite_row(one, content, "intrinsics", 9).reshape(3, 3), None))
    up = np.array([0.0, 1.0, 0.0])
    known = tuple(pinholes) if len(pinholes) == len(poses) else ()
    return CameraPath("ARKit's poses", path, np.array(poses), tuple(names), pinholes=known, metric=True, up=up)


def read_aria(path: Path) -> CameraPath | None:
    """Read a trajectory of Aria's MPS, by its file or a folder above it; None for another."""
    places = [path / "closed_loop_trajectory.csv", path / "slam" / "closed_loop_trajectory.csv"]
    source = path if path.is_file() else next((place for place in places if place.is_file()), None)
    if source is None or source.suffix.lower() != ".csv":
        return None
    heads, rows = files.csv_rows(source, files.read_bytes(source, MAX_ARIA_BYTES), "a trajectory")
    if not {ARIA_TIME_COLUMN, *ARIA_POSE_COLUMNS} <= {*heads}:
        return None
    try:
        values = np.array(
            [[float(row[key]) for key in (ARIA_TIME_COLUMN, *ARIA_POSE_COLUMNS)] for _, row in rows]
        ).reshape(-1, 8)
        down = (
            np.array([[float(row[key]) for key in ARIA_GRAVITY_COLUMNS] for _, row in rows])
            if {*ARIA_GRAVITY_COLUMNS} <= {*heads}
            else None
        )
    except (ValueError, TypeError) as error:
        raise InputError(source, "", f"no number ({error})", "a trajectory of Aria's MPS") from error
    T_world_device = se3.rigid(se3.from_quaternion(values[:, [7, 4, 5, 6]]), values[:, 1:4])
    T = T_world_device @ _camera_on_device(source.parent / "online_calibration.jsonl")
    up = None if down is None or not len(down) else -down.mean(axis=0) / np.linalg.norm(down.mean(axis=0))
    return CameraPath("Aria's MPS, of camera-rgb", source, T, times=values[:, 0] / 1e6, metric=True, up=up, unit=1e-6)


def _camera_on_device(path: Path) -> Float[ndarray, "4 4"]:
    """Read ``T_device_camera`` of the RGB camera, from the first line of a calibration. Raises ``InputError``."""
    line = files.read_bytes(files.inside(path.parent, path.name, "", "Aria's calibration"), MAX_ARIA_BYTES).partition(
        b"\n"
    )[0]
    try:
        each = json.loads(line)["CameraCalibrations"]
        pose = next(one["T_Device_Camera"] for one in each if one["Label"] == ARIA_RGB_LABEL)
        w, (x, y, z) = pose["UnitQuaternion"]
        q, t = np.array([w, x, y, z], dtype=float), np.array(pose["Translation"], dtype=float).reshape(3)
    except (ValueError, KeyError, TypeError, StopIteration) as error:
        raise InputError(path, "", "no T_Device_Camera of camera-rgb", "Aria's online calibration") from error
    return se3.rigid(se3.from_quaternion(q), t)


def _finite_row(path: Path, content: Json, key: str, count: int) -> Float[ndarray, "n"]:
    try:
        values = np.array(content[key], dtype=float)
    except (ValueError, TypeError):
        values = np.zeros(0)
    if values.shape != (count,) or not np.isfinite(values).all():
        raise InputError(path, key, files.shorten_value(content[key]), f"{count} numbers")
    return values
