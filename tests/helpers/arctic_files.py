"""ARCTIC's folder with one sequence, of known poses."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from getagrip.geometry import se3
from helpers.held_ball import (
    BETAS,
    FRAMES,
    ball,
    bent,
    global_motion,
    motion,
    posed,
    save_pickled,
)  # fmt: skip

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
