"""HOI4D's folder with one sequence, of known poses."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from helpers.held_ball import (
    BETAS,
    FRAMES,
    ball,
    bent,
    global_motion,
    motion,
    posed,
)

INDEX = "ZY20210800001/H1/C5/N11/S125/s03/T1"
NAME = f"H1--{INDEX.replace('/', '-')}--Bottle--right"
K = np.array([[1000.0, 0.0, 959.5], [0.0, 1010.0, 539.5], [0.0, 0.0, 1.0]])
RED, GREEN, BROWN = (128, 0, 0), (0, 128, 0), (128, 128, 0)


def write_hoi4d(folder: Path, mano: Path) -> Path:
    """HOI4D's folder, with one sequence, of the right hand."""
    root = folder / "HOI4D"
    T_cam_hand, T_cam_obj = motion()
    notes = root / "HOI4D_annotations" / INDEX
    (notes / "objpose").mkdir(parents=True)
    hands = root / "handpose" / "refinehandpose_right" / INDEX
    hands.mkdir(parents=True)
    _, at_rest = posed(mano, "right")
    rot, trans = global_motion(T_cam_hand, at_rest.joints[0])
    for n in range(FRAMES):
        angles = Rotation.from_matrix(T_cam_obj[n, :3, :3]).as_euler("XYZ")
        entry = {
            "label": "bottle",
            "center": dict(zip("xyz", T_cam_obj[n, :3, 3].tolist(), strict=True)),
            "rotation": dict(zip("xyz", angles.tolist(), strict=True)),
            "dimensions": {"length": 0.06, "width": 0.06, "height": 0.07},
        }
        key = "dataList" if n % 2 else "objects"  # both occur
        (notes / "objpose" / f"{n}.json").write_text(json.dumps({"info": "x", key: [entry, {}]}))
        hand = {
            "poseCoeff": np.concatenate([rot[n], bent()]).astype(np.float32),
            "beta": BETAS.astype(np.float32),
            "trans": trans[n].astype(np.float32),
            "kps2D": np.zeros((21, 2)),
        }
        (hands / f"{n}.pickle").write_bytes(pickle.dumps(hand, protocol=3))
    cads = root / "HOI4D_CAD_Model_for_release" / "rigid" / "Bottle"
    cads.mkdir(parents=True)
    ball(0.03).export(cads / "011.obj")
    camera = root / "camera_params" / "ZY20210800001"
    camera.mkdir(parents=True)
    np.save(camera / "intrin.npy", K)
    return root


def write_labels(root: Path, kind: str = "mask") -> None:
    """Labels of three rectangles: the object, the right hand, another object."""
    folder = root / "HOI4D_annotations" / INDEX / "2Dseg" / kind
    folder.mkdir(parents=True)
    image = np.zeros((1080, 1920, 3), np.uint8)
    image[100:201, 300:400] = RED
    image[300:400, 300:400] = GREEN
    image[500:600, 300:401] = BROWN
    content = cv2.imencode(".png", image[..., ::-1])[1].tobytes()
    for n in range(FRAMES):
        (folder / f"{n:05d}.png").write_bytes(content)
