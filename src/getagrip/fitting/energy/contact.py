"""E_push and E_pull (appendix): push the object out of the hand's contact regions, and pull fingertips to it.

Both terms measure signed distances of the hand's contact vertices to the object's surface, a ``FaceGrid``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.clip import FINGERS, HandTrack
from getagrip.compiling import kernel
from getagrip.fitting.energy.term import PosesInCamera, Quadratic
from getagrip.geometry import se3
from getagrip.geometry.kernels.closest import GRID_SLACK_SPACINGS, FaceGrid, screen, signed_distance
from getagrip.geometry.mesh import Mesh

CONTACT_GRID_MARGIN_M = 0.03
"""Margin around the object within which contact is computed [m]."""


def build_contact_grid(mesh: Mesh, centre: Float[ndarray, "3"]) -> FaceGrid:
    """Build the object's solid for contact, about its centre."""
    return FaceGrid.of(mesh.vertices[mesh.faces] - centre, margin=CONTACT_GRID_MARGIN_M)


@kernel("f2 f3 f2 f f4 f3 f1 f f3 f3 n3 f3 f1 f")
def rms_distances(
    points, R, centre, scale, others_R, others_centre, others_scale, within, corners, normals, face, distance, origin,
    spacing,
):  # fmt: skip
    """Compute the root mean square distance of points (P, 3), posed in N frames, to C others' poses of a mesh [m].

    Infinite where it is more than ``within``. The mesh is that of a ``FaceGrid``; beyond the grid, where no face is
    known to be near, a distance is a lower bound: ``CONTACT_GRID_MARGIN_M`` and the distance to the grid.
    """
    N, P = len(R), len(points)
    most, out, moved = within * within * N * P, np.empty(len(others_scale)), np.empty((N, P, 3))
    for n in range(N):
        for p in range(P):
            x, y, z = scale * points[p, 0], scale * points[p, 1], scale * points[p, 2]
            for k in range(3):
                moved[n, p, k] = R[n, k, 0] * x + R[n, k, 1] * y + R[n, k, 2] * z + centre[n, k]
    local, rough = np.empty((P, 3)), np.empty(P)
    for c in range(len(out)):
        total = 0.0
        for n in range(N):
            if total > most:
                break
            screen(
                moved[n], others_R[c, n], others_centre[c, n], others_scale[c], distance, origin, spacing, local, rough
            )
            for p in range(P):
                if np.isfinite(rough[p]):
                    x, y, z = local[p, 0], local[p, 1], local[p, 2]
                    gap = signed_distance(x, y, z, corners, normals, face, origin, spacing)[0]
                else:
                    squared = 0.0
                    for k in range(3):
                        last = origin[k] + spacing * (distance.shape[k] - 1)
                        squared += max(max(origin[k] - local[p, k], local[p, k] - last), 0.0) ** 2
                    gap = CONTACT_GRID_MARGIN_M + np.sqrt(squared)
                total += gap * gap
                if total > most:
                    break
        out[c] = np.inf if total > most else np.sqrt(total / (N * P))
    return out


@dataclass(frozen=True)
class HandContacts:
    """The vertices of a hand's contact regions in the camera frame."""

    position: Float[ndarray, "N Q 3"]
    region: Int[ndarray, "6"]
    """Start of each of the five fingertip regions, and end of the last; palm regions follow."""

    @staticmethod
    def of(hand: HandTrack, per_region: int | None = None) -> HandContacts:
        """Return all vertices of the regions, or at most ``per_region`` spread evenly over each."""
        ids = contact_ids(hand, per_region)
        ends = np.concatenate([[0], np.cumsum([len(i) for i in ids[: len(FINGERS)]])])
        return HandContacts(se3.transform(hand.T_cam_hand, hand.vertices[:, np.concatenate(ids)]), ends)

    def take(self, index: Int[ndarray, "n"]) -> HandContacts:
        """Return the contacts at some of the frames."""
        return HandContacts(self.position[index], self.region)


def contact_ids(hand: HandTrack, per_region: int | None = None) -> list[Int[ndarray, "_"]]:
    """Return vertex ids of the regions, the five fingertips first.

    All, or at most ``per_region`` spread evenly over each.
    """
    ids = [hand.regions[name] for name in (*FINGERS, *sorted(set(hand.regions) - set(FINGERS)))]
    if per_region is None:
        return ids
    return [i[farthest_point_sampling(hand.vertices[0, i], per_region)] for i in ids]


