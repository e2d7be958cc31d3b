"""Another system's poses of the clip's mesh, as a result: so that all that measures our results measures them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from getagrip.clip import Clip, Masks
from getagrip.io import files
from getagrip.metrics.mask import iou_of_poses
from getagrip.object_poses.at_frames import place_of, read_poses
from getagrip.result import FrameKind, Reconstruction, is_result, read_result


@dataclass(frozen=True)
class OtherSystem:
    """A system by the name that tables show, and its poses of many clips (``object_poses.at_frames.place_of``)."""

    name: str
    root: Path

    def inputs(self, clip: str) -> dict[str, Path]:
        """Return the files that hold the poses of a clip, by name. Raises ``InputError``."""
        place = place_of(self.root, clip)
        inside = files.listed(place) if place.is_dir() else [place]
        return {path.name: path for path in inside}

    def result(self, clip: Clip, masks: Masks | None, frames: Sequence[str]) -> Reconstruction:
        """Read its poses of a clip, one of many, in some of its frames. Raises ``InputError``.

        A result folder of this package that has all of them keeps its hand, its checks and what else is in it.
        """
        place = place_of(self.root, clip.name)
        if place.is_dir() and is_result(place):
            found, _ = read_result(place)
            if {*frames} <= {*found.frames}:
                return replace(found.take(np.array([found.frames.index(name) for name in frames])), method=self.name)
        return poses_of(place, self.name, clip, masks).take(clip.index_of(frames))


def poses_of(place: Path, name: str, clip: Clip, masks: Masks | None, first: int | None = None) -> Reconstruction:
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
    unknown = {"total": float("nan")}
    return replace(
        Reconstruction.external(clip.name, name, clip.frames, poses.T_hand_obj, scale),
        frame_kind=kind, iou=iou, energy=unknown, seconds=unknown, notes=tuple(notes),
    )  # fmt: skip
