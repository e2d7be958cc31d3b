"""The cheapest division of a sequence into segments with states, by dynamic programming (semi-Markov).

Costs belong to whole windows of frames, since a segment's parameters are shared by all its frames:
``F(j) = min over i, s of F(i) + C(i, j, s)``.

A cost is a code length: the misfit of the masks, plus the state's parameters. Few parameters have to explain all masks
of a window: one pose in the world (static), one motion in the hand (held), or a pose per frame (free). With S =
``CONTOUR_SAMPLES_PER_FRAME`` independent contour points per frame, whose distances d have the standard deviation sigma,
n frames and p parameters cost ``S / 2 sum_t (d_t / sigma)^2 + p / 2 log(S n)``. Distances up to sigma, which right fits
leave, are free of cost. A pose per frame explains all masks at six parameters each. A segment's end is one of T frames:
log T.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.timelines.detect.grasp_evidence import HingeFit
from getagrip.timelines.detect.image_motion import ImageMotion

Motion = Literal["static", "held", "free"]
MOTION_STATES: tuple[Motion, ...] = ("static", "held", "free")
"""States of the object, before Eq. 2 separates stable grasps from unstable contacts."""

CONTOUR_SAMPLES_PER_FRAME = 10.0
"""Number of independent contour points per frame."""
N_POSE_PARAMETERS, N_HINGE_PARAMETERS = 6, 11
"""Number of parameters of a pose; and of a motion in the hand: a pose, a line, a range of the angle."""
MAX_FRAME_COST = 40.0
"""Maximum cost of a frame: its mask may be wrong."""
STATIC_CONTOUR_SIGMA_PX = 0.3
"""Standard deviation of a static object's contour displacement between two masks [px]."""
PARALLAX_SIGMA_FRACTION = 0.1
"""Addition to it, as a fraction of the displacement by the camera: parallax within the object changes its outline."""
MIN_SEGMENT_FRAMES = {"static": 6, "held": 6, "free": 1}
"""Minimum number of frames of a segment in each state: fewer are no evidence that one pose explains them."""
UNTRIED_FRAME_COST = 1e3
"""Cost of a frame outside a fit's extension."""


@dataclass(frozen=True)
class Division:
    """A sequence divided into segments.

    Attributes:
        spans: (n, 2) first and last frame of each segment, both included; consecutive from the first frame.
        states: (n,) state of each segment; neighbours may have equal states.
        cost: sum of the segments' costs.
    """

    spans: Int[ndarray, "n 2"]
    states: Int[ndarray, "n"]
    cost: float


def cheapest_division(cost: Float[ndarray, "S T T"]) -> Division:
    """Find the cheapest division of T frames; ``cost[s, i, j]`` is that of state s in frames i to j, both included.

    Costs may be infinite, where a state is impossible; entries with j < i are ignored. Without any finite division, the
    cost is infinite and the division has no segments.
    """
    T = cost.shape[1]
    of_best, state = cost.min(axis=0), cost.argmin(axis=0)
    best, start = np.full(T + 1, np.inf), np.zeros(T + 1, int)  # index: number of frames that are divided
    best[0] = 0.0
    for end in range(1, T + 1):
        total = best[:end] + of_best[:end, end - 1]
        start[end] = np.argmin(total)
        best[end] = total[start[end]]
    spans = []
    end = T if np.isfinite(best[T]) else 0
    while end > 0:
        spans.append((start[end], end - 1))
        end = int(start[end])
    span = np.array(spans[::-1], int).reshape(-1, 2)
    return Division(span, state[span[:, 0], span[:, 1]], float(best[T]))