def farthest_point_sampling(points: Float[ndarray, "P 3"], wanted: int) -> Int[ndarray, "n"]:
    """Choose ``wanted`` points spread evenly (farthest point first, starting nearest to the mean).

    Return their indices.
    """
    if len(points) <= wanted:
        return np.arange(len(points))
    chosen = np.empty(wanted, int)
    chosen[0] = np.argmin(np.sum((points - points.mean(axis=0)) ** 2, axis=1))
    distance = np.full(len(points), np.inf)
    for k in range(1, wanted):
        distance = np.minimum(distance, np.sum((points - points[chosen[k - 1]]) ** 2, axis=1))
        chosen[k] = np.argmax(distance)
    return np.sort(chosen)


@kernel()
def add_height_residual(d, tolerance, m0, m1, m2, x, y, z, R, centre, scale, weight, delta, g, H):
    """Add ``weight |scale d + tolerance|`` to the normal equations, d the height of a hand point over the object.

    The point (x, y, z) and the direction m of d are in the camera's and in the object's frame, d is of the unscaled
    object [m]. Moving the object by the local 7-vector (v, w, l) changes the height by
    ``-n . v - (r x n) . w + (d - r . n) l``, r the point from the object's centre, n the direction in the camera frame.
    Only the upper half of H is filled.
    """
    n0 = R[0, 0] * m0 + R[0, 1] * m1 + R[0, 2] * m2
    n1 = R[1, 0] * m0 + R[1, 1] * m1 + R[1, 2] * m2
    n2 = R[2, 0] * m0 + R[2, 1] * m1 + R[2, 2] * m2
    d *= scale
    r0, r1, r2 = x - centre[0], y - centre[1], z - centre[2]
    a = (
        -n0, -n1, -n2, r2 * n1 - r1 * n2, r0 * n2 - r2 * n0, r1 * n0 - r0 * n1, d - r0 * n0 - r1 * n1 - r2 * n2
    )  # fmt: skip
    h = weight / max(abs(d + tolerance), delta)
    for i in range(7):
        g[i] += h * (d + tolerance) * a[i]
        for j in range(i, 7):
            H[i, j] += h * a[i] * a[j]


@kernel()
def nearest_points(queries, points, begin, end, squared, nearest):
    """Find for each query (3, V) the nearest point (3, Q) from ``begin`` to ``end``: index and squared distance (V,).

    In single precision, which vectorises twice as wide, and with the queries inside, so that it vectorises at all:
    faster than trees for some hundred points.
    """
    squared[:] = np.float32(np.inf)
    nearest[:] = -1
    for q in range(begin, end):
        x, y, z = points[0, q], points[1, q], points[2, q]
        for v in range(len(squared)):
            dx, dy, dz = queries[0, v] - x, queries[1, v] - y, queries[2, v] - z
            d = dx * dx + dy * dy + dz * dz
            nearer = d < squared[v]
            nearest[v] = np.int32(q) if nearer else nearest[v]
            squared[v] = d if nearer else squared[v]


@kernel()
def add_rank_one(slope, curvature, a, g, H):
    """Add ``slope a`` to g (7,) and ``curvature a a^T`` to the upper half of H (7, 7)."""
    for i in range(7):
        g[i] += slope * a[i]
        for j in range(i, 7):
            H[i, j] += curvature * a[i] * a[j]


@kernel()
def mirror_upper(H):
    """Copy the upper half of a square matrix to its lower half."""
    for i in range(1, H.shape[0]):
        for j in range(i):
            H[i, j] = H[j, i]


@dataclass(frozen=True)
class PushTerm:
    """``weight * mean over contact vertices of max(0, -d - tolerance)``, d the vertex's signed distance to the object.

    The paper sums, over the object's vertices, the depth behind the tangent plane of the nearest contact vertex (the
    authors' code takes the mean). The same overlap is measured here from the hand's side: it does not depend on how the
    object is triangulated, a far vertex behind some finger's plane does not count, and the object, being rigid, can be
    prepared once.

    Skin gives way, and the hand is never known exactly: up to ``tolerance``, depth costs nothing. Without it, hands
    that are right but for some millimetres push the object off its silhouette.
    """

    solid: FaceGrid
    hand: HandContacts
    weight: Float[ndarray, "N"]
    """Energy per metre of mean depth, per frame [px^2 / m]."""
    tolerance: float = 0.004
    """Depth that costs nothing [m]."""
    delta: float = 0.002
    """Excess depths below this count as this in the curvature [m]."""
    name: str = "push"

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        found = Quadratic.zero(poses)
        _evaluate_push(
            poses.R, poses.centre, poses.scale, *self.solid.tables,
            self.hand.position, self.weight, self.tolerance, self.delta, bound,
            found.value, found.g, found.H,
        )  # fmt: skip
        return found


