"""Object poses of other systems: read at a clip's frames, in its hand frame, and written in the same formats.

Files have one 4x4 matrix for each frame, or are BOP's results:

- ``.csv``: BOP's results; ``R`` row by row and ``t`` [mm] map the model into the camera frame, ``im_id`` is the frame's
  number. One of several poses of an image is tracked (``read_poses``);
- ``.json``: a list of matrices, a dictionary with a matrix for each frame, or BOP's ``scene_gt`` (``cam_R_m2c``,
  ``cam_t_m2c`` [mm]);
- ``.npz``, or ``.json`` with the same keys: ``T_cam_obj`` or ``T_hand_obj`` (T, 4, 4), optionally ``scale`` and
  ``frames`` (names or numbers);
- ``.npy`` (T, 4, 4), ``.txt`` with 16 numbers for each frame, in any number of lines, or 12 in a line of each;
- a folder of ``.txt``, ``.npy`` or ``.json`` files of one matrix each, named like the frames.

Matrices are in metres, from the object's frame to the camera's (x right, y down, z forward), unless they are named
``T_hand_obj``. A matrix of NaN, or null in JSON, marks a lost frame.
"""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.clip.clip import Clip
from getagrip.clip.masks import find_masks
from getagrip.clip.match_frames import check_frame_numbers, frame_of, number_of, renumber_frames, rows_in_order
from getagrip.clip.read_arrays import check_poses
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.io import arrays, files
from getagrip.io.files import Json
from getagrip.io.terminal import escape_cell
from getagrip.result import is_result, read_result

POSE_FILE_SUFFIXES = (".csv", ".npz", ".npy", ".json", ".txt")
SINGLE_POSE_SUFFIXES = (".txt", ".npy", ".json")
"""Suffixes of files that may hold one matrix."""
MAX_OBJECT_POSES_BYTES = 256 * 2**20
MAX_POSES = 1_000_000
"""Maximum number of poses in a text file."""
BOP_COLUMNS = ("scene_id", "im_id", "obj_id", "score", "R", "t")
HOMOGENEOUS_ROW = (0.0, 0.0, 0.0, 1.0)
MISSING_POSE = np.full((4, 4), np.nan)
FIRST_FRAME_OPTION = "--first"
"""The option of ``evaluate`` and ``refine`` that states the number of the first frame's pose."""
RANK_COST = 0.01
"""Cost of a pose per pose of the same image with a higher score, in sizes of the object's mask."""
POSE_ROUNDING_TOLERANCE = 0.02
"""Maximum deviation of rounded matrices from rotations; the nearest rotations are used."""
MAX_GRASPED_OFFSET_M = 0.5
"""Maximum distance of an object's centre from the origin of the hand frame [m]."""


@dataclass(frozen=True)
class PoseFile:
    """The content of a file of poses.

    Attributes:
        path: the file.
        T: (n, 4, 4) poses [m]; NaN in lost frames.
        names: names or numbers of the frames; None if the file has none.
        in_hand: True if the poses are in the clip's hand frame, not in the camera's.
        scale: factor on the mesh; None if not stated.
        candidates: all poses of each row's image, if any image has several; else empty.
        by_place: True if numbers may be indices of frames without numbers, as in BOP's files.
    """

    path: Path
    T: Float[ndarray, "n 4 4"]
    names: tuple[str, ...] | None
    in_hand: bool = False
    scale: float | None = None
    candidates: tuple[Float[ndarray, "k 4 4"], ...] = ()
    by_place: bool = False


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
        stored = arrays.parse_npy(path, "", files.read_bytes(path, MAX_OBJECT_POSES_BYTES))
        return PoseFile(path, _parse_pose_matrices(path, "", stored), None)
    if suffix == ".txt":
        return PoseFile(path, _parse_pose_matrices(path, "", _read_pose_text(path)), None)
    if suffix == ".json":
        return _read_pose_json(path)
    got = f"the suffix {files.shorten_value(path.suffix)}"
    raise InputError(path, "", got, f"one of {', '.join(POSE_FILE_SUFFIXES)}")


