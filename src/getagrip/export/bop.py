"""BOP: a results CSV, and the same poses as a scene of ground truth, with masks and the model in millimetres.

As in the BOP toolkit: ``R``, row by row, and ``t`` [mm] map the model to the camera frame (x right, y down, z forward);
``time`` is -1, not measured per image. The toolkit splits file names, ``METHOD_DATASET-SPLIT.csv``, at underscores and
hyphens.

The folder is that of a scene: images, and masks rendered of the poses, so that they are estimates as these are.
``mask`` is the whole silhouette, ``mask_visib`` is without what the posed hands hide; ``scene_gt_info`` counts and
bounds both. No pixel has a valid depth: the footage has none.

A clip with views is one scene of several cameras, as BOP's of industry: files of a further view have its name, as in
``scene_gt_NAME.json``, ``mask_NAME`` and ``rgb_NAME``; an image id is the same moment in all. The results are those of
the clip's own camera. The world of such a clip is, where it is not known, the own camera's frame in each image.

Clips of BOP's own datasets, such as HOT3D, keep BOP's names from their provenance: the dataset ``hot3d``, the headset
(``aria``, ``quest3``) as the split's type, and the camera in file names, such as ``scene_gt_rgb.json``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool
from numpy import ndarray

from getagrip.clip import World
from getagrip.export.scene import Scene, csv_text, format_vector, safe_file_name
from getagrip.geometry import se3
from getagrip.geometry.mesh_files import write_mesh
from getagrip.geometry.rasterize import depth_and_face, render_coverage
from getagrip.io import files
from getagrip.io.files import read_bytes
from getagrip.io.images import read_image, write_image
from getagrip.readers.video import MAX_FRAME_FILE_BYTES

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
    images: str = "rgb"
    """Folder of the images."""
    is_own: bool = True
    """True for the clip's own camera."""

    def of_view(self, name: str) -> BopFileNames:
        """Name the files of a further view; in BOP's own datasets a folder of images has the camera's name alone."""
        images = name if self.camera else f"{self.images}_{name}"
        return replace(self, camera=f"_{name}", images=images, is_own=False)


def write(scene: Scene, folder: Path) -> dict[str, str]:
    """Write the results, the scene's files, images and masks, and the model. Raises ``InputError`` for an image."""
    images, naming = image_ids(scene.frames), naming_of(scene)
    R, t = scene.T_cam_obj[:, :3, :3], 1e3 * scene.T_cam_obj[:, :3, 3]
    method = safe_file_name(f"getagrip-{scene.method}").replace(".", "-")
    results = f"{method}_{naming.dataset}-{naming.split}.csv"
    rows = (
        [BOP_SCENE_ID, image, BOP_OBJECT_ID, f"{score:.6g}", format_vector(R[n]), format_vector(t[n]), -1]
        for n, (image, score) in enumerate(zip(images, np.nan_to_num(scene.iou), strict=True))
    )
    files.write_bytes(folder / results, csv_text([BOP_RESULT_COLUMNS, *rows]))
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
    written = {
        results: "BOP results: R row by row, t in mm, model to camera; score is the mask IOU, 0 where no mask shows "
        "the object; time -1: not per image",
        model: "the object at its estimated size, in mm",
        "models/models_info.json": "diameter and bounding box, in mm, of the model as it was fitted",
    }
    if scene.views and scene.world is None:
        scene = replace(scene, world=World(np.tile(np.eye(4), (len(images), 1, 1))))
    for seen, names in [(scene, naming), *((scene.in_view(view), naming.of_view(view.name)) for view in scene.views)]:
        written |= _write_camera(seen, folder, names, images)
    return written


def _write_camera(scene: Scene, folder: Path, naming: BopFileNames, images: list[int]) -> dict[str, str]:
    """Write the poses, images and masks of a camera, and itself; return what was written."""
    R, t = scene.T_cam_obj[:, :3, :3], 1e3 * scene.T_cam_obj[:, :3, 3]
    poses = {
        str(image): [{"cam_R_m2c": R[n].ravel(), "cam_t_m2c": t[n], "obj_id": BOP_OBJECT_ID}]
        for n, image in enumerate(images)
    }
    cameras = {str(image): _camera_entry(scene, n) for n, image in enumerate(images)}
    fx, fy, (cx, cy) = scene.K[0, 0, 0], scene.K[0, 1, 1], scene.K[0, :2, 2]
    width, height = scene.size
    pinhole = {"cx": cx, "cy": cy, "depth_scale": 1.0, "fx": fx, "fy": fy, "height": height, "width": width}
    ground_truth, camera = f"scene_gt{naming.camera}.json", f"scene_camera{naming.camera}.json"
    intrinsics = "camera.json" if naming.is_own else f"camera{naming.camera}.json"
    files.write_json(folder / ground_truth, poses)
    files.write_json(folder / camera, cameras)
    files.write_json(folder / intrinsics, pinhole)
    return _write_images(scene, folder, naming, images) | {
        ground_truth: "the same poses in the layout of BOP's ground truth; they are estimates",
        camera: "intrinsics of each image and, where known, the poses world to camera, in mm",
        intrinsics: "size of the images, and the intrinsics of the first one",
    }


