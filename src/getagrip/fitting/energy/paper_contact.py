"""E_push and E_pull as the paper states them (appendix), for the method ``paper``.

Push: object vertices behind the tangent planes of the hand's contact vertices. Pull: heights of fingertips over tangent
planes of the object.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import HandTrack
from getagrip.compiling import kernel
from getagrip.fitting.energy.contact import HandContacts, add_rank_one, contact_ids, mirror_upper, nearest_points
from getagrip.fitting.energy.term import PosesInCamera, Quadratic
from getagrip.geometry.mesh import vertex_normals


@dataclass(frozen=True)
class TangentPlanes:
    """The planes that touch a hand at the vertices of all its contact regions, in the camera frame."""

    point: Float[ndarray, "N 3 Q"]
    """The vertices [m]."""
    normal: Float[ndarray, "N 3 Q"]
    """Unit normals, out of the hand."""

    @staticmethod
    def of(hand: HandTrack, per_region: int | None = None) -> TangentPlanes:
        """Make the planes at all vertices of the regions, or at most ``per_region`` spread evenly over each."""
        ids = np.concatenate(contact_ids(hand, per_region))
        R, t = hand.T_cam_hand[:, :3, :3], hand.T_cam_hand[:, :3, 3, None]
        normals = vertex_normals(hand.vertices, hand.faces)[:, ids]
        point, normal = R @ np.swapaxes(hand.vertices[:, ids], 1, 2) + t, R @ np.swapaxes(normals, 1, 2)
        return TangentPlanes(np.ascontiguousarray(point), np.ascontiguousarray(normal))

    def take(self, index: ndarray) -> TangentPlanes:
        """Return the planes at some of the frames."""
        return TangentPlanes(self.point[index], self.normal[index])


@dataclass(frozen=True)
class PaperPushTerm:
    """``weight * sum over v in V_o of -min(0, <v - h, n_h>)``, h the contact vertex of the hand nearest to v.

    The sum grows with the number of the object's vertices, and a vertex far from the hand counts, too, where it lies
    behind the plane that is nearest. The term jumps where another contact vertex becomes the nearest.
    """

    vertices: Float[ndarray, "3 V"]
    """Vertices of the object about its centre, unscaled [m]."""
    planes: TangentPlanes
    weight: Float[ndarray, "N"]
    """Energy per metre, per frame [px^2 / m]."""
    delta: float = 0.002
    """Depths below this count as this in the curvature [m]; value and gradient are those of the term itself."""
    name: str = "push"

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        found = Quadratic.zero(poses)
        _evaluate_paper_push(
            poses.R, poses.centre, poses.scale, self.vertices, self.planes.point, self.planes.normal,
            self.weight, self.delta, found.value, found.g, found.H,
        )  # fmt: skip
        return found


@kernel("f4 f3 f1 f2 f3 f3 f1 f f2 f3 f4")
def _evaluate_paper_push(R, centre, scale, vertices, point, normal, weight, delta, value, g, H):
    """Fill in value (B, N), g (B, N, 7), H (B, N, 7, 7)."""
    B, N = value.shape
    V, Q = vertices.shape[1], point.shape[2]
    arm, rough, local = np.empty((3, V)), np.empty((3, V), np.float32), np.empty((3, Q), np.float32)
    squared, nearest = np.empty(V, np.float32), np.empty(V, np.int32)
    a = np.empty(7)
    for b in range(B):
        for n in range(N):
            for k in range(3):
                r0, r1, r2 = scale[b] * R[b, n, k, 0], scale[b] * R[b, n, k, 1], scale[b] * R[b, n, k, 2]
                for v in range(V):
                    arm[k, v] = r0 * vertices[0, v] + r1 * vertices[1, v] + r2 * vertices[2, v]
                    rough[k, v] = arm[k, v]
                for q in range(Q):
                    local[k, q] = point[n, k, q] - centre[b, n, k]
            nearest_points(rough, local, 0, Q, squared, nearest)
            for v in range(V):
                q = nearest[v]
                n0, n1, n2 = normal[n, 0, q], normal[n, 1, q], normal[n, 2, q]
                x, y, z = arm[0, v], arm[1, v], arm[2, v]
                depth = -(
                    n0 * (x + centre[b, n, 0] - point[n, 0, q])
                    + n1 * (y + centre[b, n, 1] - point[n, 1, q])
                    + n2 * (z + centre[b, n, 2] - point[n, 2, q])
                )
                if depth > 0.0:
                    value[b, n] += weight[n] * depth
                    a[0], a[1], a[2] = -n0, -n1, -n2
                    a[3], a[4], a[5] = z * n1 - y * n2, x * n2 - z * n0, y * n0 - x * n1
                    a[6] = -(x * n0 + y * n1 + z * n2)
                    add_rank_one(weight[n], weight[n] / max(depth, delta), a, g[b, n], H[b, n])
            mirror_upper(H[b, n])


@dataclass(frozen=True)
class PaperPullTerm:
    """``weight * mean over the five fingertips of |<h - v, n_v>|`` of the pair (h, v) of least distance.

    The paper writes ``min <h - v, n_v>`` over all pairs of a fingertip's and the object's vertices, and calls it "the
    minimum distance of all pairs". The words are followed, as in the authors' later code, which takes the absolute
    height of nearest pairs. A signed height has no lower bound: the least of all pairs is that over the object's far
    side and sends the object away; that of the nearest pair lets an object of free scale grow round the fingertips.
    """

    vertices: Float[ndarray, "3 V"]
    """Vertices of the object about its centre, unscaled [m]."""
    normals: Float[ndarray, "3 V"]
    """Unit normals there."""
    hand: HandContacts
    weight: Float[ndarray, "N"]
    """Energy per metre of mean height, per frame [px^2 / m]."""
    delta: float = 0.002
    """Heights below this count as this in the curvature [m]; value and gradient are those of the term itself."""
    name: str = "pull"

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        found = Quadratic.zero(poses)
        _evaluate_paper_pull(
            poses.R, poses.centre, poses.scale, self.vertices, self.normals, self.hand.position, self.hand.region,
            self.weight, self.delta, found.value, found.g, found.H,
        )  # fmt: skip
        return found


@kernel("f4 f3 f1 f2 f2 f3 i1 f1 f f2 f3 f4")
def _evaluate_paper_pull(R, centre, scale, vertices, normals, hand, region, weight, delta, value, g, H):
    """Fill in value (B, N), g (B, N, 7), H (B, N, 7, 7)."""
    B, N = value.shape
    V, fingers = vertices.shape[1], len(region) - 1
    tips = region[fingers]
    x, local = vertices.astype(np.float32), np.empty((3, tips), np.float32)
    squared, which = np.empty(V, np.float32), np.empty(V, np.int32)
    a = np.empty(7)
    for b in range(B):
        for n in range(N):
            unit = weight[n] / fingers
            for q in range(tips):
                r0, r1, r2 = _lever_arm(hand[n, q], centre[b, n])
                for k in range(3):
                    local[k, q] = (R[b, n, 0, k] * r0 + R[b, n, 1, k] * r1 + R[b, n, 2, k] * r2) / scale[b]
            for f in range(fingers):
                nearest_points(x, local, region[f], region[f + 1], squared, which)
                at = np.argmin(squared)
                tip = which[at]
                if tip < 0:  # no region, or behind the camera, where nothing is a number
                    continue
                n0, n1, n2 = 0.0, 0.0, 0.0
                for k in range(3):
                    n0 += R[b, n, 0, k] * normals[k, at]
                    n1 += R[b, n, 1, k] * normals[k, at]
                    n2 += R[b, n, 2, k] * normals[k, at]
                r0, r1, r2 = _lever_arm(hand[n, tip], centre[b, n])
                over = r0 * n0 + r1 * n1 + r2 * n2
                height = over
                for k in range(3):
                    height -= scale[b] * normals[k, at] * vertices[k, at]
                value[b, n] += unit * abs(height)
                # The height changes by -n . v - (r x n) . w + (height - r . n) l, as in ``add_height_residual``.
                a[0], a[1], a[2] = -n0, -n1, -n2
                a[3], a[4], a[5] = r2 * n1 - r1 * n2, r0 * n2 - r2 * n0, r1 * n0 - r0 * n1
                a[6] = height - over
                add_rank_one(np.copysign(unit, height), unit / max(abs(height), delta), a, g[b, n], H[b, n])
            mirror_upper(H[b, n])


@kernel()
def _lever_arm(point, centre):
    return point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]
