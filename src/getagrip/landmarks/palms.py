"""Palms in an image, by MediaPipe's palm detector: a single-shot detector with fixed anchors.

V. Bazarevsky, F. Zhang, "On-Device, Real-Time Hand Tracking with MediaPipe", 2019; F. Zhang et al., "MediaPipe Hands",
2020. The network takes the image fitted into a square, and gives for each anchor the logit of a palm, and the palm's
box and seven points relative to the anchor's middle.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray

PALM_INPUT_PX = 192
"""Side of the network's input [px]."""
ANCHOR_GRIDS = ((24, 2), (12, 6))
"""Cells along a side of each grid of anchors, and anchors in each cell."""
MIN_PALM_PROBABILITY = 0.5
"""Probability of a palm."""
PALM_IOU_THRESHOLD = 0.3
"""Boxes with a larger intersection over union are of one palm."""
BRIGHTNESS_QUANTILE, DARK_IMAGE_THRESHOLD, TARGET_BRIGHTNESS, MAX_BRIGHTNESS_GAIN = 0.98, 0.4, 0.8, 20.0
"""An image is dark if this share of its values is below the second number. It is then scaled so that the share is below
the third, but by no more than the fourth."""
PALM_WRIST_INDEX, PALM_KNUCKLE_INDEX = 0, 2
"""Two of the seven points."""


class Palm(NamedTuple):
    """A palm in the image."""

    box: Float[ndarray, "4"]
    """Left, top, right, bottom [px]."""
    points: Float[ndarray, "7 2"]
    """Wrist, knuckles of index, middle, ring and pinky, and two of the thumb [px]."""
    score: float


@cache
def anchors() -> Float[ndarray, "2016 2"]:
    """Return the middle of each anchor, in units of the input's side."""
    grids = []
    for cells, each in ANCHOR_GRIDS:
        v, u = np.mgrid[:cells, :cells]
        grids.append(np.repeat((np.stack([u, v], axis=-1).reshape(-1, 2) + 0.5) / cells, each, axis=0))
    return np.concatenate(grids)


class Letterbox(NamedTuple):
    """An image fitted into the middle of a square: (u, v) of the image is at scale * (u, v) + shift."""

    scale: float
    shift: Float[ndarray, "2"]

    @staticmethod
    def of(size: tuple[int, int], fill: float = 1.0) -> Letterbox:
        """Make it for images of this width and height [px], whose longer side is ``fill`` of the square's."""
        scale = fill * PALM_INPUT_PX / max(size)
        return Letterbox(scale, (PALM_INPUT_PX - scale * np.array(size, dtype=float)) / 2.0)

    def image(self, image: UInt8[ndarray, "H W 3"]) -> Float32[ndarray, "192 192 3"]:
        """Return the network's input: red, green, blue from 0 to 1, black beside the image."""
        import cv2

        size = max(1, round(image.shape[1] * self.scale)), max(1, round(image.shape[0] * self.scale))
        skip = max(1, int(0.5 / self.scale))  # at least two pixels are left for each of the small image
        small = cv2.resize(np.ascontiguousarray(image[::skip, ::skip]), size, interpolation=cv2.INTER_AREA)
        out = np.zeros((PALM_INPUT_PX, PALM_INPUT_PX, 3), np.float32)
        left, top = (round(float(x)) for x in self.shift)
        out[top : top + size[1], left : left + size[0]] = small[
            : PALM_INPUT_PX - top, : PALM_INPUT_PX - left
        ] / np.float32(255.0)
        return brighten(out)

    def back(self, points: Float[ndarray, "*n 2"]) -> Float[ndarray, "*n 2"]:
        """Convert points of the square to the image [px]."""
        return np.asarray((points - self.shift) / self.scale)


def brighten(image: Float32[ndarray, "H W 3"]) -> Float32[ndarray, "H W 3"]:
    """Scale a dark image (0 to 1) up: the networks have not learnt such."""
    high = float(np.quantile(image[::4, ::4], BRIGHTNESS_QUANTILE))
    return (
        image
        if high >= DARK_IMAGE_THRESHOLD
        else np.minimum(
            image * np.float32(TARGET_BRIGHTNESS / max(high, TARGET_BRIGHTNESS / MAX_BRIGHTNESS_GAIN)), np.float32(1.0)
        )
    )


def decode_palms(
    boxes: Float32[ndarray, "2016 18"],
    logits: Float32[ndarray, "2016"],
    frame: Letterbox,
    least: float = MIN_PALM_PROBABILITY,
) -> list[Palm]:
    """Decode the palms in the network's output, the most certain first; each the mean of overlapping ones by score."""
    scores = 1.0 / (1.0 + np.exp(-np.clip(logits.astype(float), -100.0, 100.0)))
    there = np.flatnonzero(scores >= least)
    there = there[np.argsort(-scores[there], kind="stable")]
    raw = boxes[there].astype(float).reshape(-1, 9, 2)
    middle = PALM_INPUT_PX * anchors()[there]
    half = 0.5 * raw[:, 1:2]
    middles = raw[:, :1] + middle[:, None]
    corners = np.concatenate([middles - half, middles + half, raw[:, 2:] + middle[:, None]], axis=1)
    found, left = [], np.arange(len(there))
    while left.size:
        same = _box_iou(corners[left[0], :2], corners[left, :2]) > PALM_IOU_THRESHOLD
        same[0] = True
        weights = scores[there[left[same]]]
        mean = frame.back(np.average(corners[left[same]], axis=0, weights=weights))
        found.append(Palm(mean[:2].ravel(), mean[2:], float(weights[0])))
        left = left[~same]
    return found


def _box_iou(one: Float[ndarray, "2 2"], many: Float[ndarray, "n 2 2"]) -> Float[ndarray, "n"]:
    """Intersection over union of a box and others."""
    inner = np.prod(np.clip(np.minimum(one[1], many[:, 1]) - np.maximum(one[0], many[:, 0]), 0.0, None), axis=1)
    area = np.prod(many[:, 1] - many[:, 0], axis=1)
    return np.asarray(inner / np.maximum(np.prod(one[1] - one[0]) + area - inner, 1e-9))
