"""Frames of the palm that retargeting to robot hands counts on, and what it needs of a scene."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import UsageError
from getagrip.export.scene import Scene
from getagrip.export.stage import Stage
from getagrip.geometry import se3

WRIST, INDEX, MIDDLE, RING = 0, 5, 9, 13
"""The wrist, and knuckles, among the 21 joints."""
TIPS = (4, 8, 12, 16, 20)
"""Fingertips, thumb to pinky."""


def joints_on_stage(scene: Scene, stage: Stage, to: str) -> Float[ndarray, "T 21 3"]:
    """Return the joints, z up [m]. Raises ``UsageError``, in the name of a format, where they are not known."""
    if scene.joints is None:
        raise UsageError(f"missing joints in hand.npz of the clip {scene.name}: --to {to} needs 21")
    return se3.transform(stage.poses(scene)[1], scene.joints)


def palm(joints: Float[ndarray, "T 21 3"], side: str, across: int) -> Float[ndarray, "T 3 3"]:
    """Return the palm's orientation.

    z points from the wrist to the middle knuckle, y of a right hand to the index finger's side. ``across`` is the
    knuckle from which the index knuckle is seen. A left hand's x and y are turned round.
    """
    z = _unit(joints[:, MIDDLE] - joints[:, WRIST])
    x = _unit(np.cross(joints[:, INDEX] - joints[:, across], z))
    y = np.cross(z, x)
    sign = -1.0 if side == "left" else 1.0
    return np.stack([sign * x, sign * y, z], axis=-1)


def pose7(T: Float[ndarray, "T 4 4"], last: str) -> Float[ndarray, "T 7"]:
    """Return positions [m] and quaternions: first the position, then (w, x, y, z).

    Or (x, y, z, w), then the position.
    """
    q, t = se3.quaternions_in_time(T[:, :3, :3]), T[:, :3, 3]
    return np.concatenate([t, q] if last == "wxyz" else [np.roll(q, -1, axis=1), t], axis=1)


def besides(scene: Scene) -> dict[str, ndarray]:
    """Return the arrays that the programs pass over: all poses, times and the kinds of the frames' poses."""
    return {
        **scene.poses,
        "time_s": scene.time,
        "frames": np.array(scene.frames, dtype=np.str_),
        "frame_kind": np.array(scene.frame_kind, dtype=np.str_),
    }


def _unit(v: Float[ndarray, "T 3"]) -> Float[ndarray, "T 3"]:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12))
