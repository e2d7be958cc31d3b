"""Errors of the object's pose in the hand or in the camera: ADD, rotation and translation, up to its symmetries."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.metrics.symmetry import Symmetries

ADD_SUCCESS_FRACTION = 0.1
"""A pose is right when its ADD is below this share of the true object's diameter."""
N_AXIS_ANGLES = 36
"""Sampled angles about a continuous axis; the best one is then refined."""
N_BALL_ROTATIONS = 500
"""Sampled rotations of a ball."""
N_SYMMETRY_VERTICES = 500
"""Vertices that choose among symmetries; all of them count in the error that is reported."""


@dataclass(frozen=True)
class ObjectTrack:
    """Poses of an object, predicted or true, and its scale.

    Attributes:
        T_ref_obj: (T, 4, 4) in a frame of reference, the hand's or the camera's: tracks are compared in the same one.
        scale: of the object.
    """

    T_ref_obj: Float[ndarray, "T 4 4"]
    scale: float

    def placed(self, points: Float[ndarray, "P 3"]) -> Float[ndarray, "T P 3"]:
        """Return points of the object's own frame in the frame of reference [m]."""
        return np.asarray(se3.transform(self.T_ref_obj, self.scale * points))


@dataclass(frozen=True)
class PoseErrors:
    """Errors of each frame.

    Attributes:
        add: (T,) mean distance between corresponding vertices, each object at its own scale [m].
        rotation: (T,) angle between the rotations [rad].
        translation: (T,) distance between the objects' centres (middles of the bounding box) [m].
        diameter: of the true object, at its true scale [m].
    """

    add: Float[ndarray, "T"]
    rotation: Float[ndarray, "T"]
    translation: Float[ndarray, "T"]
    diameter: float

    @property
    def frame_success(self) -> Float[ndarray, "T"]:
        """1 in frames whose own ADD is below 10 % of the diameter, 0 in the others."""
        return (self.add < ADD_SUCCESS_FRACTION * self.diameter).astype(float)

    @property
    def success(self) -> bool:
        """The paper's ADD: mean over vertices and frames below 10 % of the diameter."""
        return bool(self.add.mean() < ADD_SUCCESS_FRACTION * self.diameter)


def pose_errors(
    mesh: Mesh, predicted: ObjectTrack, true: ObjectTrack, symmetry: Float[ndarray, "4 4"] | None = None
) -> PoseErrors:
    """Compute the errors of a prediction.

    ``symmetry``, a map of the unscaled object onto itself, applies to the true one.
    """
    S = np.eye(4) if symmetry is None else symmetry
    A, b = _displacement_map(predicted, true, S)
    add = np.stack([np.linalg.norm(mesh.vertices @ M.T + c, axis=1).mean() for M, c in zip(A, b, strict=True)])
    return PoseErrors(
        add=add,
        rotation=se3.angle_between(predicted.T_ref_obj[:, :3, :3], true.T_ref_obj[:, :3, :3] @ S[:3, :3]),
        translation=np.linalg.norm(A @ mesh.centre + b, axis=1),
        diameter=mesh.diameter * true.scale,
    )


def best_symmetry(
    mesh: Mesh, predicted: ObjectTrack, true: ObjectTrack, symmetries: Symmetries
) -> Float[ndarray, "4 4"]:
    """Return the symmetry with the smallest ADD over the whole sequence: one for all frames, as in BOP and HOT3D.

    Continuous rotations are sampled (36 angles; 500 rotations of a ball) and the best sample is refined by a simplex
    search, so that sampling adds no error.
    """
    vertices = mesh.vertices[:: max(1, len(mesh.vertices) // N_SYMMETRY_VERTICES)]

    def cost(S: Float[ndarray, "4 4"]) -> float:
        A, b = _displacement_map(predicted, true, S)
        return float(np.linalg.norm(vertices @ np.swapaxes(A, 1, 2) + b[:, None], axis=2).mean())

    free = len(symmetries.axes)
    if free == 0:
        angles = np.zeros((1, 0))
    elif free == 1:
        angles = np.arange(N_AXIS_ANGLES)[:, None] * 2.0 * np.pi / N_AXIS_ANGLES
    else:
        angles = se3.log_so3(se3.super_fibonacci(N_BALL_ROTATIONS))
    rotations = symmetries.about(angles)
    samples = [(cost(rotation @ S), k, S) for k, rotation in enumerate(rotations) for S in symmetries.elements]
    _, k, S = min(samples, key=lambda sample: sample[0])
    if free == 0:
        return S
    from scipy.optimize import minimize

    start = angles[k] + np.vstack([np.zeros(free), np.radians(8.0) * np.eye(free)])
    options = {"initial_simplex": start, "xatol": 1e-6, "fatol": 1e-9}
    found = minimize(lambda x: cost(symmetries.about(x) @ S), angles[k], method="Nelder-Mead", options=options)
    return symmetries.about(found.x) @ S


def _displacement_map(
    predicted: ObjectTrack, true: ObjectTrack, S: Float[ndarray, "4 4"]
) -> tuple[Float[ndarray, "T 3 3"], Float[ndarray, "T 3"]]:
    """Return (A, b) with A x + b the displacement [m], in the frame of reference, of the unscaled object point x."""
    P, Q = predicted.T_ref_obj, true.T_ref_obj
    A = predicted.scale * P[:, :3, :3] - true.scale * Q[:, :3, :3] @ S[:3, :3]
    return A, P[:, :3, 3] - Q[:, :3, 3] - true.scale * Q[:, :3, :3] @ S[:3, 3]
