"""Reprojection (HOMan): points of a body stay where they were observed in the image."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.fitting.energy.term import PosesInCamera, Quadratic
from getagrip.geometry import se3


@dataclass(frozen=True)
class ReprojectionTerm:
    """``weight * mean over points of |pi(x) - u|^2``, pi the pinhole projection of the crop."""

    points: Float[ndarray, "N P 3"]
    """Points of the body in each frame, about its centre, unscaled [m]."""
    K: Float[ndarray, "N 4"]
    """fx, fy, cx, cy [px of the crop]."""
    target: Float[ndarray, "N P 2"]
    """Observed points [px of the crop]."""
    weight: float
    """Energy per squared pixel."""
    name: str = "reprojection"

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        arm = poses.scale[:, None, None, None] * self.points @ np.swapaxes(poses.R, -1, -2)
        x = arm + poses.centre[:, :, None]
        z = x[..., 2:]
        f, c = self.K[:, None, :2], self.K[:, None, 2:]
        error = f * x[..., :2] / z + c - self.target
        J_pi = np.zeros((*x.shape[:-1], 2, 3))
        J_pi[..., 0, 0], J_pi[..., 1, 1] = np.moveaxis(f / z, -1, 0)
        J_pi[..., 2] = -f * x[..., :2] / z**2
        J_x = np.concatenate([np.broadcast_to(np.eye(3), (*x.shape, 3)), -se3.hat(arm), arm[..., None]], axis=-1)
        J = (J_pi @ J_x).reshape(*poses.centre.shape[:2], -1, 7)
        found = Quadratic.of_squares(error.reshape(*J.shape[:-1]), J, self.weight / self.points.shape[1])
        return replace(found, value=np.where((z > 0.0).all(axis=(2, 3)), found.value, np.inf))