def _read_pose_folder(folder: Path) -> PoseFile:
    """Read a folder with a matrix in each file."""
    paths = files.list_files(folder, SINGLE_POSE_SUFFIXES)
    if not paths:
        expected = f"files named like the frames ({', '.join(SINGLE_POSE_SUFFIXES)})"
        raise InputError(folder, "", "no poses in it", expected)
    found = [read_pose_file(path) for path in paths]
    several = next((each for each in found if len(each.T) != 1), None)
    if several is not None:
        got = f"{len(several.T)} matrices"
        raise InputError(several.path, "", got, "one, of the frame that the file is named after")
    return PoseFile(folder, np.concatenate([each.T for each in found]), tuple(path.stem for path in paths))


def _read_pose_text(path: Path) -> ndarray:
    content = files.read_bytes(path, MAX_OBJECT_POSES_BYTES)
    words = re.finditer(rb"[^\s,]+", content)  # one by one: a list takes 30 times the file
    numbers = (float(word[0].decode("utf-8", "replace")) for word in words)
    try:
        values = np.fromiter(islice(numbers, 16 * MAX_POSES + 1), float)
    except ValueError as error:
        raise InputError(path, "", f"not a number ({error})", "12 or 16 numbers for each frame") from error
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
        rows = [MISSING_POSE.tolist() if each is None else each for each in content]
        return PoseFile(path, _parse_pose_matrices(path, "", rows), None)
    if not isinstance(content, dict) or not content:
        raise InputError(path, "", files.shorten_value(content), "a list of matrices, or a matrix for each frame")
    if {"T_cam_obj", "T_hand_obj"} & content.keys():
        return _read_pose_record(path, content)
    if all(isinstance(value, list) and value and isinstance(value[0], dict) for value in content.values()):
        return _read_bop_truth(path, content)
    T = [MISSING_POSE[None] if one is None else _parse_pose_matrices(path, name, one) for name, one in content.items()]
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
            expected = f"{len(T)} names or numbers of frames"
            raise InputError(path, "frames", files.shorten_value(entry["frames"]), expected)
        names = tuple(str(value) for value in values)
    if "scale" in entry:
        value = arrays.from_lists(entry["scale"])
        if value is None or value.dtype.kind not in "fiu" or value.size != 1 or not 0 < float(value.item()) < np.inf:
            raise InputError(path, "scale", files.shorten_value(entry["scale"]), "one number above 0 for all frames")
        scale = float(value.item())
    return PoseFile(path, T, names, key == "T_hand_obj", scale)


def _read_bop_results(path: Path) -> PoseFile:
    """Read BOP's table of results. Raises ``InputError`` for several scenes or objects."""
    heads, rows = files.csv_rows(path, files.read_bytes(path, MAX_OBJECT_POSES_BYTES), "BOP's results as CSV in UTF-8")
    if not {*BOP_COLUMNS} <= {*heads}:
        expected = f"the columns {', '.join(BOP_COLUMNS)} of BOP's results"
        raise InputError(path, "line 1", files.shorten_value(heads), expected)
    each: dict[str, list[tuple[float, ndarray]]] = {}
    seen: dict[str, set[str]] = {"scene_id": set(), "obj_id": set()}
    for at, row in rows:
        where = at.rstrip(", ")
        for key, values in seen.items():
            values.add(str(row[key]))
            if len(values) > 1:
                got = f"a second {key}, {files.printable(str(row[key]))}"
                raise InputError(path, where, got, "those of one clip's object")
        score, T = _parse_pose_numbers(path, where, row["score"], 1)[0], np.eye(4)
        T[:3, :3] = _parse_pose_numbers(path, where, row["R"], 9, "nan").reshape(3, 3)
        T[:3, 3] = 1e-3 * _parse_pose_numbers(path, where, row["t"], 3, "nan")
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
                where, got = f"{files.printable(image)}.{key}", files.shorten_value(objects[0].get(key))
                raise InputError(path, where, got, f"{count} numbers")
            if count == 9:
                T[n, :3, :3] = values.reshape(3, 3)
            else:
                T[n, :3, 3] = 1e-3 * values.ravel()
    return PoseFile(path, T, tuple(content), by_place=True)


