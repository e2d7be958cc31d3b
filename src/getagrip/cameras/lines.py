"""Paths as lines of numbers.

- **TUM** (RGB-D benchmark; evo, ORB-SLAM): time, place, quaternion (x, y, z, w), camera to world.
- **KITTI** (odometry): the upper three rows of camera to world, row by row.

Neither says whether lengths are metres.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.cameras.camera_path import CameraPath
from getagrip.geometry import se3
from getagrip.io import files

LARGEST = 256 * 2**20


def read_tum(path: Path) -> CameraPath | None:
    """Read lines of 8 numbers; None for another file."""
    rows = _numbers(path, 8)
    if rows is None:
        return None
    T = se3.rigid(se3.from_quaternion(rows[:, [7, 4, 5, 6]]), rows[:, 1:4])
    return CameraPath("lines as of TUM's benchmark", path, T, times=rows[:, 0])


def read_kitti(path: Path) -> CameraPath | None:
    """Read lines of 12 numbers; None for another file."""
    rows = _numbers(path, 12)
    if rows is None:
        return None
    matrices = rows.reshape(-1, 3, 4)
    return CameraPath("lines as of KITTI's", path, se3.rigid(matrices[:, :, :3], matrices[:, :, 3]))


def _numbers(path: Path, count: int) -> Float[ndarray, "n count"] | None:
    """Read a file whose lines are all of ``count`` numbers, comments apart; None for another one."""
    if not path.is_file() or path.suffix.lower() not in (".txt", ".csv", ".tum", ".kitti", ".traj", ""):
        return None
    text = files.read_bytes(path, LARGEST).decode(errors="replace").replace(",", " ")
    lines = [line.split() for line in text.splitlines() if line.strip() and not line.startswith("#")]
    if not lines or any(len(words) != count for words in lines):
        return None
    try:
        rows = np.array(lines, dtype=float)
    except ValueError:
        return None
    return rows if np.isfinite(rows).all() else None
