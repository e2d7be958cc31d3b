"""Pinhole cameras, square crops, and lens distortion; the camera's options on the command line.

Pixel (row i, column j) has its centre at (u, v) = (j + 0.5, i + 0.5). In OpenCV, centres are integers: 0.5 is
subtracted for its functions. Its distortion models ("Camera Calibration and 3D Reconstruction"), with (x, y) = (X, Y) /
Z and r^2 = x^2 + y^2:

- perspective lenses: (x, y) (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6), and tangentially
  (2 p1 x y + p2 (r^2 + 2 x^2), p1 (r^2 + 2 y^2) + 2 p2 x y); then thin prism and tilt;
- fisheye lenses: (x, y) theta_d / r, theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8), theta =
  atan(r).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float, Int, Shaped, UInt8
from numpy import ndarray
from tyro.conf import arg

from getagrip.errors import UsageError
from getagrip.io.options import Flag, numbers_argument

N_DISTORTION_COEFFICIENTS = (4, 5, 8, 12, 14)
"""Allowed numbers of coefficients in OpenCV's model of perspective lenses."""
MIN_UNDISTORTED_COVERAGE = 0.5
"""Fraction of the undistorted image's pixels that the original image must cover."""


def project(
    K: Float[ndarray, "*#batch 3 3"], X_cam: Float[ndarray, "*#batch points 3"]
) -> Float[ndarray, "*batch points 2"]:
    """Project points in the camera frame [m] to pixel coordinates (u, v)."""
    uvw = X_cam @ np.swapaxes(K, -1, -2)
    return uvw[..., :2] / uvw[..., 2:]


def backproject(
    K: Float[ndarray, "*#batch 3 3"], uv: Float[ndarray, "*#batch points 2"]
) -> Float[ndarray, "*batch points 3"]:
    """Return the points at depth 1 on the rays through pixel coordinates; multiply by the depth [m]."""
    uv1 = np.concatenate([uv, np.ones((*uv.shape[:-1], 1))], axis=-1)
    return uv1 @ np.swapaxes(np.linalg.inv(K), -1, -2)


@dataclass(frozen=True)
class Crops:
    """One square window per frame, all of the same side, resampled to ``size`` x ``size`` pixels.

    Attributes:
        corner: (T, 2) top left corners (u, v) in the image [px]; windows may leave the image.
        side: side of the windows in the image [px].
        size: side of the resampled crop [px].
    """

    corner: Float[ndarray, "T 2"]
    side: float
    size: int

    @property
    def zoom(self) -> float:
        """Crop pixels per image pixel."""
        return self.size / self.side

    def intrinsics(self, K: Float[ndarray, "T 3 3"]) -> Float[ndarray, "T 3 3"]:
        """Return the intrinsics of the crops, from those of the images."""
        M = np.zeros((len(self.corner), 3, 3))
        M[:, 0, 0] = M[:, 1, 1] = self.zoom
        M[:, :2, 2] = -self.corner * self.zoom
        M[:, 2, 2] = 1.0
        return M @ K

    def resample(self, images: Shaped[ndarray, "T H W"], outside: int | bool) -> Shaped[ndarray, "T size size"]:
        """Crop label images by nearest neighbours; pixels beyond the image become ``outside``."""
        T, H, W = images.shape
        centres = (np.arange(self.size) + 0.5) / self.zoom
        out = np.full((T, self.size, self.size), outside, dtype=images.dtype)
        for n in range(T):
            cols = np.floor(self.corner[n, 0] + centres).astype(int)
            rows = np.floor(self.corner[n, 1] + centres).astype(int)
            (left, right), (top, bottom) = np.searchsorted(cols, [0, W]), np.searchsorted(rows, [0, H])
            out[n, top:bottom, left:right] = images[n].take(rows[top:bottom], 0).take(cols[left:right], 1)
        return out


def bounding_boxes(masks: Shaped[ndarray, "T H W"]) -> Int[ndarray, "T 4"]:
    """Return (u0, v0, u1, v1) [px], end exclusive, of each mask's non-zero pixels; zeros for an empty mask."""
    boxes = np.zeros((len(masks), 4), dtype=int)
    for n, mask in enumerate(masks):
        rows, cols = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        if rows.size:
            boxes[n] = cols[0], rows[0], cols[-1] + 1, rows[-1] + 1
    return boxes


