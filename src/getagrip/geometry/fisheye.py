"""Fisheye cameras of Project Aria and Quest 3 (Fisheye624), and pinhole images resampled from theirs.

The model (projectaria_tools, ``FisheyeRadTanThinPrism.h``; "Camera Intrinsic Models for Project Aria devices"): for a
point (x, y, z) in front of the camera, with r = |(x, y)| / z and theta = atan(r),

    m = theta (1 + k0 theta^2 + k1 theta^4 + ... + k5 theta^12) (x, y) / |(x, y)|        radial
    d = m + 2 (m . p) m + |m|^2 p                                                        tangential
          + (s0 |m|^2 + s1 |m|^4, s2 |m|^2 + s3 |m|^4)                                   thin prism
    (u, v) = f d + c

The model's pixel centres are integers, ours halves (``camera``): 0.5 is added on reading.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Shaped
from numpy import ndarray

from getagrip.geometry import se3
from getagrip.geometry.camera import backproject


@dataclass(frozen=True)
class Fisheye624:
    """A fisheye camera (equations: see the module).

    Attributes:
        f: focal length [px].
        c: (2,) principal point (u, v) [px].
        k: (6,) radial coefficients.
        p: (2,) tangential coefficients.
        s: (4,) thin prism coefficients.
        size: width and height of the image [px].
    """

    f: float
    c: Float[ndarray, "2"]
    k: Float[ndarray, "6"]
    p: Float[ndarray, "2"]
    s: Float[ndarray, "4"]
    size: tuple[int, int]

    @classmethod
    def from_parameters(cls, parameters: Sequence[float], size: tuple[int, int]) -> Fisheye624:
        """Make a camera from the 15 numbers f, cx, cy, k0-k5, p0, p1, s0-s3, or 16 with two equal focal lengths first.

        Raises ``ValueError`` for another count, non-finite numbers, or a focal length that is not positive.
        """
        numbers = np.asarray(parameters, dtype=float)
        if numbers.shape == (16,):
            numbers = np.delete(numbers, 1)  # as HOT3D's tools do
        if numbers.shape != (15,) or not np.isfinite(numbers).all() or numbers[0] <= 0:
            raise ValueError(f"must be 15 or 16 finite numbers, a focal length above 0 first (got {numbers.tolist()})")
        return cls(float(numbers[0]), numbers[1:3] + 0.5, numbers[3:9], numbers[9:11], numbers[11:15], size)

    def project(self, X_cam: Float[ndarray, "*batch 3"]) -> Float[ndarray, "*batch 2"]:
        """Project points in the camera frame [m], z > 0, to pixel coordinates (u, v)."""
        xy = X_cam[..., :2] / X_cam[..., 2:]
        r = np.linalg.norm(xy, axis=-1, keepdims=True)
        theta = np.arctan(r)
        m = self._radial(theta) * xy / np.maximum(r, 1e-12)
        return self.f * self._bent(m) + self.c

    def _radial(self, theta: Float[ndarray, "*b 1"]) -> Float[ndarray, "*b 1"]:
        """Return |m|."""
        powers = theta ** np.array([2, 4, 6, 8, 10, 12])
        return np.asarray(theta * (1.0 + (powers @ self.k)[..., None]))

    def _bent(self, m: Float[ndarray, "*b 2"]) -> Float[ndarray, "*b 2"]:
        """Return the distorted point d(m)."""
        square = np.sum(m * m, axis=-1, keepdims=True)
        dot = (m @ self.p)[..., None]
        prism = self.s.reshape(2, 2)
        return np.asarray(m + 2.0 * dot * m + square * self.p + square * prism[:, 0] + square**2 * prism[:, 1])


@dataclass(frozen=True)
class Pinhole:
    """A pinhole camera with the centre and the optical axis of a fisheye camera.

    Attributes:
        K: (3, 3) intrinsics [px].
        size: width and height [px].
        T_fisheye_pinhole: (4, 4) pinhole camera to fisheye camera: a rotation about the optical axis.
    """

    K: Float[ndarray, "3 3"]
    size: tuple[int, int]
    T_fisheye_pinhole: Float[ndarray, "4 4"]

    def source(self, camera: Fisheye624) -> Float[ndarray, "h w 2"]:
        """Return each pixel's point (u, v) in the fisheye image [px]."""
        width, height = self.size
        uv = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1)
        return camera.project(se3.transform(self.T_fisheye_pinhole, backproject(self.K, uv)))

    def covered(self, camera: Fisheye624) -> Bool[ndarray, "h w"]:
        """Return a mask of the pixels inside the fisheye image."""
        uv = self.source(camera)
        return np.all((uv >= 0.0) & (uv < camera.size), axis=-1)

    def undistort(self, camera: Fisheye624, image: Shaped[ndarray, "H W *c"]) -> Shaped[ndarray, "h w *c"]:
        """Resample the fisheye image to this pinhole; pixels outside it are black."""
        import cv2

        at = (self.source(camera) - 0.5).astype(np.float32)  # to OpenCV's pixel centres
        return np.asarray(cv2.remap(image, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT))


def pinhole(camera: Fisheye624, focal: float, size: tuple[int, int], quarter_turns: int = 0) -> Pinhole:
    """Make a pinhole of given focal length and size [px] along a fisheye camera's axis.

    Each of ``quarter_turns`` turns the image clockwise by 90 degrees: one makes images of Aria's cameras, which are
    mounted sideways, upright. Raises ``ValueError`` for a focal length or size that is not positive.
    """
    if not 0.0 < focal < np.inf or min(size) < 1:
        raise ValueError("focal length and size must be above 0")
    K = np.array([[focal, 0.0, size[0] / 2.0], [0.0, focal, size[1] / 2.0], [0.0, 0.0, 1.0]])
    # The image turns clockwise when the camera turns counter-clockwise: its x axis goes to the old -y (up).
    R = np.linalg.matrix_power(np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), quarter_turns % 4)
    return Pinhole(K, size, se3.rigid(R))
