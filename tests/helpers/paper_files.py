"""Small folders of EPIC-Grasps and ARCTIC in the official layouts, with MANO stood in for by a file of our making."""

from __future__ import annotations

import pickle
from pathlib import Path

import cv2
import numpy as np

from getagrip.geometry import se3
from helpers.epic_files import V, box, dense, hand, row, sparse, thing, write, write_mapping, write_table
from helpers.held_ball import ball, bent, posed, write_mano

SIZE = (456, 256)
"""EPIC-KITCHENS' images."""
CATEGORIES = {"mug": ("left", 1000), "bowl": ("right", 1200)}
"""Side and first frame of the grasp of each."""
LENGTH = 9


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
    """HaMeR's records and FrankMocap's pickles of each clip's frames, by their own formulas, in images of 456 x 256."""
    for category, (side, first) in CATEGORIES.items():
        model, shaped = posed(root / "mano", side)
        s, centre, size = 6.0, np.array([200.0, 136.0]), 130.0
        for n in range(LENGTH):
            shift = np.array([1.6 * n / size, 0.0])
            R = se3.exp_so3(np.array([0.2, 0.03 * n, 0.1]))
            fingers = se3.exp_so3(bent("right").reshape(15, 3))
            flip = np.diag([-1.0, 1.0, 1.0])
            hamer = root / "hamer" / clip_name(category)
            hamer.mkdir(parents=True, exist_ok=True)
            np.savez(
                hamer / f"frame_{first + n:010d}_0.npz", global_orient=R[None], hand_pose=fingers, betas=np.zeros(10),
                right=float(side == "right"), img_size=np.array(SIZE, float), pred_cam=np.array([s, *shift]),
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
