"""E_push (appendix): the object is pushed out of the hand's contact regions."""

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
