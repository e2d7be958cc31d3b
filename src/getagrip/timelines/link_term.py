"""A link between segments: where one of them has the object, the next should have it, but for a slip."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.fitting.energy import PosesInCamera, Quadratic
from getagrip.geometry import se3


@dataclass(frozen=True)
class Expected:
    """The object's pose in some frames of a segment, by a neighbouring segment's hypotheses, in the camera frame.

    Attributes:
        frames: the frames, of those that the segment's fit sees.
        R, centre: poses about the mesh's centre; the first axis is the neighbour's hypotheses.
        cost: (K,) energy of each hypothesis above the best.
    """

    frames: Int[ndarray, "m"]
    R: Float[ndarray, "K m 3 3"]
    centre: Float[ndarray, "K m 3"]
    cost: Float[ndarray, "K"]


@dataclass(frozen=True)
class LinkTerm:
    """``min over hypotheses k of cost_k + weight * d^2 / (d^2 + slip^2)``, in the frames of the link.

    d^2 is the mean squared distance of the object's vertices from where hypothesis k expects them. Beyond ``slip`` a
    larger distance costs little more: the object may have been turned in between, or the hypothesis lost.
    """

    moments: Float[ndarray, "4 4"]
    """Second moments of the vertices about the centre (``smoothness.moments``)."""
    expected: Expected
    weight: float
    """Most that a link can cost in all its frames together [px^2]."""
    slip: float
    """[m]."""
    name: str = "link"

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        at, found = self.expected.frames, Quadratic.zero(poses)
        if not len(at):
            return found
        points, share = self.moments[:, :3], self.moments[:, 3:]
        scale = poses.scale[:, None, None, None]
        arm = scale * points @ np.swapaxes(poses.R[:, at], -1, -2)
        placed = arm + share * poses.centre[:, at, None]
        arm_there = scale[:, None] * points @ np.swapaxes(self.expected.R, -1, -2)
        gap = placed[:, None] - arm_there - share * self.expected.centre[:, :, None]
        d2 = np.sum(gap**2, axis=(-2, -1))
        each = self.weight / len(at)
        cost = self.expected.cost + np.sum(each * d2 / (d2 + self.slip**2), axis=-1)
        best = np.argmin(cost, axis=1)
        b = np.arange(len(best))
        error, d2 = gap[b, best], d2[b, best]
        curvature = each * (self.slip / (d2 + self.slip**2)) ** 2
        J = np.empty((*error.shape, 7))
        J[..., :3], J[..., 3:6], J[..., 6] = share[..., None] * np.eye(3), -se3.hat(arm), arm - arm_there[b, best]
        J = J.reshape(*error.shape[:2], 12, 7)
        Jt = np.swapaxes(J, -1, -2)
        found.value[:, at] = self.expected.cost[best][:, None] / len(at) + each * d2 / (d2 + self.slip**2)
        found.g[:, at] = 2.0 * curvature[..., None] * (Jt @ error.reshape(*error.shape[:2], 12, 1))[..., 0]
        found.H[:, at] = 2.0 * curvature[..., None, None] * (Jt @ J)
        return found


WEIGHT = 0.03
"""Most that a link can cost, in areas of the object's mask times frames of the segment."""
SLIP = 0.08
"""Distance of the surface at which it costs half of that, in diameters: about 15 degrees."""
