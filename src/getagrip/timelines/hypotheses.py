"""Hypotheses about the object in some frames of a timeline: a few distinct solutions, in the world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.fitting.motion.base import Batch
from getagrip.geometry import se3


@dataclass(frozen=True)
class Hypotheses(Batch):
    """K solutions in n frames of a clip, best first: ``X_world = R @ (scale * (X_obj - c)) + centre``.

    Attributes:
        R, centre: poses about the mesh's centre c, in the world.
        scale: of the mesh.
        energy: of each [px^2 of the 256-pixel crop].
    """

    R: Float[ndarray, "K n 3 3"]
    centre: Float[ndarray, "K n 3"]
    scale: Float[ndarray, "K"]
    energy: Float[ndarray, "K"]

    def at(self, frames: Int[ndarray, "m"]) -> Hypotheses:
        """Return the hypotheses at some of the frames."""
        return Hypotheses(self.R[:, frames], self.centre[:, frames], self.scale, self.energy)

    def T_world_obj(self, centre: Float[ndarray, "3"]) -> Float[ndarray, "K n 4 4"]:
        """Return poses of the mesh's own frame, in which its centre is where it is given."""
        scale = self.scale[:, None, None]
        return se3.rigid(self.R, self.centre - scale * (self.R @ centre))

    def seen_from(
        self, T_cam_world: Float[ndarray, "n 4 4"]
    ) -> tuple[Float[ndarray, "K n 3 3"], Float[ndarray, "K n 3"]]:
        """Return rotations and centres in another frame than the world, as the camera's or the hand's."""
        return T_cam_world[:, :3, :3] @ self.R, se3.transform(T_cam_world, self.centre[:, :, None])[:, :, 0]


def in_world(
    R: Float[ndarray, "K n 3 3"],
    centre: Float[ndarray, "K n 3"],
    scale: Float[ndarray, "K"],
    energy: Float[ndarray, "K"],
    T_world_other: Float[ndarray, "n 4 4"],
) -> Hypotheses:
    """Make hypotheses from poses in another frame than the world."""
    placed = se3.transform(T_world_other, centre[:, :, None])[:, :, 0]
    return Hypotheses(T_world_other[:, :3, :3] @ R, np.asarray(placed), scale, energy)
