"""A small folder of EPIC-Grasps: a table of one grasp, VISOR's annotations of it, images, and a hand."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial.transform import Rotation

from getagrip.geometry import se3
from getagrip.hands import generic
from getagrip.hands.model import hand_track
from helpers.command_line import Run
from helpers.visor_files import box, dense, hand, sparse, thing, write, write_mapping

V = "P01_101"
"""A video of the extension: 50 frames a second."""
NAME = f"{V}_left_bottle_1000_1099"
OFFSET = 2
"""VISOR's numbers are so much higher than EPIC's."""
OBJECT, HAND, OTHER_HAND, HOB = (
    box(400, 200, 499, 349), box(360, 240, 420, 300), box(520, 210, 560, 260), box(0, 0, 853, 479),
)  # fmt: skip


def row(**changed: object) -> dict[str, object]:
    """A row of the table: a bottle in the left hand, frames 1000 to 1099."""
    values = {
        "vid": V, "st_bound": 900, "ed_bound": 1300, "st": 1000, "ed": 1099, "contact": 1010, "handside": "left hand",
        "cat": "bottle", "hos_name": "olive oil bottle", "mp4_name": f"{V}_900_1010_1300_left_bottle.mp4",
        "set_name": "Set001", "round": "round1", "duration": 100, "n_unfiltered_masks": 100, "n_filtered_masks": 90,
        "good_CAD": 1, "example": 0, "fmt": f"bottle/{V}_left_hand_1000_1099", "ablate_inithand": 0,
    }  # fmt: skip
    return values | changed


def write_table(path: Path, *rows: dict[str, object]) -> Path:
    with path.open("w", newline="") as stream:
        table = csv.DictWriter(stream, list(rows[0]))
        table.writeheader()
        table.writerows(rows)
    return path


def scene(scale: float = 1.0, *, hidden: bool = False) -> list[dict[str, Any]]:
    """A bottle in the left hand before the hob, a spoon in front of its corner, and the right hand beside."""

    def at(polygon: list[list[float]]) -> list[list[float]]:
        return (np.array(polygon) * scale).tolist()

    bottle = [] if hidden else [thing("b", "olive oil bottle", 15, at(OBJECT))]
    return [
        *bottle,
        hand("left", "b", at(HAND)),
        hand("right", "hand-not-in-contact", at(OTHER_HAND)),
        thing("s", "spoon", 1, at(box(440, 330, 520, 400))),
        thing("h", "hob", 24, at(HOB)),
    ]


def write_epic(root: Path) -> Path:
    """A table of one grasp, VISOR's dense and sparse annotations of it, and EPIC's images."""
    ends = (1000 + OFFSET, 1080 + OFFSET)
    numbers = [n for n in range(1000, 1081) if not 1020 <= n < 1040]  # interpolations are not always good enough
    write(root / "visor" / "dense" / f"{V}_interpolations.json",
          [dense(V, n + OFFSET, ends, *scene(hidden=n == 1050)) for n in [990, *numbers]])  # fmt: skip
    write(root / "visor" / f"{V}.json", [sparse(V, 1080 + OFFSET, *scene(1920 / 854))])
    write_mapping(root / "visor" / "frame_mapping.json", V, {n: n - OFFSET for n in ends})
    write_table(root / "grasps.csv", row())
    images = root / "images" / "P01" / "rgb_frames" / V
    images.mkdir(parents=True)
    for n in range(1000, 1100):
        cv2.imwrite(str(images / f"frame_{n:010d}.jpg"), np.full((256, 456, 3), n % 256, np.uint8))
    return root


def write_timeline(root: Path, T_world_cam: Float[ndarray, "n 4 4"], scale: float = 0.4) -> Path:
    """EPIC-HIT's list of one timeline, EPIC-Fields' cameras of frames 1000, 1001, ..., and what makes them metric.

    ``T_world_cam`` is where the camera is in the metric world.
    """
    T_metric = se3.rigid(se3.exp_so3(np.array([2.0, 0.4, -0.7])), np.array([0.5, -0.2, 1.1]))
    T_fields = se3.inverse(T_metric) @ T_world_cam
    T_fields[:, :3, 3] /= scale
    T = se3.inverse(T_fields)
    q = Rotation.from_matrix(T[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
    poses = np.concatenate([q, T[:, :3, 3]], axis=1)
    camera = {"model": "OPENCV", "width": 456, "height": 256, "params": [220.0, 221.0, 228.0, 128.0, 0, 0, 0, 0]}
    images = {f"frame_{1000 + n:010d}.jpg": pose.tolist() for n, pose in enumerate(poses)}
    similarity = np.diag([scale, scale, scale, 1.0])
    contents: dict[str, object] = {
        f"cameras/{V}.json": {"camera": camera, "images": images, "points": []},
        f"metric/{V}.json": {"T": (T_metric @ similarity).tolist()},
        "hit.json": [{
            "timeline_name": f"{V}_left_bottle_1000_1090", "vid": V, "cat": "bottle", "main_side": "left",
            "mp4_name": f"{V}_900_1010_1300_left_bottle", "total_start": 1000, "total_end": 1090,
            "segments": [
                {"st": 1000, "ed": 1040, "side": None, "ref": "scene_static"},
                {"st": 1040, "ed": 1060, "side": None, "ref": "scene_dynamic"},
                {"st": 1062, "ed": 1090, "side": "left", "ref": "inhand"},
            ],
        }],
    }  # fmt: skip
    for name, content in contents.items():
        (root / name).parent.mkdir(exist_ok=True)
        (root / name).write_text(json.dumps(content))
    return root / "hit.json"


def hand_arrays(frames: int) -> dict[str, Any]:
    """A generic left hand half a metre before the camera."""
    T = np.tile(se3.rigid(None, np.array([0.0, 0.0, 0.5])), (frames, 1, 1))
    track = hand_track(generic.load("left").with_shape().with_pose(np.zeros((frames, 45))), T)
    regions = {f"region_{name}": ids for name, ids in track.regions.items()}
    return {"vertices": track.vertices, "faces": track.faces, "T_cam_hand": track.T_cam_hand} | regions


def import_epic(run: Run, root: Path, *more: object) -> tuple[int, str, str]:
    return run("import", "epic", root / "grasps.csv", "--visor", root / "visor", "--frames", root / "images",
               "--out", root / "out", *more)  # fmt: skip
