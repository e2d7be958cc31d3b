"""The parts of ``clip.json`` about each frame: its name, camera, time and camera pose."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip.data import World
from getagrip.clip.plausible import MAX_CAMERA_TRAVEL_M, check_camera_poses, check_intrinsics, check_times
from getagrip.errors import InputError
from getagrip.io import arrays, files

CLIP_CAMERA_KEYS = ("K", "T_world_cam", "world_up", "world_support")
"""Keys of ``camera``; the second and third since version 2, the last since version 3."""


def parse_frame_names(path: Path, names: object) -> tuple[str, ...]:
    """Check the frames' names: at least one, each a plain file name, none twice."""
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise InputError(path, "frames", files.shorten_value(names), "a list of names, one for each frame")
    bad = next((name for name in names if not files.is_portable_name(name)), None)
    if bad is not None:
        raise InputError(
            path, "frames", f"the name {files.shorten_value(bad)}", "names of files, without folder and suffix"
        )
    if len(set(names)) < len(names):
        twice = Counter(names).most_common(1)[0][0]
        raise InputError(path, "frames", f"the name {files.shorten_value(twice)} twice", "each frame once")
    return tuple(names)


def parse_intrinsics(
    path: Path, camera: dict[str, object], frames: int, size: tuple[int, int]
) -> Float[ndarray, "T 3 3"]:
    """Parse the pinhole intrinsics of each frame [px]."""
    K = _parse_matrices(path, "camera.K", camera["K"], 3, frames)
    check_intrinsics(path, K, size)
    return K


def parse_world(path: Path, camera: dict[str, object], frames: tuple[str, ...]) -> World | None:
    """Parse the camera's path in a frame that stands still; None where it is not known."""
    up = None if "world_up" not in camera else _numbers_to_array(camera["world_up"])
    if up is not None and not (up.shape == (3,) and abs(np.linalg.norm(up) - 1.0) < 1e-3):
        raise InputError(
            path, "camera.world_up", files.shorten_value(camera["world_up"]), "[x, y, z], a direction of length 1"
        )
    support = None if "world_support" not in camera else _numbers_to_array(camera["world_support"])
    if support is not None and not (support.shape == () and abs(support) <= MAX_CAMERA_TRAVEL_M):
        got = files.shorten_value(camera["world_support"])
        raise InputError(
            path,
            "camera.world_support",
            got,
            f"a height [m], at most {MAX_CAMERA_TRAVEL_M:g} m from the world's origin",
        )
    if support is not None and up is None:
        raise InputError(path, "camera.world_support", "it", "none without camera.world_up, along which it is")
    if "T_world_cam" not in camera:
        if up is not None:
            raise InputError(path, "camera.world_up", "it", "none without camera.T_world_cam, whose world it is in")
        return None
    T = _parse_matrices(path, "camera.T_world_cam", camera["T_world_cam"], 4, len(frames))
    check_camera_poses(path, T, frames)
    return World(T, up, None if support is None else float(support))


def parse_times(path: Path, value: object, frames: tuple[str, ...]) -> Float[ndarray, "T"]:
    """Parse the time of each frame [s]."""
    values = _numbers_to_array(value)
    if values.ndim != 1:
        raise InputError(path, "times", files.shorten_value(value), "a list of numbers [s], one for each frame")
    if len(values) != len(frames):
        raise InputError(path, "times", f"{len(values)} numbers", f"one for each of the {len(frames)} frames")
    check_times(path, values, frames)
    return values


def _parse_matrices(path: Path, key: str, value: object, rows: int, frames: int) -> Float[ndarray, "T rows rows"]:
    """Parse a square matrix of finite numbers for each frame, given once for all or for each."""
    values = _numbers_to_array(value)
    if values.shape[-2:] != (rows, rows) or values.ndim not in (2, 3):
        raise InputError(
            path, key, files.shorten_value(value), f"a {rows}x{rows} matrix of numbers, or one for each frame"
        )
    if values.ndim == 3 and len(values) != frames:
        raise InputError(path, key, f"{len(values)} matrices", f"one, or one for each of the {frames} frames")
    return np.broadcast_to(values, (frames, rows, rows)).copy()


def _numbers_to_array(value: object) -> Float[ndarray, "..."]:
    """Convert lists of numbers to an array; one without axes where they are none.

    JSON's reader has found the numbers to be finite.
    """
    values = arrays.from_lists(value)
    return np.array(np.nan) if values is None or values.dtype.kind not in "fi" else values.astype(float)
