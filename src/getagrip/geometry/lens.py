"""The camera's lens as a user states it: intrinsics, and distortion to be removed. Light to load, as options must be.

In OpenCV, pixel centres are integers: 0.5 is subtracted for its functions. Its distortion models ("Camera
Calibration and 3D Reconstruction"), with (x, y) = (X, Y) / Z and r^2 = x^2 + y^2:

- perspective lenses: (x, y) (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6), and tangentially
  (2 p1 x y + p2 (r^2 + 2 x^2), p1 (r^2 + 2 y^2) + 2 p2 x y); then thin prism and tilt;
- fisheye lenses: (x, y) theta_d / r, theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8), theta =
  atan(r).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from getagrip.errors import UsageError
from getagrip.io.options import Flag, numbers_argument

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8
    from numpy import ndarray

N_DISTORTION_COEFFICIENTS = (4, 5, 8, 12, 14)
"""Allowed numbers of coefficients in OpenCV's model of perspective lenses."""
MIN_UNDISTORTED_COVERAGE = 0.5
"""Fraction of the undistorted image's pixels that the original image must cover."""


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
        import numpy as np

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
