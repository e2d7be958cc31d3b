"""ArtiGrasp's folder with one sequence, its joints wrong where the real ones are, and estimates of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from getagrip.geometry import se3
from getagrip.hands.fit_joints import JOINT_ORDERS
from helpers.recorded_joints import FRAMES, recording, write_parts

SEQUENCE = "box_use_01"
HO3D = np.argsort(JOINT_ORDERS["ho3d"])
"""Where each of HO-3D's joints stands in this package's order."""


def write_artigrasp(folder: Path) -> Path:
    """ArtiGrasp's folder with one sequence, its joints wrong where the real ones are."""
    rsc, of = folder / "rsc", recording()
    ee, box = rsc / "mano_double" / "ee" / "s1", rsc / "arctic" / "box"
    (box / "s1").mkdir(parents=True)
    ee.mkdir(parents=True)
    wrong = (np.arange(FRAMES) < 3) | (np.arange(FRAMES) >= 32 * (FRAMES // 32))
    for side, letter in (("left", "l"), ("right", "r")):
        joints = of.joints[side][:, HO3D].copy()
        joints[wrong] = joints[0]
        joints[wrong] *= 0.7
        np.save(ee / f"{SEQUENCE}_{letter}.npy", joints)
    R, t = of.T_world_obj[:, :3, :3], of.T_world_obj[:, :3, 3]
    poses = np.concatenate([of.angle[:, None], se3.log_so3(R), 1e3 * t], axis=1).astype(np.float32)
    np.save(box / "s1" / f"{SEQUENCE}.object.npy", poses)
    write_parts(box / "bottom_watertight_tiny.obj", box / "top_watertight_tiny.obj")
    return folder


ESTIMATE_WORLD = se3.rigid(se3.exp_so3(np.array([1.2, 1.7, -1.4])), np.array([0.1, 1.0, 2.0]))
"""The camera that the estimates were made by."""


def write_estimates(root: Path) -> Path:
    """The same with estimates: in a camera's axes, the object held still and turned by jitter, hands 10 mm nearer."""
    rsc = root / "rsc"
    poses = np.load(rsc / "arctic" / "box" / "s1" / f"{SEQUENCE}.object.npy").astype(float)
    T = ESTIMATE_WORLD @ se3.rigid(se3.exp_so3(poses[:, 1:4]), 1e-3 * poses[:, 4:])
    turned = se3.exp_so3(np.random.default_rng(0).normal(size=(FRAMES, 3)) * 0.02) @ T[:, :3, :3]
    held = np.concatenate([poses[:, :1], se3.log_so3(turned), np.tile([0.0, 0.0, 2000.0], (FRAMES, 1))], axis=1)
    (rsc / "arctic" / "box" / "s1_recon").mkdir()
    (rsc / "mano_double" / "ee_recon" / "s1").mkdir(parents=True)
    np.save(rsc / "arctic" / "box" / "s1_recon" / f"{SEQUENCE}.object.npy", held.astype(np.float32))
    for letter in "lr":
        joints = se3.transform(ESTIMATE_WORLD, np.load(rsc / "mano_double" / "ee" / "s1" / f"{SEQUENCE}_{letter}.npy"))
        placed = joints - T[:, None, :3, 3] + [0.0, 0.0, 2.0] - [0.0, 0.0, 0.01]
        np.save(rsc / "mano_double" / "ee_recon" / "s1" / f"{SEQUENCE}_{letter}.npy", placed)
    return root
