"""SPIDER (Pan et al., 2025; https://github.com/facebookresearch/spider): keypoint trajectories in its folders.

The layout is that of its dataset readers: ``trajectory_keypoints.npz`` with the poses of the wrist (T, 7), the five
fingertips (T, 5, 7) and the object (T, 7) of each side, as positions [m] and quaternions (w, x, y, z), z up; and
``task_info.json`` with the time between frames and the folder of ``visual.obj``. The wrist's z points to the middle
knuckle. Poses of the side that the clip lacks are the identity.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from getagrip.export.scene import (
    FINGERTIP_JOINTS,
    RING_KNUCKLE_JOINT,
    WRIST_JOINT,
    Scene,
    StageFrame,
    extra_arrays,
    joints_on_stage,
    palm_orientation,
    pose7,
    safe_file_name,
)
from getagrip.geometry import se3
from getagrip.geometry.mesh_files import write_mesh
from getagrip.io import arrays, files

SPIDER_DATASET_NAME = "getagrip"
IDENTITY_POSE7 = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


def write(scene: Scene, folder: Path) -> dict[str, str]:
    """Write SPIDER's ``processed`` folder. Raises ``UsageError`` for a hand without joints."""
    if len(scene.frames) > 1:
        scene = scene.even(1.0 / float(np.median(np.diff(scene.time))))
    stage = StageFrame.of(scene)
    joints = joints_on_stage(scene, stage, "spider")
    T_stage_obj, _ = stage.poses(scene)
    T_stage_wrist = se3.rigid(palm_orientation(joints, scene.side, RING_KNUCKLE_JOINT), joints[:, WRIST_JOINT])
    unturned = np.tile(IDENTITY_POSE7[3:], (len(joints), len(FINGERTIP_JOINTS), 1))
    own = {
        "wrist": pose7(T_stage_wrist, "wxyz"),
        "finger": np.concatenate([joints[:, FINGERTIP_JOINTS], unturned], axis=-1),
        "obj": pose7(T_stage_obj, "wxyz"),
    }
    content: dict[str, np.ndarray] = {}
    for side in ("right", "left"):
        for name, poses in own.items():
            none = np.broadcast_to(IDENTITY_POSE7, poses.shape)
            content[f"qpos_{name}_{side}"] = poses if side == scene.side else none
    content |= {"timestamps": np.round(1e9 * scene.time).astype(np.int64), "joints": joints, **extra_arrays(scene)}
    task = safe_file_name(scene.name)
    mesh_folder = f"processed/{SPIDER_DATASET_NAME}/assets/objects/{task}"
    clip_folder = f"processed/{SPIDER_DATASET_NAME}/mano/{scene.side}/{task}"
    trajectory, info, mesh = f"{clip_folder}/0/trajectory_keypoints.npz", f"{clip_folder}/task_info.json", "visual.obj"
    (folder / trajectory).parent.mkdir(parents=True)
    (folder / mesh_folder).mkdir(parents=True)
    arrays.write(folder / trajectory, content)
    write_mesh(scene.object, folder / mesh_folder / mesh)
    about = {
        "task": task,
        "dataset_name": SPIDER_DATASET_NAME,
        "robot_type": "mano",
        "embodiment_type": scene.side,
        "data_id": 0,
        **{f"{side}_object_mesh_dir": mesh_folder if side == scene.side else None for side in ("right", "left")},
        "ref_dt": float(np.median(np.diff(scene.time))) if len(joints) > 1 else 1.0 / scene.fps,
    }
    files.write_json(folder / info, about)
    return {
        trajectory: f"positions and quaternions (w, x, y, z); {stage.words}; T_a_b, time_s, frame_kind are ours",
        info: "SPIDER's record; ref_dt, the time between frames [s], is the median; folders are relative; metres",
        f"{mesh_folder}/{mesh}": "the object at its estimated size; metres",
    }