@kernel("f4 f3 f1 f3 f3 n3 f3 f1 f f3 f1 f f f1 f2 f3 f4")
def _evaluate_push(
    R, centre, scale, corners, normals, face, distance, origin, spacing, hand, weight, tolerance, delta, bound,
    value, g, H,
):  # fmt: skip
    """Fill in value (B, N), g (B, N, 7), H (B, N, 7, 7)."""
    B, N = value.shape
    Q = hand.shape[1]
    local, rough = np.empty((Q, 3)), np.empty(Q)
    slack = GRID_SLACK_SPACINGS * spacing
    for b in range(B):
        if not bound[b] >= 0.0:  # the step is rejected already, or no number
            continue
        for n in range(N):
            unit = weight[n] / Q
            screen(hand[n], R[b, n], centre[b, n], scale[b], distance, origin, spacing, local, rough)
            for q in range(Q):
                if scale[b] * (rough[q] - slack) >= -tolerance:
                    continue
                d, n0, n1, n2 = signed_distance(
                    local[q, 0], local[q, 1], local[q, 2], corners, normals, face, origin, spacing
                )  # fmt: skip
                if scale[b] * d < -tolerance:
                    value[b, n] -= unit * (scale[b] * d + tolerance)
                    x, y, z = hand[n, q, 0], hand[n, q, 1], hand[n, q, 2]
                    add_height_residual(
                        d, tolerance, n0, n1, n2, x, y, z, R[b, n], centre[b, n], scale[b], unit, delta,
                        g[b, n], H[b, n],
                    )  # fmt: skip
            mirror_upper(H[b, n])


@dataclass(frozen=True)
class PullTerm:
    """``weight * mean over the five fingertips of min over their vertices of |d|``, d the distance to the object.

    The paper takes ``<v_h - v_o, n_o>``, the height over the tangent plane of an object vertex, without an absolute
    value, which is unbounded below; the authors' later code takes the absolute value at the nearest vertex. The
    distance to the surface is what both stand for. A finger farther than ``max_distance`` is taken to hold
    nothing and feels no pull: in a pinch three of five fingers are in the air.
    """

    solid: FaceGrid
    hand: HandContacts
    weight: Float[ndarray, "N"]
    """Energy per metre of mean distance, per frame [px^2 / m]."""
    max_distance: float
    """Largest distance that pulls [m]."""
    delta: float = 0.002
    """Distances below this count as this in the curvature [m]."""
    name: str = "pull"

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        found = Quadratic.zero(poses)
        _evaluate_pull(
            poses.R, poses.centre, poses.scale, *self.solid.tables,
            self.hand.position, self.hand.region, self.weight, self.max_distance, self.delta, bound,
            found.value, found.g, found.H,
        )  # fmt: skip
        return found


@kernel("f4 f3 f1 f3 f3 n3 f3 f1 f f3 i1 f1 f f f1 f2 f3 f4")
def _evaluate_pull(
    R, centre, scale, corners, normals, face, distance, origin, spacing, hand, region, weight, max_distance, delta,
    bound, value, g, H,
):  # fmt: skip
    """Fill in value (B, N), g (B, N, 7), H (B, N, 7, 7)."""
    B, N = value.shape
    fingers = len(region) - 1
    tips = region[fingers]
    local, rough = np.empty((tips, 3)), np.empty(tips)
    slack = GRID_SLACK_SPACINGS * spacing
    for b in range(B):
        if not bound[b] >= 0.0:  # the step is rejected already, or no number
            continue
        farthest = max_distance / scale[b]
        for n in range(N):
            unit = weight[n] / fingers
            screen(hand[n, :tips], R[b, n], centre[b, n], scale[b], distance, origin, spacing, local, rough)
            for f in range(fingers):
                least, tip, d, n0, n1, n2 = farthest, -1, 0.0, 0.0, 0.0, 0.0
                for q in range(region[f], region[f + 1]):
                    if abs(rough[q]) - slack > least:
                        continue
                    e, m0, m1, m2 = signed_distance(
                        local[q, 0], local[q, 1], local[q, 2], corners, normals, face, origin, spacing
                    )  # fmt: skip
                    if abs(e) < least:
                        least, tip, d, n0, n1, n2 = abs(e), q, e, m0, m1, m2
                value[b, n] += unit * scale[b] * least
                if tip >= 0:
                    x, y, z = hand[n, tip, 0], hand[n, tip, 1], hand[n, tip, 2]
                    add_height_residual(
                        d, 0.0, n0, n1, n2, x, y, z, R[b, n], centre[b, n], scale[b], unit, delta, g[b, n], H[b, n]
                    )  # fmt: skip
            mirror_upper(H[b, n])
