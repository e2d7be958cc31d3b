"""Interaction (HOMan): the object's centre is drawn to the hand's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.fitting.energy import Local, Poses


@dataclass(frozen=True)
class InteractionTerm:
    """``weight * |c_object - c_hand|^2``."""

    hand: Float[ndarray, "N 3"]
    """The hand's centre in the camera frame [m]."""
    weight: float
    """Energy per square metre [px^2 / m^2]."""
    name: str = "interaction"

    def __call__(self, poses: Poses, bound: Float[ndarray, "B"]) -> Local:
        apart = poses.centre - self.hand
        g, H = np.zeros((*apart.shape[:2], 7)), np.zeros((*apart.shape[:2], 7, 7))
        g[..., :3] = 2.0 * self.weight * apart
        H[..., :3, :3] = 2.0 * self.weight * np.eye(3)
        return Local(self.weight * np.sum(apart**2, axis=-1), g, H)
