"""The crop of a hand: a turned square of the image in which the fingers point up.

Sizes and shifts are those that the landmark network was trained with (MediaPipe's published graphs).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray

from getagrip.landmarks.palms import PALM_KNUCKLE_INDEX, PALM_WRIST_INDEX, Palm, brighten

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
