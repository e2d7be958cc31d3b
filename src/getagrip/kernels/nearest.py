"""Nearest of a few hundred points, by brute force: at this size faster than any tree, and the points move every call."""

from __future__ import annotations

import numpy as np
from numba import njit

from getagrip.kernels.silhouette import OPTIONS


@njit(**OPTIONS)
def nearest(points, x, y, z, squared):
    """Index of the column of points (3, P) nearest to (x, y, z); squared (P,) is scratch, left with squared distances.

    Three plain passes, each of which the compiler turns into vector instructions.
    """
    n = points.shape[1]
    for k in range(n):
        dx, dy, dz = points[0, k] - x, points[1, k] - y, points[2, k] - z
        squared[k] = dx * dx + dy * dy + dz * dz
    least = squared[0]
    for k in range(n):
        least = squared[k] if squared[k] < least else least
    for k in range(n):
        if squared[k] == least:
            return k
    return 0


@njit(**OPTIONS)
def add_residual(slope, curvature, n0, n1, n2, r0, r1, r2, s, g, H):
    """Add one residual to a frame's normal equations; returns nothing.

    Its derivative by the local 7-vector is (n, r x n, s). ``slope`` is dE/dresidual, ``curvature`` d2E/dresidual2.
    Only the upper half of H is filled.
    """
    a = (n0, n1, n2, r1 * n2 - r2 * n1, r2 * n0 - r0 * n2, r0 * n1 - r1 * n0, s)
    for i in range(7):
        g[i] += slope * a[i]
        for j in range(i, 7):
            H[i, j] += curvature * a[i] * a[j]


@njit(**OPTIONS)
def mirror_upper(H):
    """Copy the upper half of a square matrix to its lower half."""
    for i in range(1, H.shape[0]):
        for j in range(i):
            H[i, j] = H[j, i]


@njit(**OPTIONS)
def place(points, R, centre, scale, posed):
    """Pose points (3, P): ``posed = scale R points + centre``."""
    for k in range(points.shape[1]):
        x, y, z = scale * points[0, k], scale * points[1, k], scale * points[2, k]
        posed[0, k] = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + centre[0]
        posed[1, k] = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + centre[1]
        posed[2, k] = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + centre[2]


def spread_points(points: np.ndarray, wanted: int) -> np.ndarray:
    """Indices of ``wanted`` points (P, 3) spread evenly (farthest point first, starting nearest to the mean)."""
    if len(points) <= wanted:
        return np.arange(len(points))
    chosen = np.empty(wanted, int)
    chosen[0] = np.argmin(np.sum((points - points.mean(axis=0)) ** 2, axis=1))
    distance = np.full(len(points), np.inf)
    for k in range(1, wanted):
        distance = np.minimum(distance, np.sum((points - points[chosen[k - 1]]) ** 2, axis=1))
        chosen[k] = np.argmax(distance)
    return np.sort(chosen)
