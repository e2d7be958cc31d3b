"""What an estimator says of one hand, in this package's conventions."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.hands.model import MIRROR, Side

ROUNDED = 0.05
"""Entries of a matrix so far from the nearest rotation's are no rounding."""


class Camera(NamedTuple):
    """The clip's camera in one frame."""

    K: Float[ndarray, "3 3"]
    """Pinhole intrinsics [px]."""
    size: tuple[int, int]
    """Width and height of the images [px]."""


class Seen(NamedTuple):
    """A hand in one frame, as it is: rotations and joints of a left hand are those of the left hand."""

    R: Float[ndarray, "3 3"]
    """MANO's global rotation, hand to camera."""
    pose: Float[ndarray, "45"]
    """Rotation vectors of the fingers, relative to the flat hand [rad]."""
    betas: Float[ndarray, "10"]
    """MANO's shape."""
    t: Float[ndarray, "3"]
    """MANO's translation before the clip's camera [m]: the hand is turned about its root joint, then moved by it."""
    joints: Float[ndarray, "21 3"] | None = None
    """The 21 joints, where the estimator gives them, before the clip's camera [m]; this package's order."""
    vertices: Float[ndarray, "778 3"] | None = None
    """The surface where it is not that of ``betas``: ``t`` is then where the origin of these is, their mean counts."""


class NamedHand(NamedTuple):
    """A hand and the frame in which it was seen."""

    path: Path
    frame: str
    seen: Seen


@dataclass(frozen=True)
class Estimates:
    """One hand over the frames in which it was seen."""

    side: Side
    hands: tuple[NamedHand, ...]
    left_model: Literal["mirrored", "own"]
    """The surface of a left hand: MANO's right one mirrored, as networks have it that know right hands only, or the
    left one's own."""


def rotations(
    path: Path, key: str, values: Float[ndarray, "*n 3"] | Float[ndarray, "*n 3 3"], axes: int
) -> Float[ndarray, "*n 3 3"]:
    """Rotation matrices from rotation vectors [rad], or from matrices that a network has rounded (made exact).

    ``axes`` is the number of leading axes, n: three vectors are no matrix. Raises ``InputError`` for other matrices.
    """
    if values.ndim == axes + 1:
        return se3.exp_so3(values)
    R = se3.nearest_rotation(values)
    off = float(np.abs(R - values).max())
    if off > ROUNDED:
        raise InputError(path, key, f"a matrix {off:.2g} off the nearest rotation", "rotations")
    return R


def mirror_rotation(R: Float[ndarray, "*n 3 3"]) -> Float[ndarray, "*n 3 3"]:
    """M R M with M = diag(-1, 1, 1): what a rotation is in the mirrored image. (Of a vector, y and z change sign.)"""
    return np.asarray(MIRROR[:, None] * R * MIRROR)
