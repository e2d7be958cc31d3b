"""Files of estimators and datasets as their public writers make them, of a known hand.

Random numbers in the layout of MANO's published files, pickled as they are.

Files of hand estimators, written by their own formulas from a known hand.

Hands from estimators' files: what tests of them ask for and look at.
"""

from __future__ import annotations

import json
import pickle
import sys
import types
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy import ndarray

from getagrip.geometry import se3
from getagrip.hands import generic, mano
from getagrip.hands.model import KNUCKLES, PARENTS, SIDE_MIRROR, Side, mirrored, mirrored_pose
from getagrip.io import arrays
from getagrip.readers.trackers import Request, TrackedHands
from getagrip.readers.trackers.dynhamr import mano_root_joint
from getagrip.readers.trackers.estimates import mirror_rotation, vitdet_side


def make_class(monkeypatch: pytest.MonkeyPatch, module: str, name: str) -> type:
    """A class that pickles under the name of one of chumpy's or old scipy's."""
    kind = type(name, (), {"__module__": module})
    where = types.ModuleType(module)
    setattr(where, name, kind)
    for parent in (module.split(".", maxsplit=1)[0], module):
        if parent not in sys.modules or parent == module:
            monkeypatch.setitem(sys.modules, parent, where)
    return kind


def holding(kind: type, **state: Any) -> Any:
    it = kind()
    it.__dict__.update(state)
    return it


def fake_mano(monkeypatch: pytest.MonkeyPatch, side: Side = "right") -> dict[str, Any]:
    """Random numbers in the layout of the published file; vertices and weights are some of the generic hand's."""
    ch = make_class(monkeypatch, "chumpy.ch", "Ch")
    select = make_class(monkeypatch, "chumpy.reordering", "Select")
    csc = make_class(monkeypatch, "scipy.sparse.csc", "csc_matrix")
    rng = np.random.default_rng(0)
    hand = generic.load(side)
    some = rng.permutation(len(hand.template))[:778]
    v, weights = hand.template[some], hand.weights[some]
    J_regressor = np.zeros((16, 778))
    for j in range(16):  # each joint is the mean of two vertices
        pair = np.array([2 * j, 2 * j + 1])
        J_regressor[j, pair] = 0.5
        v[pair] = hand.joints[j] + 0.01 * np.array([[1.0], [-1.0]])
    for n, tip in enumerate(mano.FINGERTIP_VERTICES[side]):
        v[tip] = hand.template[hand.tips[n]]
        weights[tip] = np.arange(16) == KNUCKLES[n] + 2
    cols, rows = np.nonzero(J_regressor.T)
    x = rng.normal(scale=1e-3, size=(778, 3, 20))
    kept = np.arange(x.size).reshape(x.shape)[:, :, :10].ravel()
    return {
        "hands_components": rng.normal(size=(45, 45)),
        "hands_coeffs": rng.normal(size=(1554, 45)),
        "hands_mean": rng.normal(scale=0.2, size=45),
        "f": rng.integers(0, 778, size=(1538, 3)).astype(np.uint32),
        "J_regressor": holding(
            csc,
            _shape=(16, 778),
            maxprint=50,
            data=J_regressor[rows, cols],
            indices=rows.astype(np.int32),
            indptr=np.searchsorted(cols, np.arange(779)).astype(np.int32),
        ),
        "kintree_table": np.array([[2**32 - 1, *PARENTS[1:]], range(16)], dtype=np.uint32),
        "J": J_regressor @ v,
        "weights": weights / weights.sum(axis=1, keepdims=True),
        "posedirs": rng.normal(scale=1e-3, size=(778, 3, 135)),
        "shapedirs": holding(select, a=holding(ch, x=x), idxs=kept, preferred_shape=(778, 3, 10)),
        "v_template": v,
        "bs_style": "lbs",
        "bs_type": "lrotmin",
        "pose_training_info": {"gender": set()},
    }


def python2(content: object) -> bytes:
    """A protocol 2 pickle with the module names of that time."""
    return pickle.dumps(content, protocol=2).replace(b"cnumpy._core.", b"cnumpy.core.")


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


FOCAL, CENTRE = 900.0, np.array(SIZE) / 2.0


def plain(value: Any) -> Any:
    """A value as JSON has it."""
    if isinstance(value, dict):
        return {key: plain(one) for key, one in value.items()}
    return np.asarray(value).tolist() if isinstance(value, ndarray | np.generic) else value


