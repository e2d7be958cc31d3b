"""The stage: a frame that stands still, in metres, z up, as simulators and robots need."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.export.scene import Scene
from getagrip.geometry import se3

Z = np.array([0.0, 0.0, 1.0])
"""Up on a stage."""


@dataclass(frozen=True)
class Stage:
    """A frame that stands still, z up.

    Attributes:
        T_stage_cam: (T, 4, 4) pose of the camera, camera frame to stage frame [m].
        words: what the frame is, and what of it is a guess.
    """

    T_stage_cam: Float[ndarray, "T 4 4"]
    words: str

    @staticmethod
    def of(scene: Scene) -> Stage:
        """Make the stage: the world frame turned z up.

        Without a world the camera is taken to stand still, without up to be level.
        """
        up = None if scene.world is None else scene.world.up
        if scene.world is None:
            T = np.tile(np.eye(4), (len(scene.frames), 1, 1))
            words = "the camera's own frame, the camera taken to stand still and to be level (a guess)"
        elif up is None:
            T = scene.world.T_world_cam
            words = "the clip's world, the camera taken to be level in the first frame (a guess)"
        else:
            T, words = scene.world.T_world_cam, "the clip's world"
        if up is None:
            up = -T[0, :3, 1]
        turn = se3.rigid(se3.between(up / np.linalg.norm(up), Z))
        return Stage(np.asarray(turn @ T), f"{words}, turned z up; metres")

    def poses(self, scene: Scene) -> tuple[Float[ndarray, "T 4 4"], Float[ndarray, "T 4 4"]]:
        """Return the (T, 4, 4) poses of the object and of the hand on the stage."""
        return np.asarray(self.T_stage_cam @ scene.T_cam_obj), np.asarray(self.T_stage_cam @ scene.T_cam_hand)
