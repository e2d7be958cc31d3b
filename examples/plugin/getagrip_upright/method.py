"""A method: the soft hinge, with a term that keeps the object's z axis vertical."""

from dataclasses import dataclass

import numpy as np

from getagrip.fitting.energy import PosesInCamera, Quadratic
from getagrip.fitting.methods import Method, OnStage
from getagrip.fitting.methods.all_frames import soft_hinge
from getagrip.fitting.problem import MethodResult, Problem
from getagrip_upright.upright import UP


@dataclass(frozen=True)
class UprightTerm:
    """``weight * |R z - up|^2`` in each frame."""

    weight: float
    name: str = "upright"

    def __call__(self, poses: PosesInCamera, bound: np.ndarray) -> Quadratic:
        axis = poses.R[..., :, 2]
        J = np.zeros((*axis.shape, 7))  # by the local 7-vector: translation, rotation, log scale
        J[..., 3:6] = -np.cross(np.eye(3), axis[..., None, :])  # a rotation w moves the axis by w x axis
        return Quadratic.of_squares(axis - UP, J, self.weight)


def fit(problem: Problem, on_stage: OnStage) -> MethodResult:
    """The soft hinge with one term more."""
    return soft_hinge(problem, on_stage, more=lambda level, frames: [UprightTerm(10.0)])


UPRIGHT = Method("upright", fit, has_axis=True)