def crops_around(masks: Shaped[ndarray, "T H W"], expand: float = 1.8, size: int = 256) -> Crops:
    """Make square crops centred on each frame's mask, which needs a pixel, ``expand`` times the largest mask's size.

    All frames have one side, so that a pixel of energy is worth the same; each has its own centre, so that an object
    moving across the image keeps its resolution.
    """
    return crops_of_boxes(bounding_boxes(masks).astype(float), expand, size)


def crops_of_boxes(boxes: Float[ndarray, "T 4"], expand: float, size: int) -> Crops:
    """Make square crops centred on each frame's box (u0, v0, u1, v1) [px], ``expand`` times the largest box's side."""
    side = expand * float((boxes[:, 2:] - boxes[:, :2]).max())
    centre = (boxes[:, :2] + boxes[:, 2:]) / 2.0
    return Crops(corner=centre - side / 2.0, side=side, size=size)


@dataclass(frozen=True)
class Lens:
    """Known intrinsics of the camera: at most one of three fields is set."""

    K: Annotated[
        tuple[float, float, float, float] | None,
        numbers_argument(4, "FX FY CX CY"),
        arg(name="K", help_behavior_hint=""),
    ] = None
    """The camera's focal lengths and principal point [px]."""
    focal: Annotated[float | None, arg(metavar="PX", help_behavior_hint="")] = None
    """Instead of K, the focal length; the principal point is in the middle."""
    guess_focal: Flag = False
    """Assume the focal length; depths and sizes are then assumptions as well."""

    @property
    def is_set(self) -> bool:
        """True if any field is set."""
        return self.K is not None or self.focal is not None or self.guess_focal


@dataclass(frozen=True)
class Distortion:
    """The distortion of the camera's lens; none without coefficients."""

    distortion: Annotated[tuple[float, ...], arg(metavar="K1 K2 P1 P2...", help_behavior_hint="")] = ()
    """Remove the lens distortion from the images: OpenCV's coefficients, 4, 5, 8, 12 or 14. Masks and hands must be of
    the images without it."""
    fisheye: Flag = False
    """With --distortion: the coefficients are the 4 of OpenCV's fisheye model."""

    @property
    def words(self) -> str:
        """Note on the change of the images, for their provenance; empty without a change."""
        model = "fisheye model" if self.fisheye else "model"
        numbers = " ".join(f"{value:.6g}" for value in self.distortion)
        return f"; lens distortion removed from the images (OpenCV's {model}, {numbers})" if self.distortion else ""

    def removal(
        self, K: Float[ndarray, "3 3"], size: tuple[int, int]
    ) -> Callable[[UInt8[ndarray, "H W 3"]], UInt8[ndarray, "H W 3"]]:
        """Return a function that removes the distortion from an image, whose intrinsics and size stay the same.

        Raises ``UsageError`` for impossible coefficients.
        """
        import cv2

        counts = (4,) if self.fisheye else N_DISTORTION_COEFFICIENTS
        if len(self.distortion) not in counts:
            raise UsageError(f"--distortion must be {' or '.join(map(str, counts))} (got {len(self.distortion)})")
        in_opencv = K - np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]])
        coefficients, maps = np.array(self.distortion), cv2.fisheye if self.fisheye else cv2
        u, v = maps.initUndistortRectifyMap(in_opencv, coefficients, np.eye(3), in_opencv, size, cv2.CV_32FC1)
        inside = (u >= -0.5) & (u <= size[0] - 0.5) & (v >= -0.5) & (v <= size[1] - 0.5)
        if not inside.mean() > MIN_UNDISTORTED_COVERAGE:
            got = f"{100.0 * inside.mean():.0f} % of the pixels inside the image"
            raise UsageError(f"--distortion must be this lens's (got coefficients that leave {got}); is it --fisheye?")
        return lambda image: np.asarray(cv2.remap(image, u, v, cv2.INTER_LINEAR), dtype=np.uint8)
