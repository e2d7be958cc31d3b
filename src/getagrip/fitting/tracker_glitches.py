"""Frames in which the given hand jumps away and back: a tracker flips it, loses it, or takes another for it.

Kept are those frames for which the least is

    sum_(i, j) d(i, j) + price * (number of frames left out),

over neighbours i < j among them, with d(i, j) how far the hand's surface moves from i to j (root mean square). So a
frame is left out where the detour by it is longer than the price, and k in a row where it is longer than k prices. In
the frames left out the hand is put between its neighbours.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.checks.evidence import Glitches
from getagrip.clip import Clip, HandTrack
from getagrip.clip.sampling import frame_indices
from getagrip.fitting.motion import PosesInHand, interpolated
from getagrip.fitting.options import Options
from getagrip.geometry import se3

LEAST = 0.04
"""Lowest price of a frame [m]. On DexYCB's training subjects no true hand makes a detour of more than 5 mm."""
TIMES = 4.0
"""The price where hands are fast, in the step from frame to frame that two thirds of the steps exceed."""
AT_ENDS, FEW = 2.0, 3
"""Price at an end, in the steps that follow; number of these that count, and most frames left out there."""
LONGEST = 30
"""Most frames from one that is kept to the next."""
POINTS = 16
"""Points of the surface that stand for the hand."""


def repair_hand(clip: Clip, options: Options) -> tuple[Clip, Glitches | None]:
    """Interpolate the hand in frames with tracker glitches; also return those frames.

    The clip stays unchanged, without such frames (None), where the options say that hands are as given.
    Rotations are interpolated along the shortest path, the hand's middle along a line; before the first frame that is
    kept and after the last, the hand is as there. Vertices stay as given.
    """
    if options.hands == "as-given" or options.as_published:
        return clip, None
    kept = frames_without_glitch(clip.hand)
    moved = np.setdiff1d(np.arange(len(clip)), kept)
    if not len(moved) or len(kept) < 2:
        return clip, Glitches((), len(clip))
    T, middle = clip.hand.T_cam_hand.copy(), clip.hand.vertices.mean(axis=(0, 1))
    known = PosesInHand(T[None, kept, :3, :3], se3.transform(T[kept], middle[None])[None, :, 0], np.ones(1))
    between = interpolated(known, kept, moved)
    T[moved] = se3.rigid(between.R[0], between.centre[0] - between.R[0] @ middle)
    return clip.with_hand_at(T), Glitches(tuple(clip.frames[n] for n in moved), len(clip))


def frames_without_glitch(hand: HandTrack) -> Int[ndarray, "n"]:
    """Return the frames without a glitch."""
    steps = steps_of(hand)
    if not steps:
        return np.arange(len(hand.T_cam_hand))
    price = max(LEAST, TIMES * float(np.quantile(steps[0], 1 / 3)))
    N = len(steps[0]) + 1
    # Of the best choice that ends with a frame: at first, with it alone.
    cost, before = at_the_start(steps[0], price), np.full(N, -1)
    for n in range(1, N):
        gaps = np.arange(min(n, len(steps)))
        costs = cost[n - 1 - gaps] + price * gaps + [steps[gap][n - 1 - gap] for gap in gaps]
        best = int(np.argmin(costs))
        if costs[best] < cost[n]:
            cost[n], before[n] = costs[best], n - 1 - best
    kept = [int(np.argmin(cost + at_the_start(steps[0][::-1], price)[::-1]))]
    while before[kept[-1]] >= 0:
        kept.append(int(before[kept[-1]]))
    return np.array(kept[::-1])


def at_the_start(steps: Float[ndarray, "n"], price: float) -> Float[ndarray, "n+1"]:
    """Compute the cost of leaving out all frames before each one.

    There is no detour at an end, and a hand that comes in fast is to keep the frames in which it does. So few can be
    left out, and each costs at least ``AT_ENDS`` times the steps that follow.
    """
    cost = np.full(len(steps) + 1, np.inf)
    for n in range(min(FEW + 1, len(steps))):
        cost[n] = n * max(price, AT_ENDS * float(np.median(steps[n : n + FEW])))
    return cost


def steps_of(hand: HandTrack) -> list[Float[ndarray, "_"]]:
    """Compute how far the hand's surface moves [m] from each frame to the next, to the next but one, and so on."""
    template = hand.vertices.mean(axis=0)
    posed = se3.transform(hand.T_cam_hand, template[frame_indices(len(template), POINTS)][None])
    gaps = range(1, min(LONGEST, len(posed) - 1) + 1)
    return [np.sqrt(np.square(posed[gap:] - posed[:-gap]).sum(axis=-1).mean(axis=-1)) for gap in gaps]
