"""Rigid motions, and the package's conventions for them.

- ``T_a_b`` is a 4x4 matrix that maps points of frame b into frame a (column vectors): ``X_a = T_a_b @ X_b``. Adjacent
  names cancel: ``T_cam_hand @ T_hand_obj``.
- Rotation vectors are axis times angle [rad]; quaternions are (w, x, y, z).
- A local 7-vector of a posed object is ``(v, w, l)``: the point X moves by ``v + w x (X - c) + l (X - c)``, with c
  the object's centre: translation [m], rotation about the centre [rad], log scale with the centre fixed, in that order.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

_MIN_QUATERNION_NORM = 1e-8


def hat(w: Float[ndarray, "*batch 3"]) -> Float[ndarray, "*batch 3 3"]:
    """Return the cross-product matrix: ``hat(w) @ x == cross(w, x)``."""
    out = np.zeros((*w.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2] = -w[..., 2], w[..., 1]
    out[..., 1, 0], out[..., 1, 2] = w[..., 2], -w[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -w[..., 1], w[..., 0]
    return out


def exp_so3(w: Float[ndarray, "*batch 3"]) -> Float[ndarray, "*batch 3 3"]:
    """Return the rotation matrix of a rotation vector [rad] (Rodrigues' formula)."""
    theta = np.sqrt(np.add.reduce(w * w, axis=-1))[..., None, None]
    small = theta < 1e-4
    safe = np.where(small, 1.0, theta)
    a, b = np.sin(safe) / safe, (1.0 - np.cos(safe)) / safe**2
    if small.any():
        a = np.where(small, 1.0 - theta**2 / 6.0, a)
        b = np.where(small, 0.5 - theta**2 / 24.0, b)
    W = hat(w)
    return np.eye(3) + a * W + b * (W @ W)


def log_so3(R: Float[ndarray, "*batch 3 3"]) -> Float[ndarray, "*batch 3"]:
    """Return the rotation vector [rad], of angle in [0, pi], of a rotation matrix; exact at 0 and at pi as well."""
    q = quaternion(R)
    vec = q[..., 1:]
    norm = np.linalg.norm(vec, axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(norm, q[..., :1])
    safe = np.where(norm < _MIN_QUATERNION_NORM, 1.0, norm)
    return np.where(norm < _MIN_QUATERNION_NORM, 2.0 * vec, angle * vec / safe)


def left_jacobian(w: Float[ndarray, "*batch 3"]) -> Float[ndarray, "*batch 3 3"]:
    """Return the left Jacobian of SO(3): ``exp(w + dw) = exp(left_jacobian(w) @ dw) exp(w)`` to first order."""
    theta = np.linalg.norm(w, axis=-1)[..., None, None]
    small = theta < 1e-4
    safe = np.where(small, 1.0, theta)
    a = np.where(small, 0.5, (1.0 - np.cos(safe)) / safe**2)
    b = np.where(small, 1.0 / 6.0, (safe - np.sin(safe)) / safe**3)
    W = hat(w)
    return np.eye(3) + a * W + b * (W @ W)


def right_jacobian(w: Float[ndarray, "*batch 3"]) -> Float[ndarray, "*batch 3 3"]:
    """Return the right Jacobian of SO(3): ``exp(w + dw) = exp(w) exp(right_jacobian(w) @ dw)`` to first order."""
    return left_jacobian(-w)


def quaternion(R: Float[ndarray, "*batch 3 3"]) -> Float[ndarray, "*batch 4"]:
    """Convert a rotation matrix to a unit quaternion (w, x, y, z), w >= 0 (Shepperd's method)."""
    m = np.moveaxis(R.reshape(*R.shape[:-2], 9), -1, 0)
    xx, xy, xz, yx, yy, yz, zx, zy, zz = m
    candidates = np.stack(
        [
            np.stack([1 + xx + yy + zz, zy - yz, xz - zx, yx - xy], -1),
            np.stack([zy - yz, 1 + xx - yy - zz, xy + yx, xz + zx], -1),
            np.stack([xz - zx, xy + yx, 1 - xx + yy - zz, yz + zy], -1),
            np.stack([yx - xy, xz + zx, yz + zy, 1 - xx - yy + zz], -1),
        ],
        axis=-2,
    )
    best = np.argmax(np.stack([xx + yy + zz, xx - yy - zz, yy - xx - zz, zz - xx - yy], -1), axis=-1)
    q = np.take_along_axis(candidates, best[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(q[..., :1] < 0, -q, q)


def quaternions_in_time(R: Float[ndarray, "T 3 3"]) -> Float[ndarray, "T 4"]:
    """Return quaternions (w, x, y, z) with signs such that each is nearest to the previous one, for interpolation."""
    q = quaternion(R)
    q[1:] *= np.cumprod(np.where(np.sum(q[1:] * q[:-1], axis=1) < 0.0, -1.0, 1.0))[:, None]
    return q


def rotation_between(a: Float[ndarray, "*#batch 3"], b: Float[ndarray, "*#batch 3"]) -> Float[ndarray, "*batch 3 3"]:
    """Return the smallest rotation that takes the unit vector a to the unit vector b."""
    a, b = np.broadcast_arrays(a, b)
    cosine = np.sum(a * b, axis=-1)
    W = hat(np.cross(a, b))
    opposite = cosine < -1.0 + 1e-9
    R = np.eye(3) + W + W @ W / np.where(opposite, 1.0, 1.0 + cosine)[..., None, None]
    side = np.eye(3)[np.argmin(np.abs(a), axis=-1)]  # half a turn about any line across
    across = side - np.sum(side * a, axis=-1, keepdims=True) * a
    across = across / np.linalg.norm(across, axis=-1, keepdims=True)
    half = 2.0 * across[..., :, None] * across[..., None, :] - np.eye(3)
    return np.where(opposite[..., None, None], half, R)


def from_quaternion(q: Float[ndarray, "*batch 4"]) -> Float[ndarray, "*batch 3 3"]:
    """Return the rotation matrix of a quaternion (w, x, y, z); the quaternion need not have unit length."""
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    W = hat(q[..., 1:])
    return np.eye(3) + 2.0 * (q[..., 0, None, None] * W + W @ W)


def rigid(
    R: Float[ndarray, "*#batch 3 3"] | None = None, t: Float[ndarray, "*#batch 3"] | None = None
) -> Float[ndarray, "*batch 4 4"]:
    """Return the 4x4 matrix of a rotation (default: identity) and a translation (default: zero)."""
    R = np.eye(3) if R is None else R
    t = np.zeros(3) if t is None else t
    batch = np.broadcast_shapes(R.shape[:-2], t.shape[:-1])
    T = np.zeros((*batch, 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, t, 1.0
    return T


def inverse(T: Float[ndarray, "*batch 4 4"]) -> Float[ndarray, "*batch 4 4"]:
    """Return the inverse of rigid motions; other matrices give wrong results."""
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    return rigid(Rt, -(Rt @ T[..., :3, 3, None])[..., 0])


def transform(
    T: Float[ndarray, "*#batch 4 4"], X: Float[ndarray, "*#batch points 3"]
) -> Float[ndarray, "*batch points 3"]:
    """Transform points X of frame b to frame a, for ``T = T_a_b``."""
    return X @ np.swapaxes(T[..., :3, :3], -1, -2) + T[..., None, :3, 3]


def rotation_about_line(
    point: Float[ndarray, "*#batch 3"], direction: Float[ndarray, "*#batch 3"], angle: Float[ndarray, "*#batch"]
) -> Float[ndarray, "*batch 4 4"]:
    """Turn by ``angle`` [rad] about the line through ``point`` [m] along the unit vector ``direction``."""
    R = exp_so3(direction * angle[..., None])
    return rigid(R, point - (R @ point[..., None])[..., 0])


def is_rigid(T: Float[ndarray, "*batch 4 4"], tolerance: float = 1e-3) -> Bool[ndarray, "*batch"]:
    """Return whether each 4x4 matrix is a rotation and a translation (no scale, no mirror), within ``tolerance``."""
    R = T[..., :3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        orthogonal = np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max(axis=(-1, -2)) < tolerance
        bottom = np.abs(T[..., 3, :] - np.array([0.0, 0.0, 0.0, 1.0])).max(axis=-1) < tolerance
        return np.asarray(orthogonal & bottom & (np.linalg.det(R) > 0))


def nearest_rotation(M: Float[ndarray, "*batch 3 3"]) -> Float[ndarray, "*batch 3 3"]:
    """Return the rotation matrix nearest to M in the Frobenius norm."""
    U, _, Vt = np.linalg.svd(M)
    U = U.copy()
    U[..., :, 2] *= np.sign(np.linalg.det(U @ Vt))[..., None]
    return U @ Vt


def angle_between(Ra: Float[ndarray, "*#batch 3 3"], Rb: Float[ndarray, "*#batch 3 3"]) -> Float[ndarray, "*batch"]:
    """Return the angle [rad] of the rotation that takes one rotation matrix to the other."""
    return np.asarray(np.linalg.norm(log_so3(np.swapaxes(Ra, -1, -2) @ Rb), axis=-1))


def super_fibonacci(n: int) -> Float[ndarray, "n 3 3"]:
    """Return n rotations (n, 3, 3), nearly uniform over SO(3) (Alexa, "Super-Fibonacci Spirals", CVPR 2022)."""
    phi, psi = np.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(n) + 0.5
    t = s / n
    alpha, beta = 2.0 * np.pi * s / phi, 2.0 * np.pi * s / psi
    r, R = np.sqrt(t), np.sqrt(1.0 - t)
    return from_quaternion(np.stack([R * np.cos(beta), r * np.sin(alpha), r * np.cos(alpha), R * np.sin(beta)], -1))
