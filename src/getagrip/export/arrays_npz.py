"""npz: all arrays of a scene in one file, named by their frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from getagrip.export.scene import CAMERA_AXES_NOTE, Scene
from getagrip.io import arrays


def write(scene: Scene, folder: Path) -> dict[str, str]:
    """Write ``scene.npz``."""
    content = {
        "frames": np.array(scene.frames, dtype=np.str_),
        "time_s": scene.time,
        **scene.poses,
        "object_vertices": scene.object.vertices,
        "object_faces": scene.object.faces,
        "hand_vertices_cam": scene.hand_in_camera,
        "hand_faces": scene.hand_faces,
        "K": scene.K,
        "image_size": np.array(scene.size),
        "iou": scene.iou,
        "frame_kind": np.array(scene.frame_kind, dtype=np.str_),
    }
    if (joints := scene.joints_in_camera) is not None:
        content["joints_cam"] = joints
    for other in scene.hands[1:]:
        content |= {
            "T_cam_other_hand": other.T_cam_hand,
            "other_hand_vertices_cam": other.in_camera,
            "other_hand_faces": other.faces,
            "other_hand_known": other.known,
        }
        if (joints := other.joints_in_camera) is not None:
            content["other_joints_cam"] = joints
    if scene.views:
        content |= {
            "views": np.array([view.name for view in scene.views], dtype=np.str_),
            "T_cam_views": np.stack([view.T_cam_view for view in scene.views]),
            "K_views": np.stack([view.K for view in scene.views]),
            "image_size_views": np.array([view.size for view in scene.views]),
        }
    if scene.world is not None and scene.world.up is not None:
        content["world_up"] = scene.world.up
    if scene.angle is not None:
        content["angle_rad"] = scene.angle
    arrays.write(folder / "scene.npz", content)
    return {
        "scene.npz": f"arrays; {CAMERA_AXES_NOTE}; joints: wrist, then thumb to pinky, each from the palm to the tip"
    }
