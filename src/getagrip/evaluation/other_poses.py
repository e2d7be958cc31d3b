"""Another system's poses of the clip's mesh, as a result: so that all that measures our results measures them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import Clip, Masks
from getagrip.clip.sampling import frame_indices
from getagrip.geometry import se3
from getagrip.io import files
from getagrip.metrics.mask import iou_of_poses
from getagrip.object_poses.at_frames import poses_path_of_clip, read_poses
from getagrip.probability import format_probability
from getagrip.result import FrameKind, Reconstruction, is_result, read_result


@dataclass(frozen=True)
class ExternalSystem:
    """A system by the name that tables show, and its poses of many clips (``object_poses.at_frames.place_of``)."""

    name: str
    root: Path

    def inputs(self, clip: str) -> dict[str, Path]:
        """Return the files that hold the poses of a clip, by name. Raises ``InputError``."""
        place = poses_path_of_clip(self.root, clip)
        inside = files.list_files(place) if place.is_dir() else [place]
        return {path.name: path for path in inside}

    def result(self, clip: Clip, masks: Masks | None, frames: Sequence[str]) -> Reconstruction:
        """Read its poses of a clip, one of many, in some of its frames. Raises ``InputError``.

        A result folder of this package that has all of them keeps its hand, its checks and what else is in it.
        """
        place = poses_path_of_clip(self.root, clip.name)
        if place.is_dir() and is_result(place):
            found, _ = read_result(place)
            if {*frames} <= {*found.frames}:
                return replace(found.take(np.array([found.frames.index(name) for name in frames])), method=self.name)
        return read_external_poses(place, self.name, clip, masks).take(clip.index_of(frames))


def read_external_poses(
    place: Path, name: str, clip: Clip, masks: Masks | None, first: int | None = None
) -> Reconstruction:
    """Read the poses of a file or folder as a result; arguments and errors are those of ``read_poses``.

    A frame without a pose has the nearest frame's, fixed in the hand, and counts as interpolated.
    """
    poses = read_poses(place, clip, first)
    scale = 1.0 if poses.scale is None else poses.scale
    kind: tuple[FrameKind, ...] = tuple("sampled" if found else "interpolated" for found in poses.found)
    iou = np.full(len(clip), np.nan)
    if masks is not None:
        iou = iou_of_poses(clip.mesh, scale, clip.hand.T_cam_hand @ poses.T_hand_obj, clip.K, masks).full
    notes = [f"poses of another system, from {place.name}"]
    if "interpolated" in kind:
        notes.append(
            f"no pose in {kind.count('interpolated')} of {len(clip)} frames: those of their neighbours, in the hand"
        )
    if poses.scale is None and clip.scale == "free":
        notes.append("the scale 1 is a guess: the poses say none, and the clip's mesh has no known size")
    if masks is not None and (
        text := diagnose_pose_convention(clip, masks, clip.hand.T_cam_hand @ poses.T_hand_obj, scale, iou)
    ):
        notes.append(text)
    notes += poses.notes
    unknown = {"total": float("nan")}
    return replace(
        Reconstruction.external(clip.name, name, clip.frames, poses.T_hand_obj, scale),
        frame_kind=kind, iou=iou, energy=unknown, seconds=unknown, notes=tuple(notes),
    )  # fmt: skip


MISALIGNED_IOU_THRESHOLD, CONVENTION_IOU_THRESHOLD = 0.5, 0.6
"""Mean overlap with the masks below which poses may be in another convention, and from which on one is theirs."""
MISALIGNED_POSES_MESSAGE = (
    "no given pose meets the masks: are they inverse, in another frame, of another mesh or of another instance?"
)
N_CONVENTION_FRAMES = 6
"""Frames in which conventions are tried."""


def diagnose_pose_convention(
    clip: Clip, masks: Masks, T_cam_obj: Float[ndarray, "T 4 4"], scale: float, iou: Float[ndarray, "T"]
) -> str:
    """Say that poses miss the masks, and by which convention they would meet them; empty where they meet them."""
    known = np.flatnonzero(np.isfinite(iou))
    if not len(known) or (mean := float(iou[known].mean())) >= MISALIGNED_IOU_THRESHOLD:
        return ""
    some = known[frame_indices(len(known), N_CONVENTION_FRAMES)]
    T, mesh, seen = T_cam_obj[some], clip.mesh, masks.take(some)
    to_middle = se3.rigid(np.eye(3), -scale * mesh.centre)
    to_mean = se3.rigid(np.eye(3), -scale * mesh.vertices.mean(axis=0))
    turned = se3.exp_so3(np.array([np.pi / 2.0, 0.0, 0.0]))
    conventions = {
        "inverse (camera to object)": se3.inverse(T),
        "of a camera that looks along -z (OpenGL)": np.diag([1.0, -1.0, -1.0, 1.0]) @ T,
        "with rotations that are transposed": se3.rigid(np.swapaxes(T[:, :3, :3], 1, 2), T[:, :3, 3]),
        "of the mesh moved to its middle": T @ to_middle,
        "of the mesh moved to the mean of its vertices": T @ to_mean,
        "of the mesh with y up instead of z": T @ se3.rigid(turned, np.zeros(3)),
        "of the mesh with z up instead of y": T @ se3.rigid(turned.T, np.zeros(3)),
    }
    each = {
        name: float(np.nanmean(iou_of_poses(mesh, scale, one, clip.K[some], seen).full))
        for name, one in conventions.items()
        if (se3.transform(one, scale * mesh.vertices)[..., 2] > 0.0).all()
    }
    best = max(each, key=lambda name: each[name], default="")
    beginning = (
        MISALIGNED_POSES_MESSAGE.partition(":")[0]
        if mean == 0.0
        else f"the poses meet the masks by {format_probability(mean)} only"
    )
    if best and each[best] >= max(CONVENTION_IOU_THRESHOLD, mean + 0.2):
        return f"{beginning}; they meet them by {format_probability(each[best])} if they are {best}"
    return f"{beginning}:{MISALIGNED_POSES_MESSAGE.partition(':')[2]}"
