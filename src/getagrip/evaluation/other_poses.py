"""Another system's poses of the clip's mesh, as a result: so that all that measures our results measures them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import Clip, Masks
from getagrip.clip.naming import check_numbers, frame_of, number_of, renumbered
from getagrip.clip.plausible import check_poses
from getagrip.errors import InputError
from getagrip.evaluation.pose_files import SUFFIXES, PoseFile, read_pose_file, row_of_each
from getagrip.geometry import se3
from getagrip.io import files
from getagrip.metrics.mask import iou_of_poses
from getagrip.result import Candidates, FrameKind, Reconstruction, Status, is_result, read_result

FIRST = "--first"
"""The option of ``evaluate`` that states the number of the first frame's pose."""
FROM_HAND = 0.5
"""Largest distance of an object's middle from the origin of the hand frame [m]."""


@dataclass(frozen=True)
class OtherSystem:
    """A system by the name that tables show, and its poses: a file or folder of one clip, or a folder of many.

    Of many clips ``root`` holds ``<clip>.csv`` (or another suffix of ``pose_files``) or a folder ``<clip>``: result
    folders of this package, or what ``pose_files`` reads.
    """

    name: str
    root: Path

    def of_clip(self, clip: str) -> Path:
        """Return the place of a clip's poses. Raises ``InputError`` where there are none."""
        places = [self.root / clip, *(self.root / f"{clip}{suffix}" for suffix in SUFFIXES)]
        found = next((place for place in places if place.exists()), None)
        if found is None:
            expected = f"{files.plain(clip)}/, or {files.plain(clip)} with one of {', '.join(SUFFIXES)}"
            raise InputError(self.root, "", f"no poses of the clip {files.plain(clip)}", expected)
        return found

    def inputs(self, clip: str) -> dict[str, Path]:
        """Return the files that hold the poses of a clip, by name. Raises ``InputError``."""
        place = self.of_clip(clip)
        inside = sorted(path for path in place.iterdir() if path.is_file()) if place.is_dir() else [place]
        return {path.name: path for path in inside}

    def result(self, clip: Clip, masks: Masks | None) -> Reconstruction:
        """Read its poses of a clip, one of many. Raises ``InputError``."""
        return poses_of(self.of_clip(clip.name), self.name, clip, masks)


def poses_of(place: Path, name: str, clip: Clip, masks: Masks | None, first: int | None = None) -> Reconstruction:
    """Read the poses of a file or folder at the clip's frames.

    ``first`` is the number of the first frame's pose, where poses are counted from another start. A frame without a
    pose has that of the nearest one that has, still in the hand, and counts as interpolated. Raises ``InputError``, and
    ``UsageError`` where poses seem to be counted from another start.
    """
    poses = _of_result(place, clip) if place.is_dir() and is_result(place) else read_pose_file(_only_file(place))
    rows = _rows(poses, clip, first)
    index = np.array(sorted(rows))
    T = poses.T[[rows[n] for n in index]]
    scale = 1.0 if poses.scale is None else poses.scale
    T_hand_obj = _in_hand(poses, T, scale, clip, index)
    nearest = index[np.abs(np.arange(len(clip))[:, None] - index).argmin(axis=1)]
    T_hand_obj = T_hand_obj[np.searchsorted(index, nearest)]
    kind: tuple[FrameKind, ...] = tuple("sampled" if n in rows else "interpolated" for n in range(len(clip)))
    iou = np.full(len(clip), np.nan)
    if masks is not None:
        iou = iou_of_poses(clip.mesh, scale, clip.hand.T_cam_hand @ T_hand_obj, clip.K, masks).full
    notes = [f"poses of another system, from {place.name}"]
    if "interpolated" in kind:
        notes.append(
            f"no pose in {len(clip) - len(index)} of {len(clip)} frames: those of their neighbours, in the hand"
        )
    if poses.scale is None and clip.scale == "free":
        notes.append("the scale 1 is a guess: the poses say none, and the clip's mesh has no known size")
    return Reconstruction(
        clip=clip.name,
        method=name,
        frames=clip.frames,
        frame_kind=kind,
        T_hand_obj=T_hand_obj,
        scale=scale,
        iou=iou,
        axis=None,
        candidates=Candidates(T_hand_obj[None], np.array([scale]), np.zeros(1)),
        energy={"total": float("nan")},
        status=Status.EXTERNAL,
        ambiguous=False,
        seconds={"total": float("nan")},
        notes=tuple(notes),
    )


def _only_file(place: Path) -> Path:
    """Return a folder's one table of poses, where it has one; else the folder itself."""
    if not place.is_dir():
        return place
    tables = sorted(path for path in place.iterdir() if path.suffix.lower() in (".csv", ".npz"))
    if len(tables) > 1:
        raise InputError(place, "", f"several files of poses, {tables[0].name}, {tables[1].name}", "one")
    return tables[0] if tables else place


def _of_result(folder: Path, clip: Clip) -> PoseFile:
    """Read a result folder of this package, perhaps of another version or made from other hands."""
    result, _ = read_result(folder)
    if result.T_cam_hand is None:
        return PoseFile(folder, result.T_hand_obj, result.frames, in_hand=True, scale=result.scale)
    return PoseFile(folder, result.T_cam_hand @ result.T_hand_obj, result.frames, scale=result.scale)


def _rows(poses: PoseFile, clip: Clip, first: int | None) -> dict[int, int]:
    """Return the row of each of the clip's frames that has one. Raises ``InputError``."""
    if poses.names is None:
        if len(poses.T) != len(clip):
            expected = f"{len(clip)} as the clip has frames, or names of frames beside them"
            raise InputError(poses.path, "", f"{len(poses.T)} poses without names", expected)
        return {n: n for n in range(len(clip))}
    frames = clip.frames
    if poses.by_place and number_of(frames[0]) is None:
        frames = tuple(str(n) for n in range(len(clip)))
    if first is not None:
        frames = renumbered(frames, first, FIRST)
    check_numbers(frames, poses.names, poses.path, "pose", FIRST if first is None else "")
    rows = row_of_each(poses.names, [frame_of(name, frames) for name in poses.names], poses.path)
    if not rows:
        shown = f"{files.plain(frames[0])} to {files.plain(frames[-1])}"
        raise InputError(poses.path, "", f"no pose of the clip's frames ({files.plain(poses.names[0])}, ...)", shown)
    return rows


def _in_hand(
    poses: PoseFile, T: Float[ndarray, "n 4 4"], scale: float, clip: Clip, index: ndarray
) -> Float[ndarray, "n 4 4"]:
    """Convert poses to the clip's hand frame. Raises ``InputError`` for what can be no pose there."""
    T_cam_hand = clip.hand.T_cam_hand[index]
    centres = np.tile(scale * clip.mesh.centre, (len(T), 1))
    if not poses.in_hand:
        check_poses(poses.path, "T_cam_obj", T, centres, "the object")
        return np.asarray(se3.inverse(T_cam_hand) @ T)
    check_poses(poses.path, "T_hand_obj", T_cam_hand @ T, centres, "the object")
    away = np.linalg.norm(se3.transform(T, centres[:, None])[:, 0], axis=1).max()
    if away > FROM_HAND:
        expected = f"at most {FROM_HAND:g} m; are these in the camera frame (T_cam_obj)?"
        raise InputError(poses.path, "T_hand_obj", f"an object {away:.3g} m from the hand's origin", expected)
    return T
