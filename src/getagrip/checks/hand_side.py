"""The side of a hand, by the direction from the palm in which its fingers bend."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import HandTrack
from getagrip.clip.timeline import Side

WRIST, INDEX, MIDDLE, PINKY = 0, 5, 9, 17
"""Indices among the 21 joints: the wrist, and the first joints of three fingers."""
ROOTS, TIPS = np.array([5, 9, 13, 17]), np.array([8, 12, 16, 20])


def bend(hand: HandTrack, side: Side) -> float:
    """Measure how far the fingers bend towards the palm of a hand of that side, median over frames [degrees].

    Negative where they would bend backwards: it is the other hand. NaN for hands without joints.

    Seen with the palm in front and the fingers up, a right hand's index lies to the right of its little finger; so
    little finger to index, crossed with wrist to fingers, points out of the palm, where bent fingers go.
    """
    joints = hand.joints
    if joints is None:
        return float("nan")
    along = _unit(joints[:, MIDDLE] - joints[:, WRIST])
    out = _unit(np.cross(joints[:, INDEX] - joints[:, PINKY], along))
    fingers = (joints[:, TIPS] - joints[:, ROOTS]).mean(axis=1)
    angle = np.degrees(np.arctan2(np.sum(fingers * out, axis=1), np.abs(np.sum(fingers * along, axis=1))))
    return float(np.median(angle if side == "right" else -angle))


def _unit(v: Float[ndarray, "T 3"]) -> Float[ndarray, "T 3"]:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-12))
