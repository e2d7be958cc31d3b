"""The order of masks and hands: the given one, compared with the reverse and with shifts.

Masks that come a few frames late hardly displace their middles; but the hand's own pixels come late with them, and its
outline shows a frame or two where it moves (``mask_delay``).

While a grasp is stable, a point that is fixed in the hand lies near the middle of the object's mask in every frame. So
does the drawn hand over the pixels that are ignored, where they are the hand's. Masks that fit so much better in
another order are probably in the wrong one. Where hand and camera hardly move, all orders fit alike.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.checks.evidence import Evidence

HAND_PRIOR_DISTANCE_M = 0.15
"""The point is pulled towards the hand's middle by a hundredth of the weight of the masks at this distance [m]."""
MIN_SHIFTED_FRACTION = 0.6
"""Shifted masks must still be those of this share of the frames."""
MIN_ORDER_FRAMES = 5
"""Fewer frames have no order."""
MIN_CENTROID_ERROR, MIN_HAND_OVERLAP = 0.05, 0.05
"""Smaller distances, in sizes of the mask, and smaller overlaps count as these."""


@dataclass(frozen=True)
class MaskDelay:
    """By how much the hand's pixels come late.

    Attributes:
        frames: number of frames by which masks are late, counted as their names are; negative: early.
        times: how many times better the hands overlap them then; 1: they are in time. NaN where no pixels are given.
    """

    frames: int
    times: float

    def __str__(self) -> str:
        count = f"{abs(self.frames)} frame{'s' if abs(self.frames) > 1 else ''}"
        when = "late" if self.frames > 0 else "early"
        return f"masks seem to come {count} {when}: shifted, they would meet the hands {self.times:.2f} times better"


def centroid_error(it: Evidence) -> float:
    """Measure the distance of the masks' middles from a point that moves with the hand, in roots of the mask's area."""
    here = np.flatnonzero(it.mask_area > 0)
    return _centroid_rmse(it, here, here) if len(here) >= MIN_ORDER_FRAMES else float("nan")


def reordering_gain(it: Evidence) -> float:
    """Return how many times better the masks fit the hands in another order than in the given one; 1: none is better.

    The distance of the masks' middles in the given order over that in the other; times, likewise, the overlap of hands
    and ignored pixels, where there are any.
    """
    shown = it.mask_area > 0
    overlap = _pairwise_iou(it.drawn_hands, it.small_ignore) if it.masks.say_what_hides else None
    best = 1.0 if shown.sum() >= MIN_ORDER_FRAMES else float("nan")
    for frames, others in _candidate_orders(len(shown)):
        both = shown[frames] & shown[others]
        n, m = frames[both], others[both]
        if len(n) < MIN_ORDER_FRAMES:
            continue
        times = _centroid_rmse(it, n, n) / max(_centroid_rmse(it, n, m), MIN_CENTROID_ERROR)
        if overlap is not None:
            times *= overlap[n, m].mean() / max(overlap[n, n].mean(), MIN_HAND_OVERLAP)
        best = max(best, times)
    return best


def mask_delay(it: Evidence) -> MaskDelay:
    """Find the shift at which the hands overlap their own pixels best: ``masks/hand``, else those ignored."""
    pixels, known = it.small_hand_pixels, it.masks.known
    best = MaskDelay(0, 1.0 if pixels[known].any() and len(pixels) >= MIN_ORDER_FRAMES else float("nan"))
    overlap, when = _pairwise_iou(it.drawn_hands, pixels), it.clip.time * it.clip.fps
    for frames, others in _frame_shifts(len(pixels)):
        both = known[frames] & known[others]
        n, m = frames[both], others[both]
        if 2 * len(n) < known.sum():
            continue
        times = float(overlap[n, m].mean() / max(overlap[n, n].mean(), MIN_HAND_OVERLAP))
        if times > best.times:
            best = MaskDelay(round(float(np.median(when[m] - when[n]))), times)
    return best


def _candidate_orders(count: int) -> Iterator[tuple[Int[ndarray, "n"], Int[ndarray, "n"]]]:
    """Frames, and the frames whose masks they might have: in reverse, and shifted either way."""
    every = np.arange(count)
    yield every, every[::-1]
    yield from _frame_shifts(count)


def _frame_shifts(count: int) -> Iterator[tuple[Int[ndarray, "n"], Int[ndarray, "n"]]]:
    """Frames, and those by one or more earlier or later."""
    every = np.arange(count)
    for shift in range(1, int((1.0 - MIN_SHIFTED_FRACTION) * count) + 1):
        yield every[shift:], every[:-shift]
        yield every[:-shift], every[shift:]


def _centroid_rmse(it: Evidence, frames: Int[ndarray, "n"], masks: Int[ndarray, "n"]) -> float:
    """Root mean square distance of the masks' middles from the projection of the best point in the hand."""
    hand, K = it.clip.hand, it.clip.K[frames]
    T = hand.T_cam_hand[frames]
    middle = it.hand_middle[frames].mean(axis=0)
    P = K @ T[:, :3]
    uv, depth = it.centroids[masks], it.depth[frames]
    rows = (P[:, :2] - uv[..., None] * P[:, 2:]) / depth[:, None, None]  # (n, 2, 4): pixels off, nearly
    size = max(np.sqrt(np.median(it.mask_area[masks])), _expected_size(it))
    rows = rows / size
    A, b = rows[..., :3].reshape(-1, 3), -(rows @ np.append(middle, 1.0)).ravel()
    ridge = 0.01 * len(frames) / HAND_PRIOR_DISTANCE_M**2
    p = np.linalg.solve(A.T @ A + ridge * np.eye(3), A.T @ b)
    return float(np.sqrt(np.sum((A @ p - b) ** 2) / len(frames)))


def _expected_size(it: Evidence) -> float:
    """Return half of the object's diameter in the image, where it is known [px].

    That is about the root of the area of a whole mask. The little that the hand leaves visible of an object may lie
    anywhere in it.
    """
    if it.clip.scale != "known":
        return 0.0
    focal = it.clip.K[:, [0, 1], [0, 1]].mean(axis=1)
    return float(np.median(focal / it.depth)) * it.clip.mesh.diameter / 2.0


def _pairwise_iou(hands: Bool[ndarray, "T h w"], pixels: Bool[ndarray, "T h w"]) -> Float[ndarray, "T T"]:
    """Overlap (IOU) of each drawn hand with the pixels of each frame."""
    hands, pixels = (x.reshape(len(x), -1).astype(np.float32) for x in (hands, pixels))
    both = hands @ pixels.T
    either = hands.sum(axis=1)[:, None] + pixels.sum(axis=1)[None] - both
    return both / np.maximum(either, 1.0)
