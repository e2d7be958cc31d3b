"""Paths of SLAM programs, camera to world: ``.npz`` files, or lines of numbers.

- **ViPE** (``vipe_results``): ``pose/<video>.npz`` with ``data`` (N, 4, 4) and ``inds`` (N,), numbers of images from 0;
  ``intrinsics/<video>.npz`` likewise, (N, 4): fx, fy, cx, cy [px]. About metric.
- **MegaSaM**: ``cam_c2w`` (N, 4, 4), ``intrinsic`` (3, 3) of the size of ``images`` or ``depths``. Not metric.
- **HaWoR**: ``traj`` (N, 7), place and quaternion (x, y, z, w), with ``scale``, ``img_focal``, ``img_center``: metric.
  A ``traj`` without a scale, as of DROID-SLAM, is not.
- **TUM** (RGB-D benchmark; evo, ORB-SLAM): lines of time, place, quaternion (x, y, z, w). Metric or not.
- **KITTI** (odometry): lines of the upper three rows, row by row. Metric or not.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float, Shaped
from numpy import ndarray

from getagrip.cameras.camera_path import CameraPath, Pinhole
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.hands.trackers.hawor import slam_poses
from getagrip.io import arrays, files

SMALL = ("cam_c2w", "intrinsic", "traj", "scale", "img_focal", "img_center", "data", "inds")
"""Arrays that are read: images and depths, which such files hold as well, are not."""


def read_vipe(path: Path) -> CameraPath | None:
    """Read a folder of ViPE's results, or a file of its poses; None for another."""
    found = [path] if path.is_file() and path.parent.name == "pose" else files.listed(path / "pose", (".npz",))
    if not found or path.suffix not in ("", ".npz"):
        return None
    if len(found) > 1:
        raise InputError(path, "pose", f"the poses of {len(found)} videos", "one: name its file")
    pose = files.inside(found[0].parent, found[0].name, "", "ViPE's poses")
    record = arrays.read(pose, SMALL.__contains__)
    T, inds = arrays.floats(pose, record, "data", (-1, 4, 4)), _inds(pose, record)
    beside = pose.parent.parent / "intrinsics" / pose.name
    pinhole = None
    if beside.is_file():
        lens = arrays.floats(beside, arrays.read(beside, SMALL.__contains__), "data", (-1, 4))
        fx, fy, cx, cy = np.median(lens, axis=0).tolist()
        pinhole = Pinhole.of(fx, fy, cx, cy, (round(2.0 * cx), round(2.0 * cy)))
    return CameraPath("ViPE's poses", pose, T, tuple(map(str, inds)), pinhole=pinhole, metric=True)


def read_megasam(path: Path) -> CameraPath | None:
    """Read a file of MegaSaM's; None for another."""
    record = _record(path)
    if "cam_c2w" not in record:
        return None
    T = arrays.floats(path, record, "cam_c2w", (-1, 4, 4))
    pinhole = None
    if "intrinsic" in record:
        K = arrays.floats(path, record, "intrinsic", (3, 3))
        pinhole = Pinhole(K, (round(2.0 * K[0, 2]), round(2.0 * K[1, 2])))
    return CameraPath("MegaSaM's poses", path, T, pinhole=pinhole)


def read_hawor(path: Path) -> CameraPath | None:
    """Read HaWoR's SLAM, by its folder or its file, or another file with ``traj``; None without any."""
    if path.is_dir():
        found = sorted([*path.glob("SLAM/hawor_slam_w_scale_*.npz"), *path.glob("hawor_slam_w_scale_*.npz")])
        return read_hawor(files.inside(found[-1].parent, found[-1].name, "", "HaWoR's SLAM")) if found else None
    record = _record(path)
    if "traj" not in record:
        return None
    pinhole = None
    if "img_focal" in record and "img_center" in record:
        f, (cx, cy) = float(record["img_focal"]), np.asarray(record["img_center"], dtype=float).reshape(2)
        pinhole = Pinhole.of(f, f, cx, cy, (round(2 * cx), round(2 * cy)))
    metric = "scale" in record
    source = "HaWoR's SLAM" if metric else "poses (traj), as of DROID-SLAM"
    return CameraPath(source, path, slam_poses(path), pinhole=pinhole, metric=metric)


def _record(path: Path) -> dict[str, Shaped[ndarray, "..."]]:
    return arrays.read(path, SMALL.__contains__) if path.is_file() and path.suffix.lower() == ".npz" else {}


def _inds(path: Path, record: dict[str, Shaped[ndarray, "..."]]) -> list[int]:
    inds = record.get("inds")
    if inds is None or inds.ndim != 1 or inds.dtype.kind not in "iu" or len(inds) != len(record["data"]):
        raise InputError(path, "inds", "no such array" if inds is None else str(inds.shape), "a number for each pose")
    return [int(n) for n in inds]


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
