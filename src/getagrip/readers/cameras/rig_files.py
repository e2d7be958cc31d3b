"""Rigs by this package's own JSON, Kalibr's camchain and DexYCB's calibration.

- **cameras.json**: for each camera by name ``T_world_cam`` (4, 4), camera to world [m], ``K`` (3, 3) or ``fx``, ``fy``,
  ``cx``, ``cy`` [px from the corner of the first pixel], optionally ``size`` (width, height), ``distortion`` (OpenCV's
  coefficients) and ``fisheye``.
- **Kalibr** (``camchain.yaml``): ``cam0``, ``cam1`` ... with ``intrinsics``, ``resolution``, ``distortion_model`` and
  ``distortion_coeffs``; ``T_cn_cnm1`` takes points of the camera before into this camera's frame [m], else
  ``T_cam_imu`` those of the IMU. Pixel centres are whole numbers.
- **DexYCB** (``extrinsics.yml`` beside ``../intrinsics/<serial>_640x480.yml``): (3, 4) of each serial, camera to the
  frame of one of the cameras [m]. Pixel centres are whole numbers.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.lens import N_DISTORTION_COEFFICIENTS, Distortion
from getagrip.io import arrays, files
from getagrip.io.files import printable, shorten_value
from getagrip.readers.cameras.camera_path import Pinhole
from getagrip.readers.cameras.rig import Rig, RigCamera

OWN_KEYS = ("T_world_cam", "K", "fx", "fy", "cx", "cy", "size", "distortion", "fisheye")
KALIBR_LENSES = {"radtan": False, "equidistant": True, "equi": True, "none": False}
"""Models of lenses: True for fisheye lenses."""
YAML_SUFFIXES = (".yaml", ".yml")
MAX_SIDE_PX = 100_000


def numbers(path: Path, key: str, value: object, shape: tuple[int, ...]) -> Float[ndarray, "..."]:
    """Return finite numbers of a shape, -1 for any length. Raises ``InputError``."""
    array = arrays.from_lists(list(value) if isinstance(value, tuple) else value)
    fits = array is not None and array.ndim == len(shape) and array.dtype.kind in "fiu"
    if array is None or not fits or not all(w in (-1, n) for n, w in zip(array.shape, shape, strict=True)):
        expected = f"numbers of shape {shape}" if shape else "a number"
        raise InputError(path, key, "nothing" if value is None else shorten_value(value), expected)
    if not np.isfinite(array).all():
        raise InputError(path, key, "NaN or infinite numbers", "finite numbers")
    return np.asarray(array, dtype=float)


def image_size(path: Path, key: str, value: object) -> tuple[int, int]:
    """Return width and height [px]. Raises ``InputError``."""
    width, height = numbers(path, key, value, (2,)).tolist()
    if min(width, height) < 1.0 or max(width, height) > MAX_SIDE_PX:
        raise InputError(path, key, shorten_value(value), f"width and height in pixels, 1 to {MAX_SIDE_PX}")
    return round(width), round(height)


def lens_of(path: Path, key: str, coefficients: object, fisheye: bool) -> Distortion:
    """Return a lens by OpenCV's coefficients; without distortion if these are 0. Raises ``InputError``."""
    values = numbers(path, key, coefficients, (-1,))
    counts = (4,) if fisheye else N_DISTORTION_COEFFICIENTS
    if not values.any() and not fisheye:
        return Distortion()
    if len(values) not in counts:
        expected = f"{' or '.join(map(str, counts))} of OpenCV's{' fisheye' if fisheye else ''} model"
        raise InputError(path, key, f"{len(values)} coefficients", expected)
    return Distortion(tuple(values.tolist()), fisheye)


def rigid(path: Path, key: str, value: object) -> Float[ndarray, "4 4"]:
    """Return a rigid motion, its rotation made exact. Raises ``InputError``."""
    T = numbers(path, key, value, (4, 4))
    if not se3.is_rigid(T):
        raise InputError(path, key, "a matrix that is not a rigid motion", "a rotation and a translation")
    return np.asarray(se3.rigid(se3.nearest_rotation(T[:3, :3]), T[:3, 3]))


def _is_own_camera(value: object) -> bool:
    return isinstance(value, dict) and OWN_KEYS[0] in value


def read_own_rig(path: Path) -> Rig | None:
    """Read cameras by name from a JSON file, or a folder's ``cameras.json``; None for others. Raises ``InputError``."""
    source = path / "cameras.json" if path.is_dir() else path
    if source.suffix.lower() != ".json" or not source.is_file():
        return None
    if path.is_dir():
        files.inside(path, source.name, "", "the cameras")
    content = files.read_any_json(source)
    if not isinstance(content, dict) or not any(
        isinstance(one, dict) and OWN_KEYS[0] in one for one in content.values()
    ):
        return None
    cameras = []
    for name, one in content.items():
        shown = printable(name)
        if not isinstance(one, dict):
            raise InputError(source, shown, shorten_value(one), f"an object with {', '.join(OWN_KEYS)}")
        unknown = next((key for key in one if key not in OWN_KEYS), None)
        if unknown is not None:
            raise InputError(source, f"{shown}.{printable(unknown)}", "an unknown key", f"one of {', '.join(OWN_KEYS)}")
        if "K" in one:
            K = numbers(source, f"{shown}.K", one["K"], (3, 3))
        else:
            fx, fy, cx, cy = (float(numbers(source, f"{shown}.{key}", one.get(key), ())) for key in OWN_KEYS[2:6])
            K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        size = image_size(source, f"{shown}.size", one["size"]) if "size" in one else None
        if not isinstance(fisheye := one.get("fisheye", False), bool):
            raise InputError(source, f"{shown}.fisheye", shorten_value(fisheye), "true or false")
        lens = Distortion()
        if "distortion" in one:
            lens = lens_of(source, f"{shown}.distortion", one["distortion"], fisheye)
        T = rigid(source, f"{shown}.T_world_cam", one.get("T_world_cam"))
        cameras.append(RigCamera(name, Pinhole(K, size, lens), T))
    return Rig("cameras by name", source, tuple(cameras), metric=True)


