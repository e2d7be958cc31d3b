"""ARCTIC's folder with one sequence, of known poses.

A sequence of TACO's as GeneOH Diffusion holds them.

A recording of joints: two hands, one carries a box whose lid turns, in a world where z is up. Known answers.

ArtiGrasp's folder with one sequence, its joints wrong where the real ones are, and estimates of it.

A file of tracks in this package's own layout.
"""

from __future__ import annotations

import json
import pickle
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from getagrip.geometry import se3
from getagrip.hands import generic
from getagrip.hands.fit_joints import JOINT_ORDERS
from getagrip.hands.mano import FINGERTIP_VERTICES
from getagrip.hands.model import Side
from helpers.held_ball import AT, BETAS, FRAMES, ball, bent, global_motion, motion, posed, save_pickled  # fmt: skip

OPENED = 28
"""From this frame on, the joint is at another angle."""
OFFSET = 3
K_EGO = np.array([[1720.0, 0.0, 1399.5], [0.0, 1710.0, 999.5], [0.0, 0.0, 1.0]])


def scene() -> dict[str, np.ndarray]:
    """A camera that moves in the world, and the ball, which the right hand carries."""
    T_cam_hand, T_cam_obj = motion()
    t = np.linspace(0.0, 1.0, FRAMES)
    T_cam_world = se3.rigid(
        se3.exp_so3(np.stack([1.0 + 0.1 * t, 0.2 * t, -0.3 * t], axis=-1)), np.array([0.1, 0.2, 1.5])
    )
    angle = np.where(np.arange(FRAMES) < OPENED, 0.03, 0.4)
    return {"T_cam_hand": T_cam_hand, "T_cam_obj": T_cam_obj, "T_cam_world": T_cam_world, "angle": angle}


def write_arctic(folder: Path, mano: Path) -> Path:
    """ARCTIC's folder, with one sequence."""
    data, of = folder / "data", scene()
    raw, meta = data / "raw_seqs" / "s01", data / "meta"
    template = meta / "object_vtemplates" / "ball"
    raw.mkdir(parents=True)
    template.mkdir(parents=True)
    T_world_obj = se3.inverse(of["T_cam_world"]) @ of["T_cam_obj"]
    numbers = [of["angle"][:, None], se3.log_so3(T_world_obj[:, :3, :3]), 1e3 * T_world_obj[:, :3, 3]]
    np.save(raw / "ball_use_01.object.npy", np.concatenate(numbers, axis=1).astype(np.float32))
    hands: dict[str, Any] = {}
    for side in ("right", "left"):
        hand, at_rest = posed(mano, side)
        aside = se3.rigid(None, np.array([-0.14 if side == "left" else 0.0, 0.0, 0.0]))
        T = se3.inverse(of["T_cam_world"]) @ aside @ of["T_cam_hand"]
        rot, trans = global_motion(T, at_rest.joints[0])
        # float32, and the error of the fit as a list, as the real files have them
        numbers_of = {"rot": rot, "pose": np.tile(bent(side) - hand.mean, (FRAMES, 1)), "trans": trans, "shape": BETAS}
        hands[side] = {key: value.astype(np.float32) for key, value in numbers_of.items()}
        hands[side]["fitting_err"] = [0.5] * FRAMES
    save_pickled(raw / "ball_use_01.mano.npy", hands)
    camera = {
        "R_k_cam_np": of["T_cam_world"][:, :3, :3],
        "T_k_cam_np": of["T_cam_world"][:, :3, 3:],
        "intrinsics": K_EGO,
        "ego_markers.label": ["a", "b"],
        "dist8": np.zeros(8),
    }
    save_pickled(raw / "ball_use_01.egocam.dist.npy", camera)
    mesh = ball(40.0)
    mesh.export(template / "mesh.obj")
    (template / "parts.json").write_text(json.dumps((np.asarray(mesh.vertices)[:, 1] <= 0).astype(int).tolist()))
    fixed = {
        "world2cam": np.tile(of["T_cam_world"][0], (8, 1, 1)).tolist(),
        "intris_mat": np.tile(K_EGO, (8, 1, 1)).tolist(),
        "image_size": [[2800, 2000]] * 9,
        "ioi_offset": OFFSET,
        "gender": "female",
    }
    (meta / "misc.json").write_text(json.dumps({"s01": fixed}))
    return data


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


