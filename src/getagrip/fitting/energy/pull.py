"""E_pull (appendix): each fingertip is drawn to the object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.compiling import kernel
from getagrip.fitting.contact import HandContacts, add_height_residual, mirror_upper
from getagrip.fitting.energy.term import PosesInCamera, Quadratic
from getagrip.kernels.closest import GRID_SLACK_SPACINGS, FaceGrid, screen, signed_distance


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
