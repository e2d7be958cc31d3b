"""Terms on the hand: pixels in which its silhouette differs from its mask, and reprojection of its 2D joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.fitting.energy.term import HandInCamera, Quadratic
from getagrip.fitting.hand.hand_silhouette import HandSilhouette
from getagrip.fitting.hand.joint_reprojection import SeenJoints, projection_jacobian
from getagrip.geometry import se3


@dataclass(frozen=True)
class HandMaskTerm:
    """Differing pixels of each frame by the hand's rigid motion and size; the fingers stay as in the input.

    Attributes:
        seen: the hand and its mask, with the mask's field.
        weight: (N,) energy per pixel of the hand's crop.
    """

    seen: HandSilhouette
    weight: Float[ndarray, "N"]
    name: str = "hand-mask"

    def __call__(self, poses: HandInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        found = Quadratic.zero(poses, poses.size)
        about = self.seen.errors.tracked.vertices - poses.middle
        for b, (R, centre, scale) in enumerate(zip(poses.R, poses.centre, poses.scale, strict=True)):
            arm = scale * about @ np.swapaxes(R, -1, -2)
            contour = self.seen.contour(arm + centre[:, None])
            arm = np.take_along_axis(arm, contour.nearest[..., None], axis=1)
            grown = np.sum(arm * contour.along, axis=-1, keepdims=True)
            J = np.concatenate([contour.along, np.cross(arm, contour.along), grown], axis=-1)
            value, g, H = contour.quadratic(J)
            found.value[b] = self.weight * value
            found.g[b, :, :7], found.H[b, :, :7, :7] = self.weight[:, None] * g, self.weight[:, None, None] * H
        return found


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