JOINT_FRAMES, TAKEN, OPENED_BOX = 70, 10, 45
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
    t = np.linspace(0.0, 1.0, JOINT_FRAMES)
    turn = se3.exp_so3(np.stack([0.4 * t - 0.8, 0.5 * t, 0.2 * t], axis=-1))
    T_world_hand = se3.rigid(turn, np.stack([0.1 * t, 0.05 * t, 1.0 + 0.1 * t], axis=-1))
    at = AT if holder == "right" else AT * [-1.0, 1.0, 1.0]
    T_hand_obj = np.tile(se3.rigid(None, at), (JOINT_FRAMES, 1, 1))
    T_hand_obj[:TAKEN, 1, 3] -= 0.15
    aside = se3.rigid(None, np.array([0.0, 0.0, -0.4]))
    joints: dict[Side, np.ndarray] = {}
    for side in ("left", "right"):
        hand = generic.load(side).with_shape().with_pose(bent(side))
        joints[side] = se3.transform(T_world_hand if side == holder else aside @ T_world_hand, hand.joints)
    angle = np.where(np.arange(JOINT_FRAMES) < OPENED_BOX, 0.02, 0.5)
    return Recording(joints, T_world_hand @ T_hand_obj, angle, T_world_hand)


def write_parts(bottom: Path, lid: Path) -> None:
    """The meshes of the box and of its lid, with as few vertices as boxes have."""
    trimesh.creation.box(BOTTOM).export(bottom)
    above = se3.rigid(None, np.array([0.0, -0.5 * (BOTTOM[1] + LID[1]) - 0.001, 0.0]))
    trimesh.creation.box(LID, transform=above).export(lid)


SEQUENCE = "box_use_01"
HO3D = np.argsort(JOINT_ORDERS["ho3d"])
"""Where each of HO-3D's joints stands in this package's order."""


def write_artigrasp(folder: Path) -> Path:
    """ArtiGrasp's folder with one sequence, its joints wrong where the real ones are."""
    rsc, of = folder / "rsc", recording()
    ee, box = rsc / "mano_double" / "ee" / "s1", rsc / "arctic" / "box"
    (box / "s1").mkdir(parents=True)
    ee.mkdir(parents=True)
    wrong = (np.arange(JOINT_FRAMES) < 3) | (np.arange(JOINT_FRAMES) >= 32 * (JOINT_FRAMES // 32))
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
    turned = se3.exp_so3(np.random.default_rng(0).normal(size=(JOINT_FRAMES, 3)) * 0.02) @ T[:, :3, :3]
    held = np.concatenate([poses[:, :1], se3.log_so3(turned), np.tile([0.0, 0.0, 2000.0], (JOINT_FRAMES, 1))], axis=1)
    (rsc / "arctic" / "box" / "s1_recon").mkdir()
    (rsc / "mano_double" / "ee_recon" / "s1").mkdir(parents=True)
    np.save(rsc / "arctic" / "box" / "s1_recon" / f"{SEQUENCE}.object.npy", held.astype(np.float32))
    for letter in "lr":
        joints = se3.transform(ESTIMATE_WORLD, np.load(rsc / "mano_double" / "ee" / "s1" / f"{SEQUENCE}_{letter}.npy"))
        placed = joints - T[:, None, :3, 3] + [0.0, 0.0, 2.0] - [0.0, 0.0, 0.01]
        np.save(rsc / "mano_double" / "ee_recon" / "s1" / f"{SEQUENCE}_{letter}.npy", placed)
    return root


def content(holder: Side = "right") -> dict[str, Any]:
    """A file's arrays, of one hand and a rigid box."""
    of = recording(holder)
    return {
        f"joints_{holder}": of.joints[holder],
        "order": "openpose",
        "T_world_obj": of.T_world_obj,
        "mesh": "box.obj",
        "fps": 25,
        "category": "box",
        "subject": "ann",
        "sequence": "box-1",
    }


def write(folder: Path, **changes: Any) -> Path:
    """A file of ``content`` with some arrays changed, or left out where they are None."""
    write_parts(folder / "box.obj", folder / "lid.obj")
    given = {key: value for key, value in {**content(), **changes}.items() if value is not None}
    np.savez(folder / "one.npz", **given)
    return folder / "one.npz"
