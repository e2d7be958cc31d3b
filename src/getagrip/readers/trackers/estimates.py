"""An estimator's output for one hand, in this package's conventions; its crop's camera, as the whole image's.

A network that is given a crop of side b [px] about (cx, cy) predicts (s, tx, ty): a point X of its hand projects to

    (u, v) = (cx, cy) + (b s / 2) (X + tx, Y + ty):

``b s / 2`` pixels to the metre, its origin at ``(cx, cy) + (b s / 2) (tx, ty)``. A pinhole of focal length f sees as
many pixels to the metre at the depth z = f / (b s / 2), which is what HaMeR's ``cam_crop_to_full`` computes (the
notation is SPIN's and CLIFF's). Whatever focal length an estimator has assumed, its pixels to the metre and the place
of its origin in the image are what it observed; depth follows from them and the real focal length.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip.match_frames import check_frame_numbers
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.hands.model import SIDE_MIRROR, Side
from getagrip.provenance import Source

ONE_CAMERA_NOTE = "one camera determines neither the size nor the depth of a hand"
ROTATION_MATRIX_TOLERANCE = 0.05
"""Entries of a matrix so far from the nearest rotation's are no rounding."""
HAMER_FOCAL, HAMER_CROP = 5000.0, 256.0
"""HaMeR's and WiLoR's demos assume a focal length of 5000 / 256 times the larger side of the image [px]."""


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
        counted: True if it was used: frames are numbered as the hands' files count them.
        hand_masks: the image of the hand's mask in each frame, None where a frame has none; empty where no frame has.
        times: (T,) the times of the frames [s]; None where they are not known.
    """

    side: Side
    frames: tuple[str, ...]
    K: Float[ndarray, "T 3 3"]
    size: tuple[int, int]
    mano: Path | None = None
    ask_first: str = "--first"
    counted: bool = False
    hand_masks: tuple[Path | None, ...] = ()
    times: Float[ndarray, "T"] | None = None

    def check_numbers(self, source: Path, names: Iterable[str]) -> None:
        """Raise ``UsageError`` where hands seem to be counted from another start than frames."""
        check_frame_numbers(self.frames, names, source, "hand", self.ask_first)

    def camera(self, frame: int) -> Camera:
        """Return the camera in a frame, by its index."""
        return Camera(self.K[frame], self.size)


class HandParameters(NamedTuple):
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
    mano: HandParameters | None
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
        scale_assumed: True where nothing tells the size of the hand.
        warning: possible error, in words; empty where there is none.
    """

    side: Side
    hands: tuple[Estimate, ...]
    left_model: Literal["mirrored", "own"] = "mirrored"
    scale: str = ""
    scale_assumed: bool = False
    warning: str = ""


def to_rotation_matrices(path: Path, key: str, values: Float[ndarray, "... 3"], axes: int) -> Float[ndarray, "... 3 3"]:
    """Convert rotation vectors [rad] (..., 3), or rounded matrices, to rotation matrices (..., 3, 3).

    ``axes`` is the number of leading axes: three vectors are no matrix. Raises ``InputError`` for other matrices.
    """
    if values.ndim == axes + 1:
        return se3.exp_so3(values)
    R = se3.nearest_rotation(values)
    off = float(np.abs(R - values).max())
    if off > ROTATION_MATRIX_TOLERANCE:
        raise InputError(path, key, f"a matrix {off:.2g} off the nearest rotation", "rotations")
    return R


def mirror_rotation(R: Float[ndarray, "*n 3 3"]) -> Float[ndarray, "*n 3 3"]:
    """Return a rotation in the mirrored image, M R M with M = diag(-1, 1, 1); in vectors, y and z change sign."""
    return np.asarray(SIDE_MIRROR[:, None] * R * SIDE_MIRROR)


class WeakPerspective(NamedTuple):
    """An orthographic camera in an image."""

    origin: Float[ndarray, "2"]
    """Projection (u, v) of the hand's origin [px]."""
    pixels_per_metre: float

    @staticmethod
    def of_crop(centre: Float[ndarray, "2"], side: float, cam: Float[ndarray, "3"]) -> WeakPerspective:
        """Make it from a crop's middle and side [px], and the camera (s, tx, ty) in it."""
        scale = side * cam[0] / 2.0
        return WeakPerspective(centre + scale * cam[1:], float(scale))

    @staticmethod
    def of_translation(t: Float[ndarray, "3"], focal: float, centre: Float[ndarray, "2"]) -> WeakPerspective:
        """Make it from a translation [m] before a pinhole with a focal length and a principal point [px]."""
        return WeakPerspective(centre + focal * t[:2] / t[2], focal / float(t[2]))

    def resized(self, zoom: Float[ndarray, "2"]) -> WeakPerspective:
        """Return it in an image ``zoom`` times as wide and as high."""
        return WeakPerspective(self.origin * zoom, self.pixels_per_metre * float(zoom[0]))

    def before(self, camera: Camera) -> Float[ndarray, "3"]:
        """Return the translation [m] that shows the hand's origin there, and at fx / z pixels to the metre."""
        K = camera.K
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # a hand that is too far is refused later
            z = K[0, 0] / self.pixels_per_metre
            return np.array([*(z * (self.origin - K[:2, 2]) / K[[0, 1], [0, 1]]), z])


def hamer_focal(size: tuple[int, int]) -> float:
    """Return the focal length that HaMeR's and WiLoR's demos assume of an image [px]."""
    return HAMER_FOCAL / HAMER_CROP * max(size)


def vitdet_side(box: Float[ndarray, "2"], rescale: float) -> float:
    """Return the side [px] of the crop that HaMeR takes of a box of some width and height.

    ``rescale`` times as large, and high enough for 192 : 256 (``expand_to_aspect_ratio``).
    """
    width, height = rescale * box
    return float(max(height, width * 256.0 / 192.0))
