"""Reprojection of the hand's joints, as they were seen in the images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.fitting.energy.hand_term import HandInCamera
from getagrip.fitting.energy.term import Quadratic
from getagrip.fitting.seen_joints import SeenJoints, projection_jacobian
from getagrip.geometry import se3


@dataclass(frozen=True)
class SeenJointsTerm:
    """Cost of the hand's joints.

    Attributes:
        seen: the hand and its joints.
        weight: energy of a nat [px^2 of the 256-pixel crop].
    """

    seen: SeenJoints
    weight: float
    name: str = "joints-2d"

    def __call__(self, poses: HandInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        found = Quadratic.zero(poses, poses.size)
        given = self.seen.errors.tracked.joints
        assert given is not None
        for b, (R, centre, scale) in enumerate(zip(poses.R, poses.centre, poses.scale, strict=True)):
            arm = (given - poses.middle) @ np.swapaxes(scale * R, -1, -2)
            X = arm + centre[:, None]
            J = np.empty((*X.shape, poses.size))
            J[..., :3], J[..., 3:6], J[..., 6] = np.eye(3), -se3.hat(arm), arm
            J = projection_jacobian(self.seen.K, X) @ J
            value, g, H = self.seen.quadratic(X, J.reshape(len(X), 42, -1))
            found.value[b], found.g[b], found.H[b] = self.weight * value, self.weight * g, self.weight * H
        return found
