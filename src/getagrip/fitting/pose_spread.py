"""Pose spread: the standard deviation that the energy leaves of the object's pose.

The Gauss-Newton covariance of what all frames share (base pose, axis, scale), each frame's own at their best:

    S = noise inverse(sum_n H_ss - H_sl inverse(H_ll) H_ls),   noise = E_mask of a frame

E_mask in place of the variance of an observation is a rule of thumb: contours that are met badly tell less. What ties
frames to each other is left out. It knows nothing of minima elsewhere, nor of a hand or mesh that is wrong.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.fitting.observation import MASK_CROP_SIZE_PX
from getagrip.fitting.problem import MethodResult, Problem
from getagrip.fitting.solve import hessian
from getagrip.geometry import se3
from getagrip.least_squares import BlockArrow

MIN_RELATIVE_CERTAINTY = 1e-6
"""Least certainty of a direction that the energy does not see (the spin of a bottle), as a share of the most
certain."""


def pose_spread(problem: Problem, found: MethodResult) -> float:
    """Compute the spread of the best solution: root mean square over the surface, in diameters, in the middle frame.

    NaN for a method that has no motion of its own, and for one whose frames share nothing.
    """
    if found.motion is None or found.energy_of is None:
        return float("nan")
    frames, T_cam_hand = np.arange(len(problem.clip)), problem.clip.hand.T_cam_hand
    motion = found.motion.take(np.zeros(1, int))
    J_shared = motion.jacobian()[0]
    S = J_shared.shape[-1]
    if S == 0:
        return float("nan")
    H, prior = hessian(motion, found.energy_of(problem)(MASK_CROP_SIZE_PX, frames), T_cam_hand), motion.prior()
    arrow = BlockArrow.of(H, np.zeros(H.shape[:-1]), slice(S), slice(S, None))
    arrow = arrow.plus(H_ll=prior.H + MIN_RELATIVE_CERTAINTY * np.eye(H.shape[-1] - S))
    certain, directions = np.linalg.eigh(arrow.reduced()[0])
    if not certain[-1] > 0.0:  # no contour and no contact tells anything
        return float("nan")
    spread = directions / np.sqrt(np.maximum(certain, MIN_RELATIVE_CERTAINTY * certain[-1]))
    noise = found.terms["mask"] / len(frames)
    middle, scale = len(frames) // 2, float(found.poses.scale[0])
    moved = (
        _surface_jacobian(scale * problem.surface.points @ found.poses.R[0, middle].T) @ J_shared[0, middle] @ spread
    )
    return float(np.sqrt(noise * np.mean(np.sum(moved**2, axis=(1, 2)))) / (scale * problem.surface.diameter))


def _surface_jacobian(x: Float[ndarray, "P 3"]) -> Float[ndarray, "P 3 7"]:
    """How points about the object's centre move with its local 7-vector."""
    shift = np.broadcast_to(np.eye(3), (len(x), 3, 3))
    return np.concatenate([shift, -se3.hat(x), x[..., None]], axis=-1)
