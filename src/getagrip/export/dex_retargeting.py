"""dex-retargeting (Qin et al.; https://github.com/dexsuite/dex-retargeting): 21 joints and object poses, z up.

Its examples take joints in the order of this package. ``joint_pos`` are positions [m] for position retargeting, with
the initial ``wrist_quat`` (w, x, y, z), MANO's global rotation. ``joint_pos_wrist`` are the joints relative to the
wrist, in the palm frame of its detector, for vector retargeting. ``object_pose`` is a quaternion (x, y, z, w) and a
position, as in DexYCB, in the frame of ``joint_pos``; ``extrinsics`` are therefore the identity.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from getagrip.export.scene import (
    MIDDLE_KNUCKLE_JOINT,
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
from getagrip.io import arrays

TRAJECTORY_FILE, OBJECT_MESH_FILE = "trajectory.npz", "object.obj"


def write(scene: Scene, folder: Path) -> dict[str, str]:
    """Write ``trajectory.npz`` and the object. Raises ``UsageError`` for a hand without joints."""
    stage = StageFrame.of(scene)
    joints = joints_on_stage(scene, stage, "dex-retargeting")
    T_stage_obj, T_stage_hand = stage.poses(scene)
    R_stage_palm = palm_orientation(joints, scene.side, MIDDLE_KNUCKLE_JOINT)
    content = {
        "joint_pos": joints,
        "joint_pos_wrist": (joints - joints[:, WRIST_JOINT, None]) @ R_stage_palm,
        "wrist_quat": se3.quaternions_in_time(T_stage_hand[:, :3, :3]),
        "object_pose": pose7(T_stage_obj, "xyzw")[:, None],
        "extrinsics": np.eye(4),
        "object_mesh_file": np.array([OBJECT_MESH_FILE]),
        "capture_name": np.array(safe_file_name(scene.name)),
        "hand_type": np.array(scene.side),
        **extra_arrays(scene),
    }
    arrays.write(folder / TRAJECTORY_FILE, content)
    write_mesh(scene.object, folder / OBJECT_MESH_FILE)
    arrays_in_words = "joint_pos (T, 21, 3), object_pose (T, 1, 7): quaternion (x, y, z, w), position"
    mesh_in_words = "the object at its estimated size; metres"
    return {TRAJECTORY_FILE: f"{arrays_in_words}; {stage.words}", OBJECT_MESH_FILE: mesh_in_words}
