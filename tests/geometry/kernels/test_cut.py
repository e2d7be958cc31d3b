"""The compiled minimal cut against readable steps."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from getagrip.studio.masks.graph_cut import cut_steps


def steps(cost: ndarray, edge: ndarray, start: ndarray, rounds: int) -> ndarray:
    """Chambolle and Pock's steps."""
    u, bar = start, start.copy()
    px, py = np.zeros_like(u), np.zeros_like(u)
    step = np.float32(1.0 / np.sqrt(8.0))
    for _ in range(rounds):
        px[:, :-1] += step * (bar[:, 1:] - bar[:, :-1])
        py[:-1] += step * (bar[1:] - bar[:-1])
        length = np.maximum(np.float32(1.0), np.sqrt(px * px + py * py) / edge)
        px, py = px / length, py / length
        spread = px + py
        spread[:, 1:] -= px[:, :-1]
        spread[1:] -= py[:-1]
        new = np.clip(u + step * (spread - cost), 0.0, 1.0)
        bar, u = 2.0 * new - u, new
    return u


def test_the_compiled_cut_is_the_readable_one() -> None:
    rng = np.random.default_rng(0)
    for shape in ((1, 1), (1, 7), (9, 1), (24, 31)):
        cost = rng.normal(size=shape).astype(np.float32)
        edge = rng.uniform(0.1, 3.0, shape).astype(np.float32)
        u = rng.uniform(size=shape).astype(np.float32)
        expected = steps(cost, edge, u.copy(), 50)
        cut_steps(cost, edge, u, 50)
        np.testing.assert_allclose(u, expected, atol=1e-4)
