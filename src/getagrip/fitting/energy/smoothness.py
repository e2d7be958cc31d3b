"""Temporal smoothness (HOMan): vertices move little from one frame to the next, as the camera sees them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.fitting.energy.term import PosesInCamera, Quadratic
from getagrip.geometry import se3


def moments(vertices: Float[ndarray, "V 3"]) -> Float[ndarray, "4 4"]:
    """Compute four weighted points (rows.

    X, y, z and weight) that move, squared and summed, as the vertices do on average.

    The mean over the vertices of ``|A x - B x|^2`` for affine A and B depends on them by the mean of ``x x^T`` alone, x
    homogeneous; these are the rows of a root of it.
    """
    homogeneous = np.concatenate([vertices, np.ones((len(vertices), 1))], axis=1)
    values, vectors = np.linalg.eigh(homogeneous.T @ homogeneous / len(vertices))
    return np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T


@dataclass(frozen=True)
class SmoothnessTerm:
    """``weight * mean over vertices of |x(n+1) - x(n)|^2``, summed over neighbouring frames, in the camera frame.

    Half of a pair's energy stands in either frame's value.
    """

    moments: Float[ndarray, "4 4"]
    """Second moments of the vertices about the centre, unscaled (``moments``)."""
    weight: float
    """Energy per square metre [px^2 / m^2]."""
    name: str = "smoothness"

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        B, N = poses.centre.shape[:2]
        points, share = self.moments[:, :3], self.moments[:, 3:]
        arm = poses.scale[:, None, None, None] * points @ np.swapaxes(poses.R, -1, -2)
        step = np.diff(arm + share * poses.centre[:, :, None], axis=1)
        pair = self.weight * np.sum(step**2, axis=(2, 3))
        by_step = np.empty((B, N, 4, 3, 7))
        by_step[..., :3], by_step[..., 3:6], by_step[..., 6] = share[..., None] * np.eye(3), -se3.hat(arm), arm
        J = by_step.reshape(B, N, 12, 7)
        Jt = np.swapaxes(J, -1, -2)
        pull = 2.0 * self.weight * step.reshape(B, N - 1, 12, 1)
        value, g = np.zeros((B, N)), np.zeros((B, N, 7))
        value[:, :-1] += 0.5 * pair
        value[:, 1:] += 0.5 * pair
        g[:, :-1] -= (Jt[:, :-1] @ pull)[..., 0]
        g[:, 1:] += (Jt[:, 1:] @ pull)[..., 0]
        neighbours = np.full(N, 2.0)
        neighbours[0] -= 1.0
        neighbours[-1] -= 1.0
        H = 2.0 * self.weight * neighbours[:, None, None] * (Jt @ J)
        cross = np.zeros((B, N, 7, N, 7))
        n = np.arange(N - 1)
        block = -2.0 * self.weight * np.swapaxes(Jt[:, :-1] @ J[:, 1:], 0, 1)  # frames first, as the indexing below
        cross[:, n, :, n + 1] = block
        cross[:, n + 1, :, n] = np.swapaxes(block, -1, -2)
        return Quadratic(value, g, H, cross)
