"""Inputs and outputs of MediaPipe's networks: palms of the palm detector, crops of hands for the landmark network.

V. Bazarevsky, F. Zhang, "On-Device, Real-Time Hand Tracking with MediaPipe", 2019; F. Zhang et al., "MediaPipe Hands",
2020. The palm detector, a single-shot detector with fixed anchors, takes the image fitted into a square, and returns
for each anchor the logit of a palm, and the palm's box and seven points relative to the anchor's middle. A crop is a
turned square of the image in which the fingers point up, with sizes and shifts of MediaPipe's published graphs.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray

PALM_INPUT_PX = 192
"""Side of the palm detector's input [px]."""
ANCHOR_GRIDS = ((24, 2), (12, 6))
"""Cells along a side of each grid of anchors, and anchors in each cell."""
MIN_PALM_PROBABILITY = 0.5
PALM_IOU_THRESHOLD = 0.3
"""Intersection over union above which two boxes are of one palm."""
BRIGHTNESS_QUANTILE, DARK_IMAGE_THRESHOLD, TARGET_BRIGHTNESS, MAX_BRIGHTNESS_GAIN = 0.98, 0.4, 0.8, 20.0
"""Quantile of an image's values; value of it below which the image is dark; value to which it is then scaled, and the
largest factor."""
PALM_WRIST_INDEX, PALM_KNUCKLE_INDEX = 0, 2
"""Indices in ``Palm.points``."""
HAND_INPUT_PX = 224
"""Side of the landmark network's input [px]."""
PALM_CROP_SCALE_SHIFT = (2.6, 0.5)
"""Side of a palm's crop in sides of the palm's box, and its shift towards the fingers in heights of the box."""
LANDMARK_CROP_SCALE_SHIFT = (2.0, 0.1)
"""Side and shift of a hand's crop, in sizes of the box of ``RIGID_LANDMARKS``."""
RIGID_LANDMARKS = np.array([0, 1, 2, 3, 5, 6, 9, 10, 13, 14, 17, 18])
"""Landmarks up to the middle joints of the fingers, which bent fingers hardly move."""


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
        """Fit images of a size (width, height) [px]; their longer side is the fraction ``fill`` of the square's."""
        scale = fill * PALM_INPUT_PX / max(size)
        return Letterbox(scale, (PALM_INPUT_PX - scale * np.array(size, dtype=float)) / 2.0)

    def image(self, image: UInt8[ndarray, "H W 3"]) -> Float32[ndarray, "192 192 3"]:
        """Return the palm detector's input: red, green, blue from 0 to 1, black outside the image."""
        import cv2

        size = max(1, round(image.shape[1] * self.scale)), max(1, round(image.shape[0] * self.scale))
        skip = max(1, int(0.5 / self.scale))  # two input pixels or more remain for each output pixel
        small = cv2.resize(np.ascontiguousarray(image[::skip, ::skip]), size, interpolation=cv2.INTER_AREA)
        out = np.zeros((PALM_INPUT_PX, PALM_INPUT_PX, 3), np.float32)
        left, top = (round(float(x)) for x in self.shift)
        inside = small[: PALM_INPUT_PX - top, : PALM_INPUT_PX - left]
        out[top : top + size[1], left : left + size[0]] = inside / np.float32(255.0)
        return brighten(out)

    def back(self, points: Float[ndarray, "*n 2"]) -> Float[ndarray, "*n 2"]:
        """Convert points of the square to the image [px]."""
        return np.asarray((points - self.shift) / self.scale)


def brighten(image: Float32[ndarray, "H W 3"]) -> Float32[ndarray, "H W 3"]:
    """Scale up the values (0 to 1) of a dark image, since the networks were not trained with dark ones."""
    high = float(np.quantile(image[::4, ::4], BRIGHTNESS_QUANTILE))
    if high >= DARK_IMAGE_THRESHOLD:
        return image
    gain = TARGET_BRIGHTNESS / max(high, TARGET_BRIGHTNESS / MAX_BRIGHTNESS_GAIN)
    return np.minimum(image * np.float32(gain), np.float32(1.0))


def decode_palms(
    boxes: Float32[ndarray, "2016 18"],
    logits: Float32[ndarray, "2016"],
    frame: Letterbox,
    least: float = MIN_PALM_PROBABILITY,
) -> list[Palm]:
    """Decode the palm detector's output; return palms by score, each the weighted mean of overlapping detections."""
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
    inner = np.prod(np.clip(np.minimum(one[1], many[:, 1]) - np.maximum(one[0], many[:, 0]), 0.0, None), axis=1)
    area = np.prod(many[:, 1] - many[:, 0], axis=1)
    return np.asarray(inner / np.maximum(np.prod(one[1] - one[0]) + area - inner, 1e-9))


