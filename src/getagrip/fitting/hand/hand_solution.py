"""The solved hand: its poses by all evidence on hand and object, their uncertainty, and the energies that changed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.fitting.motion import PosesInHand, interpolate_object_poses
from getagrip.geometry import se3

N_ALTERNATIVE_DIRECTIONS, MIN_POINT_VARIANCE_M2 = 3, 1e-12
"""Number of directions of a hand's alternatives; minimum squared motion of points by a standard deviation [m^2]."""


@dataclass(frozen=True)
class SolvedHand:
    """A hand that was solved together with its object.

    Attributes:
        T_cam_hand: (N, 4, 4) its poses.
        covariance: (6, 6) of the error that all frames share, in the hand frame: shift of the hand's middle [m], turn
            about the middle [rad]. By curvature, without other minima.
        energy: energy of each kind of evidence, before and after [px^2 of the 256-pixel crop].
        differing: fraction of the hand's visible pixels that differ from its silhouette.
    """

    T_cam_hand: Float[ndarray, "N 4 4"]
    covariance: Float[ndarray, "6 6"]
    energy: Mapping[str, tuple[float, float]]
    differing: float

    def alternatives(
        self, points: Float[ndarray, "P 3"], middle: Float[ndarray, "3"], apart: float
    ) -> Float[ndarray, "M 4 4"]:
        """Return alternative hand poses, either way along the ``N_ALTERNATIVE_DIRECTIONS`` least certain directions.

        Args:
            points: points in the hand, from its middle [m].
            middle: the hand's middle, in the hand frame [m].
            apart: motion of these points, root mean square [m].

        Returns:
            Poses in the hand frame, in pairs, the least certain direction first.
        """
        certain, axes = np.linalg.eigh(self.covariance)
        root, moved = axes * np.sqrt(np.maximum(certain, 0.0)), rigid_point_jacobian(points)
        spread, axes = np.linalg.eigh(root.T @ np.einsum("pij,pik->jk", moved, moved) @ root / len(points))
        x = (apart * root @ axes[:, ::-1] / np.sqrt(np.maximum(spread[::-1], MIN_POINT_VARIANCE_M2))).T
        x = np.stack([x, -x], axis=1)[:N_ALTERNATIVE_DIRECTIONS].reshape(-1, 6)
        R = se3.exp_so3(x[:, 3:])
        return se3.rigid(R, middle + x[:, :3] - R @ middle)

    def spread(self, points: Float[ndarray, "P 3"]) -> float:
        """Compute the standard deviation of points in the hand, from its middle, that its shared error leaves [m]."""
        moved = rigid_point_jacobian(points)
        return float(np.sqrt(np.einsum("pij,jk,pik->p", moved, self.covariance, moved).mean()))

    def __str__(self) -> str:
        place, turn = (np.sqrt(np.trace(part)) for part in (self.covariance[:3, :3], self.covariance[3:, 3:]))
        evidence = ", ".join(f"{name} {before:.0f} to {after:.0f}" for name, (before, after) in self.energy.items())
        return (
            "hand and object were solved together: the hand is known to about "
            f"{1e3 * place:.0f} mm and {np.degrees(turn):.0f} degrees; energies: {evidence}"
        )


def rigid_point_jacobian(points: Float[ndarray, "P 3"]) -> Float[ndarray, "P 3 6"]:
    """Differentiate points about a body's centre by the body's shift and turn."""
    return np.concatenate([np.broadcast_to(np.eye(3), (len(points), 3, 3)), -se3.hat(points)], axis=-1)


def interpolate_solved_hand(
    T_input: Float[ndarray, "T 4 4"], T_found: Float[ndarray, "n 4 4"], at: ndarray
) -> Float[ndarray, "T 4 4"]:
    """Interpolate the corrections of the hand's poses in the frames ``at`` to every frame."""
    C = (se3.inverse(T_input[at]) @ T_found)[None]
    corrections = PosesInHand(C[..., :3, :3], C[..., :3, 3], np.ones(1))
    between = interpolate_object_poses(corrections, at, np.arange(len(T_input)))
    T_cam_hand = T_input @ se3.rigid(between.R[0], between.centre[0])
    T_cam_hand[at] = T_found
    return np.asarray(T_cam_hand)
