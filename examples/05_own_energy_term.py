"""An energy term of your own: here, that the object's z axis stays level, as a full plate's does.

    python examples/05_own_energy_term.py

reconstructs a synthetic plate without and with it, and prints how far from level the plate is, on average.
"""

from dataclasses import dataclass

import numpy as np

import getagrip
from getagrip.fitting.energy import PosesInCamera, Quadratic
from getagrip.fitting.methods import METHODS, Method, OnStage
from getagrip.fitting.methods.all_frames import soft_hinge
from getagrip.fitting.problem import MethodResult, Problem


@dataclass(frozen=True)
class LevelTerm:
    """``weight * |R z - up|^2`` in the camera frame, ``up`` the direction that the plate's axis is to keep."""

    up: np.ndarray
    weight: float
    name: str = "level"

    def __call__(self, poses: PosesInCamera, bound: np.ndarray) -> Quadratic:
        axis = poses.R @ np.array([0.0, 0.0, 1.0])
        J = np.zeros((*axis.shape, 7))  # by the local 7-vector: translation, rotation, log scale
        J[..., 3:6] = -np.cross(np.eye(3), axis[..., None, :])  # a rotation w moves the axis by w x axis
        return Quadratic.of_squares(axis - self.up, J, self.weight)


UP = np.array([0.0, -1.0, 0.0])  # the camera is level: its y axis points down


def level_soft_hinge(problem: Problem, on_stage: OnStage) -> MethodResult:
    """The soft hinge with one term more."""
    return soft_hinge(problem, on_stage, more=lambda level, frames: [LevelTerm(UP, 3e4)])


if __name__ == "__main__":
    METHODS["level"] = Method("Level soft hinge", level_soft_hinge, has_axis=True)
    clip, masks = getagrip.synthesise("plate", seed=3)
    for name in ("soft-hinge", "level"):
        result = getagrip.reconstruct(clip, masks, getagrip.Options(method=name))
        z = (clip.with_hand_at(result.T_cam_hand).hand.T_cam_hand @ result.T_hand_obj)[:, :3, 2]
        off = np.degrees(np.arccos(np.clip(z @ UP, -1.0, 1.0)))
        print(f"{METHODS[name].label}: axis {off.mean():.1f} degrees off, mask IOU {result.iou.mean():.3f}")