def write_json(path: Path, content: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, default=plain), encoding="utf-8")
    return path


def translation(known: Known) -> ndarray:
    """The translations with which a camera of another focal length shows the hand where the clip's does."""
    return by_other_camera(known.t)


def by_other_camera(points: ndarray) -> ndarray:
    """Points (T, 3) that a camera of another focal length sees where the clip's does, as many pixels to the metre."""
    u = K[:2, 2] + K[0, 0] * points[:, :2] / points[:, 2:]
    z = points[:, 2:] * FOCAL / K[0, 0]
    return np.hstack([z * (u - CENTRE) / FOCAL, z])


def in_world(known: Known, folder: Path | None) -> tuple[ndarray, ndarray, ndarray]:
    """The hand's rotations and translations in a world, and ``T_cam_world`` of a moving camera."""
    rng = np.random.default_rng(3)
    count = len(known.R)
    T = se3.rigid(se3.exp_so3(rng.normal(scale=0.4, size=(count, 3))), rng.normal(size=(count, 3)))
    root = np.array([mano_root_joint(folder, known.side, betas) for betas in known.betas])
    t = se3.transform(se3.inverse(T), (root + translation(known))[:, None])[:, 0] - root
    return np.swapaxes(T[:, :3, :3], 1, 2) @ known.R, t, T


def hawor_folder(place: Path, known: Known, folder: Path | None) -> Path:
    """HaWoR's folder, its hands in the world converted to an .npz."""
    R, t, T_cam_world = in_world(known, folder)
    count, row = len(t), int(known.side == "right")
    fields = {"pred_trans": t, "pred_rot": se3.log_so3(R), "pred_hand_pose": known.pose, "pred_betas": known.betas}
    both = {key: np.zeros((2, *value.shape)) for key, value in fields.items()}
    for key, value in fields.items():
        both[key][row] = value
    valid = np.zeros((2, count), dtype=bool)
    valid[row] = True
    write_npz(place / "world_space_res.npz", both | {"pred_valid": valid})
    T = se3.inverse(T_cam_world)
    q = se3.quaternion(T[:, :3, :3])[:, [1, 2, 3, 0]]
    (place / "SLAM").mkdir()
    slam = {"traj": np.hstack([T[:, :3, 3] / 2.5, q]), "scale": 2.5, "img_focal": FOCAL, "img_center": CENTRE}
    write_npz(place / "SLAM" / f"hawor_slam_w_scale_0_{count}.npz", slam | {"tstamp": np.arange(count)})
    (place / "est_focal.txt").write_text(str(FOCAL))
    return place


def hawor_cam_space(place: Path, known: Known) -> Path:
    """HaWoR's cam_space, of frames 7 to 9, with a file for the other hand."""
    record = {
        "init_root_orient": known.R[None], "init_hand_pose": se3.exp_so3(known.pose.reshape(-1, 15, 3))[None],
        "init_betas": known.betas[None], "init_trans": translation(known)[None],
    }  # fmt: skip
    other = {**record, "init_trans": translation(known)[None] + [0.3, 0.0, 0.0]}
    for row, content in ((int(known.side == "right"), record), (int(known.side == "left"), other)):
        write_json(place / "cam_space" / str(row) / "6_8.json", content)
    (place / "est_focal.txt").write_text(str(FOCAL))
    return place


def dynhamr_file(place: Path, known: Known, folder: Path | None) -> Path:
    """Dyn-HaMR's results: a track of each side, a left hand as the right one that it is the mirror image of."""
    R, t, T_cam_world = in_world(known, folder)
    pose = se3.exp_so3(known.pose.reshape(-1, 15, 3))
    if known.side == "left":
        R, pose, t = mirror_rotation(R), mirror_rotation(pose), t * SIDE_MIRROR
    rows = [np.zeros_like(t), t] if known.side == "right" else [t, np.zeros_like(t)]
    both = {"trans": np.stack(rows), "root_orient": np.stack([se3.log_so3(R)] * 2)}
    right = np.repeat([[0.0], [1.0]], len(t), axis=1)
    both |= {"pose_body": np.stack([se3.log_so3(pose)] * 2), "betas": np.stack([known.betas[0]] * 2)}
    both |= {"cam_R": np.stack([T_cam_world[:, :3, :3]] * 2), "cam_t": np.stack([T_cam_world[:, :3, 3]] * 2)}
    both |= {"is_right": right, "intrins": np.array([FOCAL, FOCAL, *CENTRE])}
    return write_npz(place / "clip_000300_world_results.npz", both)


