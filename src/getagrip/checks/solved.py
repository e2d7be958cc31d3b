"""A clip with all that a fit has found for it, as the signs of a right result look at it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.checks.evidence import Evidence
from getagrip.clip.sampling import frame_indices
from getagrip.geometry import se3
from getagrip.metrics.pose import ObjectTrack, best_symmetry, pose_errors
from getagrip.metrics.symmetry import find_symmetries, surface_points
from getagrip.result import Axis, Candidates

N_COMPARED_FRAMES, N_COMPARED_POINTS = 5, 200
"""Frames in which candidates are compared, and points of the object's surface."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SolvedEvidence(Evidence):
    """A fitted clip at the frames that were fitted together; its hand is the one that the poses are relative to.

    Attributes:
        T_hand_obj: (T, 4, 4) poses that were found.
        iou: (T,) overlap of rendered and observed mask.
        candidates: the best distinct solutions in these frames; the first is the one that was found.
        axis: the axis that was found, where the method has one.
        T_cam_hand_input: (T, 4, 4) poses of the hand as it was given.
        spread: standard deviation of the pose that the energy leaves, in diameters; NaN where it is not known.
        hand_spread: standard deviation of an object in the hand that the evidence on the hand leaves [m].
        joint_error: error of the hand's 2D joints, estimated from the clip [shares of the hand's box]; NaN: none count.
    """

    candidates: Candidates
    axis: Axis | None
    T_cam_hand_input: Float[ndarray, "T 4 4"]
    spread: float
    hand_spread: float
    joint_error: float = np.nan

    @property
    def poses(self) -> Float[ndarray, "T 4 4"]:
        """``T_hand_obj``, which is known here."""
        assert self.T_hand_obj is not None
        return self.T_hand_obj

    @property
    def diameter(self) -> float:
        """Diameter of the object at the resulting scale [m]."""
        return self.scale * self.clip.mesh.diameter

    @property
    def energy_times(self) -> Float[ndarray, "K"]:
        """How many times as large as the least energy those of the candidates are."""
        energy = np.maximum(self.candidates.energy, 1e-9)
        return np.asarray(energy / energy.min())

    @cached_property
    def apart(self) -> Float[ndarray, "K"]:
        """Distance of each candidate's surface from that of the first, in diameters.

        Means of the distances to the nearest point, so that symmetric poses are not apart.
        """
        from scipy.spatial import cKDTree

        few = frame_indices(len(self.clip), N_COMPARED_FRAMES)
        points = surface_points(self.clip.mesh, N_COMPARED_POINTS)
        T, scale = self.candidates.T_hand_obj[:, few], self.candidates.scale[:, None, None, None]
        surfaces = se3.transform(T, scale * points)
        trees = [cKDTree(surface) for surface in surfaces[0]]
        off = [[tree.query(x)[0].mean() for tree, x in zip(trees, surface, strict=True)] for surface in surfaces]
        nearest = [tree.query(x, k=2)[0][:, 1].mean() for tree, x in zip(trees, surfaces[0], strict=True)]
        return np.maximum(np.mean(off, axis=1) - 0.5 * np.mean(nearest), 0.0) / self.diameter

    def vertices_apart(self, k: int) -> float:
        """Return the distance of a candidate's vertices from those of the first, in diameters.

        The distance is ADD, up to symmetries.
        """
        if k == 0:
            return 0.0
        few, mesh = frame_indices(len(self.clip), N_COMPARED_FRAMES), self.clip.mesh
        first, other = (
            ObjectTrack(self.candidates.T_hand_obj[n, few], float(self.candidates.scale[n])) for n in (0, k)
        )
        symmetry = best_symmetry(mesh, other, first, find_symmetries(mesh))
        return float(pose_errors(mesh, other, first, symmetry).add.mean()) / self.diameter

    @cached_property
    def off_axis(self) -> float:
        """Angle by which the motion is off a rotation about the axis, root mean square [rad]."""
        R = self.poses[:, :3, :3]
        if self.axis is not None:
            R = se3.exp_so3(-self.axis.angle[:, None] * self.axis.direction) @ R
        return float(np.sqrt(np.mean(se3.angle_between(R, se3.nearest_rotation(R.mean(axis=0))) ** 2)))

    @property
    def hand_shift(self) -> float:
        """Shift of the hand's middle by the refinement, mean over frames [m]."""
        middle = self.clip.hand.vertices.mean(axis=(0, 1))[None]
        T, value = self.clip.hand.T_cam_hand, self.T_cam_hand_input
        return float(np.linalg.norm(se3.transform(T, middle) - se3.transform(value, middle), axis=-1).mean())

    @property
    def hand_turn(self) -> float:
        """Rotation of the hand by the refinement, mean over frames [rad]."""
        T, value = self.clip.hand.T_cam_hand, self.T_cam_hand_input
        return float(se3.angle_between(T[:, :3, :3], value[:, :3, :3]).mean())
