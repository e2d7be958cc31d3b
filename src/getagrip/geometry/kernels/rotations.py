"""Kernels on many small rotations: as ``se3``'s functions, which are the readable reference, without numpy's calls."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.compiling import kernel

SMALL_ANGLE_RAD = 1e-4
"""Angle below which series replace quotients of small numbers, as in ``se3``."""


def exp_so3(w: Float[ndarray, "*batch 3"]) -> Float[ndarray, "*batch 3 3"]:
    """Return the rotation matrix of each rotation vector [rad], as ``se3.exp_so3``."""
    out = np.empty((*w.shape, 3))
    _exp_so3(np.ascontiguousarray(w, dtype=float).reshape(-1, 3), out.reshape(-1, 3, 3))
    return out


def left_jacobian(w: Float[ndarray, "*batch 3"]) -> Float[ndarray, "*batch 3 3"]:
    """Return the left Jacobian at each rotation vector [rad], as ``se3.left_jacobian``."""
    out = np.empty((*w.shape, 3))
    _left_jacobian(np.ascontiguousarray(w, dtype=float).reshape(-1, 3), out.reshape(-1, 3, 3))
    return out


def cross(a: Float[ndarray, "*#batch 3"], b: Float[ndarray, "*#batch 3"]) -> Float[ndarray, "*batch 3"]:
    """Return ``np.cross(a, b)`` without its checks, which take longer than the product of a few vectors."""
    a0, a1, a2, b0, b1, b2 = a[..., 0], a[..., 1], a[..., 2], b[..., 0], b[..., 1], b[..., 2]
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], axis=-1)


@kernel("f2 f3")
def _exp_so3(w, out):
    for n in range(len(w)):
        x, y, z = w[n, 0], w[n, 1], w[n, 2]
        squared = x * x + y * y + z * z
        angle = np.sqrt(squared)
        if angle < SMALL_ANGLE_RAD:
            a, b = 1.0 - squared / 6.0, 0.5 - squared / 24.0
        else:
            a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / squared
        _identity_and_powers(x, y, z, a, b, out[n])


@kernel("f2 f3")
def _left_jacobian(w, out):
    for n in range(len(w)):
        x, y, z = w[n, 0], w[n, 1], w[n, 2]
        squared = x * x + y * y + z * z
        angle = np.sqrt(squared)
        a, b = 0.5, 1.0 / 6.0
        if angle >= SMALL_ANGLE_RAD:
            a, b = (1.0 - np.cos(angle)) / squared, (angle - np.sin(angle)) / (squared * angle)
        _identity_and_powers(x, y, z, a, b, out[n])


@kernel()
def _identity_and_powers(x, y, z, a, b, out):
    """Fill in ``I + a W + b W W``, W the cross-product matrix of (x, y, z)."""
    out[0, 0], out[0, 1], out[0, 2] = 1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
    out[1, 0], out[1, 1], out[1, 2] = b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x
    out[2, 0], out[2, 1], out[2, 2] = b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)
