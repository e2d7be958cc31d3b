"""OBJ sequence: meshes of object and hands in every frame, posed in the camera frame."""

from __future__ import annotations

from pathlib import Path

from getagrip.export.scene import Scene, frame_file_names
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files import write_mesh


def write(scene: Scene, folder: Path) -> dict[str, str]:
    """Write ``object/<frame>.obj``, ``hand/<frame>.obj`` and, in frames that have it, ``other_hand/<frame>.obj``."""
    in_camera = se3.transform(scene.T_cam_obj, scene.object.vertices[None])
    moving = {"object": (in_camera, scene.object.faces, scene.hand.known)}
    moving |= {hand.name: (hand.in_camera, hand.faces, hand.known) for hand in scene.hands}
    for name, (vertices, faces, known) in moving.items():
        (folder / name).mkdir()
        for frame, posed, is_known in zip(frame_file_names(scene.frames), vertices, known, strict=True):
            if is_known:
                write_mesh(Mesh(posed, faces), folder / name / f"{frame}.obj")
    axes = "camera frame of its image: x right, y down, z forward; metres"
    return {f"{name}/<frame>.obj": axes for name in moving}
