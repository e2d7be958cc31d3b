"""E_push (appendix): object points behind the surface of the hand's contact regions are pushed out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numba import njit
from numpy import ndarray

from getagrip.contact import HandContacts, SurfacePoints
from getagrip.energy import Local, Poses
from getagrip.kernels.nearest import add_residual, mirror_upper, nearest, place
from getagrip.kernels.silhouette import OPTIONS


@dataclass(frozen=True)
class PushTerm:
    """``weight * mean over object points of max(0, -d)``, d the height above the nearest contact vertex's tangent plane.

    Points farther than ``reach`` from every contact vertex do not count: behind the tangent plane of a finger they are
    on its other side, not inside it.
    """

    points: SurfacePoints
    hand: HandContacts
    weight: Float[ndarray, "N"]
    """Energy per metre of mean depth, per frame [px^2 / m]."""
    reach: float = 0.02
    delta: float = 0.002
    """Depths below this count as this in the curvature [m]."""
    name: str = "push"

    def __call__(self, poses: Poses, bound: Float[ndarray, "B"]) -> Local:
        B, N = poses.centre.shape[:2]
        value, g, H = np.zeros((B, N)), np.zeros((B, N, 7)), np.zeros((B, N, 7, 7))
        _evaluate(
            poses.R, poses.centre, poses.scale, self.points.position, self.hand.position, self.hand.normal,
            self.weight, self.reach, self.delta, value, g, H,
        )  # fmt: skip
        return Local(value, g, H)


@njit(**OPTIONS)
def _evaluate(R, centre, scale, points, hand, normal, weight, reach, delta, value, g, H):
    """Fill in value (B, N), g (B, N, 7), H (B, N, 7, 7)."""
    B, N = value.shape
    P = points.shape[1]
    posed = np.empty((3, P))
    squared = np.empty(hand.shape[2])
    low, high = np.empty((N, 3)), np.empty((N, 3))
    for n in range(N):
        for k in range(3):
            low[n, k], high[n, k] = hand[n, k].min() - reach, hand[n, k].max() + reach
    for b in range(B):
        for n in range(N):
            place(points, R[b, n], centre[b, n], scale[b], posed)
            c0, c1, c2 = centre[b, n, 0], centre[b, n, 1], centre[b, n, 2]
            unit = weight[n] / P
            for i in range(P):
                x, y, z = posed[0, i], posed[1, i], posed[2, i]
                if (
                    x < low[n, 0] or x > high[n, 0] or y < low[n, 1] or y > high[n, 1] or z < low[n, 2] or z > high[n, 2]
                ):  # fmt: skip
                    continue
                k = nearest(hand[n], x, y, z, squared)
                if squared[k] > reach * reach:
                    continue
                n0, n1, n2 = normal[n, 0, k], normal[n, 1, k], normal[n, 2, k]
                d = n0 * (x - hand[n, 0, k]) + n1 * (y - hand[n, 1, k]) + n2 * (z - hand[n, 2, k])
                if d >= 0.0:
                    continue
                value[b, n] -= unit * d
                h = unit / max(-d, delta)
                r0, r1, r2 = x - c0, y - c1, z - c2
                s = r0 * n0 + r1 * n1 + r2 * n2
                add_residual(h * d, h, n0, n1, n2, r0, r1, r2, s, g[b, n], H[b, n])
            mirror_upper(H[b, n])