def fasthamer_files(place: Path, known: Known) -> Path:
    """fasthamer's results as ``dataclasses.asdict`` has them, one for each image."""
    for n, frame in enumerate(FRAMES[: len(known.R)]):
        R, fingers = known.raw(n)
        hand = {"is_right": known.side == "right", "bbox": [0, 0, 9, 9], "cam_t": translation(known)[n]}
        hand |= {"global_orient": R, "hand_pose": fingers, "betas": known.betas[n]}
        result = {"hands": [hand], "focal": FOCAL, "cx": CENTRE[0], "cy": CENTRE[1], "image_size": list(SIZE)}
        write_json(place / f"{frame}.json", result)
    return place


def v2d_tracks(place: Path, known: Known) -> Path:
    """V2D's hand tracks: a folder for each track, with the network's right hands."""
    for n, frame in enumerate(FRAMES[: len(known.R)]):
        R, fingers = known.raw(n)
        mano = {"betas": known.betas[n], "global_orient": se3.log_so3(R), "hand_pose": se3.log_so3(fingers).ravel()}
        camera = {"scaled_focal_length": FOCAL, "pred_cam_t_full": translation(known)[n]}
        for track, right in ((2, False), (3, True)):
            record = {"track_id": track, "is_right": right, "frame_idx": n, "image_size": list(SIZE)}
            write_json(place / str(track) / f"{frame}.json", {**record, "camera": camera, "mano": mano})
    return place


def v2d_result(place: Path, known: Known) -> Path:
    """V2D's result, as ``write_result_bundle`` makes it, of a hand that is half as large again, and farther away."""
    count, scale = len(known.R), 1.5
    raw = [known.raw(n) for n in range(count)]
    hand = {
        "betas": known.betas[0], "wrist_orient_in_camera": se3.log_so3(np.array([R for R, _ in raw])),
        "finger_pose": se3.log_so3(np.array([fingers for _, fingers in raw])),
        "wrist_trans_in_camera": scale * translation(known), "scale": np.full(count, scale),
        "is_valid": np.ones(count, dtype=bool),
    }  # fmt: skip
    arrays = {"camera_intrinsics": np.array([FOCAL, FOCAL, *CENTRE], dtype=np.float32)}
    arrays["camera_to_world_transform"] = np.tile(np.eye(4), (count, 1, 1))
    for side in ("left", "right"):
        there = float(side == known.side)
        arrays |= {f"hand_{side}_{key}": (value * there).astype(value.dtype) for key, value in hand.items()}
    (place / "result").mkdir()
    write_npz(place / "result" / "result.npz", arrays)
    return place


def egovision_file(place: Path, known: Known) -> Path:
    """ego-vision's result, whose frames without a hand are NaN."""
    rng = np.random.default_rng(5)
    count = len(known.R)
    T_world_cam = se3.rigid(se3.exp_so3(rng.normal(scale=0.4, size=(count, 3))), rng.normal(size=(count, 3)))
    at = known.joints[:, 0]
    moved = by_other_camera(at)
    joints = se3.transform(T_world_cam, known.joints - at[:, None] + moved[:, None])
    hand = {"joints_world": joints, "mano_pose": np.zeros((count, 96)), "infilled": np.arange(count) == 1}
    none = {"joints_world": np.full((count, 21, 3), np.nan), "infilled": np.zeros(count, dtype=bool)}
    K_own = np.tile([[FOCAL, 0.0, CENTRE[0]], [0.0, FOCAL, CENTRE[1]], [0.0, 0.0, 1.0]], (count, 1, 1))
    sides = {side: hand if side == known.side else none for side in ("left", "right")}
    result = {"episode_id": "episode", "fps": 30.0, "camera_trajectory": T_world_cam, "intrinsics": K_own}
    return write_json(place / "result.json", result | {"hands_world": sides, "metadata": {"vggt_seq_length": 64}})


def _egohandkit_hands(known: Known, n: int) -> list[tuple[dict[str, Any], ndarray, dict[str, Any]]]:
    """The known hand and one of the other side, of the network HaWoR, as ``BackendOutputInstance`` has them."""
    R, fingers = known.raw(n)
    mano = {"global_orient": R[None], "hand_pose": fingers, "betas": known.betas[n]}
    meta = {"backend": "hawor", "img_focal": FOCAL, "img_center": list(CENTRE), "segment_range": [0, 3]}
    right = int(known.side == "right")
    own = ({**mano, "is_right": right}, translation(known)[n], meta)
    return [own, ({**mano, "is_right": 1 - right}, own[1] + [0.2, 0.0, 0.0], meta)]


