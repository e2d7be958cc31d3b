"""A sequence of TACO's as GeneOH Diffusion holds them."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np

from getagrip.geometry import se3
from getagrip.hands import generic
from helpers.held_ball import FRAMES, ball, motion, synthetic_mano


def write_taco(folder: Path) -> Path:
    """A folder with one sequence: MANO's number of vertices, the translation is the wrist joint."""
    T_cam_hand, T_cam_obj = motion("left")
    model = synthetic_mano("left")
    content = {
        "hand_pose": np.concatenate([se3.log_so3(T_cam_hand[:, :3, :3]), np.zeros((FRAMES, 45))], axis=1),
        "hand_trans": se3.transform(T_cam_hand, generic.load("left").joints[:1])[:, 0],
        "hand_verts": se3.transform(T_cam_hand, model["v_template"]),
        "hand_faces": model["f"].astype(np.int64),
        "obj_pose": T_cam_obj,
    }
    (folder / "a_1.pkl").write_bytes(pickle.dumps(content))
    ball(0.04).export(folder / "a_1.obj")
    return folder