class HandCrop(NamedTuple):
    """A turned square of an image."""

    middle: Float[ndarray, "2"]
    """[px]"""
    side: float
    """[px]"""
    angle: float
    """Rotation from x to y [rad]."""

    @property
    def axes(self) -> Float[ndarray, "2 2"]:
        """The crop's x and y axes in the image, as columns."""
        c, s = np.cos(self.angle), np.sin(self.angle)
        return np.array([[c, -s], [s, c]])

    def to_image(self, points: Float[ndarray, "*n 2"]) -> Float[ndarray, "*n 2"]:
        """Convert pixels of the network's input to those of the image."""
        return np.asarray(self.middle + (points / HAND_INPUT_PX - 0.5) @ self.axes.T * self.side)

    def from_image(self, points: Float[ndarray, "*n 2"]) -> Float[ndarray, "*n 2"]:
        """Convert pixels of the image to those of the network's input."""
        return np.asarray(((points - self.middle) @ self.axes / self.side + 0.5) * HAND_INPUT_PX)

    def image(self, image: UInt8[ndarray, "H W 3"]) -> Float32[ndarray, "224 224 3"]:
        """Return the landmark network's input: red, green, blue from 0 to 1, black outside the image."""
        import cv2

        M = np.column_stack([self.axes * self.side / HAND_INPUT_PX, self.to_image(np.zeros(2))])
        M[:, 2] += M[:, :2] @ [0.5, 0.5] - 0.5  # OpenCV's pixels have their middle at whole numbers
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        warped = cv2.warpAffine(image, M, (HAND_INPUT_PX, HAND_INPUT_PX), flags=flags)
        return brighten(np.asarray(warped, np.float32) / np.float32(255.0))

    def near(self, other: HandCrop) -> bool:
        """Return whether both crops show the network nearly the same pixels."""
        apart = float(np.linalg.norm(self.middle - other.middle)) / min(self.side, other.side)
        turned = abs(angle_difference(self.angle, other.angle))
        return apart < 0.25 and turned < 0.6 and 0.75 < self.side / other.side < 1.35


def angle_difference(one: float, other: float) -> float:
    """Return the difference of two angles, from -pi to pi [rad]."""
    return (one - other + np.pi) % (2.0 * np.pi) - np.pi


def crop_of_palm(palm: Palm) -> HandCrop:
    """Return the crop around the hand of a detected palm."""
    angle = _upright_angle(palm.points[PALM_WRIST_INDEX], palm.points[PALM_KNUCKLE_INDEX])
    low, high = palm.box[:2], palm.box[2:]
    scale, ahead = PALM_CROP_SCALE_SHIFT
    crop = HandCrop((low + high) / 2.0, scale * float(np.max(high - low)), angle)
    return crop._replace(middle=crop.middle - crop.axes[:, 1] * ahead * float(high[1] - low[1]))


def crop_of_box(box: Float[ndarray, "4"]) -> HandCrop:
    """Return the upright crop around the middle of a box (left, top, width, height) [px]."""
    return HandCrop(box[:2] + box[2:] / 2.0, float(box[2:].max()), 0.0)


def crop_of_landmarks(points: Float[ndarray, "21 2"]) -> HandCrop:
    """Return the crop around a hand with landmarks ``points`` [px], for the next frame."""
    ahead = 0.25 * (points[6] + points[14]) + 0.5 * points[10]
    crop = HandCrop(np.zeros(2), 1.0, _upright_angle(points[0], ahead))
    own = points[RIGID_LANDMARKS] @ crop.axes
    low, high = own.min(axis=0), own.max(axis=0)
    scale, shift = LANDMARK_CROP_SCALE_SHIFT
    middle = (low + high) / 2.0 - np.array([0.0, shift * (high[1] - low[1])])
    return HandCrop(crop.axes @ middle, max(scale * float(np.max(high - low)), 1.0), crop.angle)


def _upright_angle(wrist: Float[ndarray, "2"], ahead: Float[ndarray, "2"]) -> float:
    """Return the angle of a crop in which ``ahead`` is above the wrist [rad]."""
    x, y = ahead - wrist
    return float(np.arctan2(x, -y))
