"""Pixels that move with a clicked object, and not with its surroundings, in frames before and after the click.

The surroundings are what lies far from the click and the hand. The object moves as the pixels at the click and the hand
do, or in a way of its own: of that, a pixel far from both motions is no evidence beyond ``INDEPENDENT_MOTION_LOG_RATIO``.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float32, UInt8
from numpy import ndarray

from getagrip.studio.masks.graph_cut import ColourHistogram, colour_bins, colour_log_ratio, edge_cost, minimal_cut
from getagrip.studio.masks.optical_flow import FLOW_SIGMA_PX, fit_object_motion, optical_flow
from getagrip.studio.masks.propagate_frame import FLOW_CONSISTENCY_PX, Images

CLICK_MOTION_IMAGE_PX = 320
"""Longer side of the images in which motion is looked at [px]."""
COMPARED_FRAME_OFFSETS = (-36, -24, -16, -8, -4, 4, 8, 16, 24, 36)
"""Frames that are looked at, from the one of the click."""
CLICK_RADIUS_FRACTION, MIN_SURROUNDINGS_DISTANCE = 0.05, 0.3
"""Pixels nearer to the click are the object's, and those farther the surroundings', in shorter sides of the image."""
CLICK_HAND_DILATION_PX = 9
"""Side of the square by which the hand is widened: its flow reaches beyond it [px]."""
INDEPENDENT_MOTION_LOG_RATIO = 2.0
"""Log ratio, by which a pixel moves rather as something of its own than as the object."""
MIN_CLICK_EVIDENCE = 1.0
"""Evidence at the click below which nothing has moved."""

MOVING_LOG_RATIO_THRESHOLD, STATIC_LOG_RATIO_THRESHOLD = 0.5, -1.5
"""Pixels with more of the click's motion show the object's colours first; below the second, the ground's."""
MOTION_DEAD_ZONE, MOTION_EVIDENCE_RANGE = 0.3, (-2.0, 0.75)
"""Motion that is no evidence, and the least and the most log ratio: it reaches 1 at three times as much."""
CLICK_COLOUR_WEIGHT, MAX_CLICK_LOG_RATIO = 1.5, 6.0
"""Weight of the log ratio of colours, and the largest one."""
N_CLICK_ITERATIONS = 3


def click_motion_log_ratio(
    images: Images, frame: int, interval: tuple[int, int], click: Bool[ndarray, "H W"], hand: Bool[ndarray, "H W"]
) -> Float32[ndarray, "H W"] | None:
    """Return the log ratio of the probabilities that a pixel moves with what was clicked, or with the surroundings.

    It is in multiples of that at the click, but for the sign no less than 1 there. None where the click has not moved
    in the frames of the ``interval``, ends included.
    """
    import cv2

    def small(image: ndarray) -> ndarray:
        return cv2.resize(image, size, interpolation=cv2.INTER_AREA)

    shape = click.shape
    size = tuple(max(16, round(length * min(1.0, CLICK_MOTION_IMAGE_PX / max(shape)))) for length in shape[::-1])
    away = cv2.distanceTransform((small(click.astype(np.float32)) == 0).astype(np.uint8), cv2.DIST_L2, 3) / min(size)
    held = small(hand.astype(np.float32)) > 0.5
    here, around = (
        away < CLICK_RADIUS_FRACTION,
        cv2.dilate(held.astype(np.uint8), np.ones((CLICK_HAND_DILATION_PX, CLICK_HAND_DILATION_PX), np.uint8)) > 0,
    )
    x, y = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in size))
    now, total = small(images(frame)), np.zeros(size[::-1], np.float32)
    for other in (frame + step for step in COMPARED_FRAME_OFFSETS if interval[0] <= frame + step <= interval[1]):
        then = small(images(other))
        back = optical_flow(now, then)
        came = x + back[..., 0], y + back[..., 1]
        off = back + cv2.remap(optical_flow(then, now), *came, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)
        off = np.einsum("hwc,hwc->hw", off, off)
        own, ground = (
            fit_object_motion(x, y, came, each & (off < FLOW_CONSISTENCY_PX**2))
            for each in (here | held, (away > MIN_SURROUNDINGS_DISTANCE) & ~around)
        )
        if own is None or ground is None:
            continue
        apart, still = (np.square(came[0] - each[0]) + np.square(came[1] - each[1]) for each in (own, ground))
        noise = 1.0 + float(np.median(still[(away > MIN_SURROUNDINGS_DISTANCE) & ~around]))
        ratio = np.log1p(still / noise) - np.minimum(np.log1p(apart / FLOW_SIGMA_PX**2), INDEPENDENT_MOTION_LOG_RATIO)
        ratio = cv2.GaussianBlur((ratio / (1.0 + off / FLOW_SIGMA_PX**2)).astype(np.float32), (0, 0), 2.0)
        if np.median(ratio[here]) > 0.0:
            total += ratio
    at_click = float(np.median(total[here])) if here.any() else 0.0
    if at_click < MIN_CLICK_EVIDENCE:
        return None
    whole = cv2.resize(total, shape[::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(np.where(whole > 0.0, whole / at_click, whole), np.float32)


def segment_by_click_motion(
    image: UInt8[ndarray, "h w 3"],
    motion: Float32[ndarray, "h w"],
    sure: Bool[ndarray, "h w"],
    never: Bool[ndarray, "h w"],
) -> Bool[ndarray, "h w"]:
    """Return the object by its motion (``click_motion_log_ratio``) and by the colours of what moves so.

    Motion stays evidence when the colours are counted again: a part in another colour is not lost.
    """
    at, edge = colour_bins(image), edge_cost(image)
    moved = np.clip((motion - MOTION_DEAD_ZONE) / (2.0 * MOTION_DEAD_ZONE), *MOTION_EVIDENCE_RANGE)
    found, known = ((motion > MOVING_LOG_RATIO_THRESHOLD) & ~never) | sure, np.zeros_like(sure)
    known[[0, -1]] = known[:, [0, -1]] = True
    known |= found | never | (motion < STATIC_LOG_RATIO_THRESHOLD)
    for _ in range(N_CLICK_ITERATIONS):
        colours = np.clip(
            CLICK_COLOUR_WEIGHT * colour_log_ratio(at, ColourHistogram.of(image, found, known)),
            -MAX_CLICK_LOG_RATIO,
            MAX_CLICK_LOG_RATIO,
        )
        object_ = np.where(sure, MAX_CLICK_LOG_RATIO, np.where(never, -MAX_CLICK_LOG_RATIO, colours + moved)).astype(
            np.float32
        )
        found = minimal_cut(-object_, edge, (object_ > 0.0).astype(np.float32))
        known = np.ones_like(sure)
    return found
