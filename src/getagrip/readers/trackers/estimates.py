"""Hand estimates in this package's conventions, with the weak-perspective camera of a crop as one of the whole image.

For a crop of side b [px] about (cx, cy), a network predicts (s, tx, ty): a point X of the hand projects to

    (u, v) = (cx, cy) + (b s / 2) (X + tx, Y + ty):

``b s / 2`` pixels per metre, the origin at ``(cx, cy) + (b s / 2) (tx, ty)``. A pinhole of focal length f has the same
number of pixels per metre at the depth z = f / (b s / 2), as in HaMeR's ``cam_crop_to_full`` (notation: SPIN and
CLIFF). Whatever focal length an estimator assumes, it observes the pixels per metre and the origin in the image; the
depth follows from these and the real focal length.
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
"""Maximum difference of a matrix's entries from the nearest rotation's that rounding explains."""
OPPOSITE_SIDE: dict[Side, Side] = {"left": "right", "right": "left"}
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
    """A request for a hand: its side, the frames, and the clip's camera.

    Attributes:
        side: ``left`` or ``right`` hand.
        frames: names of the clip's frames.
        K: (T, 3, 3) the clip's intrinsics in each of them [px].
        size: width and height of the clip's images [px].
        mano: folder of the user's MANO files.
        ask_first: the option for the number of the first frame's hand; empty if used.
        counted: True if the option was used: frames are numbered as the hands' files count them.
        hand_masks: the file of the hand mask in each frame, None in frames without; empty without hand masks.
        times: (T,) the times of the frames [s]; None where unknown.
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
        """Raise ``UsageError`` for hands apparently counted from another start than frames."""
        check_frame_numbers(self.frames, names, source, "hand", self.ask_first)

    def camera(self, frame: int) -> Camera:
        """Return the camera in a frame, by its index."""
        return Camera(self.K[frame], self.size)


class HandParameters(NamedTuple):
    """MANO's parameters of a hand; rotations of a left hand are not mirrored.

    Attributes:
        R: (3, 3) global rotation, hand to camera.
        pose: (45,) rotation vectors of the fingers, relative to the flat hand [rad].
        betas: (10,) shape.
        t: (3,) translation before the clip's camera [m], after the rotation about the hand's root joint.
    """

    R: Float[ndarray, "3 3"]
    pose: Float[ndarray, "45"]
    betas: Float[ndarray, "10"]
    t: Float[ndarray, "3"]


class Estimate(NamedTuple):
    """A hand in one frame: MANO's parameters, joints, or both.

    Attributes:
        path: the hand's file.
        frame: index of the frame among the frames of the ``Request``.
        depth: source of the depth.
        mano: MANO's parameters; None for trackers of joints only.
        joints: (21, 3) the joints before the clip's camera [m], in this package's order; None where not estimated.
        vertices: (778, 3) the surface where ``mano.betas`` does not give it: ``mano.t`` is then the position of its
            origin, and the hand is moved to the mean of the vertices.
        seen: (21, 3) the joints in the clip's image [px] and their confidence; None where not estimated.
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
        left_model: the surface of a left hand: MANO's right hand mirrored, for networks trained on right hands, or
            MANO's own left hand.
        scale: source of the size, in words; empty for the size of the shape parameters or of the generic hand.
        scale_assumed: True where the hand's size is unknown.
        warning: a possible error, in words; empty without one.
    """

    side: Side
    hands: tuple[Estimate, ...]
    left_model: Literal["mirrored", "own"] = "mirrored"
    scale: str = ""
    scale_assumed: bool = False
    warning: str = ""


def to_rotation_matrices(path: Path, key: str, values: Float[ndarray, "... 3"], axes: int) -> Float[ndarray, "... 3 3"]:
    """Convert rotation vectors [rad] (..., 3), or rounded matrices, to rotation matrices (..., 3, 3).

    ``axes`` is the number of leading axes, which tells three vectors from a matrix. Raises ``InputError``.
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
        """Convert the camera (s, tx, ty) of a crop with a centre and a side [px]."""
        scale = side * cam[0] / 2.0
        return WeakPerspective(centre + scale * cam[1:], float(scale))

    @staticmethod
    def of_translation(t: Float[ndarray, "3"], focal: float, centre: Float[ndarray, "2"]) -> WeakPerspective:
        """Convert a translation [m] before a pinhole with a focal length and a principal point [px]."""
        return WeakPerspective(centre + focal * t[:2] / t[2], focal / float(t[2]))

    def resized(self, zoom: Float[ndarray, "2"]) -> WeakPerspective:
        """Return the camera in an image ``zoom`` times as wide and as high."""
        return WeakPerspective(self.origin * zoom, self.pixels_per_metre * float(zoom[0]))

    def before(self, camera: Camera) -> Float[ndarray, "3"]:
        """Return the translation [m] with the same projection of the origin and the same pixels per metre, fx / z."""
        K = camera.K
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # hands too far away are refused later
            z = K[0, 0] / self.pixels_per_metre
            return np.array([*(z * (self.origin - K[:2, 2]) / K[[0, 1], [0, 1]]), z])


def hamer_focal(size: tuple[int, int]) -> float:
    """Return the focal length that HaMeR's and WiLoR's demos assume for an image [px]."""
    return HAMER_FOCAL / HAMER_CROP * max(size)


def vitdet_side(box: Float[ndarray, "2"], rescale: float) -> float:
    """Return the side [px] of HaMeR's crop of a box: ``rescale`` times as large, and high enough for 192 : 256.

    The function ``expand_to_aspect_ratio`` of HaMeR's code.
    """
    width, height = rescale * box
    return float(max(height, width * 256.0 / 192.0))
