"""The cost of each state in every window of frames, as a code length: misfit of the masks, and the state's parameters.

A state's claim is that few parameters explain all masks of a window: one pose in the world, one motion in the hand, or
a pose per frame. With ``SAMPLES`` independent contour points per frame, whose distances have the standard deviation
sigma, n frames cost ``SAMPLES / 2 sum_t (d_t / sigma)^2 + p / 2 log(SAMPLES n)``; distances up to sigma, which every
right fit leaves, cost nothing. A pose per frame explains everything and costs six parameters each. Where a segment
ends is a choice of T, log T.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.segmentation.hinge_fits import HingeFit
from getagrip.segmentation.image_motion import ImageMotion

Motion = Literal["static", "held", "free"]
MOTIONS: tuple[Motion, ...] = ("static", "held", "free")
"""States of the object, before Eq. 2 separates stable grasps from unstable contacts."""

SAMPLES = 10.0
"""Contour points per frame that are independent."""
POSE, HINGE = 6, 11
"""Parameters of a pose; of a motion in the hand: a pose, a line, an angle's range."""
MOST = 40.0
"""A frame that is explained badly costs no more than this: it may be the mask that is wrong."""
STILL = 0.3
"""Mean displacement of a still object's contour between two masks [px]."""
UNEXPLAINED = 0.1
"""And as a share of the displacement by the camera's motion: parallax within the object turns its outline."""
SHORTEST = {"static": 6, "held": 6, "free": 1}
"""Frames of the shortest segment: fewer are no evidence that one pose explains them."""
NOT_TRIED = 1e3
"""Cost of a frame in which a fit was not tried."""


def window_costs(moved: ImageMotion, fits: Sequence[HingeFit]) -> Float[ndarray, "3 T T"]:
    """Compute ``cost[s, i, j]``: state s (``MOTIONS``) in the frames i to j, both included; infinite where j < i."""
    T = moved.moved.shape[1]
    frames = np.arange(T)
    length = frames[None] - frames[:, None] + 1.0
    known = np.log(SAMPLES * np.maximum(length, 1.0))
    free = length * POSE / 2.0 * np.log(SAMPLES)
    cost = np.stack(
        [_static(moved) + POSE / 2.0 * known, _in_hand_cost(fits, T, moved.jitter) + HINGE / 2.0 * known, free]
    )
    cost += np.log(T)
    shortest = np.array([SHORTEST[motion] for motion in MOTIONS])
    return np.where(length >= shortest[:, None, None], cost, np.inf)


def _static(moved: ImageMotion) -> Float[ndarray, "T T"]:
    """Misfit of a still object: each frame against the one ``lags`` before it, or the window's first."""
    each = residual(moved.moved / (np.hypot(STILL, moved.jitter) + UNEXPLAINED * moved.by_camera))
    L, T = each.shape
    out = np.zeros((T, T))
    for i in range(T):
        frames = np.arange(i + 1, T)
        out[i, i + 1 :] = np.cumsum(each[np.minimum(frames - i, L) - 1, frames])
    return out


def _in_hand_cost(fits: Sequence[HingeFit], T: int, jitter: float) -> Float[ndarray, "T T"]:
    """Misfit of the fit to the hand that is best in each window."""
    out = np.full((T, T), np.inf)
    for one in fits:
        each = np.full(T, NOT_TRIED)
        each[one.frames] = _misfit(one, jitter)
        total = np.concatenate([[0.0], np.cumsum(each)])
        out = np.minimum(out, total[None, 1:] - total[:-1, None])
    return out


def _misfit(one: HingeFit, jitter: float) -> Float[ndarray, "n"]:
    """Cost of each frame in which a fit was tried. Of two masks' jitter, one has its share."""
    return residual(one.misfit / np.hypot(one.expected, jitter / np.sqrt(2.0)))


def residual(distance: Float[ndarray, "*n"]) -> Float[ndarray, "*n"]:
    """Compute the cost of distances in standard deviations; unknown ones cost nothing."""
    excess = np.maximum(np.nan_to_num(distance, nan=0.0) - 1.0, 0.0)
    return np.asarray(np.minimum(0.5 * SAMPLES * excess**2, MOST))


def chosen(fits: Sequence[HingeFit], first: int, last: int, jitter: float) -> HingeFit:
    """Return the fit that is best in a window, of those tried in all of it."""
    costs = []
    for one in fits:
        inside = (one.frames >= first) & (one.frames <= last)
        costs.append(_misfit(one, jitter)[inside].sum() + NOT_TRIED * (last + 1 - first - inside.sum()))
    return fits[int(np.argmin(costs))]
