"""E_pull (appendix): each fingertip is drawn to the object."""

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
class PullTerm:
    """``weight * mean over the five fingertips of min over their vertices of |<v_h - v_o, n_o>|``, v_o the object point
    nearest to v_h.

    The paper writes no absolute value, which is unbounded below; the authors' later code takes one. A finger farther
    than ``reach`` is not holding anything and feels no pull.
    """

    points: SurfacePoints
    hand: HandContacts
    weight: Float[ndarray, "N"]
    """Energy per metre of mean distance, per frame [px^2 / m]."""
    reach: float = 0.03
    delta: float = 0.002
    """Distances below this count as this in the curvature [m]."""
    name: str = "pull"

    def __call__(self, poses: Poses, bound: Float[ndarray, "B"]) -> Local:
        B, N = poses.centre.shape[:2]
        value, g, H = np.zeros((B, N)), np.zeros((B, N, 7)), np.zeros((B, N, 7, 7))
        _evaluate(
            poses.R, poses.centre, poses.scale, self.points.position, self.points.normal, self.hand.position,
            self.hand.region, self.weight, self.reach, self.delta, value, g, H,
        )  # fmt: skip
        return Local(value, g, H)


@njit(**OPTIONS)
def _evaluate(R, centre, scale, points, normal, hand, region, weight, reach, delta, value, g, H):
    """Fill in value (B, N), g (B, N, 7), H (B, N, 7, 7)."""
    B, N = value.shape
    P, F = points.shape[1], len(region) - 1
    posed, squared = np.empty((3, P)), np.empty(P)
    for b in range(B):
        for n in range(N):
            place(points, R[b, n], centre[b, n], scale[b], posed)
            unit = weight[n] / F
            for f in range(F):
                least, signed, at, tip = reach, 0.0, -1, -1
                for q in range(region[f], region[f + 1]):
                    x, y, z = hand[n, 0, q], hand[n, 1, q], hand[n, 2, q]
                    k = nearest(posed, x, y, z, squared)
                    m0, m1, m2 = normal[0, k], normal[1, k], normal[2, k]
                    n0 = R[b, n, 0, 0] * m0 + R[b, n, 0, 1] * m1 + R[b, n, 0, 2] * m2
                    n1 = R[b, n, 1, 0] * m0 + R[b, n, 1, 1] * m1 + R[b, n, 1, 2] * m2
                    n2 = R[b, n, 2, 0] * m0 + R[b, n, 2, 1] * m1 + R[b, n, 2, 2] * m2
                    d = n0 * (x - posed[0, k]) + n1 * (y - posed[1, k]) + n2 * (z - posed[2, k])
                    if abs(d) < least and squared[k] < reach * reach:
                        least, signed, at, tip = abs(d), d, k, q
                value[b, n] += unit * least
                if at < 0:
                    continue
                m0, m1, m2 = normal[0, at], normal[1, at], normal[2, at]
                n0 = R[b, n, 0, 0] * m0 + R[b, n, 0, 1] * m1 + R[b, n, 0, 2] * m2
                n1 = R[b, n, 1, 0] * m0 + R[b, n, 1, 1] * m1 + R[b, n, 1, 2] * m2
                n2 = R[b, n, 2, 0] * m0 + R[b, n, 2, 1] * m1 + R[b, n, 2, 2] * m2
                r0, r1, r2 = hand[n, 0, tip] - centre[b, n, 0], hand[n, 1, tip] - centre[b, n, 1], hand[n, 2, tip] - centre[b, n, 2]  # fmt: skip
                s = (
                    (posed[0, at] - centre[b, n, 0]) * n0
                    + (posed[1, at] - centre[b, n, 1]) * n1
                    + (posed[2, at] - centre[b, n, 2]) * n2
                )
                h = unit / max(least, delta)
                add_residual(h * signed, h, -n0, -n1, -n2, r0, r1, r2, -s, g[b, n], H[b, n])
            mirror_upper(H[b, n])