def _parse_pose_numbers(path: Path, where: str, text: str | None, count: int, unless: str = "") -> Float[ndarray, "n"]:
    """Parse numbers, which are finite ``unless`` all of them are this word."""
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
    """Parse 4x4 matrices, finite or all NaN; a missing last row is added."""
    found = arrays.from_lists(value)
    values = np.array("") if found is None else found
    if values.dtype.kind in "fiu" and values.shape[-1:] == (16,):
        values = values.reshape(*values.shape[:-1], 4, 4)
    if values.dtype.kind in "fiu" and values.shape[-2:] == (3, 4):
        row = np.broadcast_to(HOMOGENEOUS_ROW, (*values.shape[:-2], 1, 4))
        values = np.concatenate([values, row], axis=-2)
    if values.dtype.kind not in "fiu" or values.shape[-2:] != (4, 4) or values.ndim > 3 or not values.size:
        stored = isinstance(value, ndarray) and f"{value.dtype} of shape {value.shape}"
        got = stored or files.shorten_value(value)
        raise InputError(path, key, got, "a 4x4 matrix of numbers for each frame")
    values = values.reshape(-1, 4, 4).astype(float)
    lost = np.isnan(values[:, :3]).all(axis=(1, 2))
    arrays.floats(path, {key: np.where(lost[:, None, None], np.eye(4), values)}, key, values.shape)
    values[lost] = np.nan
    return values


def map_frames_to_rows(names: Sequence[str], found: Sequence[int | None], path: Path) -> dict[int, int]:
    """Return the row of each frame with a pose. Raises ``InputError`` for two rows of one frame."""
    rows: dict[int, int] = {}
    for row, frame in enumerate(found):
        if frame is not None:
            if frame in rows:
                got = f"{files.printable(names[rows[frame]])} and {files.printable(names[row])}"
                raise InputError(path, "frames", got, "one pose for each frame")
            rows[frame] = row
    return rows


@dataclass(frozen=True)
class PosesAtFrames:
    """Poses of a clip's mesh in its hand frame, in T frames.

    Attributes:
        T_hand_obj: (T, 4, 4) poses [m]; a frame without one has the nearest frame's.
        found: (T,) frames with a pose.
        scale: factor on the mesh; None if not stated.
        names: names of the frames in the source, or by its scheme.
        notes: how one of several poses of a frame was chosen, in words.
    """

    T_hand_obj: Float[ndarray, "T 4 4"]
    found: Bool[ndarray, "T"]
    scale: float | None
    names: tuple[str, ...]
    notes: tuple[str, ...] = ()


def poses_path_of_clip(root: Path, clip: str) -> Path:
    """Return a clip's poses in a folder of many clips': ``<clip>.csv`` (or another suffix), or a folder ``<clip>``.

    Raises ``InputError`` if both are missing.
    """
    places = [root / clip, *(root / f"{clip}{suffix}" for suffix in POSE_FILE_SUFFIXES)]
    found = next((place for place in places if place.exists()), None)
    if found is None:
        expected = f"{files.printable(clip)}/, or {files.printable(clip)} with one of {', '.join(POSE_FILE_SUFFIXES)}"
        raise InputError(root, "", f"no poses of the clip {files.printable(clip)}", expected)
    return found


