"""Poses in other systems' files: one 4x4 for each frame, in one file or in a file each, or BOP's results.

- ``.csv``: BOP's results; ``R`` row by row and ``t`` [mm] bring the model into the camera frame, ``im_id`` is the
  frame's number. Of several poses of an image one is followed (``at_frames``);
- ``.json``: a list of matrices, a dictionary with a matrix for each frame, or BOP's ``scene_gt`` (``cam_R_m2c``,
  ``cam_t_m2c`` [mm]);
- ``.npz``, or ``.json`` with the same keys: ``T_cam_obj`` or ``T_hand_obj`` (T, 4, 4), and perhaps ``scale`` and
  ``frames`` (names or numbers);
- ``.npy`` (T, 4, 4), ``.txt`` with 16 numbers for each frame, in any number of lines, or 12 in a line of each;
- a folder of ``.txt``, ``.npy`` or ``.json`` files of one matrix each, named like the frames.

Matrices are in metres, from the object's frame to the camera's (x right, y down, z forward), unless they are called
``T_hand_obj``. A matrix of NaN, or null in JSON, is a frame that was lost.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.io import arrays, files
from getagrip.io.files import Json

POSE_FILE_SUFFIXES = (".csv", ".npz", ".npy", ".json", ".txt")
SINGLE_POSE_SUFFIXES = (".txt", ".npy", ".json")
"""Suffixes of files that may hold one matrix."""
MAX_OBJECT_POSES_BYTES = 256 * 2**20
MAX_POSES = 1_000_000
"""In a text file, bounds its memory."""
BOP_COLUMNS = ("scene_id", "im_id", "obj_id", "score", "R", "t")
HOMOGENEOUS_ROW = (0.0, 0.0, 0.0, 1.0)
MISSING_POSE = np.full((4, 4), np.nan)


@dataclass(frozen=True)
class PoseFile:
    """The content of a file of poses."""

    path: Path
    T: Float[ndarray, "n 4 4"]
    """NaN in frames that were lost."""
    names: tuple[str, ...] | None
    """Names of the frames, or their numbers; None where the file does not name them."""
    in_hand: bool = False
    """True if the poses are in the clip's hand frame, not in the camera's."""
    scale: float | None = None
    candidates: tuple[Float[ndarray, "k 4 4"], ...] = ()
    """All poses of each row's image, where some images have several; empty where none has."""
    by_place: bool = False
    """True if numbers may stand for the places of frames that have no numbers, as in BOP's files."""


def read_pose_file(path: Path) -> PoseFile:
    """Read the poses in a file or folder. Raises ``InputError``."""
    if path.is_dir():
        return _read_pose_folder(path)
    if not path.exists():
        raise InputError(path, "", "no such file or folder", "poses of the object")
    suffix = path.suffix.lower()
    if suffix == ".csv":
        return _read_bop_results(path)
    if suffix == ".npz":
        return _read_pose_record(path, arrays.read(path, {"T_cam_obj", "T_hand_obj", "scale", "frames"}.__contains__))
    if suffix == ".npy":
        return PoseFile(
            path,
            _parse_pose_matrices(path, "", arrays.parse_npy(path, "", files.read_bytes(path, MAX_OBJECT_POSES_BYTES))),
            None,
        )
    if suffix == ".txt":
        return PoseFile(path, _parse_pose_matrices(path, "", _read_pose_text(path)), None)
    if suffix == ".json":
        return _read_pose_json(path)
    raise InputError(
        path, "", f"the suffix {files.shorten_value(path.suffix)}", f"one of {', '.join(POSE_FILE_SUFFIXES)}"
    )


def _read_pose_folder(folder: Path) -> PoseFile:
    """Read a folder with a matrix in each file."""
    paths = files.list_files(folder, SINGLE_POSE_SUFFIXES)
    if not paths:
        raise InputError(
            folder, "", "no poses in it", f"files named like the frames ({', '.join(SINGLE_POSE_SUFFIXES)})"
        )
    found = [read_pose_file(path) for path in paths]
    several = next((each for each in found if len(each.T) != 1), None)
    if several is not None:
        raise InputError(
            several.path, "", f"{len(several.T)} matrices", "one, of the frame that the file is named after"
        )
    return PoseFile(folder, np.concatenate([each.T for each in found]), tuple(path.stem for path in paths))


