"""A sequence of TACO's as GeneOH Diffusion holds them."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np

from getagrip.geometry import se3
from getagrip.hands import generic
from getagrip.hands.mano import FINGERTIP_VERTICES
from helpers.held_ball import FRAMES, ball, motion


def write_taco(folder: Path) -> Path:
    """A folder with one sequence: MANO's number of vertices, the translation is the wrist joint; its fingers bend."""
    folder.mkdir(parents=True, exist_ok=True)
    T_cam_hand, T_cam_obj = motion("left")
    hand, rng = generic.load("left"), np.random.default_rng(0)
    pose = rng.normal(scale=0.12, size=(FRAMES, 15, 3))
    pose[..., 2] -= rng.uniform(0.0, 1.0, (FRAMES, 15))
    posed = hand.with_shape().with_pose(pose.reshape(FRAMES, 45))
    which = rng.permutation(len(hand.template))[:778]
    which[list(FINGERTIP_VERTICES["left"])] = hand.tips
    content = {
        "hand_pose": np.concatenate([se3.log_so3(T_cam_hand[:, :3, :3]), pose.reshape(FRAMES, 45)], axis=1),
        "hand_trans": se3.transform(T_cam_hand, hand.joints[:1])[:, 0],
        "hand_verts": se3.transform(T_cam_hand, posed.vertices[:, which]),
        "obj_pose": T_cam_obj,
    }
    (folder / "a_1.pkl").write_bytes(pickle.dumps(content))
    ball(0.04).export(folder / "a_1.obj")
    return folder
