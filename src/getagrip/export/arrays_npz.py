"""npz: every array, named by its frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from getagrip.export.scene import AXES, Scene
from getagrip.geometry import se3
from getagrip.io import arrays


def write(scene: Scene, folder: Path) -> dict[str, str]:
    """Write ``scene.npz``."""
    content = {
        "frames": np.array(scene.frames, dtype=np.str_),
        "time_s": scene.time,
        "T_cam_obj": scene.T_cam_obj,
        "T_hand_obj": scene.T_hand_obj,
        "T_cam_hand": scene.T_cam_hand,
        "object_vertices": scene.object.vertices,
        "object_faces": scene.object.faces,
        "hand_vertices_cam": scene.hand_in_camera,
        "hand_faces": scene.hand_faces,
        "K": scene.K,
        "image_size": np.array(scene.size),
        "iou": scene.iou,
        "frame_kind": np.array(scene.frame_kind, dtype=np.str_),
    }
    if scene.joints is not None:
        content["joints_cam"] = se3.transform(scene.T_cam_hand, scene.joints)
    if scene.angle is not None:
        content["angle_rad"] = scene.angle
    arrays.write(folder / "scene.npz", content)
    return {"scene.npz": f"arrays; {AXES}; joints: wrist, then thumb to pinky, each from the palm to the tip"}
