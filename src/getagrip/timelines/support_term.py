"""The plane that a static object lies on: its lowest point is at the plane's height."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.fitting.energy import PosesInCamera, Quadratic
from getagrip.geometry import se3


@dataclass(frozen=True)
class SupportTerm:
    """``weight * h^2 / (1 + h^2 / far^2)`` in each frame, h the height of the lowest vertex over the plane.

    An object may lie on something else that lies on the plane: beyond ``far``, more height costs little more.
    """

    vertices: Float[ndarray, "V 3"]
    """Vertices of the object about its centre, unscaled [m]; those of the convex hull are enough."""
    normal: Float[ndarray, "N 3"]
    """Up, in the camera frame."""
    height: Float[ndarray, "N"]
    """Height of the plane along it, from the camera [m]."""
    weight: float
    """Energy per square metre [px^2 / m^2]."""
    far: float = 0.02
    """[m]."""
    name: str = "support"

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        scale = poses.scale[:, None, None]
        up = np.broadcast_to(self.normal, poses.centre.shape)
        along = scale * (np.swapaxes(poses.R, -1, -2) @ up[..., None])[..., 0] @ self.vertices.T
        lowest = np.argmin(along, axis=-1)
        arm = scale * (poses.R @ self.vertices[lowest][..., None])[..., 0]
        h = np.sum((poses.centre + arm) * up, axis=-1) - self.height
        shape = 1.0 / (1.0 + (h / self.far) ** 2)
        J = np.concatenate([up, np.cross(arm, up), np.sum(arm * up, axis=-1, keepdims=True)], axis=-1)
        slope = 2.0 * self.weight * shape**2 * h
        H = 2.0 * self.weight * (shape**2)[..., None, None] * (J[..., :, None] * J[..., None, :])
        return Quadratic(self.weight * shape * h**2, slope[..., None] * J, H)


def hull_vertices(vertices: Float[ndarray, "V 3"]) -> Float[ndarray, "n 3"]:
    """Return the vertices that can be the lowest."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return np.asarray(vertices[ConvexHull(vertices).vertices])
    except QhullError:  # a flat mesh
        return vertices


def plane_in_camera(
    T_world_cam: Float[ndarray, "N 4 4"], up: Float[ndarray, "3"], support: float
) -> tuple[Float[ndarray, "N 3"], Float[ndarray, "N"]]:
    """Return normal and height of the world's plane in the camera frame."""
    normal = (se3.inverse(T_world_cam)[:, :3, :3] @ up[:, None])[..., 0]
    return normal, support - T_world_cam[:, :3, 3] @ up
