"""Which way is up, and what keeps an object's axis."""

from dataclasses import dataclass

import numpy as np

from getagrip.fitting.energy import PosesInCamera, Quadratic

UP = np.array([0.0, -1.0, 0.0])
"""In the camera frame, of a camera that is held level."""


def tilt(R: np.ndarray) -> np.ndarray:
    """Angle [rad] of the object's z axis to the vertical, by rotations (..., 3, 3) to the camera frame."""
    return np.arccos(np.clip(R[..., :, 2] @ UP, -1.0, 1.0))


@dataclass(frozen=True)
class AxisTerm:
    """``weight * |R z - axis|^2`` in each frame, with the axis (3,), or (N, 3), in the camera frame."""

    name: str
    axis: np.ndarray
    weight: float

    def __call__(self, poses: PosesInCamera, bound: np.ndarray) -> Quadratic:
        z = poses.R[..., :, 2]
        J = np.zeros((*z.shape, 7))  # by the local 7-vector: translation, rotation, log scale
        J[..., 3:6] = -np.cross(np.eye(3), z[..., None, :])  # a rotation w moves the axis by w x axis
        return Quadratic.of_squares(z - self.axis, J, self.weight)