def find_poses_path(root: Path, clip: str) -> Path:
    """Return a clip's poses in a folder of many clips', else ``root`` itself."""
    many = root.is_dir() and any((root / f"{clip}{suffix}").exists() for suffix in ("", *POSE_FILE_SUFFIXES))
    return poses_path_of_clip(root, clip) if many else root


def read_poses(place: Path, clip: Clip, first: int | None = None) -> PosesAtFrames:
    """Read the poses of a file or folder at the clip's frames.

    ``first`` is the number of the first frame's pose, for poses numbered from another start. Raises ``InputError``, and
    ``UsageError`` if poses seem to be numbered from another start.
    """
    poses = _poses_of_result(place) if place.is_dir() and is_result(place) else read_pose_file(find_pose_table(place))
    rows, frames = _rows_of_frames(poses, clip, first)
    index = np.array(sorted(n for n, row in rows.items() if not np.isnan(poses.T[row]).any()), dtype=int)
    if not len(index):
        raise InputError(poses.path, "", "a matrix of NaN in every frame of the clip", "a pose in one of them")
    scale = 1.0 if poses.scale is None else poses.scale
    T, notes = poses.T[[rows[n] for n in index]], tuple[str, ...]()
    if poses.candidates:
        T, notes = _track_candidates([poses.candidates[rows[n]] for n in index], scale, clip, index)
    T_hand_obj = _convert_to_hand_frame(poses, T, scale, clip, index)
    nearest = np.abs(np.arange(len(clip))[:, None] - index).argmin(axis=1)
    names = tuple(poses.names[rows[n]] if poses.names and n in rows else name for n, name in enumerate(frames))
    return PosesAtFrames(T_hand_obj[nearest], np.isin(np.arange(len(clip)), index), poses.scale, names, notes)


def _track_candidates(
    candidates: Sequence[Float[ndarray, "k 4 4"]], scale: float, clip: Clip, index: ndarray
) -> tuple[Float[ndarray, "n 4 4"], tuple[str, ...]]:
    """Track one of several poses from frame to frame, near the clip's masks if any; return its poses, and notes."""
    masks = find_masks(clip)
    size = scale * clip.mesh.diameter
    centres = [se3.transform(T, np.tile(scale * clip.mesh.centre, (len(T), 1, 1)))[:, 0] for T in candidates]
    costs = list[Float[ndarray, "k"]]()
    for n, at in zip(index.tolist(), centres, strict=True):
        rank = RANK_COST * np.arange(len(at))
        rows, columns = np.nonzero(masks.object[n]) if masks is not None else (np.zeros(0), np.zeros(0))
        if len(rows):
            before = np.where(at[:, 2:] > 0.0, at, [0.0, 0.0, 1e-3])
            off = project(clip.K[n], before) - [columns.mean() + 0.5, rows.mean() + 0.5]
            rank = rank + np.linalg.norm(off, axis=1) / np.sqrt(len(rows))
        costs.append(rank)
    total, back = costs[0], list[ndarray]()
    for n in range(1, len(centres)):
        steps = np.linalg.norm(centres[n][None] - centres[n - 1][:, None], axis=2) / size + total[:, None]
        back.append(steps.argmin(axis=0))
        total = costs[n] + steps.min(axis=0)
    row = [int(total.argmin())]
    for of in reversed(back):
        row.append(int(of[row[-1]]))
    chosen = np.array([T[k] for T, k in zip(candidates, reversed(row), strict=True)])
    several = [at for at in centres if len(at) > 1]
    apart = 1e3 * max((float(np.ptp(at, axis=0).max()) for at in several), default=0.0)
    by = "nearest to the masks" if masks is not None else "of the highest score"
    said = f"several poses in {len(several)} of {len(index)} images, up to {apart:.0f} mm apart"
    return chosen, (f"{said}: one was followed from image to image, {by}, a guess",) if several else ()


