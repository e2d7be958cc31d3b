"""The smoothness term."""

from __future__ import annotations

import numpy as np

from getagrip.fitting.energy import no_bound
from getagrip.fitting.energy.smoothness import SmoothnessTerm, moments
from helpers.terms import random_poses


def test_smoothness_is_the_mean_square_of_the_vertices_steps() -> None:
    rng = np.random.default_rng(5)
    vertices, poses = rng.normal(0.01, 0.05, (40, 3)), random_poses(rng)
    value = SmoothnessTerm(moments(vertices), 7.0)(poses, no_bound(poses)).value.sum(axis=1)
    placed = poses.scale[:, None, None, None] * vertices @ np.swapaxes(poses.R, -1, -2) + poses.centre[:, :, None]
    expected = 7.0 * np.sum(np.diff(placed, axis=1) ** 2, axis=-1).mean(axis=-1).sum(axis=-1)
    np.testing.assert_allclose(value, expected, rtol=1e-9)
