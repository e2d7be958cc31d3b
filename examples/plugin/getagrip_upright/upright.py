"""Which way is up."""

import numpy as np

UP = np.array([0.0, -1.0, 0.0])
"""In the camera frame, of a camera that is held level."""


def tilt(R: np.ndarray) -> np.ndarray:
    """Angle [rad] of the object's z axis to the vertical, by rotations (..., 3, 3) to the camera frame."""
    return np.arccos(np.clip(R[..., :, 2] @ UP, -1.0, 1.0))
