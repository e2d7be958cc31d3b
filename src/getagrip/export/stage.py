"""The stage: a frame that stands still, in metres, z up, as simulators and robots need; and the frame of the palm."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import UsageError
from getagrip.export.scene import Scene
from getagrip.geometry import se3

Z = np.array([0.0, 0.0, 1.0])
"""Up on a stage."""
WRIST_JOINT, INDEX_KNUCKLE_JOINT, MIDDLE_KNUCKLE_JOINT, RING_KNUCKLE_JOINT = 0, 5, 9, 13
"""The wrist, and knuckles, among the 21 joints."""
FINGERTIP_JOINTS = (4, 8, 12, 16, 20)
"""Fingertips, thumb to pinky."""


@dataclass(frozen=True)
class StageFrame:
    """A frame that stands still, z up.

    Attributes:
        T_stage_cam: (T, 4, 4) pose of the camera, camera frame to stage frame [m].
        words: what the frame is, and what of it is a guess.
    """

    T_stage_cam: Float[ndarray, "T 4 4"]
    words: str

    @staticmethod
    def of(scene: Scene) -> StageFrame:
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
        turn = se3.rigid(se3.rotation_between(up / np.linalg.norm(up), Z))
        return StageFrame(np.asarray(turn @ T), f"{words}, turned z up; metres")

    def poses(self, scene: Scene) -> tuple[Float[ndarray, "T 4 4"], Float[ndarray, "T 4 4"]]:
        """Return the (T, 4, 4) poses of the object and of the hand on the stage."""
        return np.asarray(self.T_stage_cam @ scene.T_cam_obj), np.asarray(self.T_stage_cam @ scene.T_cam_hand)


def joints_on_stage(scene: Scene, stage: StageFrame, to: str) -> Float[ndarray, "T 21 3"]:
    """Return the joints, z up [m]. Raises ``UsageError``, in the name of a format, where they are not known."""
    if scene.joints is None:
        raise UsageError(f"missing joints in hand.npz of the clip {scene.name}: --to {to} needs 21")
    return se3.transform(stage.poses(scene)[1], scene.joints)


def palm_orientation(joints: Float[ndarray, "T 21 3"], side: str, across: int) -> Float[ndarray, "T 3 3"]:
    """Return the palm's orientation.

    z points from the wrist to the middle knuckle, y of a right hand to the index finger's side. ``across`` is the
    knuckle from which the index knuckle is seen. A left hand's x and y are turned round.
    """
    z = _normalise(joints[:, MIDDLE_KNUCKLE_JOINT] - joints[:, WRIST_JOINT])
    x = _normalise(np.cross(joints[:, INDEX_KNUCKLE_JOINT] - joints[:, across], z))
    y = np.cross(z, x)
    sign = -1.0 if side == "left" else 1.0
    return np.stack([sign * x, sign * y, z], axis=-1)


def pose7(T: Float[ndarray, "T 4 4"], last: str) -> Float[ndarray, "T 7"]:
    """Return positions [m] and quaternions: first the position, then (w, x, y, z).

    Or (x, y, z, w), then the position.
    """
    q, t = se3.quaternions_in_time(T[:, :3, :3]), T[:, :3, 3]
    return np.concatenate([t, q] if last == "wxyz" else [np.roll(q, -1, axis=1), t], axis=1)


def extra_arrays(scene: Scene) -> dict[str, ndarray]:
    """Return the arrays that the programs pass over: all poses, times and the kinds of the frames' poses."""
    return {
        **scene.poses,
        "time_s": scene.time,
        "frames": np.array(scene.frames, dtype=np.str_),
        "frame_kind": np.array(scene.frame_kind, dtype=np.str_),
    }


def _normalise(v: Float[ndarray, "T 3"]) -> Float[ndarray, "T 3"]:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12))
