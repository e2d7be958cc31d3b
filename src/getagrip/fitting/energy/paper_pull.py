"""E_pull as the paper has it (appendix): heights of fingertips over tangent planes of the object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.compiling import kernel
from getagrip.fitting.contact import HandContacts, add_rank_one, mirror_upper, nearest_points
from getagrip.fitting.energy.term import PosesInCamera, Quadratic


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
                # The height changes by -n . v - (r x n) . w + (height - r . n) l, as in ``contact.add_height``.
                a[0], a[1], a[2] = -n0, -n1, -n2
                a[3], a[4], a[5] = r2 * n1 - r1 * n2, r0 * n2 - r2 * n0, r1 * n0 - r0 * n1
                a[6] = height - over
                add_rank_one(np.copysign(unit, height), unit / max(abs(height), delta), a, g[b, n], H[b, n])
            mirror_upper(H[b, n])


@kernel()
def _lever_arm(point, centre):
    """From the centre to the point."""
    return point[0] - centre[0], point[1] - centre[1], point[2] - centre[2]
