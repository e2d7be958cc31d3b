"""Contact consistency: every pair of frames keeps the same distances between points of the hand and of the object."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.compiling import kernel
from getagrip.fitting.energy.term import PosesInCamera, Quadratic, Ties

N_PARTNERS = 30
"""Number of frames that each frame is compared with in long clips; in shorter ones with all."""


@dataclass(frozen=True)
class ContactConsistencyTerm:
    """``sum over t of weight_t * mean over frames t' and pairs (h, o) of rho(D_t - D_t')``, D = |h - o|^2 [m^2].

    The term of the authors' later in-hand model, between all pairs of frames; in clips of more than ``N_PARTNERS``
    frames each is compared with this many, evenly spaced, so that the cost is linear. Its absolute value is rounded off
    below ``delta`` (Huber: ``rho(e) = e^2 / (2 delta)`` there, ``|e| - delta / 2`` beyond), so that value, gradient and
    curvature agree; the curvature ``1 / max(|e|, delta)`` is that of a quadratic above it.
    """

    points: Float[ndarray, "P 3"]
    """Points of the object about its centre, unscaled [m]."""
    hand: Float[ndarray, "N Q 3"]
    """Points of the hand in the camera frame [m]."""
    weight: Float[ndarray, "N"]
    """Energy per square metre, per frame [px^2 / m^2]."""
    delta: float = 2e-5
    """The Huber threshold [m^2]: a tenth of a millimetre at a distance of ten centimetres."""
    exact: bool = False
    """True for a dense, exact Hessian between frames (``Quadratic.cross``); False for ``Quadratic.ties``."""
    name: str = "consistency"

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        B, N = poses.centre.shape[:2]
        first, second = pairs_of_frames(N)
        found, block = Quadratic.zero(poses), np.zeros((B, len(first), 7, 7))
        _evaluate_contact_consistency(
            poses.R, poses.centre, poses.scale, self.points, self.hand, self.weight, self.delta, bound, first, second,
            found.value, found.g, found.H, block,
        )  # fmt: skip
        ties = Ties(first, second, block, found.H.copy())
        return replace(found, cross=ties.dense()) if self.exact else replace(found, ties=ties)


@cache
def pairs_of_frames(N: int) -> tuple[Int[ndarray, "M"], Int[ndarray, "M"]]:
    """Return all pairs of N frames, or such that each frame is in ``N_PARTNERS`` pairs."""
    if N <= N_PARTNERS + 1:
        return np.tril_indices(N, -1)
    apart = np.linspace(1, (N - 1) // 2, N_PARTNERS // 2).round().astype(int)
    first = np.repeat(np.arange(N), len(apart))
    return first, (first + np.tile(apart, N)) % N


@kernel("f4 f3 f1 f2 f3 f1 f f1 i1 i1 f2 f3 f4 f4")
def _evaluate_contact_consistency(
    R, centre, scale, points, hand, weight, delta, bound, first, second, value, g, H, block
):  # fmt: skip
    """Fill in value (B, N), g (B, N, 7), H (B, N, 7, 7), block (B, M, 7, 7)."""
    B, N = value.shape
    D = len(points) * hand.shape[1]
    share = (N - 1) / (2.0 * max(len(first), 1) * D)  # of the mean over N frames, in the mean over a frame's partners
    distance, a = np.empty((N, D)), np.empty((N, 7, D))
    for b in range(B):
        if not bound[b] >= 0.0:  # nothing to be gained, or no number at all
            continue
        for n in range(N):
            _squared_distances(R[b, n], centre[b, n], scale[b], points, hand[n], distance[n], a[n])
        total = _add_pairwise_costs(distance, weight, delta, first, second, share, value[b])
        if not total <= bound[b]:
            continue
        _add_pairwise_derivatives(distance, a, weight, delta, first, second, share, g[b], H[b], block[b])


@kernel()
def _add_pairwise_costs(distance, weight, delta, first, second, share, value):
    """Share the cost of each pair of frames between the two, in value (N,), and return the sum."""
    total = 0.0
    for pair in range(len(first)):
        i, j = first[pair], second[pair]
        cost = 0.0
        for k in range(distance.shape[1]):
            e = abs(distance[i, k] - distance[j, k])
            cost += e - 0.5 * delta if e > delta else 0.5 * e * e / delta
        cost *= share
        value[i] += weight[i] * cost
        value[j] += weight[j] * cost
        total += (weight[i] + weight[j]) * cost
    return total


@kernel()
def _add_pairwise_derivatives(distance, a, weight, delta, first, second, share, g, H, block):
    """Fill in g (N, 7), H (N, 7, 7), block (M, 7, 7) from distances (N, D) and their derivatives (N, 7, D)."""
    N, D = distance.shape
    slope, curve = np.zeros((N, D)), np.zeros((N, D))
    between, weighted = np.empty(D), np.empty((7, D))
    for pair in range(len(first)):
        i, j = first[pair], second[pair]
        unit = (weight[i] + weight[j]) * share
        for k in range(D):
            e = distance[i, k] - distance[j, k]
            h = unit / max(abs(e), delta)
            between[k] = h
            slope[i, k] += h * e
            slope[j, k] -= h * e
            curve[i, k] += h
            curve[j, k] += h
        _multiply_rows(between, a[i], weighted)
        for p in range(7):
            for q in range(7):
                block[pair, p, q] = -_dot(weighted[p], a[j, q])
    for n in range(N):
        _multiply_rows(curve[n], a[n], weighted)
        for p in range(7):
            g[n, p] = _dot(slope[n], a[n, p])
            for q in range(p + 1):
                H[n, p, q] = H[n, q, p] = _dot(weighted[p], a[n, q])


@kernel()
def _squared_distances(R, centre, scale, points, hand, distance, a):
    """Squared distances (D,) of all pairs of a frame, and their derivatives (7, D) by the local 7-vector.

    With y = scale R x from the object's centre and u = h - centre - y, D = |u|^2 changes by
    ``-2 u . v - 2 (y x u) . w - 2 (u . y) l``.
    """
    k = 0
    for x in points:
        y0 = scale * (R[0, 0] * x[0] + R[0, 1] * x[1] + R[0, 2] * x[2])
        y1 = scale * (R[1, 0] * x[0] + R[1, 1] * x[1] + R[1, 2] * x[2])
        y2 = scale * (R[2, 0] * x[0] + R[2, 1] * x[1] + R[2, 2] * x[2])
        for h in hand:
            u0, u1, u2 = h[0] - centre[0] - y0, h[1] - centre[1] - y1, h[2] - centre[2] - y2
            distance[k] = u0 * u0 + u1 * u1 + u2 * u2
            a[0, k], a[1, k], a[2, k] = -2.0 * u0, -2.0 * u1, -2.0 * u2
            a[3, k] = -2.0 * (y1 * u2 - y2 * u1)
            a[4, k] = -2.0 * (y2 * u0 - y0 * u2)
            a[5, k] = -2.0 * (y0 * u1 - y1 * u0)
            a[6, k] = -2.0 * (u0 * y0 + u1 * y1 + u2 * y2)
            k += 1


@kernel()
def _multiply_rows(h, a, out):
    for p in range(7):
        for k in range(len(h)):
            out[p, k] = h[k] * a[p, k]


@kernel()
def _dot(a, b):
    total = 0.0
    for k in range(len(a)):
        total += a[k] * b[k]
    return total
