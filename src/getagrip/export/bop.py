"""BOP: a results CSV, and the same poses as ``scene_gt.json`` and ``scene_camera.json`` with the model in millimetres.

As in the BOP toolkit: ``R`` row by row and ``t`` [mm] bring the model into the camera frame (x right, y down, z
forward); ``time`` is the same for all poses of an image, -1 where it was not measured per image.
"""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.export.scene import Scene
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files import write_mesh
from getagrip.io import files

SCENE, OBJECT = 1, 1
"""Ids of the one scene and the one object."""


def write(scene: Scene, folder: Path) -> dict[str, str]:
    """Write the results, the scene's two files and the model."""
    images = image_ids(scene.frames)
    R, t = scene.T_cam_obj[:, :3, :3], 1e3 * scene.T_cam_obj[:, :3, 3]
    results = f"{_word('getagrip-' + scene.method)}_{_word(scene.name)}-test.csv"
    files.write_bytes(folder / results, _results(images, R, t, np.nan_to_num(scene.iou)).encode())
    poses = {
        str(image): [{"cam_R_m2c": R[n].ravel(), "cam_t_m2c": t[n], "obj_id": OBJECT}] for n, image in enumerate(images)
    }
    cameras = {str(image): {"cam_K": K.ravel(), "depth_scale": 1.0} for image, K in zip(images, scene.K, strict=True)}
    files.write_json(folder / "scene_gt.json", poses)
    files.write_json(folder / "scene_camera.json", cameras)
    (folder / "models").mkdir()
    model = f"models/obj_{OBJECT:06d}.ply"
    write_mesh(Mesh(1e3 * scene.object.vertices, scene.object.faces), folder / model)
    return {
        results: "BOP results: R row by row, t in mm, model to camera; score is the mask IOU, 0 where no mask shows "
        "the object; time -1: not per image",
        "scene_gt.json": "the same poses in the layout of BOP's ground truth; they are estimates",
        "scene_camera.json": "intrinsics of each image",
        model: "the object at the size that was found, in mm",
    }


def image_ids(frames: tuple[str, ...]) -> list[int]:
    """BOP's image ids: the frames' names where all are whole numbers, else their places."""
    if all(name.isascii() and name.isdigit() for name in frames) and len({int(name) for name in frames}) == len(frames):
        return [int(name) for name in frames]
    return list(range(len(frames)))


def _results(
    images: list[int], R: Float[ndarray, "T 3 3"], t: Float[ndarray, "T 3"], score: Float[ndarray, "T"]
) -> str:
    """The results' text."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["scene_id", "im_id", "obj_id", "score", "R", "t", "time"])
    for n, image in enumerate(images):
        rows.writerow([SCENE, image, OBJECT, f"{score[n]:.6g}", _spaced(R[n]), _spaced(t[n]), -1])
    return text.getvalue()


def _spaced(values: Float[ndarray, "*n"]) -> str:
    return " ".join(f"{x:.9g}" for x in np.ravel(values))


def _word(text: str) -> str:
    """Without the underscore that parts BOP's file names."""
    return text.replace("_", "-")
