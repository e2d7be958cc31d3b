"""A small folder of EPIC-Grasps: a table of one grasp, VISOR's annotations of it, images, and a hand.

Small files of exactly VISOR's schema, of whose masks the answer is known.

Small folders of EPIC-Grasps and ARCTIC in the official layouts, with MANO stood in for by a file of our making.
"""

from __future__ import annotations

import csv
import json
import pickle
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
from helpers.environment import Run
from helpers.held_ball import ball, bent, posed, write_mano

HANDS = {"left": 300, "right": 301}


def box(x0: float, y0: float, x1: float, y1: float) -> list[list[float]]:
    """The corners of a rectangle."""
    return [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]


def thing(id_: str, name: str, class_id: int, *polygons: Any, **more: Any) -> dict[str, Any]:
    """An annotation."""
    return {"id": id_, "name": name, "class_id": class_id, "exhaustive": "y", "segments": list(polygons)} | more


def hand(side: str, touches: str | None, *polygons: Any) -> dict[str, Any]:
    """A hand that touches something."""
    return thing(f"{side}-hand", f"{side} hand", HANDS[side], *polygons, in_contact_object=touches)


def sparse(video: str, number: int, *annotations: dict[str, Any]) -> dict[str, Any]:
    """A frame that people have annotated."""
    name = f"{video}_frame_{number:010d}.jpg"
    image = {"image_path": f"{video}/{name}", "name": name, "subsequence": f"{video}_seq_00001", "video": video}
    return {"image": image, "annotations": list(annotations)}


def dense(video: str, number: int, ends: tuple[int, int], *annotations: dict[str, Any]) -> dict[str, Any]:
    """A frame that was interpolated between two others."""
    names = [f"{video}_frame_{n:010d}.jpg" for n in (number, *ends)]
    image = {
        "image_path": f"{video}/{names[0]}",
        "name": names[0],
        "video": video,
        "interpolation": f"{video}_interpolation_0001",
        "interpolation_start_frame": names[1],
        "interpolation_end_frame": names[2],
    }
    kind = int(number in ends)
    return {"image": image, "annotations": [{**annotation, "type": kind} for annotation in annotations]}


def write(path: Path, frames: list[dict[str, Any]]) -> Path:
    """A file of VISOR's."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"info": {"version": "1.1", "n": 1.5e3}, "video_annotations": frames}))
    return path


def write_mapping(path: Path, video: str, epic: dict[int, int]) -> Path:
    """A frame_mapping.json, with another video before."""
    names = {f"{video}_frame_{a:010d}.jpg": f"frame_{b:010d}.jpg" for a, b in epic.items()}
    path.write_text(json.dumps({"P00_01": {"P00_01_frame_0000000140.jpg": "frame_0000000138.jpg"}, video: names}))
    return path


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


SIZE = (456, 256)
"""EPIC-KITCHENS' images."""
CATEGORIES = {"mug": ("left", 1000), "bowl": ("right", 1200)}
"""Side and first frame of the grasp of each."""
LENGTH = 4


def clip_name(category: str) -> str:
    side, first = CATEGORIES[category]
    return f"{V}_{side}_{category}_{first}_{first + LENGTH - 1}"


def write_epic_paper(root: Path) -> Path:
    """Everything that ``reproduce epic-grasps`` needs but hands: two grasps of two categories, of 9 frames each."""
    rows, frames, mapping = [], [], {}
    images = root / "EPIC-KITCHENS" / "P01" / "rgb_frames" / V
    images.mkdir(parents=True)
    for n, (category, (side, first)) in enumerate(CATEGORIES.items()):
        last = first + LENGTH - 1
        rows.append(row(
            st_bound=first - 50, ed_bound=last + 50, st=first, ed=last, contact=first, handside=f"{side} hand",
            cat=category, hos_name=category, mp4_name=f"{V}_{first}_{first}_{last}_{side}_{category}.mp4",
            duration=LENGTH, example=n, fmt=f"{category}/{V}_{side}_hand_{first}_{last}",
        ))  # fmt: skip
        for number in range(first, last + 1):
            shift = 3 * (number - first)
            seen = [
                thing("b", category, 15, box(380 + shift, 180, 480 + shift, 290)),
                hand(side, "b", box(350 + shift, 220, 400 + shift, 290)),
            ]
            frames.append(dense(V, number, (first, last), *seen))
            cv2.imwrite(str(images / f"frame_{number:010d}.jpg"), np.full((*SIZE[::-1], 3), 90, np.uint8))
        mapping |= {first: first, last: last}
    write(root / "visor" / f"{V}_interpolations.json", frames)
    write(root / "visor" / f"{V}.json", [sparse(V, 900, hand("left", None, box(0, 0, 90, 90)))])
    write_mapping(root / "visor" / "frame_mapping.json", V, mapping)
    write_table(root / "epicgrasps_2431.csv", *rows)
    for category, (side, _) in CATEGORIES.items():
        (root / "cad").mkdir(exist_ok=True)
        ball(0.05).export(root / "cad" / f"{category}.obj")
        (root / "pose_priors" / category).mkdir(parents=True)
        for k, turn in enumerate((0.0, 0.8)):
            T = se3.rigid(se3.exp_so3(np.array([turn, 0.0, 0.0])), np.array([0.0, -0.06, 0.0]))
            np.save(root / "pose_priors" / category / f"{side}_rxx{k}.npy", T)
    write_mano(root / "mano")
    return root


def write_demos(root: Path) -> None:
    """HaMeR's records and FrankMocap's pickles of the images of clips, 854 x 480, by their own formulas."""
    for category, (side, first) in CATEGORIES.items():
        model, shaped = posed(root / "mano", side)
        s, centre, size = 6.0, np.array([375.0, 255.0]), 244.0
        for n in range(LENGTH):
            shift = np.array([1.6 * n / size, 0.0])
            R = se3.exp_so3(np.array([0.2, 0.03 * n, 0.1]))
            fingers = se3.exp_so3(bent("right").reshape(15, 3))
            flip = np.diag([-1.0, 1.0, 1.0])
            hamer = root / "hamer" / clip_name(category)
            hamer.mkdir(parents=True, exist_ok=True)
            np.savez(
                hamer / f"frame_{first + n:010d}_0.npz", global_orient=R[None], hand_pose=fingers, betas=np.zeros(10),
                right=float(side == "right"), img_size=np.array([854.0, 480.0]), pred_cam=np.array([s, *shift]),
                box_center=centre, box_size=size,
            )  # fmt: skip
            seen = R if side == "right" else flip @ R @ flip
            vertices = (shaped.vertices @ seen.T).astype(float)
            record = {
                "pred_camera": np.array([s, *shift]), "bbox_scale_ratio": np.float64(224.0 / size),
                "bbox_top_left": tuple(np.int64(centre - size / 2)),
                "pred_hand_pose": np.array([[*se3.log_so3(seen), *(bent(side) - model.mean)]]),
                "pred_hand_betas": np.ones((1, 10)), "pred_vertices_smpl": vertices,
            }  # fmt: skip
            hands = {"left_hand": {}, "right_hand": {}} | {f"{side}_hand": record}
            content = {
                "image_path": "x.jpg",
                "demo_type": "hand",
                "hand_bbox_list": [None],
                "pred_output_list": [hands],
            }
            frank = root / "frankmocap" / clip_name(category)
            frank.mkdir(parents=True, exist_ok=True)
            path = frank / f"frame_{first + n:010d}_prediction_result.pkl"
            path.write_bytes(pickle.dumps(content, protocol=2))
