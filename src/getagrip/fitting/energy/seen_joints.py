"""Reprojection of the hand's joints, as they were seen in the images."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.fitting.energy.hand_term import HandInCamera
from getagrip.fitting.energy.term import Quadratic
from getagrip.fitting.seen_joints import SeenJoints, image_derivatives
from getagrip.geometry import se3
from getagrip.hands.bending import BONE_OF_JOINT, CURLS, bend_derivatives, bent, hinges


@dataclass(frozen=True)
class SeenJointsTerm:
    """Cost of the hand's joints; its modes, where it has any, are ``CURLS``.

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
        axes, F = hinges(given), poses.modes.shape[-1]
        for b, (R, centre, scale, modes) in enumerate(
            zip(poses.R, poses.centre, poses.scale, poses.modes, strict=True)
        ):
            joints, turned = given, scale * R
            if F:
                joints = bent(given, given, BONE_OF_JOINT, np.tensordot(modes, CURLS[:F], 1))[1]
            arm = (joints - poses.middle) @ np.swapaxes(turned, -1, -2)
            X = arm + centre[:, None]
            J = np.empty((*X.shape, poses.size))
            J[..., :3], J[..., 3:6], J[..., 6] = np.eye(3), -se3.hat(arm), arm
            if F:
                bends = bend_derivatives(joints, axes).reshape(*X.shape, 15) @ CURLS[:F].reshape(F, 15).T
                J[..., 7:] = turned[:, None] @ bends
            J = image_derivatives(self.seen.K, X) @ J
            value, g, H = self.seen.quadratic(X, J.reshape(len(X), 42, -1))
            found.value[b], found.g[b], found.H[b] = self.weight * value, self.weight * g, self.weight * H
        return found