def _write_images(scene: Scene, folder: Path, naming: BopFileNames, images: list[int]) -> dict[str, str]:
    """Write images, masks and their counts; return what was written."""
    camera, colours = naming.camera, naming.images
    mask, visible, information = f"mask{camera}", f"mask_visib{camera}", f"scene_gt_info{camera}.json"
    written = {
        f"{mask}/<image>_000000.png": "silhouettes of the model at the same poses",
        f"{visible}/<image>_000000.png": "the same without what the posed hands hide",
        information: "bounding boxes [x, y, width, height] and numbers of pixels of the same masks; no depth is known",
    }
    for name in (mask, visible):
        (folder / name).mkdir()
    about = {}
    for n, image in enumerate(images):
        whole, seen = object_pixels(scene, n)
        width, height = scene.size
        inside = whole[height : 2 * height, width : 2 * width]
        for name, pixels in ((mask, inside), (visible, seen)):
            write_image(folder / name / f"{image:06d}_{0:06d}.png", np.where(pixels, np.uint8(255), np.uint8(0)))
        count, shown = int(np.count_nonzero(whole)), int(np.count_nonzero(seen))
        about[str(image)] = [
            {
                "bbox_obj": _bounding_box(whole, (width, height)),
                "bbox_visib": _bounding_box(seen, (0, 0)),
                "px_count_all": count,
                "px_count_valid": 0,
                "px_count_visib": shown,
                "visib_fract": shown / count if count else 0.0,
            }
        ]
    files.write_json(folder / information, about)
    known = {image: path for image, path in zip(images, scene.image_files, strict=False) if path is not None}
    if known:
        (folder / colours).mkdir()
        for image, path in known.items():
            suffix = ".png" if path.suffix.lower() == ".png" else ".jpg"
            read_image(path, scene.size)  # which refuses what is no image of this size
            files.write_bytes(folder / colours / f"{image:06d}{suffix}", read_bytes(path, MAX_FRAME_FILE_BYTES))
        written[f"{colours}/<image>.png"] = "the same images as the clip's, .jpg where its are"
    return written


def object_pixels(scene: Scene, n: int) -> tuple[Bool[ndarray, "h w"], Bool[ndarray, "H W"]]:
    """Render a frame's object: all its pixels, with an image's size around the image, and the visible ones in it."""
    width, height = scene.size
    K = scene.K[n].copy()
    K[:2, 2] += width, height
    posed = se3.transform(scene.T_cam_obj[n], scene.object.vertices)
    whole = render_coverage(posed, scene.object.faces, K, (3 * width, 3 * height))
    seen = whole[height : 2 * height, width : 2 * width].copy()
    depth, _ = depth_and_face(posed, scene.object.faces, scene.K[n], scene.size)
    for hand in scene.hands:
        if hand.known[n]:
            seen &= depth < depth_and_face(hand.in_camera[n], hand.faces, scene.K[n], scene.size)[0]
    return whole, seen


def _bounding_box(pixels: Bool[ndarray, "h w"], origin: tuple[int, int]) -> list[int]:
    """Return left, top, width and height of pixels, from an origin; -1 each without any, as the BOP toolkit."""
    if not pixels.any():
        return [-1, -1, -1, -1]
    rows, columns = np.flatnonzero(pixels.any(axis=1)), np.flatnonzero(pixels.any(axis=0))
    left, top = int(columns[0]), int(rows[0])
    return [left - origin[0], top - origin[1], int(columns[-1]) + 1 - left, int(rows[-1]) + 1 - top]


def naming_of(scene: Scene) -> BopFileNames:
    """Name a scene's files, for a clip of one of BOP's own datasets as in that dataset."""
    if {"dataset", "split", "camera"} <= scene.bop.keys():
        of = scene.bop
        return BopFileNames(of["dataset"], of["split"], f"_{of['camera']}", of["camera"])
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