def find_pose_table(place: Path) -> Path:
    """Return a folder's only table of poses, else the folder itself. Raises ``InputError`` for several tables."""
    if not place.is_dir():
        return place
    tables = files.list_files(place, (".csv", ".npz"))
    if len(tables) > 1:
        raise InputError(place, "", f"several files of poses, {tables[0].name}, {tables[1].name}", "one")
    return tables[0] if tables else place


def _poses_of_result(folder: Path) -> PoseFile:
    """Read a result folder of this package, possibly of another version or with other hands."""
    result, _ = read_result(folder)
    if result.T_cam_hand is None:
        return PoseFile(folder, result.T_hand_obj, result.frames, in_hand=True, scale=result.scale)
    return PoseFile(folder, result.T_cam_hand @ result.T_hand_obj, result.frames, scale=result.scale)


def _rows_of_frames(poses: PoseFile, clip: Clip, first: int | None) -> tuple[dict[int, int], tuple[str, ...]]:
    """Return the row of each of the clip's frames with a pose, and the frames' names in the file."""
    if poses.names is None:
        frames = clip.frames if first is None else renumber_frames(clip.frames, first, FIRST_FRAME_OPTION)
        return rows_in_order(len(poses.T), frames, poses.path, "pose", first is not None), clip.frames
    frames = clip.frames
    if poses.by_place and number_of(frames[0]) is None:
        frames = tuple(str(n) for n in range(len(clip)))
    if first is not None:
        frames = renumber_frames(frames, first, FIRST_FRAME_OPTION)
    check_frame_numbers(frames, poses.names, poses.path, "pose", FIRST_FRAME_OPTION if first is None else "")
    rows = map_frames_to_rows(poses.names, [frame_of(name, frames) for name in poses.names], poses.path)
    if not rows:
        got = f"no pose of the clip's frames, only of {files.printable(poses.names[0])}, ..."
        raise InputError(poses.path, "", got, f"{files.printable(frames[0])} to {files.printable(frames[-1])}")
    return rows, frames


def _convert_to_hand_frame(
    poses: PoseFile, T: Float[ndarray, "n 4 4"], scale: float, clip: Clip, index: ndarray
) -> Float[ndarray, "n 4 4"]:
    """Convert poses to the clip's hand frame. Raises ``InputError`` for implausible poses."""
    T_cam_hand = clip.hand.T_cam_hand[index]
    rounded = se3.is_rigid(T, POSE_ROUNDING_TOLERANCE)
    T[rounded, :3, :3] = se3.nearest_rotation(T[rounded, :3, :3])
    centres = np.tile(scale * clip.mesh.centre, (len(T), 1))
    if not poses.in_hand:
        check_poses(poses.path, "T_cam_obj", T, centres, "the object")
        return np.asarray(se3.inverse(T_cam_hand) @ T)
    check_poses(poses.path, "T_hand_obj", T_cam_hand @ T, centres, "the object")
    away = np.linalg.norm(se3.transform(T, centres[:, None])[:, 0], axis=1).max()
    if away > MAX_GRASPED_OFFSET_M:
        expected = f"at most {MAX_GRASPED_OFFSET_M:g} m; are these in the camera frame (T_cam_obj)?"
        raise InputError(poses.path, "T_hand_obj", f"an object {away:.3g} m from the hand's origin", expected)
    return T


@dataclass(frozen=True)
class ExternalTrack:
    """Poses of an object in T frames.

    Attributes:
        names: names of the frames in the format's other files.
        T_cam_obj: (T, 4, 4) poses in the camera frame [m].
        T_hand_obj: (T, 4, 4) the same poses in the clip's hand frame [m].
        scale: factor on the mesh.
        score: (T,) score of each pose, for formats with scores; NaN: unknown.
    """

    names: tuple[str, ...]
    T_cam_obj: Float[ndarray, "T 4 4"]
    T_hand_obj: Float[ndarray, "T 4 4"]
    scale: float
    score: Float[ndarray, "T"]


