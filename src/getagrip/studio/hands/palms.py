"""Palms in an image, by MediaPipe's palm detector: a single-shot detector with fixed anchors.

V. Bazarevsky, F. Zhang, "On-Device, Real-Time Hand Tracking with MediaPipe", 2019; F. Zhang et al., "MediaPipe Hands",
2020. The network takes the image fitted into a square, and gives for each anchor the logit of a palm, and the palm's
box and seven points relative to the anchor's middle.

The crop of a hand: a turned square of the image in which the fingers point up.

Sizes and shifts are those that the landmark network was trained with (MediaPipe's published graphs).
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


HAND_INPUT_PX = 224
"""Side of the landmark network's input [px]."""
PALM_CROP_SCALE_SHIFT = (2.6, 0.5)
"""Side of the square in sides of the palm's box, and its shift towards the fingers in heights of the box."""
LANDMARK_CROP_SCALE_SHIFT = (2.0, 0.1)
"""Size and shift for the box of the landmarks that finger bends hardly move."""
RIGID_LANDMARKS = np.array([0, 1, 2, 3, 5, 6, 9, 10, 13, 14, 17, 18])
"""Landmarks up to the middle joints of the fingers."""


class HandCrop(NamedTuple):
    """A turned square."""

    middle: Float[ndarray, "2"]
    """[px]"""
    side: float
    """[px]"""
    angle: float
    """Rotation from x to y [rad]."""

    @property
    def axes(self) -> Float[ndarray, "2 2"]:
        """Columns: its own x and y in the image."""
        c, s = np.cos(self.angle), np.sin(self.angle)
        return np.array([[c, -s], [s, c]])

    def to_image(self, points: Float[ndarray, "*n 2"]) -> Float[ndarray, "*n 2"]:
        """Convert pixels of the network's input to those of the image."""
        return np.asarray(self.middle + (points / HAND_INPUT_PX - 0.5) @ self.axes.T * self.side)

    def from_image(self, points: Float[ndarray, "*n 2"]) -> Float[ndarray, "*n 2"]:
        """Convert pixels of the image to those of the network's input."""
        return np.asarray(((points - self.middle) @ self.axes / self.side + 0.5) * HAND_INPUT_PX)

    def image(self, image: UInt8[ndarray, "H W 3"]) -> Float32[ndarray, "224 224 3"]:
        """Return the network's input: red, green, blue from 0 to 1, black beyond the image."""
        import cv2

        M = np.column_stack([self.axes * self.side / HAND_INPUT_PX, self.to_image(np.zeros(2))])
        M[:, 2] += M[:, :2] @ [0.5, 0.5] - 0.5  # OpenCV's pixels have their middle at whole numbers
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return brighten(
            np.asarray(cv2.warpAffine(image, M, (HAND_INPUT_PX, HAND_INPUT_PX), flags=flags), np.float32)
            / np.float32(255.0)
        )

    def near(self, other: HandCrop) -> bool:
        """Return whether both crops show the network nearly the same pixels."""
        apart = float(np.linalg.norm(self.middle - other.middle)) / min(self.side, other.side)
        turned = abs((self.angle - other.angle + np.pi) % (2.0 * np.pi) - np.pi)
        return apart < 0.25 and turned < 0.6 and 0.75 < self.side / other.side < 1.35


def crop_of_palm(palm: Palm) -> HandCrop:
    """Make the crop about the hand of a palm."""
    angle = _upright_angle(palm.points[PALM_WRIST_INDEX], palm.points[PALM_KNUCKLE_INDEX])
    low, high = palm.box[:2], palm.box[2:]
    scale, ahead = PALM_CROP_SCALE_SHIFT
    crop = HandCrop((low + high) / 2.0, scale * float(np.max(high - low)), angle)
    return crop._replace(middle=crop.middle - crop.axes[:, 1] * ahead * float(high[1] - low[1]))


def crop_of_box(box: Float[ndarray, "4"]) -> HandCrop:
    """Make the upright square about the middle of a box (left, top, width, height) [px]."""
    return HandCrop(box[:2] + box[2:] / 2.0, float(box[2:].max()), 0.0)


def crop_of_landmarks(points: Float[ndarray, "21 2"]) -> HandCrop:
    """Make the crop about a detected hand, for the next frame."""
    ahead = 0.25 * (points[6] + points[14]) + 0.5 * points[10]
    crop = HandCrop(np.zeros(2), 1.0, _upright_angle(points[0], ahead))
    own = points[RIGID_LANDMARKS] @ crop.axes
    low, high = own.min(axis=0), own.max(axis=0)
    scale, shift = LANDMARK_CROP_SCALE_SHIFT
    middle = (low + high) / 2.0 - np.array([0.0, shift * (high[1] - low[1])])
    return HandCrop(crop.axes @ middle, max(scale * float(np.max(high - low)), 1.0), crop.angle)


def _upright_angle(wrist: Float[ndarray, "2"], ahead: Float[ndarray, "2"]) -> float:
    """Return the angle of a square in which the second point is above the first [rad]."""
    x, y = ahead - wrist
    return float(np.arctan2(x, -y))
