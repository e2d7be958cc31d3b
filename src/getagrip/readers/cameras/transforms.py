"""Paths in JSON, camera to world, with OpenGL's cameras (x right, y up, z backward): nerfstudio's and Record3D's.

- **nerfstudio** (``transforms.json``; Polycam, KIRI, Spectacular AI and instant-ngp write it, too): ``frames`` with
  ``file_path`` and ``transform_matrix`` (4, 4); ``fl_x``, ``cx``, ``w`` and so on of all images or of each. Not metric.
- **Record3D** (``metadata.json`` of an unpacked recording): ``poses``, a quaternion (x, y, z, w) and a place of each
  image, counted from 0; ``K`` down its columns, ``perFrameIntrinsicCoeffs`` of each. Metric, y is up.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.io import arrays, files
from getagrip.io.files import Json
from getagrip.readers.cameras.camera_path import CameraPath, Pinhole
from getagrip.readers.cameras.phones import OPENGL_CAMERA_AXES

DISTORTION_KEYS = ("k1", "k2", "k3", "k4", "p1", "p2")


def read_nerfstudio(path: Path) -> CameraPath | None:
    """Read a ``transforms.json``, by its file or its folder; None for another file. Raises ``InputError``."""
    content, source = _read_camera_json(path, "transforms.json")
    frames = content.get("frames")
    if not isinstance(frames, list) or not all(isinstance(one, dict) and "transform_matrix" in one for one in frames):
        return None
    names = [one.get("file_path") for one in frames]
    if not all(isinstance(name, str) for name in names):
        raise InputError(source, "file_path", files.shorten_value(names[:3]), "the name of each frame's image")
    T = np.array([_finite_array(source, one, "transform_matrix", (4, 4)) for one in frames]).reshape(-1, 4, 4)
    each = [_pinhole_from_transforms(source, content | one) for one in frames]
    known = tuple(one for one in each if one is not None)
    one = not any(key in frame for frame in frames for key in ("fl_x", "camera_angle_x"))
    pinholes = () if len(known) < len(each) else known[:1] if one else known
    return CameraPath(
        "nerfstudio's transforms", source, T @ OPENGL_CAMERA_AXES, tuple(map(str, names)), pinholes=pinholes
    )


def read_record3d(path: Path) -> CameraPath | None:
    """Read the ``metadata.json`` of Record3D, by its file or its folder; None for another. Raises ``InputError``."""
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
    up = np.array([0.0, 1.0, 0.0])
    return CameraPath("Record3D's poses", source, T, pinholes=pinholes, metric=True, up=up)


def _read_camera_json(path: Path, *names: str) -> tuple[Json, Path]:
    """Read a JSON object, by its file or by that of one of these names in a folder; empty for others."""
    inside = [path / name for name in names if (path / name).is_file()] if path.is_dir() else [path]
    if not inside or inside[0].suffix.lower() not in (".json", ""):
        return {}, path
    if path.is_dir():
        files.inside(path, inside[0].name, "", "a camera's path")
    content = files.read_any_json(inside[0]) if files.read_bytes(inside[0]).lstrip()[:1] == b"{" else {}
    return content if isinstance(content, dict) else {}, inside[0]


def _pinhole_from_transforms(path: Path, content: Mapping[str, object]) -> Pinhole | None:
    """Convert the intrinsics of an image; None where they are not stated."""
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
    bent = any(content.get(key) for key in DISTORTION_KEYS) or "FISHEYE" in str(content.get("camera_model"))
    return Pinhole.of(fx, fy, cx, cy, size, bent)


def _image_side(path: Path, content: Mapping[str, object], key: str) -> int:
    side = float(_finite_array(path, content, key, ()))
    if not 1.0 <= side <= 1e5:
        raise InputError(path, key, f"{side:g}", "pixels, 1 to 100000")
    return round(side)


def _finite_array(path: Path, content: Mapping[str, object], key: str, shape: tuple[int, ...]) -> Float[ndarray, "..."]:
    """Check that a value is finite numbers of a shape. Raises ``InputError``."""
    value = arrays.from_lists(content.get(key))
    return arrays.floats(path, {} if value is None else {key: value}, key, shape, kinds="fi")
