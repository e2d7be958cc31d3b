"""Write poses in the format of a file or folder of another system's (``object_poses.files``)."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.io import arrays, files
from getagrip.io.tables import escape_cell
from getagrip.object_poses.files import BOP_COLUMNS, SINGLE_POSE_SUFFIXES


@dataclass(frozen=True)
class ExternalTrack:
    """Poses of an object in T frames.

    Attributes:
        names: how the format's other files call the frames.
        T_cam_obj: (T, 4, 4) [m].
        T_hand_obj: (T, 4, 4) the same in the clip's hand frame [m].
        scale: factor on the mesh.
        score: (T,) how good each is, for formats that say so; NaN: unknown.
    """

    names: tuple[str, ...]
    T_cam_obj: Float[ndarray, "T 4 4"]
    T_hand_obj: Float[ndarray, "T 4 4"]
    scale: float
    score: Float[ndarray, "T"]


def write_poses_like(place: Path, track: ExternalTrack, folder: Path) -> Path:
    """Write a track into a folder as ``place`` has one, under the same name; return where it is.

    ``place`` is a file, or a folder with a file for each frame. Raises ``InputError`` where it cannot be read.
    """
    out = folder / place.name
    if place.is_dir():
        suffix = files.list_files(place, SINGLE_POSE_SUFFIXES)[0].suffix.lower()
        files.folder_inside(folder, place.name)  # a call that is repeated finds it there
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
    """BOP's table, of the scene and object that the file is of."""
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
    """Arrays by name, in the frame that the file's are in."""
    key = "T_hand_obj" if "T_hand_obj" in arrays.read(place, {"T_cam_obj", "T_hand_obj"}.__contains__) else "T_cam_obj"
    stream = io.BytesIO()
    np.savez(stream, **{key: getattr(track, key)}, frames=np.array(track.names), scale=np.array(track.scale))
    return stream.getvalue()


def _encode_pose_json(place: Path, track: ExternalTrack) -> bytes:
    """Write a list, a record, a matrix by frame, or BOP's ``scene_gt``: whichever the file has."""
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