def write_poses_like(place: Path, track: ExternalTrack, folder: Path) -> Path:
    """Write a track into a folder in the format and under the name of ``place``; return its path.

    ``place`` is a file, or a folder with a file for each frame. Raises ``InputError`` if it cannot be read.
    """
    out = folder / place.name
    if place.is_dir():
        suffix = files.list_files(place, SINGLE_POSE_SUFFIXES)[0].suffix.lower()
        files.folder_inside(folder, place.name)  # exists in a repeated call
        for name, T in zip(track.names, track.T_cam_obj, strict=True):
            files.write_bytes(out / f"{name}{suffix}", _encode_pose_matrices(suffix, T))
        return out
    suffix = place.suffix.lower()
    if suffix == ".csv":
        content = _encode_bop_results(place, track)
    elif suffix == ".npz":
        content = _encode_pose_record(place, track)
    elif suffix == ".json":
        content = _encode_pose_json(place, track)
    else:
        content = _encode_pose_matrices(suffix, track.T_cam_obj)
    files.write_bytes(out, content)
    return out


def _encode_pose_matrices(suffix: str, T: Float[ndarray, "*T 4 4"]) -> bytes:
    if suffix == ".json":
        return json.dumps(T.tolist()).encode()
    stream = io.BytesIO()
    if suffix == ".npy":
        np.save(stream, T)
    else:
        np.savetxt(stream, T.reshape(-1, 4), fmt="%.9g")
    return stream.getvalue()


def _encode_bop_results(place: Path, track: ExternalTrack) -> bytes:
    """Write BOP's table, for the scene and object of the file ``place``."""
    _, rows = files.csv_rows(place, files.read_bytes(place), "BOP's results as CSV in UTF-8")
    _, first = next(iter(rows))
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow([*BOP_COLUMNS, "time"])
    for name, T, score in zip(track.names, track.T_cam_obj, np.nan_to_num(track.score), strict=True):
        R, t = (" ".join(f"{x:.9g}" for x in values) for values in (T[:3, :3].ravel(), 1e3 * T[:3, 3]))
        table.writerow([*map(escape_cell, (first["scene_id"], name, first["obj_id"])), f"{score:.6g}", R, t, -1])
    return text.getvalue().encode()


def _encode_pose_record(place: Path, track: ExternalTrack) -> bytes:
    """Write arrays by name, in the frame of the file ``place``."""
    key = "T_hand_obj" if "T_hand_obj" in arrays.read(place, {"T_cam_obj", "T_hand_obj"}.__contains__) else "T_cam_obj"
    stream = io.BytesIO()
    np.savez(stream, **{key: getattr(track, key)}, frames=np.array(track.names), scale=np.array(track.scale))
    return stream.getvalue()


def _encode_pose_json(place: Path, track: ExternalTrack) -> bytes:
    """Write a list, a record, a matrix by frame, or BOP's ``scene_gt``, as in the file ``place``."""
    given = files.read_any_json(place)
    content: object = track.T_cam_obj.tolist()
    if isinstance(given, dict) and {"T_cam_obj", "T_hand_obj"} & given.keys():
        key = "T_cam_obj" if "T_cam_obj" in given else "T_hand_obj"
        content = {key: getattr(track, key).tolist(), "frames": [*track.names], "scale": track.scale}
    elif isinstance(given, dict):
        first = next(iter(given.values()))
        content = dict(zip(track.names, track.T_cam_obj.tolist(), strict=True))
        if isinstance(first, list) and first and isinstance(first[0], dict):
            about = {"obj_id": first[0].get("obj_id", 1)}
            content = {
                name: [{"cam_R_m2c": T[:3, :3].ravel().tolist(), "cam_t_m2c": (1e3 * T[:3, 3]).tolist(), **about}]
                for name, T in zip(track.names, track.T_cam_obj, strict=True)
            }
    return json.dumps(content).encode()
