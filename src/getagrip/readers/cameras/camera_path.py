"""Camera trajectories, resampled at a clip's frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip.match_frames import frames_of, rows_in_order, rows_of_frames, stem_of
from getagrip.clip.read_arrays import ASPECT_RATIO_TOLERANCE, check_shape
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.lens import Distortion
from getagrip.io.array_data import ArrayData

MAX_POSE_GAP_S = 0.25
"""Maximum time between a frame and the nearest pose [s]."""
TIME_TOLERANCE_S = 1e-6
"""Maximum difference of equal times [s]."""
PRINCIPAL_POINT_SHAPE_TOLERANCE = 0.15
"""Maximum relative difference between twice the principal point and the image size."""


NO_DISTORTION = Distortion()
"""A lens without distortion."""


class Pinhole(NamedTuple):
    """Intrinsics from another program.

    Attributes:
        K: (3, 3) pinhole intrinsics [px].
        size: width and height of the images [px]; None if not stated.
        lens: the lens's distortion; None if its model is not OpenCV's.
    """

    K: Float[ndarray, "3 3"]
    size: tuple[int, int] | None
    lens: Distortion | None = NO_DISTORTION

    @staticmethod
    def of(
        fx: float,
        fy: float,
        cx: float,
        cy: float,
        size: tuple[int, int] | None,
        lens: Distortion | None = NO_DISTORTION,
    ) -> Pinhole:
        """Make a pinhole from focal lengths and principal point [px]."""
        return Pinhole(np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), size, lens)

    @property
    def distorted(self) -> bool:
        """True if the camera's lens distorts its images."""
        return self.lens is None or bool(self.lens.distortion)

    @property
    def is_possible(self) -> bool:
        """True if all numbers are finite, and focal lengths and size are above 0."""
        focal = self.K[..., [0, 1], [0, 1]]
        return bool(np.isfinite(self.K).all() and focal.min() > 0.0 and (self.size is None or min(self.size) > 0))

    def resized(self, size: tuple[int, int]) -> Float[ndarray, "3 3"]:
        """Return the intrinsics of the same images at another size."""
        own = self.of_images
        if self.size is None and max(abs(np.array(own) / size - 1.0)) < PRINCIPAL_POINT_SHAPE_TOLERANCE:
            return self.K
        return np.diag([*(np.array(size) / own), 1.0]) @ self.K

    @property
    def of_images(self) -> tuple[int, int]:
        """Width and height of the images [px]; if not stated, twice the principal point."""
        return self.size or (round(2.0 * self.K[0, 2]), round(2.0 * self.K[1, 2]))

    def check_images(self, path: Path, size: tuple[int, int]) -> None:
        """Raise ``InputError`` for images of another shape than the clip's, of a ``size``."""
        key = "size" if self.size else "size (twice the principal point)"
        tolerance = ASPECT_RATIO_TOLERANCE if self.size else PRINCIPAL_POINT_SHAPE_TOLERANCE
        check_shape(path, key, self.of_images, size, tolerance)


