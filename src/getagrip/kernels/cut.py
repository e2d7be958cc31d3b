"""The primal-dual steps of a continuous minimal cut (``annotate.colour_cut``), pixel by pixel."""

from __future__ import annotations

import numpy as np
from numpy import ndarray

from getagrip.compiling import kernel


@kernel("s2 s2 s2 i")
def cut_steps(cost: ndarray, edge: ndarray, u: ndarray, rounds: int) -> None:
    """Minimise the sum of cost u + edge |grad u| over 0 <= u <= 1, from ``u`` (h, w) and into it."""
    height, width = u.shape
    step = np.float32(1.0 / np.sqrt(8.0))
    bar = u.copy()
    px, py = np.zeros_like(u), np.zeros_like(u)
    for _ in range(rounds):
        for i in range(height):
            for j in range(width):
                x, y = px[i, j], py[i, j]
                if j + 1 < width:
                    x += step * (bar[i, j + 1] - bar[i, j])
                if i + 1 < height:
                    y += step * (bar[i + 1, j] - bar[i, j])
                length = np.sqrt(x * x + y * y) / edge[i, j]
                if length > 1.0:
                    x, y = x / length, y / length
                px[i, j], py[i, j] = x, y
        for i in range(height):
            for j in range(width):
                spread = px[i, j] + py[i, j]
                if j > 0:
                    spread -= px[i, j - 1]
                if i > 0:
                    spread -= py[i - 1, j]
                new = min(max(u[i, j] + step * (spread - cost[i, j]), np.float32(0.0)), np.float32(1.0))
                bar[i, j], u[i, j] = np.float32(2.0) * new - u[i, j], new
