"""Another system's poses at the frames of a clip, in its hand frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.clip import Clip, find_masks
from getagrip.clip.naming import check_frame_numbers, frame_of, number_of, renumber_frames, rows_in_order
from getagrip.clip.plausible import check_poses
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.io import files
from getagrip.object_poses.files import POSE_FILE_SUFFIXES, PoseFile, map_frames_to_rows, read_pose_file
from getagrip.result import is_result, read_result

FIRST_FRAME_OPTION = "--first"
"""The option of ``evaluate`` and ``refine`` that states the number of the first frame's pose."""
RANK_COST = 0.01
"""Cost of a pose for each one of the same image that has a higher score [sizes of the object's mask]."""
POSE_ROUNDING_TOLERANCE = 0.02
"""Tolerance of rotations that were rounded, as to two decimals: the nearest ones are taken."""
MAX_GRASPED_OFFSET_M = 0.5
"""Largest distance of an object's middle from the origin of the hand frame [m]."""


@dataclass(frozen=True)
class PosesAtFrames:
    """Poses of a clip's mesh in its hand frame, in T frames.

    Attributes:
        T_hand_obj: (T, 4, 4) a frame without a pose has that of the nearest frame that has one.
        found: (T,) the frames that have one.
        scale: factor on the mesh; None where the source says none.
        names: what the source calls the frames, or would.
        notes: how one of several poses of a frame was chosen, in words.
    """

    T_hand_obj: Float[ndarray, "T 4 4"]
    found: Bool[ndarray, "T"]
    scale: float | None
    names: tuple[str, ...]
    notes: tuple[str, ...] = ()


def poses_path_of_clip(root: Path, clip: str) -> Path:
    """Return the place of a clip's poses in a folder of many clips'.

    It holds ``<clip>.csv`` (or another suffix of ``files``) or a folder ``<clip>``. Raises ``InputError`` where there
    are none.
    """
    places = [root / clip, *(root / f"{clip}{suffix}" for suffix in POSE_FILE_SUFFIXES)]
    found = next((place for place in places if place.exists()), None)
    if found is None:
        expected = f"{files.printable(clip)}/, or {files.printable(clip)} with one of {', '.join(POSE_FILE_SUFFIXES)}"
        raise InputError(root, "", f"no poses of the clip {files.printable(clip)}", expected)
    return found


def find_poses_path(root: Path, clip: str) -> Path:
    """Return the place of a clip's poses: in a folder of many clips', or ``root`` itself, which may be one clip's."""
    many = root.is_dir() and any((root / f"{clip}{suffix}").exists() for suffix in ("", *POSE_FILE_SUFFIXES))
    return poses_path_of_clip(root, clip) if many else root


def read_poses(place: Path, clip: Clip, first: int | None = None) -> PosesAtFrames:
    """Read the poses of a file or folder at the clip's frames.

    ``first`` is the number of the first frame's pose, where poses are counted from another start. Raises
    ``InputError``, and ``UsageError`` where poses seem to be counted from another start.
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
    """Follow one of several poses from frame to frame, near the masks where the clip has some; return it, and notes."""
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
    """Return a folder's one table of poses, where it has one; else the folder itself."""
    if not place.is_dir():
        return place
    tables = files.list_files(place, (".csv", ".npz"))
    if len(tables) > 1:
        raise InputError(place, "", f"several files of poses, {tables[0].name}, {tables[1].name}", "one")
    return tables[0] if tables else place


def _poses_of_result(folder: Path) -> PoseFile:
    """Read a result folder of this package, perhaps of another version or made from other hands."""
    result, _ = read_result(folder)
    if result.T_cam_hand is None:
        return PoseFile(folder, result.T_hand_obj, result.frames, in_hand=True, scale=result.scale)
    return PoseFile(folder, result.T_cam_hand @ result.T_hand_obj, result.frames, scale=result.scale)


def _rows_of_frames(poses: PoseFile, clip: Clip, first: int | None) -> tuple[dict[int, int], tuple[str, ...]]:
    """Return the row of each of the clip's frames that has one, and the frames' names there. Raises ``InputError``."""
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
        shown = f"{files.printable(frames[0])} to {files.printable(frames[-1])}"
        raise InputError(
            poses.path, "", f"no pose of the clip's frames, only of {files.printable(poses.names[0])}, ...", shown
        )
    return rows, frames


def _convert_to_hand_frame(
    poses: PoseFile, T: Float[ndarray, "n 4 4"], scale: float, clip: Clip, index: ndarray
) -> Float[ndarray, "n 4 4"]:
    """Convert poses to the clip's hand frame. Raises ``InputError`` for what can be no pose there."""
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
