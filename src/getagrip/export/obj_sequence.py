"""OBJ sequence: meshes of object and hand in every frame, posed in the camera frame."""

from __future__ import annotations

from pathlib import Path

from getagrip.export.scene import Scene, file_names
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files import write_mesh


def write(scene: Scene, folder: Path) -> dict[str, str]:
    """Write ``object/<frame>.obj`` and ``hand/<frame>.obj``."""
    in_camera = se3.transform(scene.T_cam_obj, scene.object.vertices[None])
    moving = {"object": (in_camera, scene.object.faces), "hand": (scene.hand_in_camera, scene.hand_faces)}
    for name, (vertices, faces) in moving.items():
        (folder / name).mkdir()
        for frame, posed in zip(file_names(scene.frames), vertices, strict=True):
            write_mesh(Mesh(posed, faces), folder / name / f"{frame}.obj")
    axes = "camera frame of its image: x right, y down, z forward; metres"
    return {f"{name}/<frame>.obj": axes for name in moving}
