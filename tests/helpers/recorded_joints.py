"""A recording of joints: two hands, one carries a box whose lid turns, in a world where z is up. Known answers."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from getagrip.geometry import se3
from getagrip.hands import generic
from getagrip.hands.model import Side
from helpers.held_ball import AT, bent

FRAMES, TAKEN, OPENED = 70, 10, 45
"""The box is taken in frame 10; from frame 45 on its lid is at another angle."""
BOTTOM, LID = (0.07, 0.05, 0.05), (0.07, 0.012, 0.05)


@dataclass(frozen=True)
class Recording:
    """In the world frame [m]; joints in this package's order."""

    joints: dict[Side, np.ndarray]
    T_world_obj: np.ndarray
    angle: np.ndarray
    T_world_hand: np.ndarray
    """Of the hand that holds the box."""


def recording(holder: Side = "right") -> Recording:
    """The hand turns the box about itself a little, and moves it about."""
    t = np.linspace(0.0, 1.0, FRAMES)
    turn = se3.exp_so3(np.stack([0.4 * t - 0.8, 0.5 * t, 0.2 * t], axis=-1))
    T_world_hand = se3.rigid(turn, np.stack([0.1 * t, 0.05 * t, 1.0 + 0.1 * t], axis=-1))
    at = AT if holder == "right" else AT * [-1.0, 1.0, 1.0]
    T_hand_obj = np.tile(se3.rigid(None, at), (FRAMES, 1, 1))
    T_hand_obj[:TAKEN, 1, 3] -= 0.15
    aside = se3.rigid(None, np.array([0.0, 0.0, -0.4]))
    joints: dict[Side, np.ndarray] = {}
    for side in ("left", "right"):
        hand = generic.load(side).with_shape().with_pose(bent(side))
        joints[side] = se3.transform(T_world_hand if side == holder else aside @ T_world_hand, hand.joints)
    angle = np.where(np.arange(FRAMES) < OPENED, 0.02, 0.5)
    return Recording(joints, T_world_hand @ T_hand_obj, angle, T_world_hand)


def write_parts(bottom: Path, lid: Path) -> None:
    """The meshes of the box and of its lid, with as few vertices as boxes have."""
    trimesh.creation.box(BOTTOM).export(bottom)
    above = se3.rigid(None, np.array([0.0, -0.5 * (BOTTOM[1] + LID[1]) - 0.001, 0.0]))
    trimesh.creation.box(LID, transform=above).export(lid)
