"""An energy term of your own: here, that the object's z axis has a direction that a sensor has measured.

    python examples/06_own_energy_term.py

reconstructs a synthetic plate without and with it, and prints how far the axis is from the ground truth, on average.
"""

from dataclasses import dataclass

import numpy as np

import getagrip
from getagrip.fitting.energy import Energy, PosesInCamera, Quadratic
from getagrip.fitting.methods import METHODS, Method, OnStage
from getagrip.fitting.methods.all_frames import soft_hinge
from getagrip.fitting.problem import MethodResult, Problem


@dataclass(frozen=True)
class AxisTerm:
    """``weight * |R_n z - measured_n|^2`` for each frame n, in the camera frame."""

    measured: np.ndarray
    weight: float
    name: str = "axis"

    def __call__(self, poses: PosesInCamera, bound: np.ndarray) -> Quadratic:
        axis = poses.R @ np.array([0.0, 0.0, 1.0])
        J = np.zeros((*axis.shape, 7))  # by the local 7-vector: translation, rotation, log scale
        J[..., 3:6] = -np.cross(np.eye(3), axis[..., None, :])  # a rotation w moves the axis by w x axis
        return Quadratic.of_squares(axis - self.measured, J, self.weight)


def sensor(problem: Problem) -> Energy:
    """The term in the frames of a problem. The sensor is the ground truth, 2 degrees off."""
    axis = problem.clip.truth.T_cam_obj[:, :3, 2] + np.random.default_rng(0).normal(0.0, np.radians(2.0), 3)
    return lambda level, frames: [AxisTerm(axis[frames], 3e4)]


def measured_soft_hinge(problem: Problem, on_stage: OnStage) -> MethodResult:
    """The soft hinge with one term more, in every frame."""
    return soft_hinge(problem, on_stage, more=sensor)


if __name__ == "__main__":
    METHODS["measured"] = Method("soft hinge with a sensor", measured_soft_hinge, has_axis=True)
    clip, masks = getagrip.synthesise("plate", seed=3)
    for name in ("soft-hinge", "measured"):
        result = getagrip.reconstruct(clip, masks, getagrip.Options(method=name))
        z = (clip.with_hand_at(result.T_cam_hand).hand.T_cam_hand @ result.T_hand_obj)[:, :3, 2]
        off = np.degrees(np.arccos(np.clip(np.sum(z * clip.truth.T_cam_obj[:, :3, 2], axis=1), -1.0, 1.0)))
        print(f"{METHODS[name].label}: axis {off.mean():.1f} degrees off, mask IOU {result.iou.mean():.3f}")
