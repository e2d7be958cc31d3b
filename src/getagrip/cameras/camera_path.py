"""A camera's path as a program gives it, and at the frames of a clip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray
from scipy.spatial.transform import Rotation, Slerp

from getagrip.clip.naming import frames_of
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.io.array_data import ArrayData

BESIDE = 0.25
"""Farthest pose in time from a frame that gets one [s]."""


class Pinhole(NamedTuple):
    """Intrinsics as a program has them.

    Attributes:
        K: (3, 3) pinhole intrinsics [px].
        size: width and height of its images [px]; None where it does not say.
        distorted: True if its model has distortion that is not zero.
    """

    K: Float[ndarray, "3 3"]
    size: tuple[int, int] | None
    distorted: bool = False

    @staticmethod
    def of(
        fx: float, fy: float, cx: float, cy: float, size: tuple[int, int] | None, distorted: bool = False
    ) -> Pinhole:
        """Make it from focal lengths and principal point [px]."""
        return Pinhole(np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), size, distorted)

    @property
    def is_possible(self) -> bool:
        """True if all numbers are finite, and focal lengths and size are above 0."""
        focal = self.K[..., [0, 1], [0, 1]]
        return bool(np.isfinite(self.K).all() and focal.min() > 0.0 and (self.size is None or min(self.size) > 0))

    def resized(self, size: tuple[int, int]) -> Float[ndarray, "3 3"]:
        """Return the intrinsics of the same images at another size; without a size of its own, as they are."""
        zoom = np.ones(2) if self.size is None else np.array(size) / self.size
        return np.diag([*zoom, 1.0]) @ self.K


@dataclass(frozen=True, eq=False)
class CameraPath(ArrayData):
    """The poses of a camera in a frame that stands still.

    Attributes:
        source: what the files are, in words.
        path: the file, for errors.
        T_world_cam: (N, 4, 4) pose of the camera, camera frame (x right, y down, z forward) to world frame.
        names: names of the N images; empty where poses are counted or timed.
        times: (N,) time of each pose [s]; None if there is none.
        pinhole: the intrinsics; None where the files have none.
        metric: True if lengths are metres as far as the program knows.
        up: (3,) direction away from the ground in the world frame; None where it is not known.
    """

    source: str
    path: Path
    T_world_cam: Float[ndarray, "N 4 4"]
    names: tuple[str, ...] = ()
    times: Float[ndarray, "N"] | None = None
    pinhole: Pinhole | None = None
    metric: bool = False
    up: Float[ndarray, "3"] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        R = self.T_world_cam[:, :3, :3]
        off = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(initial=0.0)
        if not len(R) or not np.isfinite(self.T_world_cam).all() or off > 1e-2 or np.linalg.det(R).min() < 0.0:
            raise InputError(self.path, "", f"{len(R)} poses, {off:.2g} off rigid ones", "rigid poses of a camera")
        if self.pinhole is not None and not self.pinhole.is_possible:
            got = f"K {self.pinhole.K.tolist()} of images {self.pinhole.size}"
            raise InputError(self.path, "camera", got, "one with focal lengths above 0 and a size in pixels")

    def scaled(self, metres: float) -> CameraPath:
        """Return the path with a length of ``metres`` for each unit."""
        T = self.T_world_cam.copy()
        T[:, :3, 3] *= metres
        return replace(self, T_world_cam=T)

    def at(
        self, frames: Sequence[str], times: Float[ndarray, "T"], start: float | None
    ) -> tuple[Float[ndarray, "T 4 4"], Bool[ndarray, "T"]]:
        """Return the pose in each frame, and in which frames it is interpolated between those beside.

        ``times`` are those of the frames [s]; ``start`` is the time that the file gives to time 0. Raises
        ``InputError`` where the ends have no pose, ``UsageError`` where it is not known which pose is which frame's.
        """
        if self.names:
            at: dict[int, int] = {}
            for row, frame in enumerate(frames_of(self.names, frames)):
                if frame is not None:
                    at.setdefault(frame, row)
            known = np.array(sorted(at), dtype=np.int64)
            poses = self.T_world_cam[[at[n] for n in known]]
            return self._between(frames, known.astype(float), poses, np.arange(len(frames), dtype=float), known)
        if start is None and len(self.T_world_cam) == len(frames):
            return self.T_world_cam, np.zeros(len(frames), dtype=bool)
        if start is None or self.times is None:
            count = f"{len(self.T_world_cam)} poses for {len(frames)} frames"
            hint = (
                "--start S, the time that the file gives to time 0 of the clip" if self.times is not None else "as many"
            )
            raise UsageError(f"{self.path}: {count}: missing {hint}")
        order = np.unique(self.times, return_index=True)[1]
        stamps, wanted = self.times[order], times + start
        nearest = np.abs(stamps[None] - wanted[:, None]).min(axis=1)
        if nearest.max() > BESIDE:
            got = f"poses from {stamps[0]:.6g} to {stamps[-1]:.6g} s, frames from {wanted[0]:.6g} to {wanted[-1]:.6g} s"
            raise InputError(self.path, "", got, f"a pose within {BESIDE:g} s of every frame; is --start right?")
        return self._between(frames, stamps, self.T_world_cam[order], wanted, np.flatnonzero(nearest < 1e-6))

    def _between(
        self, frames: Sequence[str], at: Float[ndarray, "n"], T: Float[ndarray, "n 4 4"], wanted: Float[ndarray, "T"],
        known: ndarray,
    ) -> tuple[Float[ndarray, "T 4 4"], Bool[ndarray, "T"]]:  # fmt: skip
        """Interpolate poses: straight lines and constant turns."""
        if not len(at) or wanted[0] < at[0] - 1e-9 or wanted[-1] > at[-1] + 1e-9:
            got = f"no pose of frame {frames[0] if not len(at) or wanted[0] < at[0] else frames[-1]}"
            raise InputError(self.path, "", got, "poses of the first and the last frame; cut the clip, or name images")
        filled = np.ones(len(frames), dtype=bool)
        filled[known] = False
        wanted = np.clip(wanted, at[0], at[-1])
        t = np.stack([np.interp(wanted, at, T[:, axis, 3]) for axis in range(3)], axis=1)
        if len(at) == 1:
            return np.tile(T, (len(frames), 1, 1)), filled
        R = Slerp(at, Rotation.from_matrix(T[:, :3, :3]))(wanted).as_matrix()
        return se3.rigid(R, t), filled
