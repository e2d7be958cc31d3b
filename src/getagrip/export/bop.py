"""BOP: a results CSV, and the same poses as ``scene_gt`` and ``scene_camera`` with the model in millimetres.

As in the BOP toolkit: ``R``, row by row, and ``t`` [mm] map the model to the camera frame (x right, y down, z forward);
``time`` is -1, not measured per image. The toolkit splits file names, ``METHOD_DATASET-SPLIT.csv``, at underscores and
hyphens.

Clips of BOP's own datasets, such as HOT3D, keep BOP's names from their provenance: the dataset ``hot3d``, the headset
(``aria``, ``quest3``) as the split's type, and the camera in file names, such as ``scene_gt_rgb.json``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from getagrip.export.scene import Scene, csv_text, format_vector, safe_file_name
from getagrip.geometry import se3
from getagrip.geometry.mesh_files import write_mesh
from getagrip.io import files

BOP_RESULT_COLUMNS = ("scene_id", "im_id", "obj_id", "score", "R", "t", "time")
BOP_SCENE_ID, BOP_OBJECT_ID = 1, 1
"""Ids of the only scene and the only object."""


@dataclass(frozen=True)
class BopFileNames:
    """The parts of file names."""

    dataset: str
    split: str = "test"
    camera: str = ""
    """Name of the camera in the scene's files, with a leading underscore."""


def write(scene: Scene, folder: Path) -> dict[str, str]:
    """Write the results, the scene's two files and the model."""
    images, naming = image_ids(scene.frames), naming_of(scene)
    R, t = scene.T_cam_obj[:, :3, :3], 1e3 * scene.T_cam_obj[:, :3, 3]
    method = safe_file_name(f"getagrip-{scene.method}").replace(".", "-")
    results = f"{method}_{naming.dataset}-{naming.split}.csv"
    rows = (
        [BOP_SCENE_ID, image, BOP_OBJECT_ID, f"{score:.6g}", format_vector(R[n]), format_vector(t[n]), -1]
        for n, (image, score) in enumerate(zip(images, np.nan_to_num(scene.iou), strict=True))
    )
    files.write_bytes(folder / results, csv_text([BOP_RESULT_COLUMNS, *rows]))
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
    write_mesh(replace(scene.object, vertices=1e3 * scene.object.vertices), folder / model)
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
        camera: "intrinsics of each image and, where known, the poses world to camera, in mm",
        model: "the object at its estimated size, in mm",
        "models/models_info.json": "diameter and bounding box, in mm",
    }


def naming_of(scene: Scene) -> BopFileNames:
    """Name a scene's files, for a clip of one of BOP's own datasets as in that dataset."""
    if {"dataset", "split", "camera"} <= scene.bop.keys():
        return BopFileNames(scene.bop["dataset"], scene.bop["split"], f"_{scene.bop['camera']}")
    return BopFileNames("".join(filter(str.isalnum, safe_file_name(scene.name))) or "clip")


def image_ids(frames: tuple[str, ...]) -> list[int]:
    """Return BOP's image ids: the frames' names if all are distinct whole numbers, else the frames' indices."""
    if all(name.isascii() and name.isdigit() for name in frames) and len({int(name) for name in frames}) == len(frames):
        return [int(name) for name in frames]
    return list(range(len(frames)))


def _camera_entry(scene: Scene, n: int) -> dict[str, object]:
    out: dict[str, object] = {"cam_K": scene.K[n].ravel(), "depth_scale": 1.0}
    if scene.world is not None:
        T_cam_world = se3.inverse(scene.world.T_world_cam[n])
        out |= {"cam_R_w2c": T_cam_world[:3, :3].ravel(), "cam_t_w2c": 1e3 * T_cam_world[:3, 3]}
    return out
