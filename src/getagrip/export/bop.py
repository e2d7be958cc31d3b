"""BOP: a results CSV, and the same poses as ``scene_gt`` and ``scene_camera`` with the model in millimetres.

As in the BOP toolkit: ``R`` row by row and ``t`` [mm] bring the model into the camera frame (x right, y down, z
forward); ``time`` is the same for all poses of an image, -1 where it was not measured per image. File names are
``METHOD_DATASET-SPLIT.csv``: the toolkit parts them at underscores and hyphens.

Clips of BOP's own datasets, such as HOT3D, have its names, which their provenance says: the dataset ``hot3d``, the
split's type the headset (``aria``, ``quest3``), and files of the camera, such as ``scene_gt_rgb.json``.
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.export.scene import Scene, safe_file_name
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files import write_mesh
from getagrip.io import files

BOP_SCENE_ID, BOP_OBJECT_ID = 1, 1
"""Ids of the one scene and the one object."""


@dataclass(frozen=True)
class BopFileNames:
    """Names of the files."""

    dataset: str
    split: str = "test"
    camera: str = ""
    """Name of the camera in the scene's files, with an underscore before it."""


def write(scene: Scene, folder: Path) -> dict[str, str]:
    """Write the results, the scene's two files and the model."""
    images, naming = image_ids(scene.frames), naming_of(scene)
    R, t = scene.T_cam_obj[:, :3, :3], 1e3 * scene.T_cam_obj[:, :3, 3]
    method = safe_file_name(f"getagrip-{scene.method}").replace(".", "-")
    results = f"{method}_{naming.dataset}-{naming.split}.csv"
    files.write_bytes(folder / results, _results_csv(images, R, t, np.nan_to_num(scene.iou)).encode())
    poses = {
        str(image): [{"cam_R_m2c": R[n].ravel(), "cam_t_m2c": t[n], "obj_id": BOP_OBJECT_ID}]
        for n, image in enumerate(images)
    }
    cameras = {str(image): _camera_entry(scene, n) for n, image in enumerate(images)}
    ground_truth, camera = f"scene_gt{naming.camera}.json", f"scene_camera{naming.camera}.json"
    files.write_json(folder / ground_truth, poses)
    files.write_json(folder / camera, cameras)
    (folder / "models").mkdir()
    model = f"models/obj_{BOP_OBJECT_ID:06d}.ply"
    write_mesh(Mesh(1e3 * scene.object.vertices, scene.object.faces), folder / model)
    extent = scene.object.vertices
    info = {
        "diameter": 1e3 * scene.object.diameter,
        **{f"min_{axis}": 1e3 * extent[:, k].min() for k, axis in enumerate("xyz")},
        **{f"size_{axis}": 1e3 * np.ptp(extent[:, k]) for k, axis in enumerate("xyz")},
    }
    files.write_json(folder / "models" / "models_info.json", {str(BOP_OBJECT_ID): info})
    return {
        results: "BOP results: R row by row, t in mm, model to camera; score is the mask IOU, 0 where no mask shows "
        "the object; time -1: not per image",
        ground_truth: "the same poses in the layout of BOP's ground truth; they are estimates",
        camera: "intrinsics of each image, and where they are known the poses world to camera, in mm",
        model: "the object at the size that was found, in mm",
        "models/models_info.json": "diameter and bounding box, in mm",
    }


def naming_of(scene: Scene) -> BopFileNames:
    """Name the files of a scene as BOP's own dataset does, where the clip is of one."""
    if {"dataset", "split", "camera"} <= scene.bop.keys():
        return BopFileNames(scene.bop["dataset"], scene.bop["split"], f"_{scene.bop['camera']}")
    return BopFileNames("".join(filter(str.isalnum, safe_file_name(scene.name))) or "clip")


def image_ids(frames: tuple[str, ...]) -> list[int]:
    """Return BOP's image ids: the frames' names where all are whole numbers, else their places."""
    if all(name.isascii() and name.isdigit() for name in frames) and len({int(name) for name in frames}) == len(frames):
        return [int(name) for name in frames]
    return list(range(len(frames)))


def _camera_entry(scene: Scene, n: int) -> dict[str, object]:
    """Describe the camera of one image."""
    out: dict[str, object] = {"cam_K": scene.K[n].ravel(), "depth_scale": 1.0}
    if scene.world is not None:
        T_cam_world = se3.inverse(scene.world.T_world_cam[n])
        out |= {"cam_R_w2c": T_cam_world[:3, :3].ravel(), "cam_t_w2c": 1e3 * T_cam_world[:3, 3]}
    return out


def _results_csv(
    images: list[int], R: Float[ndarray, "T 3 3"], t: Float[ndarray, "T 3"], score: Float[ndarray, "T"]
) -> str:
    """Write the text of the results."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(["scene_id", "im_id", "obj_id", "score", "R", "t", "time"])
    for n, image in enumerate(images):
        rows.writerow(
            [BOP_SCENE_ID, image, BOP_OBJECT_ID, f"{score[n]:.6g}", _format_vector(R[n]), _format_vector(t[n]), -1]
        )
    return text.getvalue()


def _format_vector(values: Float[ndarray, "*n"]) -> str:
    return " ".join(f"{x:.9g}" for x in np.ravel(values))
