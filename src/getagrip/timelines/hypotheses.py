"""Hypotheses about the object in some frames of a timeline: a few distinct solutions, in the world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.fitting.motion import PosesInHand, hand_object_transforms
from getagrip.geometry import se3


@dataclass(frozen=True)
class Hypotheses(PosesInHand):
    """K solutions in n frames of a clip, best first; the poses are in the world.

    Attributes:
        energy: of each [px^2 of the 256-pixel crop].
    """

    energy: Float[ndarray, "K"]

    def at(self, frames: Int[ndarray, "m"]) -> Hypotheses:
        """Return the hypotheses at some of the frames."""
        return Hypotheses(self.R[:, frames], self.centre[:, frames], self.scale, self.energy)

    def T_world_obj(self, centre: Float[ndarray, "3"]) -> Float[ndarray, "K n 4 4"]:
        """Return poses of the mesh's own frame, in which its centre is where it is given."""
        return hand_object_transforms(self, centre)

    @staticmethod
    def of_pose(T_world_obj: Float[ndarray, "4 4"], centre: Float[ndarray, "3"]) -> Hypotheses:
        """Make the hypothesis of one known pose in one frame, at the scale of the mesh."""
        placed_centre = se3.transform(T_world_obj, centre[None])
        return Hypotheses(T_world_obj[None, None, :3, :3], placed_centre[None], np.ones(1), np.zeros(1))
