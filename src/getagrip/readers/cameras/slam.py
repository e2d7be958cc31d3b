"""Camera-to-world trajectories of SLAM programs: ``.npz`` files, or lines of numbers.

- **ViPE** (``vipe_results``): ``pose/<video>.npz`` with ``data`` (N, 4, 4) and ``inds`` (N,), numbers of images from 0;
  ``intrinsics/<video>.npz`` likewise, (N, 4): fx, fy, cx, cy [px]. About metric.
- **MegaSaM**: ``cam_c2w`` (N, 4, 4), ``intrinsic`` (3, 3) of the size of ``images`` or ``depths``. Not metric.
- **HaWoR**: ``traj`` (N, 7), position and quaternion (x, y, z, w), ``scale``, ``img_focal``, ``img_center``: metric.
  A ``traj`` without a scale, as of DROID-SLAM, is not.
- **TUM** (RGB-D benchmark; evo, ORB-SLAM): lines of time, position and quaternion (x, y, z, w). EuRoC and VINS-Fusion
  have w first, commas, and times in ns; a table may name its columns. Metric or not.
- **KITTI** (odometry): lines of the upper three rows, row by row. Metric or not.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float, Shaped
from numpy import ndarray

from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.io import arrays, files
from getagrip.io.files import shorten_value
from getagrip.readers.cameras.camera_path import CameraPath, Pinhole
from getagrip.readers.trackers.hawor import slam_poses

SLAM_ARRAYS = ("cam_c2w", "intrinsic", "traj", "scale", "img_focal", "img_center", "data", "inds")
"""Arrays to read; images and depths in the same files are left out."""


def read_vipe(path: Path) -> CameraPath | None:
    """Read a folder of ViPE's results, or a file of its poses; None for other paths. Raises ``InputError``."""
    found = [path] if path.is_file() and path.parent.name == "pose" else files.list_files(path / "pose", (".npz",))
    if not found or path.suffix not in ("", ".npz"):
        return None
    if len(found) > 1:
        raise InputError(path, "pose", f"the poses of {len(found)} videos", "one: name its file")
    pose = files.inside(found[0].parent, found[0].name, "", "ViPE's poses")
    record = arrays.read(pose, SLAM_ARRAYS.__contains__)
    T, inds = arrays.floats(pose, record, "data", (-1, 4, 4)), _image_indices(pose, record)
    beside = pose.parent.parent / "intrinsics" / pose.name
    pinholes: tuple[Pinhole, ...] = ()
    if beside.is_file():
        lens = arrays.floats(beside, arrays.read(beside, SLAM_ARRAYS.__contains__), "data", (-1, 4))
        if len(lens) != len(T):  # of some of the images
            lens = np.median(lens, axis=0)[None]
        sizes = np.rint(2.0 * lens[:, 2:]).astype(int)
        each = zip(lens.tolist(), sizes.tolist(), strict=True)
        pinholes = tuple(Pinhole.of(fx, fy, cx, cy, (w, h)) for (fx, fy, cx, cy), (w, h) in each)
    return CameraPath("ViPE's poses", pose, T, tuple(map(str, inds)), pinholes=pinholes, metric=True)


def read_megasam(path: Path) -> CameraPath | None:
    """Read a file of MegaSaM; None for other files. Raises ``InputError``."""
    record = _read_slam_arrays(path)
    if "cam_c2w" not in record:
        return None
    T = arrays.floats(path, record, "cam_c2w", (-1, 4, 4))
    pinholes: tuple[Pinhole, ...] = ()
    if "intrinsic" in record:
        K = arrays.floats(path, record, "intrinsic", (3, 3))
        pinholes = (Pinhole(K, (round(2.0 * K[0, 2]), round(2.0 * K[1, 2]))),)
    return CameraPath("MegaSaM's poses", path, T, pinholes=pinholes)


