"""Interaction (HOMan): the object's centre is drawn to the hand's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.fitting.energy.term import PosesInCamera, Quadratic


@dataclass(frozen=True)
class InteractionTerm:
    """``weight * |c_object - c_hand|^2``."""

    hand: Float[ndarray, "N 3"]
    """The hand's centre in the camera frame [m]."""
    weight: float
    """Energy per square metre [px^2 / m^2]."""
    name: str = "interaction"

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        error = poses.centre - self.hand
        J = np.broadcast_to(np.eye(3, 7), (*error.shape, 7))
        return Quadratic.of_squares(error, J, self.weight)