@dataclass(frozen=True, eq=False)
class CameraPath(ArrayData):
    """The trajectory of a camera in a static world frame.

    Attributes:
        source: description of the files, in words.
        path: the file, for errors.
        T_world_cam: (N, 4, 4) pose of the camera, camera frame (x right, y down, z forward) to world frame.
        names: names of the N images; empty for counted or timed poses.
        times: (N,) time of each pose [s]; None without times.
        pinholes: the intrinsics, one for all poses or one for each; empty if not stated.
        metric: True if lengths are in metres, as far as the program knows.
        up: (3,) direction away from the ground in the world frame; None if unknown.
        unit: the files' unit of time [s].
        others: further trajectories in the files, in other worlds, as COLMAP's further models.
    """

    source: str
    path: Path
    T_world_cam: Float[ndarray, "N 4 4"]
    names: tuple[str, ...] = ()
    times: Float[ndarray, "N"] | None = None
    pinholes: tuple[Pinhole, ...] = ()
    metric: bool = False
    up: Float[ndarray, "3"] | None = None
    unit: float = 1.0
    others: tuple[CameraPath, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        R = self.T_world_cam[:, :3, :3]
        off = np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max(initial=0.0)
        if not len(R) or not np.isfinite(self.T_world_cam).all() or off > 1e-2 or np.linalg.det(R).min() < 0.0:
            raise InputError(self.path, "", f"{len(R)} poses, {off:.2g} off rigid ones", "rigid poses of a camera")
        if self.pinhole is not None and not self.pinhole.is_possible:
            got = f"K {self.pinhole.K.tolist()} of images {self.pinhole.size}"
            raise InputError(self.path, "camera", got, "one with focal lengths above 0 and a size in pixels")

    @property
    def pinhole(self) -> Pinhole | None:
        """The intrinsics, or the first pose's; None if not stated."""
        return self.pinholes[0] if self.pinholes else None

    def scaled(self, metres: float) -> CameraPath:
        """Return the trajectory scaled by ``metres`` per unit of length."""
        T = self.T_world_cam.copy()
        T[:, :3, 3] *= metres
        return replace(self, T_world_cam=T)

    def best(self, frames: Sequence[str]) -> CameraPath:
        """Return the trajectory, this one or one of the others, with the most of the frames."""
        each = (self, *self.others)
        return max(each, key=lambda one: len({*frames_of(map(stem_of, one.names), frames)} - {None}))

    def at(
        self, frames: Sequence[str], times: Float[ndarray, "T"], start: float | None, counted: bool = False,
        images: str = "",
    ) -> tuple[Float[ndarray, "T 4 4"], Bool[ndarray, "T"]]:  # fmt: skip
        """Return the pose in each frame, and in which frames it is interpolated.

        ``times`` are the frames' times [s]; ``start`` is the file's time at time 0. With ``counted``, frames are
        numbered as the file's poses. ``images`` selects among several images of a frame. Raises ``InputError`` without
        poses at both ends, ``UsageError`` where poses cannot be matched to frames.
        """
        rows, at, wanted = self._matched(frames, times, start, counted, images)
        filled = (
            ~np.isin(wanted, at) if self.times is None else np.abs(at - wanted[:, None]).min(axis=1) >= TIME_TOLERANCE_S
        )
        T, wanted = self.T_world_cam[rows], np.clip(wanted, at[0], at[-1])
        if len(at) == 1:
            return np.tile(T, (len(frames), 1, 1)), filled
        t = np.stack([np.interp(wanted, at, T[:, axis, 3]) for axis in range(3)], axis=1)
        from scipy.spatial.transform import Rotation, Slerp

        return se3.rigid(Slerp(at, Rotation.from_matrix(T[:, :3, :3]))(wanted).as_matrix(), t), filled

    def K_at(
        self, size: tuple[int, int], frames: Sequence[str], times: Float[ndarray, "T"], start: float | None,
        counted: bool = False, images: str = "",
    ) -> Float[ndarray, "T 3 3"]:  # fmt: skip
        """Return the intrinsics of images of a ``size`` in each frame, with the arguments and errors of ``at``.

        Raises ``InputError`` for intrinsics of images of another shape.
        """
        rows, at, wanted = self._matched(frames, times, start, counted, images)
        used = [self.pinholes[row] for row in rows] if len(self.pinholes) > 1 else [self.pinholes[0]] * len(rows)
        for one in {id(one): one for one in used}.values():
            one.check_images(self.path, size)
        K = np.array([one.resized(size) for one in used]).reshape(len(rows), 9)
        return np.stack([np.interp(wanted, at, K[:, k]) for k in range(9)], axis=1).reshape(-1, 3, 3)

    def _matched(
        self, frames: Sequence[str], times: Float[ndarray, "T"], start: float | None, counted: bool, images: str
    ) -> tuple[Int[ndarray, "n"], Float[ndarray, "n"], Float[ndarray, "T"]]:
        """Return rows of poses, with their rising times [s] or positions, and the frames' times or positions."""
        if start is not None and self.times is None:
            raise UsageError(f"--start cannot be used with {self.path}: its poses have no times")
        if counted and self.times is not None:
            raise UsageError(f"--first cannot be used with {self.path}: its poses have times (--start)")
        if images and not self.names:
            raise UsageError(f"--images cannot be used with {self.path}: its poses have no names of images")
        place = times if np.all(np.diff(times) > 0.0) else np.arange(len(frames), dtype=float)
        if self.names:
            found = rows_of_frames(self.names, frames, self.path, "pose", images, "--images")
            known = sorted(found)
            return self._ends(frames, np.array([found[n] for n in known], dtype=np.int64), place[known], place)
        if self.times is None or (start is None and len(self.T_world_cam) == len(frames)):
            in_order = rows_in_order(len(self.T_world_cam), frames, self.path, "pose", counted)
            return np.array([in_order[n] for n in range(len(frames))]), place, place
        if start is None:
            count = f"{len(self.T_world_cam)} poses for {len(frames)} frames"
            raise UsageError(f"{self.path}: {count}: missing --start S, the file's time at time 0 of the clip")
        order = np.unique(self.times, return_index=True)[1]
        stamps = self.times[order]
        in_unit = not stamps[0] - 1.0 <= start <= stamps[-1] + 1.0
        wanted = times + start * (self.unit if in_unit else 1.0)
        nearest = np.abs(stamps[None] - wanted[:, None]).min(axis=1)
        if nearest.max() > MAX_POSE_GAP_S:
            got = f"poses from {stamps[0]:.6g} to {stamps[-1]:.6g} s, frames from {wanted[0]:.6g} to {wanted[-1]:.6g} s"
            raise InputError(self.path, "", got, f"a pose within {MAX_POSE_GAP_S:g} s of each frame; is --start right?")
        return self._ends(frames, order, stamps, wanted)

    def _ends(
        self, frames: Sequence[str], rows: Int[ndarray, "n"], at: Float[ndarray, "n"], wanted: Float[ndarray, "T"]
    ) -> tuple[Int[ndarray, "n"], Float[ndarray, "n"], Float[ndarray, "T"]]:
        """Check that poses are known at both ends. Raises ``InputError``."""
        if not len(at) or wanted[0] < at[0] - TIME_TOLERANCE_S or wanted[-1] > at[-1] + TIME_TOLERANCE_S:
            got = f"no pose of frame {frames[0] if not len(at) or wanted[0] < at[0] else frames[-1]}"
            raise InputError(self.path, "", got, "poses of the first and the last frame; cut the clip, or name images")
        return rows, at, wanted
