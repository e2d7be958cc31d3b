"""Camera-to-world trajectories of capture apps and devices.

- **nerfstudio** (``transforms.json``, also of Polycam, KIRI, Spectacular AI and instant-ngp): ``frames`` with
  ``file_path`` and ``transform_matrix`` (4, 4); ``fl_x``, ``cx``, ``w`` ... of all images or of each. Not metric.
- **Record3D** (``metadata.json`` of an unpacked recording): ``poses``, a quaternion (x, y, z, w) and a position of each
  image, counted from 0; ``K`` down its columns, ``perFrameIntrinsicCoeffs`` of each image. Metric, y is up.
- **ARKit** (3D Scanner App): a ``.json`` for each image with ``cameraPoseARFrame`` (16), row by row, and ``intrinsics``
  (9). Metric, y is up.
- **Aria MPS**: ``closed_loop_trajectory.csv``, poses of the device at about 1 kHz with gravity; the camera's mount on
  the device is in ``online_calibration.jsonl`` beside it, label camera-rgb. Metric.

The first three have OpenGL's cameras: x right, y up, z backward.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.lens import Distortion
from getagrip.io import arrays, files
from getagrip.io.files import Json, shorten_value
from getagrip.readers.cameras.camera_path import CameraPath, Pinhole

OPENGL_CAMERA_AXES = np.diag([1.0, -1.0, -1.0, 1.0])
Y_UP = np.array([0.0, 1.0, 0.0])
DISTORTION_KEYS = ("k1", "k2", "k3", "k4", "p1", "p2")
MAX_ARIA_BYTES = 512 * 2**20
ARIA_RGB_LABEL = "camera-rgb"
ARIA_COLUMNS = ["tracking_timestamp_us", *(f"{key}_world_device" for key in ("tx", "ty", "tz", "qx", "qy", "qz", "qw"))]
ARIA_GRAVITY_COLUMNS = [f"gravity_{axis}_world" for axis in "xyz"]


def read_nerfstudio(path: Path) -> CameraPath | None:
    """Read a ``transforms.json``, by its file or its folder; None for other files. Raises ``InputError``."""
    content, source = _read_camera_json(path, "transforms.json")
    frames = content.get("frames")
    if not isinstance(frames, list) or not all(isinstance(one, dict) and "transform_matrix" in one for one in frames):
        return None
    names = [one.get("file_path") for one in frames]
    if not all(isinstance(name, str) for name in names):
        raise InputError(source, "file_path", shorten_value(names[:3]), "the name of each frame's image")
    T = np.array([_finite_array(source, one, "transform_matrix", (4, 4)) for one in frames]).reshape(-1, 4, 4)
    each = [_pinhole_from_transforms(source, content | one) for one in frames]
    known = tuple(one for one in each if one is not None)
    one = not any(key in frame for frame in frames for key in ("fl_x", "camera_angle_x"))
    pinholes = () if len(known) < len(each) else known[:1] if one else known
    T = T @ OPENGL_CAMERA_AXES
    return CameraPath("nerfstudio's transforms", source, T, tuple(map(str, names)), pinholes=pinholes)


def read_record3d(path: Path) -> CameraPath | None:
    """Read the ``metadata.json`` of Record3D, by its file or its folder; None for others. Raises ``InputError``."""
    content, source = _read_camera_json(path, "metadata.json", "metadata")
    if not {"poses", "K", "w", "h"} <= {*content}:
        return None
    poses = _finite_array(source, content, "poses", (-1, 7))
    T = se3.rigid(se3.from_quaternion(poses[:, [3, 0, 1, 2]]), poses[:, 4:]) @ OPENGL_CAMERA_AXES
    size = _image_side(source, content, "w"), _image_side(source, content, "h")
    pinholes: tuple[Pinhole, ...] = (Pinhole(_finite_array(source, content, "K", (9,)).reshape(3, 3).T, size),)
    if content.get("perFrameIntrinsicCoeffs"):
        each = _finite_array(source, content, "perFrameIntrinsicCoeffs", (len(poses), 4))
        pinholes = tuple(Pinhole.of(fx, fy, cx, cy, size) for fx, fy, cx, cy in each.tolist())
    return CameraPath("Record3D's poses", source, T, pinholes=pinholes, metric=True, up=Y_UP)


def read_arkit(path: Path) -> CameraPath | None:
    """Read a folder of 3D Scanner App; None for other folders. Raises ``InputError``."""
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
    known = tuple(pinholes) if len(pinholes) == len(poses) else ()
    return CameraPath("ARKit's poses", path, np.array(poses), tuple(names), pinholes=known, metric=True, up=Y_UP)


def read_aria(path: Path) -> CameraPath | None:
    """Read a trajectory of Aria's MPS, by its file or a folder above; None for other paths. Raises ``InputError``."""
    places = [path / "closed_loop_trajectory.csv", path / "slam" / "closed_loop_trajectory.csv"]
    source = path if path.is_file() else next((place for place in places if place.is_file()), None)
    if source is None or source.suffix.lower() != ".csv":
        return None
    heads, rows = files.csv_rows(source, files.read_bytes(source, MAX_ARIA_BYTES), "a trajectory")
    if not {*ARIA_COLUMNS} <= {*heads}:
        return None
    gravity = ARIA_GRAVITY_COLUMNS if {*ARIA_GRAVITY_COLUMNS} <= {*heads} else []
    try:
        values = np.array([[float(row[key]) for key in (*ARIA_COLUMNS, *gravity)] for _, row in rows])
    except (ValueError, TypeError) as error:
        raise InputError(source, "", f"an invalid number ({error})", "a trajectory of Aria's MPS") from error
    values = values.reshape(-1, len(ARIA_COLUMNS) + len(gravity))
    T_world_device = se3.rigid(se3.from_quaternion(values[:, [7, 4, 5, 6]]), values[:, 1:4])
    T = T_world_device @ _camera_on_device(source.parent / "online_calibration.jsonl")
    down = values[:, len(ARIA_COLUMNS) :].mean(axis=0) if gravity and len(values) else None
    up = None if down is None else -down / np.linalg.norm(down)
    return CameraPath("Aria's MPS, of camera-rgb", source, T, times=values[:, 0] / 1e6, metric=True, up=up, unit=1e-6)


