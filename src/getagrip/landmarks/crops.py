"""The crop of a hand: a turned square of the image in which the fingers point up.

Sizes and shifts are those that the landmark network was trained with (MediaPipe's published graphs).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray

from getagrip.landmarks.palms import MIDDLE_KNUCKLE, WRIST, Palm, lit

SIDE = 224
"""Side of the landmark network's input [px]."""
PALM = (2.6, 0.5)
"""Side of the square in sides of the palm's box, and its shift towards the fingers in heights of the box."""
LANDMARKS = (2.0, 0.1)
"""Size and shift for the box of the landmarks that finger bends hardly move."""
STIFF = np.array([0, 1, 2, 3, 5, 6, 9, 10, 13, 14, 17, 18])
"""Landmarks up to the middle joints of the fingers."""


class Crop(NamedTuple):
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
        return np.asarray(self.middle + (points / SIDE - 0.5) @ self.axes.T * self.side)

    def from_image(self, points: Float[ndarray, "*n 2"]) -> Float[ndarray, "*n 2"]:
        """Convert pixels of the image to those of the network's input."""
        return np.asarray(((points - self.middle) @ self.axes / self.side + 0.5) * SIDE)

    def image(self, image: UInt8[ndarray, "H W 3"]) -> Float32[ndarray, "224 224 3"]:
        """Return the network's input: red, green, blue from 0 to 1, black beyond the image."""
        import cv2

        M = np.column_stack([self.axes * self.side / SIDE, self.to_image(np.zeros(2))])
        M[:, 2] += M[:, :2] @ [0.5, 0.5] - 0.5  # OpenCV's pixels have their middle at whole numbers
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return lit(np.asarray(cv2.warpAffine(image, M, (SIDE, SIDE), flags=flags), np.float32) / np.float32(255.0))

    def near(self, other: Crop) -> bool:
        """Return whether both crops show the network nearly the same pixels."""
        apart = float(np.linalg.norm(self.middle - other.middle)) / min(self.side, other.side)
        turned = abs((self.angle - other.angle + np.pi) % (2.0 * np.pi) - np.pi)
        return apart < 0.25 and turned < 0.6 and 0.75 < self.side / other.side < 1.35


def of_palm(palm: Palm) -> Crop:
    """Make the crop about the hand of a palm."""
    angle = _upright(palm.points[WRIST], palm.points[MIDDLE_KNUCKLE])
    low, high = palm.box[:2], palm.box[2:]
    scale, ahead = PALM
    crop = Crop((low + high) / 2.0, scale * float(np.max(high - low)), angle)
    return crop._replace(middle=crop.middle - crop.axes[:, 1] * ahead * float(high[1] - low[1]))


def of_box(box: Float[ndarray, "4"]) -> Crop:
    """Make the upright square about the middle of a box (left, top, width, height) [px]."""
    return Crop(box[:2] + box[2:] / 2.0, float(box[2:].max()), 0.0)


def of_landmarks(points: Float[ndarray, "21 2"]) -> Crop:
    """Make the crop about a detected hand, for the next frame."""
    ahead = 0.25 * (points[6] + points[14]) + 0.5 * points[10]
    crop = Crop(np.zeros(2), 1.0, _upright(points[0], ahead))
    own = points[STIFF] @ crop.axes
    low, high = own.min(axis=0), own.max(axis=0)
    scale, shift = LANDMARKS
    middle = (low + high) / 2.0 - np.array([0.0, shift * (high[1] - low[1])])
    return Crop(crop.axes @ middle, max(scale * float(np.max(high - low)), 1.0), crop.angle)


def _upright(wrist: Float[ndarray, "2"], ahead: Float[ndarray, "2"]) -> float:
    """Return the angle of a square in which the second point is above the first [rad]."""
    x, y = ahead - wrist
    return float(np.arctan2(x, -y))
