"""A method: the soft hinge, with a term that keeps the object's z axis vertical."""

from dataclasses import dataclass, field

import numpy as np

from getagrip.fitting.energy import PosesInCamera, Quadratic
from getagrip.fitting.methods import Method, OnStage
from getagrip.fitting.methods.all_frames import soft_hinge
from getagrip.fitting.problem import MethodResult, Problem
from getagrip_upright.upright import UP


@dataclass(frozen=True)
class UprightTerm:
    """``weight * |R z - up|^2`` in each frame; nothing where ``up``, one direction or one for each frame, is NaN."""

    weight: float
    name: str = "upright"
    up: np.ndarray = field(default_factory=UP.copy)

    def __call__(self, poses: PosesInCamera, bound: np.ndarray) -> Quadratic:
        axis = poses.R[..., :, 2]
        J = np.zeros((*axis.shape, 7))  # by the local 7-vector: translation, rotation, log scale
        J[..., 3:6] = -np.cross(np.eye(3), axis[..., None, :])  # a rotation w moves the axis by w x axis
        known = np.isfinite(self.up).all(axis=-1)[..., None]
        return Quadratic.of_squares(np.where(known, axis - self.up, 0.0), J * known[..., None], self.weight)


def fit(problem: Problem, on_stage: OnStage) -> MethodResult:
    """The soft hinge with one term more."""
    return soft_hinge(problem, on_stage, more=lambda _: lambda level, frames: [UprightTerm(10.0)])


UPRIGHT = Method("upright", fit, has_axis=True)