def _camera_on_device(path: Path) -> Float[ndarray, "4 4"]:
    """Read ``T_device_camera`` of the RGB camera, from the first line of a calibration. Raises ``InputError``."""
    content = files.read_bytes(files.inside(path.parent, path.name, "", "Aria's calibration"), MAX_ARIA_BYTES)
    try:
        each = json.loads(content.partition(b"\n")[0])["CameraCalibrations"]
        pose = next(one["T_Device_Camera"] for one in each if one["Label"] == ARIA_RGB_LABEL)
        w, (x, y, z) = pose["UnitQuaternion"]
        q, t = np.array([w, x, y, z], dtype=float), np.array(pose["Translation"], dtype=float).reshape(3)
    except (ValueError, KeyError, TypeError, StopIteration) as error:
        raise InputError(path, "", "no T_Device_Camera of camera-rgb", "Aria's online calibration") from error
    return se3.rigid(se3.from_quaternion(q), t)


def _read_camera_json(path: Path, *names: str) -> tuple[Json, Path]:
    """Read a JSON object, by its file or, in a folder, by one of some names; empty for other files."""
    inside = [path / name for name in names if (path / name).is_file()] if path.is_dir() else [path]
    if not inside or inside[0].suffix.lower() not in (".json", ""):
        return {}, path
    if path.is_dir():
        files.inside(path, inside[0].name, "", "a camera's path")
    content = files.read_any_json(inside[0]) if files.read_bytes(inside[0]).lstrip()[:1] == b"{" else {}
    return content if isinstance(content, dict) else {}, inside[0]


def _pinhole_from_transforms(path: Path, content: Mapping[str, object]) -> Pinhole | None:
    """Convert the intrinsics of an image; None if not stated."""
    if "fl_x" not in content and "camera_angle_x" not in content:
        return None
    size = None if not {"w", "h"} <= {*content} else (_image_side(path, content, "w"), _image_side(path, content, "h"))
    if "fl_x" in content:
        fx = float(_finite_array(path, content, "fl_x", ()))
    elif size is not None:
        fx = size[0] / 2.0 / math.tan(float(_finite_array(path, content, "camera_angle_x", ())) / 2.0)
    else:
        return None
    fy = float(_finite_array(path, content, "fl_y", ())) if "fl_y" in content else fx
    if size is None and not {"cx", "cy"} <= {*content}:
        return None
    middle = {"cx": 0.5 * size[0], "cy": 0.5 * size[1]} if size is not None else {}
    cx, cy = (float(_finite_array(path, middle | dict(content), key, ())) for key in ("cx", "cy"))
    return Pinhole.of(fx, fy, cx, cy, size, _lens_from_transforms(path, content))


def _lens_from_transforms(path: Path, content: Mapping[str, object]) -> Distortion | None:
    """Return an image's distortion; None if its model is not OpenCV's, whose fourth radial coefficient divides."""
    none = dict.fromkeys(DISTORTION_KEYS, 0.0)
    k1, k2, k3, k4, p1, p2 = (float(_finite_array(path, none | dict(content), key, ())) for key in DISTORTION_KEYS)
    model = str(content.get("camera_model"))
    if "FISHEYE" in model:
        return Distortion((k1, k2, k3, k4), True) if model == "OPENCV_FISHEYE" else None
    if k4:
        return None
    return Distortion((k1, k2, p1, p2, k3)) if any((k1, k2, k3, p1, p2)) else Distortion()


def _image_side(path: Path, content: Mapping[str, object], key: str) -> int:
    side = float(_finite_array(path, content, key, ()))
    if not 1.0 <= side <= 1e5:
        raise InputError(path, key, f"{side:g}", "pixels, 1 to 100000")
    return round(side)


def _finite_array(path: Path, content: Mapping[str, object], key: str, shape: tuple[int, ...]) -> Float[ndarray, "..."]:
    value = arrays.from_lists(content.get(key))
    return arrays.floats(path, {} if value is None else {key: value}, key, shape, kinds="fi")


def _finite_row(path: Path, content: Json, key: str, count: int) -> Float[ndarray, "n"]:
    try:
        values = np.array(content[key], dtype=float)
    except (ValueError, TypeError):
        values = np.zeros(0)
    if values.shape != (count,) or not np.isfinite(values).all():
        raise InputError(path, key, shorten_value(content[key]), f"{count} numbers")
    return values
