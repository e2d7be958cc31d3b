"""The smoothness term."""

from __future__ import annotations

import numpy as np

from getagrip.fitting.energy import PosesInCamera, no_bound
from getagrip.fitting.energy.smoothness import SmoothnessTerm, moments
from helpers.terms import B, N, moved, random_poses, total_hessian


def test_smoothness_is_the_mean_square_of_the_vertices_steps() -> None:
    rng = np.random.default_rng(5)
    vertices, poses = rng.normal(0.01, 0.05, (40, 3)), random_poses(rng)
    value = SmoothnessTerm(moments(vertices), 7.0)(poses, no_bound(poses)).value.sum(axis=1)
    placed = poses.scale[:, None, None, None] * vertices @ np.swapaxes(poses.R, -1, -2) + poses.centre[:, :, None]
    expected = 7.0 * np.sum(np.diff(placed, axis=1) ** 2, axis=-1).mean(axis=-1).sum(axis=-1)
    np.testing.assert_allclose(value, expected, rtol=1e-9)


def test_curvature_is_that_of_the_energy_where_the_object_rests() -> None:
    """A step s from rest costs ``s^T H s / 2``, in every frame, between frames and at every scale."""
    rng = np.random.default_rng(11)
    term, one = SmoothnessTerm(moments(rng.normal(0.01, 0.05, (40, 3))), 7.0), random_poses(rng, frames=1)
    rest = PosesInCamera(one.R.repeat(N, axis=1), one.centre.repeat(N, axis=1), one.scale)
    H, h = total_hessian(term(rest, no_bound(rest))), 1e-4
    for n, k in np.ndindex(N, 6):
        step = 0.2 * rng.normal(size=(N, 7))
        step[n, k] += 1.0
        step[:, 6] = rng.normal()  # shared
        ahead, behind = (
            term(p, no_bound(p)).value.sum(axis=1) for p in (moved(rest, h * step), moved(rest, -h * step))
        )
        expected = np.array([step.ravel() @ H[b] @ step.ravel() for b in range(B)])
        np.testing.assert_allclose((ahead + behind) / h**2, expected, rtol=1e-4)
