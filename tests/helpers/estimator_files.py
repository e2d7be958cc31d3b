"""Files of hand estimators, written by their own formulas from a known hand."""

from __future__ import annotations

from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy import ndarray

from getagrip.geometry import se3
from getagrip.hands import generic, mano
from getagrip.hands.model import SIDE_MIRROR, Side, mirrored, mirrored_pose
from getagrip.io import arrays
from getagrip.readers.trackers.estimates import mirror_rotation, vitdet_side
from helpers.mano_files import fake_mano, python2

SIZE = (640, 480)
K = np.array([[612.0, 0.0, 311.0], [0.0, 612.0, 247.0], [0.0, 0.0, 1.0]])
FRAMES = ("000007", "000008", "000009")
PIXELS = np.random.default_rng(7).uniform(0.0, 480.0, (3, 21, 2))
"""Joints as another network saw them: kept as they are."""


def write_mano_files(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """MANO files of the published layout, the left hand the right one's mirror image, its fault included."""
    right = fake_mano(monkeypatch)
    right["f"] = np.stack([np.arange(1538) % 700, np.arange(1538) % 700 + 1, np.arange(1538) % 700 + 3], axis=1)
    for values in (right["v_template"], right["weights"], right["posedirs"], right["shapedirs"].a.x):
        values[445] = values[444]  # the tip of a left middle finger, and of a right one
    (folder / "MANO_RIGHT.pkl").write_bytes(python2(right))
    left = dict(right) | {"v_template": mirrored(right["v_template"]), "J": mirrored(right["J"])}
    m = np.tile(np.outer(SIDE_MIRROR, SIDE_MIRROR).ravel(), 15)
    left["posedirs"] = right["posedirs"] * SIDE_MIRROR[:, None] * m
    left["hands_mean"], left["hands_components"] = (mirrored_pose(right[k]) for k in ("hands_mean", "hands_components"))
    left["shapedirs"] = right["shapedirs"]  # of the published left hand, y and z are right, and x is not mirrored
    (folder / "MANO_LEFT.pkl").write_bytes(python2(left))
    return folder


class Known:
    """A hand in a few frames, by MANO's equations: what an estimator that makes no mistake sees."""

    def __init__(self, side: Side, folder: Path | None, frames: int = 3, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        self.side = side
        self.R = se3.exp_so3(rng.normal(scale=0.8, size=(frames, 3)))
        self.pose = rng.normal(scale=0.25, size=(frames, 45))
        self.betas = rng.normal(scale=0.5, size=(frames, 10)) if folder else np.zeros((frames, 10))
        self.t = np.array([0.03, -0.02, 0.55]) + rng.normal(scale=0.02, size=(frames, 3))
        model = generic.load(side)
        if folder:
            model = mano.load(folder / f"MANO_{side.upper()}.pkl", side).model
        shaped = model.with_shape(self.betas if folder else None)
        root = shaped.joints[..., 0, :]
        T = se3.rigid(self.R, root - (self.R @ root[..., None])[..., 0] + self.t)
        posed = shaped.with_pose(self.pose)
        self.joints, self.vertices = se3.transform(T, posed.joints), se3.transform(T, posed.vertices)

    def raw(self, n: int) -> tuple[ndarray, ndarray]:
        """Rotations as a network has them that sees left hands mirrored: of the whole hand, of the fingers."""
        R, fingers = self.R[n], se3.exp_so3(self.pose[n].reshape(15, 3))
        return (mirror_rotation(R), mirror_rotation(fingers)) if self.side == "left" else (R, fingers)


def cam_crop_to_full(cam: ndarray, centre: ndarray, side: float, size: tuple[int, int], focal: float) -> ndarray:
    """HaMeR's own function, for one hand (renderer.py)."""
    bs = side * cam[0] + 1e-9
    tx, ty = (2.0 * (centre - np.array(size) / 2.0) / bs) + cam[1:]
    return np.array([tx, ty, 2.0 * focal / bs])


def crop_camera(t: ndarray, centre: ndarray, side: float) -> ndarray:
    """The (s, tx, ty) with which a crop shows a translation before the true camera."""
    s = 2.0 * K[0, 0] / (side * t[2])
    u = K[:2, 2] + K[0, 0] * t[:2] / t[2]
    return np.array([s, *(2.0 * (u - centre) / (side * s))])


def hamer_record(known: Known, n: int, kind: str) -> dict[str, Any]:
    """What HaMeR's demo holds of one hand."""
    R, fingers = known.raw(n)
    centre, side = np.array([300.0 + 9 * n, 220.0]), 210.0
    cam = crop_camera(known.t[n], centre, side)
    record: dict[str, Any] = {
        "global_orient": R[None], "hand_pose": fingers, "betas": known.betas[n], "right": float(known.side == "right"),
        "img_size": np.array(SIZE, float),
    }  # fmt: skip
    if kind == "crop":
        return record | {"pred_cam": cam, "box_center": centre, "box_size": side}
    if kind == "full":
        focal = 5000.0 / 256.0 * max(SIZE)
        full = cam_crop_to_full(cam, centre, side, SIZE, focal)
        return record | {"pred_cam_t_full": full, "scaled_focal_length": focal}
    if kind == "assumed":
        return record | {"pred_cam_t_full": cam_crop_to_full(cam, centre, side, SIZE, 12500.0)}
    width, height = 70.0, 105.0
    half = np.array([width, height]) / 2.0
    box = np.concatenate([centre - half, centre + half])
    assert vitdet_side(np.array([width, height]), 2.0) == side
    return record | {"pred_cam": cam, "box_xyxy": box}


def write_npz(path: Path, content: dict[str, Any]) -> Path:
    arrays.write(path, {key: np.asarray(value) for key, value in content.items()})
    return path


def frankmocap_record(known: Known, n: int, mean: ndarray | float = 0.0) -> dict[str, Any]:
    """What FrankMocap's ``save_pred_to_pkl`` writes: fingers relative to a mean pose, vertices about an origin of its
    own, in a crop whose pixels the image's are scaled to, an empty dictionary for the hand that was not seen."""
    origin = known.t[n] + [0.08, 0.01, 0.0]
    ratio, corner = 0.9, np.array([180.0, 110.0])
    s = K[0, 0] / origin[2] * ratio / 112.0
    u = K[:2, 2] + K[0, 0] * origin[:2] / origin[2]
    shift = ((u - corner) * ratio / 112.0 - 1.0) / s
    hand = {
        "pred_camera": np.array([s, *shift]),
        "bbox_scale_ratio": np.float64(ratio),
        "bbox_top_left": tuple(np.int64(corner)),
        "pred_hand_pose": np.array([[*se3.log_so3(known.R[n]), *(known.pose[n] - mean)]]),
        "pred_hand_betas": np.ones((1, 10)),
        "pred_vertices_smpl": (known.vertices[n] - origin).astype(np.float64),
    }
    seen = corner + 112.0 / ratio * (1.0 + s * shift)  # convert_smpl_to_bbox, convert_bbox_to_oriIm at X = 0
    np.testing.assert_allclose(seen, u)
    hands = {"left_hand": {}, "right_hand": {}} | {f"{known.side}_hand": hand}
    boxes = [{"left_hand": None, "right_hand": np.zeros(4)}, None]
    return OrderedDict(image_path="x.jpg", demo_type="hand", hand_bbox_list=boxes, pred_output_list=[hands, None])


def demo_files(folder: Path, known: Known, n: int, joints: bool = True, mesh: bool = True) -> None:
    """What HaMeR's demo saves of a hand with ``--save_mesh --save_keypoints``, by its own formulas (demo.py)."""
    centre, side = np.array([300.0, 220.0]), 210.0
    t = cam_crop_to_full(crop_camera(known.t[n], centre, side), centre, side, SIZE, 5000.0 / 256.0 * max(SIZE))
    flip = SIDE_MIRROR if known.side == "left" else 1.0
    if mesh:
        vertices = (known.vertices[n] - known.t[n] + t) * [1.0, -1.0, -1.0]
        corners = [[3, 4, 5], [92, 38, 234]]
        lines = [f"v {x:.8f} {y:.8f} {z:.8f} 0.6 0.7 0.8" for x, y, z in vertices]
        faces = [c if known.side == "right" else [c[0], c[2], c[1]] for c in corners]
        lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces]
        (folder / f"{FRAMES[n]}_0.obj").write_text("\n".join(lines))
    if joints:
        rows = np.stack([(known.joints[n] - known.t[n]) * flip + t, known.joints[n]])  # another person's follow
        np.save(folder / f"{FRAMES[n]}_0_3dkeypoints.npy", rows.astype(np.float32))
