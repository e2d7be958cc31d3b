"""dex-retargeting (Qin et al.; https://github.com/dexsuite/dex-retargeting): 21 joints and object poses, z up.

Its examples take joints in the order of this package. ``joint_pos`` are positions [m] for position retargeting, with
``wrist_quat`` (w, x, y, z), MANO's global rotation, to start from. ``joint_pos_wrist`` are the joints from the wrist,
in the frame of the palm that its detector has, for vector retargeting. ``object_pose`` is a quaternion (x, y, z, w) and
a position, as in DexYCB, in the frame of ``joint_pos``; its ``extrinsics`` are therefore the identity.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from getagrip.export.scene import Scene, word
from getagrip.export.stage import MIDDLE, WRIST, Stage, besides, joints_on_stage, palm, pose7
from getagrip.geometry import se3
from getagrip.geometry.mesh_files import write_mesh
from getagrip.io import arrays

FILE, MESH = "trajectory.npz", "object.obj"


def write(scene: Scene, folder: Path) -> dict[str, str]:
    """Write ``trajectory.npz`` and the object. Raises ``UsageError`` where joints are not known."""
    stage = Stage.of(scene)
    joints = joints_on_stage(scene, stage, "dex-retargeting")
    T_stage_obj, T_stage_hand = stage.poses(scene)
    content = {
        "joint_pos": joints,
        "joint_pos_wrist": (joints - joints[:, WRIST, None]) @ palm(joints, scene.side, MIDDLE),
        "wrist_quat": se3.quaternions_in_time(T_stage_hand[:, :3, :3]),
        "object_pose": pose7(T_stage_obj, "xyzw")[:, None],
        "extrinsics": np.eye(4),
        "object_mesh_file": np.array([MESH]),
        "capture_name": np.array(word(scene.name)),
        "hand_type": np.array(scene.side),
        **besides(scene),
    }
    arrays.write(folder / FILE, content)
    write_mesh(scene.object, folder / MESH)
    return {
        FILE: f"joint_pos (T, 21, 3), object_pose (T, 1, 7): quaternion (x, y, z, w), position; {stage.words}",
        MESH: "the object at the size that was found; metres",
    }
