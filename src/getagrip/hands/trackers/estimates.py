"""An estimator's output for one hand, in this package's conventions."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip.naming import check_numbers
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.hands.model import MIRROR, Side
from getagrip.provenance import Source

ONE_CAMERA = "one camera determines neither the size nor the depth of a hand"
ROUNDED = 0.05
"""Entries of a matrix so far from the nearest rotation's are no rounding."""


class Camera(NamedTuple):
    """The clip's camera in one frame.

    Attributes:
        K: (3, 3) pinhole intrinsics [px].
        size: width and height of the images [px].
    """

    K: Float[ndarray, "3 3"]
    size: tuple[int, int]


@dataclass(frozen=True)
class Request:
    """The hand that is asked for: which one, in which frames, before which camera.

    Attributes:
        side: ``left`` or ``right`` hand.
        frames: names of the clip's frames.
        K: (T, 3, 3) the clip's intrinsics in each of them [px].
        size: width and height of the clip's images [px].
        mano: folder of the user's MANO files.
        ask_first: the option that states the number of the first frame's hand; empty where it was used.
        hand_masks: the image of the hand's mask in each frame, None where a frame has none; empty where no frame has.
    """

    side: Side
    frames: tuple[str, ...]
    K: Float[ndarray, "T 3 3"]
    size: tuple[int, int]
    mano: Path | None = None
    ask_first: str = "--first"
    hand_masks: tuple[Path | None, ...] = ()

    def check_numbers(self, source: Path, names: Iterable[str]) -> None:
        """Raise ``UsageError`` where hands seem to be counted from another start than frames."""
        check_numbers(self.frames, names, source, "hand", self.ask_first)

    def camera(self, frame: int) -> Camera:
        """Return the camera in a frame, by its index."""
        return Camera(self.K[frame], self.size)


class Parameters(NamedTuple):
    """MANO's parameters of a hand as it is: rotations of a left hand are those of the left hand.

    Attributes:
        R: (3, 3) global rotation, hand to camera.
        pose: (45,) rotation vectors of the fingers, relative to the flat hand [rad].
        betas: (10,) shape.
        t: (3,) translation before the clip's camera [m]: the hand is turned about its root joint, then moved by it.
    """

    R: Float[ndarray, "3 3"]
    pose: Float[ndarray, "45"]
    betas: Float[ndarray, "10"]
    t: Float[ndarray, "3"]


class Estimate(NamedTuple):
    """A hand in one frame: MANO's parameters, joints, or both.

    Attributes:
        path: the file that holds it.
        frame: index of the frame among those of the ``Request``.
        depth: where its depth comes from.
        mano: MANO's parameters; None where the tracker gives joints only.
        joints: (21, 3) the 21 joints, where the estimator gives them, before the clip's camera [m]; this package's
            order.
        vertices: (778, 3) the surface where it is not that of ``mano.betas``: ``mano.t`` is then where the origin of
            these is, their mean counts.
        seen: (21, 3) the joints as seen in the clip's image [px] and their confidence, where the estimator gives them.
    """

    path: Path
    frame: int
    depth: Source
    mano: Parameters | None
    joints: Float[ndarray, "21 3"] | None = None
    vertices: Float[ndarray, "778 3"] | None = None
    seen: Float[ndarray, "21 3"] | None = None


@dataclass(frozen=True)
class Estimates:
    """One hand over the frames in which it was found.

    Attributes:
        side: ``left`` or ``right`` hand.
        hands: the hand in each frame in which it was found.
        left_model: the surface of a left hand: MANO's right one mirrored, as networks have it that know right hands
            only, or the left one's own.
        scale: where the size comes from, in words; empty where it is that of the shape parameters or of the generic
            hand.
        warning: possible error, in words; empty where there is none.
    """

    side: Side
    hands: tuple[Estimate, ...]
    left_model: Literal["mirrored", "own"] = "mirrored"
    scale: str = ""
    warning: str = ""


def rotations(path: Path, key: str, values: Float[ndarray, "... 3"], axes: int) -> Float[ndarray, "... 3 3"]:
    """Convert rotation vectors [rad] (..., 3), or rounded matrices, to rotation matrices (..., 3, 3).

    ``axes`` is the number of leading axes: three vectors are no matrix. Raises ``InputError`` for other matrices.
    """
    if values.ndim == axes + 1:
        return se3.exp_so3(values)
    R = se3.nearest_rotation(values)
    off = float(np.abs(R - values).max())
    if off > ROUNDED:
        raise InputError(path, key, f"a matrix {off:.2g} off the nearest rotation", "rotations")
    return R


def mirror_rotation(R: Float[ndarray, "*n 3 3"]) -> Float[ndarray, "*n 3 3"]:
    """Return a rotation in the mirrored image, M R M with M = diag(-1, 1, 1); in vectors, y and z change sign."""
    return np.asarray(MIRROR[:, None] * R * MIRROR)