def read_kalibr(path: Path) -> Rig | None:
    """Read Kalibr's camchain; None for other files. Raises ``InputError``."""
    if path.suffix.lower() not in YAML_SUFFIXES or not path.is_file():
        return None
    content = files.read_yaml(path)
    each = {
        key: value
        for key, value in content.items()
        if isinstance(key, str) and re.fullmatch(r"cam[0-9]{1,3}", key) and isinstance(value, dict)
    }
    if not each or any("intrinsics" not in one for one in each.values()):
        return None
    cameras, T_own_before = list[RigCamera](), np.eye(4)
    T_imu = None
    for n, name in enumerate(sorted(each, key=lambda name: int(name[3:]))):
        one = each[name]
        if one.get("camera_model", "pinhole") != "pinhole":
            got = shorten_value(one["camera_model"])
            raise InputError(path, f"{name}.camera_model", got, "pinhole; undistort the images, and calibrate these")
        if n == 0:
            T = np.eye(4)
            T_imu = rigid(path, f"{name}.T_cam_imu", one["T_cam_imu"]) if "T_cam_imu" in one else None
        elif "T_cn_cnm1" not in one and "T_cam_imu" in one and T_imu is not None:
            T = T_imu @ se3.inverse(rigid(path, f"{name}.T_cam_imu", one["T_cam_imu"]))
        else:
            T = T_own_before @ se3.inverse(rigid(path, f"{name}.T_cn_cnm1", one.get("T_cn_cnm1")))
        T_own_before = T
        cameras.append(RigCamera(name, _kalibr_pinhole(path, name, one), T))
    return Rig("Kalibr's camchain", path, tuple(cameras), metric=True)


def _kalibr_pinhole(path: Path, name: str, one: Mapping[str, object]) -> Pinhole:
    fx, fy, cx, cy = numbers(path, f"{name}.intrinsics", one["intrinsics"], (4,)).tolist()
    size = image_size(path, f"{name}.resolution", one["resolution"]) if "resolution" in one else None
    model = one.get("distortion_model", "none")
    if not isinstance(model, str) or model not in KALIBR_LENSES:
        raise InputError(path, f"{name}.distortion_model", shorten_value(model), " or ".join(KALIBR_LENSES))
    lens = Distortion()
    if model != "none":
        lens = lens_of(path, f"{name}.distortion_coeffs", one.get("distortion_coeffs"), KALIBR_LENSES[model])
    return Pinhole.of(fx, fy, cx + 0.5, cy + 0.5, size, lens)


def read_dexycb_rig(path: Path) -> Rig | None:
    """Read the cameras of an ``extrinsics.yml`` of DexYCB, or of its folder; None for others. Raises ``InputError``."""
    source = path / "extrinsics.yml" if path.is_dir() else path
    if source.name != "extrinsics.yml" or not source.is_file():
        return None
    content = files.read_yaml(files.inside(source.parent, source.name, "", "DexYCB's poses of cameras"))
    poses = content.get("extrinsics")
    if not isinstance(poses, dict) or not all(isinstance(key, str) for key in poses):
        return None
    intrinsics, cameras = source.parent.parent / "intrinsics", list[RigCamera]()
    found = {one.name.partition("_")[0]: one for one in files.list_files(intrinsics, YAML_SUFFIXES)}
    for serial, value in poses.items():
        if serial not in found:  # the tag on the table, and cameras that were replaced
            continue
        key = f"extrinsics.{printable(serial)}"
        rows = numbers(source, key, value, (12,)).reshape(3, 4)
        T = rigid(source, key, [*rows.tolist(), [0.0, 0.0, 0.0, 1.0]])
        cameras.append(RigCamera(serial, _dexycb_pinhole(intrinsics, found[serial]), T))
    if not cameras:
        got = f"no intrinsics of any of {len(poses)} cameras"
        raise InputError(intrinsics, "", got, "<serial>_<width>x<height>.yml of each, as in DexYCB's calibration")
    return Rig("DexYCB's calibration", source, tuple(cameras), metric=True)


def _dexycb_pinhole(folder: Path, file: Path) -> Pinhole:
    path = files.inside(folder, file.name, "", "the intrinsics of a camera")
    colour = files.read_yaml(path).get("color")
    of = colour if isinstance(colour, dict) else {}
    fx, fy, cx, cy = (float(numbers(path, f"color.{key}", of.get(key), ())) for key in ("fx", "fy", "ppx", "ppy"))
    stated = re.search(r"_([0-9]{1,6})x([0-9]{1,6})$", path.stem)
    size = (int(stated[1]), int(stated[2])) if stated else None
    return Pinhole.of(fx, fy, cx + 0.5, cy + 0.5, size)