def read_hawor(path: Path) -> CameraPath | None:
    """Read HaWoR's SLAM, by its folder or its file, or another file with ``traj``; None without one."""
    if path.is_dir():
        found = sorted([*path.glob("SLAM/hawor_slam_w_scale_*.npz"), *path.glob("hawor_slam_w_scale_*.npz")])
        return read_hawor(files.inside(found[-1].parent, found[-1].name, "", "HaWoR's SLAM")) if found else None
    record = _read_slam_arrays(path)
    if "traj" not in record:
        return None
    pinholes: tuple[Pinhole, ...] = ()
    if "img_focal" in record and "img_center" in record:
        f, (cx, cy) = float(record["img_focal"]), np.asarray(record["img_center"], dtype=float).reshape(2)
        pinholes = (Pinhole.of(f, f, cx, cy, (round(2 * cx), round(2 * cy))),)
    metric = "scale" in record
    source = "HaWoR's SLAM" if metric else "poses (traj), as of DROID-SLAM"
    return CameraPath(source, path, slam_poses(path), pinholes=pinholes, metric=metric)


def _read_slam_arrays(path: Path) -> dict[str, Shaped[ndarray, "..."]]:
    return arrays.read(path, SLAM_ARRAYS.__contains__) if path.is_file() and path.suffix.lower() == ".npz" else {}


def _image_indices(path: Path, record: dict[str, Shaped[ndarray, "..."]]) -> list[int]:
    inds = arrays.array_from_names(record.get("inds"))
    if inds is None or inds.dtype.kind not in "iu" or len(inds) != len(record["data"]):
        got = shorten_value(record["inds"]) if "inds" in record else "no such array"
        raise InputError(path, "inds", got, "a number from 0 on for each pose")
    return [int(n) for n in inds]


MAX_TRAJECTORY_BYTES = 256 * 2**20


def read_tum(path: Path, quaternion: str = "") -> CameraPath | None:
    """Read lines of time, position and quaternion; None for other files.

    The first line may name the columns. ``quaternion`` is the user's ``xyzw`` or ``wxyz``; otherwise the order is found
    by the names, by EuRoC's commas, or by a first pose without rotation. Raises ``UsageError`` for an unclear order.
    """
    table = _read_number_table(path)
    if table is None:
        return None
    rows, heads, commas = table
    columns = _pose_columns(heads)
    if columns is None and rows.shape[1] != 8:
        return None
    unit, counted = _unit_of_time(rows[:, 0 if columns is None else columns[0]])
    stated, order = bool(quaternion), "as stated"
    if columns is not None:
        rows, order = rows[:, columns], "as named in it"
        quaternion = quaternion or "xyzw"
    elif not stated:
        quaternion, order = _quaternion_order(path, rows[0, 4:], commas, commas and unit == 1e-9)
    w_last = rows[:, 4:] if quaternion == "xyzw" or (columns is not None and not stated) else rows[:, [5, 6, 7, 4]]
    norms = np.linalg.norm(w_last, axis=1)
    if abs(norms - 1.0).max() > 0.05:
        raise InputError(path, "", f"quaternions of length {norms[abs(norms - 1.0).argmax()]:.3g}", "unit quaternions")
    T = se3.rigid(se3.from_quaternion(w_last[:, [3, 0, 1, 2]]), rows[:, 1:4])
    words = f"lines as of TUM's benchmark, quaternions {' '.join(quaternion)} {order}"
    words += f", times in {TIME_UNITS_S[unit]}" if unit != 1.0 else ", counted from their first line" if counted else ""
    return CameraPath(words, path, T, times=None if counted else unit * rows[:, 0], unit=unit)


TIME_UNITS_S = {1.0: "s", 1e-3: "ms", 1e-6: "us", 1e-9: "ns"}
"""Names of units of time, by their seconds."""
EPOCH_RANGE_S = (1e8, 1e10)
"""Plausible times since 1970 [s]."""
POSE_INTERVAL_RANGE_S = (1e-4, 10.0)
"""Plausible times between two poses [s]."""
UNROTATED_MIN_W, NEARLY_UNROTATED_MIN_W = 0.9999, 0.99
"""Minimum real parts of the quaternions of unrotated cameras."""