def division_margins(cost: Float[ndarray, "S T T"], division: Division) -> Float[ndarray, "n"]:
    """Compute each segment's margin in the cheapest division: the additional cost of the next best one.

    The next best division has none of the middle half of the segment's frames in the segment's state. Margins are not
    negative; infinite where the alternative is impossible.
    """
    out = np.empty(len(division.states))
    for k, ((first, last), state) in enumerate(zip(division.spans, division.states, strict=True)):
        edge = (last + 1 - first) // 4
        without = cost.copy()
        without[state, : last - edge + 1, first + edge :] = np.inf
        out[k] = cheapest_division(without).cost - division.cost
    return np.maximum(out, 0.0)


def window_costs(moved: ImageMotion, fits: Sequence[HingeFit]) -> Float[ndarray, "3 T T"]:
    """Compute ``cost[s, i, j]`` of state s (``MOTION_STATES``) in frames i to j, both included; infinite for j < i."""
    T = moved.moved.shape[1]
    frames = np.arange(T)
    length = frames[None] - frames[:, None] + 1.0
    known = np.log(CONTOUR_SAMPLES_PER_FRAME * np.maximum(length, 1.0))
    cost = np.empty((len(MOTION_STATES), T, T))
    cost[0] = _static_cost(moved) + N_POSE_PARAMETERS / 2.0 * known
    cost[1] = _in_hand_cost(fits, T, moved.jitter) + N_HINGE_PARAMETERS / 2.0 * known
    cost[2] = length * N_POSE_PARAMETERS / 2.0 * np.log(CONTOUR_SAMPLES_PER_FRAME)
    cost += np.log(T)
    shortest = np.array([MIN_SEGMENT_FRAMES[motion] for motion in MOTION_STATES])
    return np.where(length >= shortest[:, None, None], cost, np.inf)


def _static_cost(moved: ImageMotion) -> Float[ndarray, "T T"]:
    """Misfit of a static object: each frame against the frame ``lags`` before it, or against the window's first."""
    sigma = np.hypot(STATIC_CONTOUR_SIGMA_PX, moved.jitter) + PARALLAX_SIGMA_FRACTION * moved.by_camera
    each = residual(moved.moved / sigma)
    L, T = each.shape
    out = np.zeros((T, T))
    for i in range(T):
        frames = np.arange(i + 1, T)
        out[i, i + 1 :] = np.cumsum(each[np.minimum(frames - i, L) - 1, frames])
    return out


def _in_hand_cost(fits: Sequence[HingeFit], T: int, jitter: float) -> Float[ndarray, "T T"]:
    """Misfit of the best fit to the hand in each window."""
    out = np.full((T, T), np.inf)
    for one in fits:
        each = np.full(T, UNTRIED_FRAME_COST)
        each[one.frames] = _misfit_cost(one, jitter)
        total = np.concatenate([[0.0], np.cumsum(each)])
        out = np.minimum(out, total[None, 1:] - total[:-1, None])
    return out


def _misfit_cost(one: HingeFit, jitter: float) -> Float[ndarray, "n"]:
    """Cost of each frame of a fit; half of the jitter's variance between two masks is that of one."""
    return residual(one.misfit / np.hypot(one.expected, jitter / np.sqrt(2.0)))


def residual(distance: Float[ndarray, "*n"]) -> Float[ndarray, "*n"]:
    """Compute the cost of distances, given in standard deviations; unknown distances (NaN) cost nothing."""
    excess = np.maximum(np.nan_to_num(distance, nan=0.0) - 1.0, 0.0)
    return np.asarray(np.minimum(0.5 * CONTOUR_SAMPLES_PER_FRAME * excess**2, MAX_FRAME_COST))


def best_fit_in_window(fits: Sequence[HingeFit], first: int, last: int, jitter: float) -> HingeFit:
    """Find the fit of least cost in a window; frames outside its extension cost ``UNTRIED_FRAME_COST``."""
    costs = []
    for one in fits:
        inside = (one.frames >= first) & (one.frames <= last)
        costs.append(_misfit_cost(one, jitter)[inside].sum() + UNTRIED_FRAME_COST * (last + 1 - first - inside.sum()))
    return fits[int(np.argmin(costs))]
