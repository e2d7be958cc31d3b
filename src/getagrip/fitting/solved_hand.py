"""Solved hand: where the hand is by all evidence on it and on its object, how well that is known, and what told it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.fitting.motion import PosesInHand, interpolated
from getagrip.geometry import se3


@dataclass(frozen=True)
class SolvedHand:
    """A hand that was solved together with its object.

    Attributes:
        T_cam_hand: (N, 4, 4) its poses.
        covariance: (6, 6) of the error that all frames share, in the hand frame: shift of its middle [m], turn about
            it [rad]. By curvature: it knows nothing of minima elsewhere.
        energy: of each kind of evidence, before and after [px^2 of the 256-pixel crop].
        differing: share of the hand's seen pixels that differ from its silhouette.
    """

    T_cam_hand: Float[ndarray, "N 4 4"]
    covariance: Float[ndarray, "6 6"]
    energy: Mapping[str, tuple[float, float]]
    differing: float

    def spread(self, points: Float[ndarray, "P 3"]) -> float:
        """Compute the standard deviation of points in the hand, from its middle, that its shared error leaves [m]."""
        moved = np.concatenate([np.broadcast_to(np.eye(3), (len(points), 3, 3)), -se3.hat(points)], axis=-1)
        return float(np.sqrt(np.einsum("pij,jk,pik->p", moved, self.covariance, moved).mean()))

    def __str__(self) -> str:
        place, turn = (np.sqrt(np.trace(part)) for part in (self.covariance[:3, :3], self.covariance[3:, 3:]))
        told = ", ".join(f"{name} {before:.0f} to {after:.0f}" for name, (before, after) in self.energy.items())
        return (
            "hand and object were solved together: the hand is known to about "
            f"{1e3 * place:.0f} mm and {np.degrees(turn):.0f} degrees; energies: {told}"
        )


def hand_between(
    T_given: Float[ndarray, "T 4 4"], T_found: Float[ndarray, "n 4 4"], at: ndarray
) -> Float[ndarray, "T 4 4"]:
    """Return the hand of every frame, by interpolating what was found of it in the frames ``at``."""
    C = (se3.inverse(T_given[at]) @ T_found)[None]
    between = interpolated(PosesInHand(C[..., :3, :3], C[..., :3, 3], np.ones(1)), at, np.arange(len(T_given)))
    T_cam_hand = T_given @ se3.rigid(between.R[0], between.centre[0])
    T_cam_hand[at] = T_found
    return np.asarray(T_cam_hand)
