"""Whose frame stands still while the others move.

Whichever it is, it stands where the camera of the middle frame sees it: the scene of that frame is the same for all,
and one may change between them without losing sight of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.geometry import se3
from getagrip.view.live.column import Column


def _world(column: Column) -> Float[ndarray, "T 4 4"]:
    world = column.view.clip.world
    assert world is not None
    return se3.inverse(world.T_world_cam)


def T_scene_cam(column: Column, still: str) -> Float[ndarray, "T 4 4"]:
    """(T, 4, 4) camera frame of each image to the scene, in which ``still`` does not move [m]."""
    T_cam_still = FRAMES[still](column)
    return np.asarray(T_cam_still[len(T_cam_still) // 2] @ se3.inverse(T_cam_still))


FRAMES: dict[str, Callable[[Column], Float[ndarray, "T 4 4"]]] = {
    "hand": lambda column: column.T_cam_hand,
    "object": lambda column: column.T_cam_obj,
    "camera": lambda column: np.broadcast_to(np.eye(4), column.T_cam_hand.shape),
    "world": _world,
}
"""The pose in the camera frame of what may stand still, by its name."""


def choices(columns: Sequence[Column]) -> tuple[str, ...]:
    """The names of those that all columns know."""
    unknown = {"object"} if not all(column.posed for column in columns) else set()
    unknown |= {"world"} if any(column.view.clip.world is None for column in columns) else set()
    return tuple(name for name in FRAMES if name not in unknown)


def up(column: Column) -> Float[ndarray, "3"]:
    """The direction in the scene that is shown upwards: away from the ground where that is known, else the images'."""
    world = column.view.clip.world
    if world is None or world.up is None:
        return np.array([0.0, -1.0, 0.0])
    return np.asarray(world.T_world_cam[len(world.T_world_cam) // 2, :3, :3].T @ world.up)
