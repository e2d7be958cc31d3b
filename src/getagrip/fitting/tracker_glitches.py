"""Detect and repair tracker glitches: flips, dropouts, identity swaps.

In each frame the hand may be as given, or flipped: by half a turn about one of its axes. Kept are those frames, each
with one of these four hands, for which the least is

    sum_(i, j) d(i, j) + price * (number of frames left out) + FLIP * price * (number of flips),

over neighbours i < j among them, with d(i, j) how far the hand's surface moves from i to j (root mean square). So a
frame is left out where the detour by it is longer than the price, and k in a row where it is longer than k prices; one
in which the hand is on its path but for a flip costs less. In the frames left out the hand is put between its
neighbours.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.checks.evidence import Glitches
from getagrip.clip import Clip, HandTrack
from getagrip.clip.sampling import frame_indices
from getagrip.fitting.motion import PosesInHand, interpolate_object_poses
from getagrip.fitting.options import Options
from getagrip.geometry import se3

MIN_FRAME_PRICE_M = 0.04
"""Lowest price of a frame [m]. On DexYCB's training subjects no true hand makes a detour of more than 5 mm."""
FRAME_PRICE_FACTOR = 4.0
"""The price where hands are fast, in the step from frame to frame that two thirds of the steps exceed."""
END_PRICE_FACTOR, MAX_END_FRAMES = 2.0, 3
"""Price at an end, in the steps that follow; number of these that count, and most frames left out there."""
FLIP_PRICE_FRACTION = 0.25
"""Price of a flip, in that of a frame."""
FLIP_ROTATIONS = se3.exp_so3(np.pi * np.eye(4)[:, 1:])
"""The hand as given, and by half a turn about each of its axes."""
MAX_GLITCH_GAP_FRAMES = 30
"""Most frames from one that is kept to the next."""
N_GLITCH_POINTS = 16
"""Points of the surface that stand for the hand."""


def repair_hand(clip: Clip, options: Options) -> tuple[Clip, Glitches | None]:
    """Flip the hand back, or interpolate it, in frames with tracker glitches; also return those frames.

    The clip stays unchanged, without such frames (None), where the options say that hands are as given.
    Rotations are interpolated along the shortest path, the hand's middle along a line; before the first frame that is
    kept and after the last, the hand is as there. Vertices stay as given.
    """
    if options.hands == "as-given" or options.as_published:
        return clip, None
    kept, flip = frames_without_glitch(clip.hand)
    moved = np.setdiff1d(np.arange(len(clip)), kept[flip == 0])
    if not len(moved) or len(kept) < 2:
        return clip, Glitches((), len(clip))
    T, middle = clip.hand.T_cam_hand.copy(), clip.hand.vertices.mean(axis=(0, 1))
    T[kept[flip > 0]] = (T[kept] @ _flips_about_middle(middle)[flip])[flip > 0]
    left_out = np.setdiff1d(moved, kept)
    known = PosesInHand(T[None, kept, :3, :3], se3.transform(T[kept], middle[None])[None, :, 0], np.ones(1))
    between = interpolate_object_poses(known, kept, left_out)
    T[left_out] = se3.rigid(between.R[0], between.centre[0] - between.R[0] @ middle)
    return clip.with_hand_at(T), Glitches(tuple(clip.frames[n] for n in moved), len(clip))


def frames_without_glitch(hand: HandTrack) -> tuple[Int[ndarray, "n"], Int[ndarray, "n"]]:
    """Return the frames without a glitch, but for a flip, and which of ``FLIP_ROTATIONS`` puts the hand on its path there."""
    steps = surface_steps(hand)
    if not steps:
        return np.arange(len(hand.T_cam_hand)), np.zeros(len(hand.T_cam_hand), int)
    given = steps[0][:, 0, 0]
    shortest = np.minimum(steps[0][:, 0].min(axis=1), steps[0][:, :, 0].min(axis=1))
    price = max(MIN_FRAME_PRICE_M, FRAME_PRICE_FACTOR * float(np.quantile(shortest, 1 / 3)))
    N, flips = len(given) + 1, FLIP_PRICE_FRACTION * price * np.minimum(np.arange(len(FLIP_ROTATIONS)), 1)
    # Of the best choice that ends with a frame, and a flip there: at first, with it alone.
    cost = leading_frames_cost(given, price)[:, None] + flips
    before = np.full((N, len(FLIP_ROTATIONS), 2), -1)
    for n in range(1, N):
        gaps = np.arange(min(n, len(steps)))
        costs = (cost[n - 1 - gaps] + price * gaps[:, None])[:, :, None] + [steps[gap][n - 1 - gap] for gap in gaps]
        for k, through in enumerate(np.moveaxis(costs, 2, 0)):
            gap, flip = np.unravel_index(np.argmin(through), through.shape)
            if through[gap, flip] + flips[k] < cost[n, k]:
                cost[n, k], before[n, k] = through[gap, flip] + flips[k], (n - 1 - gap, flip)
    at_end = cost + leading_frames_cost(given[::-1], price)[::-1, None]
    kept = [np.array(np.unravel_index(np.argmin(at_end), at_end.shape))]
    while before[*kept[-1]][0] >= 0:
        kept.append(before[*kept[-1]])
    frames, flip = np.array(kept[::-1]).T
    return frames, flip


def leading_frames_cost(steps: Float[ndarray, "n"], price: float) -> Float[ndarray, "n+1"]:
    """Compute the cost of leaving out all frames before each one.

    There is no detour at an end, and a hand that comes in fast is to keep the frames in which it does. So few can be
    left out, and each costs at least ``END_PRICE_FACTOR`` times the steps that follow.
    """
    cost = np.full(len(steps) + 1, np.inf)
    for n in range(min(MAX_END_FRAMES + 1, len(steps))):
        cost[n] = n * max(price, END_PRICE_FACTOR * float(np.median(steps[n : n + MAX_END_FRAMES])))
    return cost


def surface_steps(hand: HandTrack) -> list[Float[ndarray, "_ 4 4"]]:
    """Compute how far the hand's surface moves [m] from each frame to the next, to the next but one, and so on.

    Each array is (frame, flip in it, flip in the later frame), flips by their index in ``FLIP_ROTATIONS``.
    """
    template = hand.vertices.mean(axis=0)
    some = template[frame_indices(len(template), N_GLITCH_POINTS)]
    posed = se3.transform(hand.T_cam_hand[:, None] @ _flips_about_middle(template.mean(axis=0)), some)
    X = posed.reshape(len(posed), len(FLIP_ROTATIONS), -1) / np.sqrt(len(some))
    squares = np.square(X).sum(axis=-1)

    def steps(gap: int) -> Float[ndarray, "_ 4 4"]:
        between = squares[:-gap, :, None] + squares[gap:, None] - 2.0 * X[:-gap] @ np.swapaxes(X[gap:], 1, 2)
        return np.sqrt(np.maximum(between, 0.0))

    return [steps(gap) for gap in range(1, min(MAX_GLITCH_GAP_FRAMES, len(X) - 1) + 1)]


def _flips_about_middle(middle: Float[ndarray, "3"]) -> Float[ndarray, "4 4 4"]:
    """Return ``FLIP_ROTATIONS`` about the hand's middle."""
    return se3.rigid(FLIP_ROTATIONS, middle - FLIP_ROTATIONS @ middle)