def egohandkit_pickle(place: Path, known: Known) -> Path:
    """EgoHandKit's ``<name>_hawor.pkl``."""
    results = {}
    for n, frame in enumerate(FRAMES[: len(known.R)]):
        mano, t, meta = (list(each) for each in zip(*_egohandkit_hands(known, n), strict=True))
        content = {"mano": mano, "cam_trans": t, "backend_meta": meta, "tracked_ids": [1, 0], "tracked_time": [0, 0]}
        results[f"images/clip/{frame}.jpg"] = content | {"extra_data": [[[0.0, 0.0, 1.0]] * 21] * 2, "shot": 0}
    (place / "clip_hawor.pkl").write_bytes(pickle.dumps(results))
    (place / "pass1_raw.pkl").write_bytes(pickle.dumps([{"frame_idx": 0, "left_bbox": None}]))
    return place


def egohandkit_results(place: Path, known: Known) -> Path:
    """EgoHandKit's ``final/results.pkl``, its first image without a hand."""
    frames = [{"frame_idx": 0, "img_path": "images/clip/000006.jpg", "timestamp_ns": None, "hands": []}]
    for n, frame in enumerate(FRAMES[: len(known.R)]):
        each = _egohandkit_hands(known, n)
        hands = [{"track_id": 1, "handedness": "right", "mano": m, "cam_trans": t, "meta": meta} for m, t, meta in each]
        frames.append({"frame_idx": n + 1, "img_path": f"images/clip/{frame}.jpg", "hands": hands})
    (place / "final").mkdir()
    results = {"schema_version": "egohand.results.v1", "backend": "hawor", "frames": frames}
    (place / "final" / "results.pkl").write_bytes(pickle.dumps(results))
    return place


def landmarks(known: Known) -> ndarray:
    """The joints in the clip's images (T, 21, 2) [px]."""
    seen = known.joints @ K.T
    return np.asarray(seen[..., :2] / seen[..., 2:])


def mediapipe_files(place: Path, known: Known) -> Path:
    """MediaPipe's results (HandLandmarker), one for each image: shares of the sides."""
    for frame, points in zip(FRAMES, landmarks(known) / SIZE, strict=False):
        hand = [{"x": x, "y": y, "z": 0.0, "visibility": 0.0} for x, y in points]
        side = [{"index": 0, "score": 0.9, "category_name": "Left", "display_name": "Left"}]
        write_json(place / f"{frame}.json", {"hand_landmarks": [hand], "handedness": [side]})
    return place


def mmpose_file(place: Path, known: Known) -> Path:
    """MMPose's predictions of a video, COCO-WholeBody's keypoints of two people."""
    frames = []
    for frame, points in zip(FRAMES, landmarks(known), strict=False):
        keypoints, scores = np.zeros((133, 2)), np.full(133, 0.9)
        start = 91 if known.side == "left" else 112
        keypoints[start : start + 21] = points
        person = {"keypoints": keypoints, "keypoint_scores": scores, "bbox": [[0, 0, 9, 9]], "bbox_score": 0.9}
        other = {**person, "keypoints": keypoints + 200.0, "keypoint_scores": scores / 3.0}
        frames.append({"frame_id": int(frame), "instances": [other, person]})
    return write_json(place / "results_clip.json", {"meta_info": {"num_keypoints": 133}, "instance_info": frames})


def soma_joints(joints: ndarray) -> ndarray:
    """SOMA's 25 joints of the 21, the metacarpal ones beside the wrist."""
    fingers = [joints[:, first : first + 4] for first in range(5, 21, 4)]
    bases = [0.8 * joints[:, :1] + 0.2 * finger[:, :1] for finger in fingers]
    each = [part for pair in zip(bases, fingers, strict=True) for part in pair]
    return np.concatenate([joints[:, :5], *each], axis=1)


SIDES: list[Side] = ["right", "left"]


def request(side: Side, folder: Path | None = None) -> Request:
    return Request(side, FRAMES, np.tile(K, (3, 1, 1)), SIZE, folder)


def joints_of(hands: TrackedHands) -> ndarray:
    assert hands.track.joints is not None
    return se3.transform(hands.track.T_cam_hand, hands.track.joints)