def _unit_of_time(values: Float[ndarray, "n"]) -> tuple[float, bool]:
    """Return the unit of times [s], and whether times count lines: whole numbers are not seconds since 1970."""
    steps = np.diff(np.sort(values))
    if not len(steps) or not np.array_equal(values, np.round(values)):
        return 1.0, False
    if values[0] in (0.0, 1.0) and np.all(np.diff(values) == 1.0):
        return 1.0, True
    largest, step = float(np.abs(values).max()), float(np.median(steps))
    usual = [unit for unit in TIME_UNITS_S if POSE_INTERVAL_RANGE_S[0] <= unit * step <= POSE_INTERVAL_RANGE_S[1]]
    since_1970 = next((unit for unit in usual if EPOCH_RANGE_S[0] <= unit * largest <= EPOCH_RANGE_S[1]), None)
    if since_1970 is not None:
        return since_1970, False
    return min(TIME_UNITS_S, key=lambda unit: abs(np.log(max(step, 1e-9) * unit * 30.0))), False


def _quaternion_order(path: Path, first: Float[ndarray, "4"], commas: bool, as_euroc: bool) -> tuple[str, str]:
    """Return the order of quaternions by the first pose, and the reason. Raises ``UsageError`` where it is unclear."""
    begins, ends = abs(first[0]), abs(first[3])
    if ends >= NEARLY_UNROTATED_MIN_W:
        return "xyzw", "by the first pose"
    if begins >= UNROTATED_MIN_W or as_euroc:
        return "wxyz", "as EuRoC's" if as_euroc else "by the first pose"
    if begins >= NEARLY_UNROTATED_MIN_W or commas:
        hint = "--quaternion xyzw (as TUM's) or wxyz, the order of its quaternions"
        raise UsageError(f"{path}: missing {hint}: its first pose is unrotated with w first, half a turn with w last")
    return "xyzw", "as TUM's, a guess"


def read_kitti(path: Path) -> CameraPath | None:
    """Read lines of 12 numbers; None for other files."""
    table = _read_number_table(path)
    if table is None or table[1] or table[0].shape[1] != 12:
        return None
    matrices = table[0].reshape(-1, 3, 4)
    return CameraPath("lines as of KITTI's", path, se3.rigid(matrices[:, :, :3], matrices[:, :, 3]))


def _read_number_table(path: Path) -> tuple[Float[ndarray, "n m"], list[str], bool] | None:
    """Read lines of equally many numbers, with the names of columns, and whether commas separate them; else None."""
    if not path.is_file() or path.suffix.lower() not in (".txt", ".csv", ".tum", ".kitti", ".traj", ""):
        return None
    text = files.read_text(path, MAX_TRAJECTORY_BYTES)
    lines, heads, commas = list[list[str]](), list[str](), False
    for line in filter(str.strip, text.splitlines()):
        words = re.sub(r"\[[^\]]*\]", "", line.lstrip("# ")).replace(",", " ").split()
        if line.startswith("#") or (not lines and any(word[0].isalpha() for word in words)):
            heads = [*heads, *words] if not lines and _pose_columns(words) is None else words
            continue
        commas |= "," in line
        lines.append(words)
    if not lines or any(len(words) != len(lines[0]) for words in lines):
        return None
    try:
        rows = np.array(lines, dtype=float)
    except ValueError:
        return None
    named = _pose_columns(heads)
    return (rows, heads if named and max(named) < rows.shape[1] else [], commas) if np.isfinite(rows).all() else None


def _pose_columns(heads: list[str]) -> list[int] | None:
    """Return the columns of time, x, y, z, and qx, qy, qz, qw by their names; None if one is missing."""
    found: dict[str, int] = {}
    for column, head in enumerate(heads):
        name = head.lower()
        if re.match(r"(time|stamp|ts\b|#?t$)", name):
            found.setdefault("t", column)
        elif re.fullmatch(r"(q|quat|orientation|rot)\w*[wxyz]", name):
            found.setdefault(f"q{name[-1]}", column)
        elif re.fullmatch(r"(t|p|pos|position|trans|translation)?_?(\w*_)?[xyz]", name):
            found.setdefault(name[-1], column)
    order = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")
    return [found[key] for key in order] if {*order} <= {*found} else None