def _read_pose_text(path: Path) -> ndarray:
    content = files.read_bytes(path, MAX_OBJECT_POSES_BYTES)
    words = re.finditer(rb"[^\s,]+", content)  # one by one: a list takes 30 times the file
    numbers = (float(word[0].decode("utf-8", "replace")) for word in words)
    try:
        values = np.fromiter(islice(numbers, 16 * MAX_POSES + 1), float)
    except ValueError as error:
        raise InputError(path, "", f"a text that is no number ({error})", "12 or 16 numbers for each frame") from error
    if len(values) > 16 * MAX_POSES:
        raise InputError(path, "", f"more than {MAX_POSES} poses", f"at most {MAX_POSES}")
    wide = len(content.lstrip()[:4096].partition(b"\n")[0].replace(b",", b" ").split())
    if len(values) == 12 or (wide == 12 and len(values) % 12 == 0):
        return values.reshape(-1, 3, 4)
    if wide in (7, 8):
        got = f"lines of {wide} numbers"
        raise InputError(path, "", got, "16 for each frame, a 4x4 matrix: quaternions have no agreed order")
    if not len(values) or len(values) % 16:
        raise InputError(path, "", f"{len(values)} numbers", "16 for each frame")
    return values.reshape(-1, 4, 4)


def _read_pose_json(path: Path) -> PoseFile:
    content = files.read_any_json(path)
    if isinstance(content, list):
        return PoseFile(
            path,
            _parse_pose_matrices(path, "", [MISSING_POSE.tolist() if each is None else each for each in content]),
            None,
        )
    if not isinstance(content, dict) or not content:
        raise InputError(path, "", files.shorten_value(content), "a list of matrices, or a matrix for each frame")
    if {"T_cam_obj", "T_hand_obj"} & content.keys():
        return _read_pose_record(path, content)
    if all(isinstance(value, list) and value and isinstance(value[0], dict) for value in content.values()):
        return _read_bop_truth(path, content)
    T = [
        MISSING_POSE[None] if value is None else _parse_pose_matrices(path, name, value)
        for name, value in content.items()
    ]
    several = next((name for name, each in zip(content, T, strict=True) if len(each) != 1), None)
    if several is not None:
        raise InputError(path, files.printable(several), "several matrices", "one for each frame")
    return PoseFile(path, np.concatenate(T), tuple(content))


def _read_pose_record(path: Path, entry: Mapping[str, object]) -> PoseFile:
    key = next((key for key in ("T_cam_obj", "T_hand_obj") if key in entry), None)
    if key is None:
        raise InputError(path, "T_cam_obj", "no such array", "T_cam_obj or T_hand_obj (T, 4, 4)")
    T = _parse_pose_matrices(path, key, entry[key])
    names, scale = None, None
    if "frames" in entry:
        values = arrays.array_from_names(entry["frames"])
        if values is None or len(values) != len(T):
            raise InputError(
                path, "frames", files.shorten_value(entry["frames"]), f"{len(T)} names or numbers of frames"
            )
        names = tuple(str(value) for value in values)
    if "scale" in entry:
        value = arrays.from_lists(entry["scale"])
        if value is None or value.dtype.kind not in "fiu" or value.size != 1 or not 0 < float(value.item()) < np.inf:
            raise InputError(path, "scale", files.shorten_value(entry["scale"]), "one number above 0 for all frames")
        scale = float(value.item())
    return PoseFile(path, T, names, key == "T_hand_obj", scale)


