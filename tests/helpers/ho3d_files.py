"""HO-3D's folder with two sequences, of known poses."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np

from getagrip.geometry import se3
from getagrip.hands import generic
from getagrip.hands.fit_joints import JOINT_ORDERS
from getagrip.hands.mano import load
from helpers.held_ball import BETAS, FRAMES, ball, bent, global_motion, motion

HELD = "025_mug"
LOST = 29
"""In this frame nothing is known."""
K = np.array([[614.6, 0.0, 320.1], [0.0, 614.5, 241.4], [0.0, 0.0, 1.0]])
FLIP = np.diag([1.0, -1.0, -1.0])


def save(path: Path, content: Any) -> None:
    """As HO-3D's files are: a pickle of Python 2."""
    path.write_bytes(pickle.dumps(content, protocol=2).replace(b"cnumpy._core.", b"cnumpy.core."))


def write_ho3d(folder: Path, mano: Path) -> Path:
    """HO-3D's folder, with one sequence of the train split and one of the evaluation split."""
    root = folder / "HO3D"
    T_cam_hand, T_cam_obj = motion()
    joints = se3.transform(T_cam_hand, generic.load("right").with_shape().with_pose(bent()).joints)
    hand = load(mano / "MANO_RIGHT.pkl", "right")
    F = se3.rigid(FLIP)
    rot, trans = global_motion(F @ T_cam_hand, hand.model.with_shape(BETAS).joints[0])
    T_gl_obj = F @ T_cam_obj
    for split, sequence in (("train", "ABF12"), ("evaluation", "SM1")):
        meta = root / split / sequence / "meta"
        meta.mkdir(parents=True)
        for n in range(FRAMES):
            in_order = np.empty((21, 3))
            in_order[JOINT_ORDERS["ho3d"]] = joints[n]
            content: dict[str, Any] = {
                "objRot": se3.log_so3(T_gl_obj[n, :3, :3]).reshape(3, 1),
                "objTrans": T_gl_obj[n, :3, 3],
                "objName": HELD,
                "objLabel": 1,
                "objCorners3DRest": np.zeros((8, 3)),
                "camMat": K,
                "camIDList": ["0", "1"],
            }
            if split == "train":
                content |= {
                    "handPose": np.concatenate([rot[n], bent()]),
                    "handTrans": trans[n],
                    "handBeta": BETAS,
                    "handJoints3D": in_order @ FLIP,
                }
            else:
                content |= {"handJoints3D": joints[n, 0] @ FLIP, "handBoundingBox": [0, 0, 100, 100]}
            if n == LOST:
                content |= dict.fromkeys(("objRot", "objTrans", "handPose", "handTrans", "handJoints3D"))
            save(meta / f"{n:04d}.pkl", content)
    (root / "models" / HELD).mkdir(parents=True)
    ball(0.03).export(root / "models" / HELD / "textured_simple.obj")
    return root
