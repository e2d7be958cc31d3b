"""A hand that takes a ball and carries it, and a synthetic MANO of the published layout: known answers for readers."""

from __future__ import annotations

import pickle
from functools import cache
from pathlib import Path
from typing import Any

import fast_simplification
import numpy as np
import trimesh
from scipy.spatial import cKDTree

from getagrip.geometry import se3
from getagrip.hands import generic
from getagrip.hands.mano import Mano, load
from getagrip.hands.model import PARENTS, PosedHand, Side, mirrored, mirrored_pose

FRAMES, TAKEN = 32, 5
"""The ball is taken in frame 5."""
AT = np.array([0.01, -0.045, 0.005])
"""Where its centre is in a right hand."""
SIDES: tuple[Side, ...] = ("left", "right")
BETAS = np.linspace(-1.0, 1.0, 10)


@cache
def synthetic_mano(side: Side) -> dict[str, Any]:
    """The generic hand with fewer vertices, and a synthetic shape space: that of the left hand has MANO's fault.

    Nothing may be changed in it.
    """
    rng = np.random.default_rng(0)
    hand = generic.load("right")
    v, f = fast_simplification.simplify(
        hand.template.astype(np.float32), hand.faces.astype(np.int32), target_count=1538
    )
    v = np.vstack([v, np.tile(v[:1], (778 - len(v), 1))]).astype(float)
    weights = hand.weights[cKDTree(hand.template).query(v)[1]]
    joints = np.linalg.lstsq(np.vstack([v.T, np.ones(778)]), np.vstack([hand.joints.T, np.ones(16)]), rcond=None)[0]
    if side == "left":
        v, f = mirrored(v), f[:, ::-1]
    return {
        "hands_components": np.eye(45),
        "hands_mean": rng.normal(scale=0.05, size=45),
        "f": f.astype(np.uint32),
        "J_regressor": joints.T,
        "kintree_table": np.array([[2**32 - 1, *PARENTS[1:]], range(16)], dtype=np.uint32),
        "weights": weights,
        "posedirs": np.zeros((778, 3, 135)),
        "shapedirs": rng.normal(scale=3e-4, size=(778, 1, 1)) * rng.normal(size=(1, 3, 10)),
        "v_template": v,
    }


def write_mano(folder: Path) -> Path:
    """A folder of both files."""
    folder.mkdir(parents=True)
    for side in SIDES:
        (folder / f"MANO_{side.upper()}.pkl").write_bytes(_file(side))
    return folder


@cache
def _file(side: Side) -> bytes:
    return pickle.dumps(synthetic_mano(side), protocol=2)


def bent(side: Side = "right") -> np.ndarray:
    """The pose (45,) of bent fingers, relative to the flat hand."""
    pose = np.zeros((5, 3, 3))
    pose[:4, :, 2] = 0.5  # bends towards the palm
    return pose.reshape(45) if side == "right" else mirrored_pose(pose.reshape(45))


def posed(mano: Path, side: Side) -> tuple[Mano, PosedHand]:
    """The bent hand of ``BETAS`` as the fitters of ARCTIC and HOI4D saw it: by the published file, faults included."""
    hand = load(mano / f"MANO_{side.upper()}.pkl", side)
    values = synthetic_mano(side)
    shape = values["shapedirs"] @ BETAS
    flat = hand.model.with_shape(np.zeros(10))
    shaped = type(flat)(flat.model, flat.vertices + shape, flat.joints + values["J_regressor"] @ shape)
    return hand, shaped.with_pose(bent(side))


def motion(side: Side = "right") -> tuple[np.ndarray, np.ndarray]:
    """T_cam_hand and T_cam_obj (N, 4, 4): the hand carries the ball, turning; before ``TAKEN`` the ball is away."""
    t = np.linspace(0.0, 1.0, FRAMES)
    turn = se3.exp_so3(np.stack([0.3 * t - 0.8, 0.5 * t, 0.2 * t], axis=-1))
    T_cam_hand = se3.rigid(turn, np.stack([0.1 * t, -0.05 * t, 0.5 + 0.1 * t], axis=-1))
    T_hand_obj = np.tile(se3.rigid(None, AT if side == "right" else mirrored(AT)), (FRAMES, 1, 1))
    T_hand_obj[:TAKEN, 1, 3] -= 0.1
    return T_cam_hand, T_cam_hand @ T_hand_obj


def global_motion(T: np.ndarray, root: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """MANO's rotation vectors and translations for hand frames T (N, 4, 4): the inverse of ``root_transform``."""
    R = T[:, :3, :3]
    return se3.log_so3(R), T[:, :3, 3] - root + R @ root


def ball(radius: float) -> trimesh.Trimesh:
    """A ball, a little longer along its z axis."""
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    mesh.apply_scale([1.0, 1.05, 1.2])
    return mesh


def same_points(a: np.ndarray, b: np.ndarray, tolerance: float = 1e-6) -> bool:
    """Whether two sets of points are the same, in whatever order."""
    return max(cKDTree(a).query(b)[0].max(), cKDTree(b).query(a)[0].max()) < tolerance


def save_pickled(path: Path, content: dict[str, Any]) -> None:
    """``np.save`` of a dictionary."""
    np.save(path, content, allow_pickle=True)


class Hostile:
    """A pickle of it would run a command when read."""

    def __reduce__(self) -> tuple[Any, ...]:
        import os

        return os.system, ("exit 1",)