def _read_bop_results(path: Path) -> PoseFile:
    """BOP's table of results. Raises ``InputError`` where it is of several scenes or objects."""
    heads, rows = files.csv_rows(path, files.read_bytes(path, MAX_OBJECT_POSES_BYTES), "BOP's results as CSV in UTF-8")
    if not {*BOP_COLUMNS} <= {*heads}:
        raise InputError(
            path, "line 1", files.shorten_value(heads), f"the columns {', '.join(BOP_COLUMNS)} of BOP's results"
        )
    each: dict[str, list[tuple[float, ndarray]]] = {}
    seen: dict[str, set[str]] = {"scene_id": set(), "obj_id": set()}
    for at, row in rows:
        where = at.rstrip(", ")
        for key, values in seen.items():
            values.add(str(row[key]))
            if len(values) > 1:
                raise InputError(
                    path, where, f"a second {key}, {files.printable(str(row[key]))}", "those of one clip's object"
                )
        score, T = _parse_pose_numbers(path, where, row["score"], 1)[0], np.eye(4)
        T[:3, :3], T[:3, 3] = (
            _parse_pose_numbers(path, where, row["R"], 9, "nan").reshape(3, 3),
            1e-3 * _parse_pose_numbers(path, where, row["t"], 3, "nan"),
        )
        if np.isnan(T).any():
            continue
        image = str(row["im_id"])
        each.setdefault(image, []).append((score, T))
    if not each:
        raise InputError(path, "", "no poses", "one for each frame")
    ranked = [np.array([T for _, T in sorted(of, key=lambda one: -one[0])]) for of in each.values()]
    several = tuple(ranked) if max(map(len, ranked)) > 1 else ()
    return PoseFile(path, np.array([T[0] for T in ranked]), tuple(each), candidates=several, by_place=True)


def _read_bop_truth(path: Path, content: Json) -> PoseFile:
    T = np.tile(np.eye(4), (len(content), 1, 1))
    for n, (image, objects) in enumerate(content.items()):
        if len(objects) > 1:
            raise InputError(path, files.printable(image), f"{len(objects)} objects", "that of the clip alone")
        for key, count in (("cam_R_m2c", 9), ("cam_t_m2c", 3)):
            values = arrays.from_lists(objects[0].get(key))
            if values is None or values.dtype.kind not in "fiu" or values.size != count:
                raise InputError(
                    path,
                    f"{files.printable(image)}.{key}",
                    files.shorten_value(objects[0].get(key)),
                    f"{count} numbers",
                )
            if count == 9:
                T[n, :3, :3] = values.reshape(3, 3)
            else:
                T[n, :3, 3] = 1e-3 * values.ravel()
    return PoseFile(path, T, tuple(content), by_place=True)


def _parse_pose_numbers(path: Path, where: str, text: str | None, count: int, unless: str = "") -> Float[ndarray, "n"]:
    """Read numbers, which are finite ``unless`` all of them are this word."""
    words = (text or "").split()
    try:
        values = np.array([float(word) for word in words])
    except ValueError:
        values = np.array([])
    lost = {word.lower() for word in words} == {unless}
    if len(values) != count or not (lost or np.isfinite(values).all()):
        raise InputError(path, where, files.shorten_value(text), f"{count} number{'s' if count > 1 else ''}")
    return values


def _parse_pose_matrices(path: Path, key: str, value: object) -> Float[ndarray, "n 4 4"]:
    """Matrices of four rows and columns, finite or all NaN; a last row that a file leaves out is added."""
    found = arrays.from_lists(value)
    values = np.array("") if found is None else found
    if values.dtype.kind in "fiu" and values.shape[-1:] == (16,):
        values = values.reshape(*values.shape[:-1], 4, 4)
    if values.dtype.kind in "fiu" and values.shape[-2:] == (3, 4):
        row = np.broadcast_to(HOMOGENEOUS_ROW, (*values.shape[:-2], 1, 4))
        values = np.concatenate([values, row], axis=-2)
    if values.dtype.kind not in "fiu" or values.shape[-2:] != (4, 4) or values.ndim > 3 or not values.size:
        shape = (
            files.shorten_value(value) if not isinstance(value, ndarray) else f"{value.dtype} of shape {value.shape}"
        )
        raise InputError(path, key, shape, "a 4x4 matrix of numbers for each frame")
    values = values.reshape(-1, 4, 4).astype(float)
    lost = np.isnan(values[:, :3]).all(axis=(1, 2))
    arrays.floats(path, {key: np.where(lost[:, None, None], np.eye(4), values)}, key, values.shape)
    values[lost] = np.nan
    return values


def map_frames_to_rows(names: Sequence[str], found: Sequence[int | None], path: Path) -> dict[int, int]:
    """Return the row of each frame that has one. Raises ``InputError`` for two of one frame."""
    rows: dict[int, int] = {}
    for row, frame in enumerate(found):
        if frame is not None:
            if frame in rows:
                got = f"{files.printable(names[rows[frame]])} and {files.printable(names[row])}"
                raise InputError(path, "frames", got, "one pose for each frame")
            rows[frame] = row
    return rows
