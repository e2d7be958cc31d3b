"""HO-Cap's folder with one sequence, of known poses.

HRDexDB's folder with one scene of its human part, of known poses.

HOI4D's folder with one sequence, of known poses.

HO-3D's folder with two sequences, of known poses.

A synthetic profile of a UmeTrack hand.

HOT3D's folder with one recording, of known poses.
"""

from __future__ import annotations

import csv
import json
import pickle
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from getagrip.geometry import se3
from getagrip.hands import generic
from getagrip.hands.fit_joints import JOINT_ORDERS
from getagrip.hands.mano import load
from helpers.held_ball import BETAS, FRAMES, ball, bent, global_motion, motion, posed

HELD = "025_mug"
LOST = 29
"""In this frame nothing is known."""
HO3D_K = np.array([[614.6, 0.0, 320.1], [0.0, 614.5, 241.4], [0.0, 0.0, 1.0]])
FLIP = np.diag([1.0, -1.0, -1.0])


def save(path: Path, content: Any) -> None:
    """As HO-3D's files are: a pickle of Python 2."""
    path.write_bytes(pickle.dumps(content, protocol=2).replace(b"cnumpy._core.", b"cnumpy.core."))


def write_ho3d(folder: Path, mano: Path) -> Path:
    """HO-3D's folder, with one sequence of the train split and one of the evaluation split."""
    root = folder / "HO3D"
    T_cam_hand, T_cam_obj = motion()
    joints = se3.transform(T_cam_hand, generic.load("right").with_shape().with_pose(bent()).joints)
    hand = load(mano / "MANO_RIGHT.pkl", "right")
    F = se3.rigid(FLIP)
    rot, trans = global_motion(F @ T_cam_hand, hand.model.with_shape(BETAS).joints[0])
    T_gl_obj = F @ T_cam_obj
    for split, sequence in (("train", "ABF12"), ("evaluation", "SM1")):
        meta = root / split / sequence / "meta"
        meta.mkdir(parents=True)
        for n in range(FRAMES):
            in_order = np.empty((21, 3))
            in_order[JOINT_ORDERS["ho3d"]] = joints[n]
            content: dict[str, Any] = {
                "objRot": se3.log_so3(T_gl_obj[n, :3, :3]).reshape(3, 1),
                "objTrans": T_gl_obj[n, :3, 3],
                "objName": HELD,
                "objLabel": 1,
                "objCorners3DRest": np.zeros((8, 3)),
                "camMat": HO3D_K,
                "camIDList": ["0", "1"],
            }
            if split == "train":
                content |= {
                    "handPose": np.concatenate([rot[n], bent()]),
                    "handTrans": trans[n],
                    "handBeta": BETAS,
                    "handJoints3D": in_order @ FLIP,
                }
            else:
                content |= {"handJoints3D": joints[n, 0] @ FLIP, "handBoundingBox": [0, 0, 100, 100]}
            if n == LOST:
                content |= dict.fromkeys(("objRot", "objTrans", "handPose", "handTrans", "handJoints3D"))
            save(meta / f"{n:04d}.pkl", content)
    (root / "models" / HELD).mkdir(parents=True)
    ball(0.03).export(root / "models" / HELD / "textured_simple.obj")
    return root


def write_ho3d_calibration(root: Path, recording: str, T_shared_cam: dict[str, np.ndarray]) -> Path:
    """The calibration of a recording by several cameras, by their digits, as version 3 has it."""
    folder = root / "calibration" / recording / "calibration"
    folder.mkdir(parents=True)
    np.savetxt(folder / "cam_orders.txt", [int(digit) for digit in T_shared_cam])
    for place, T in enumerate(T_shared_cam.values()):
        np.savetxt(folder / f"trans_{place}.txt", T)
        (folder / f"cam_{place}_intrinsics.txt").write_text("ppx: 330.0, ppy: 240.25, fx: 612.0, fy: 613.0\n")
    return folder


HOCAP_SERIALS = ("105322251564", "043422252387")
HOCAP_OBJECTS = ("G01_1", "G01_2", "G01_3")
"""The ball, a box on the table, and one without a mesh."""
HOCAP_WORLD = se3.rigid(se3.exp_so3(np.array([-2.0, 0.1, 0.2])), np.array([0.1, -0.5, 0.6]))
"""Pose of the first camera in the world."""
HOCAP_BESIDE = se3.rigid(se3.exp_so3(np.array([0.1, -1.2, 0.05])), np.array([0.65, 0.1, 0.4]))
"""Pose of the second camera in the first one's frame; the HoloLens is between them, and moves."""
HOLOLENS, HOLOLENS_LOST = "hololens_kv5h72", 8
LEFT_FROM = 20
"""The left hand is known from this frame on."""
HOCAP_META = f"""num_frames: {FRAMES}
object_ids: [{", ".join(HOCAP_OBJECTS)}]
mano_sides: [right, left]
task_id: 1
subject_id: subject_1
extrinsics: extrinsics_20231014.yaml
realsense:
  serials: ['{HOCAP_SERIALS[0]}', '{HOCAP_SERIALS[1]}']
  width: 640
  height: 480
hololens:
  serial: {HOLOLENS}
  pv_width: 320
  pv_height: 240
"""


def hololens_poses() -> np.ndarray:
    """Poses of the HoloLens in the world."""
    t = np.linspace(0.0, 1.0, FRAMES)
    turn = se3.exp_so3(np.stack([0.05 * t, -0.5 + 0.1 * t, 0.0 * t], axis=-1))
    return np.asarray(HOCAP_WORLD @ se3.rigid(turn, np.stack([0.3 - 0.05 * t, 0.0 * t, 0.05 + 0.0 * t], axis=-1)))


def left_hand_poses() -> np.ndarray:
    """Poses of the left hand in the first camera's frame."""
    return np.asarray(se3.rigid(None, np.array([-0.14, 0.0, 0.0])) @ motion()[0])


def as_quaternions(T: np.ndarray) -> np.ndarray:
    """Poses (..., 4, 4) as (x, y, z, w) and translations."""
    return np.concatenate([np.roll(se3.quaternion(T[..., :3, :3]), -1, axis=-1), T[..., :3, 3]], axis=-1)


def write_hocap(folder: Path, mano: Path) -> Path:
    """HO-Cap's folder, with one sequence of two hands; in the frame ``LOST`` the ball is unknown."""
    root = folder / "HOCap"
    sequence = root / "subject_1" / "20231025_165502"
    for name in ("intrinsics", "extrinsics", "mano"):
        (root / "calibration" / name).mkdir(parents=True)
    sequence.mkdir(parents=True)
    (sequence / "meta.yaml").write_text(HOCAP_META)
    for serial, f, width in ((HOCAP_SERIALS[0], 616.0, 640), (HOCAP_SERIALS[1], 600.0, 640), (HOLOLENS, 250.0, 320)):
        camera = f"  width: {width}\n  fx: {f}\n  fy: {f}\n  ppx: {width / 2 - 0.5}\n  ppy: {0.375 * width - 0.5}\n"
        path = root / "calibration" / "intrinsics" / f"{serial}.yaml"
        path.write_text(f"serial: '{serial}'\ncolor:\n{camera}")
    T_master = se3.rigid(se3.exp_so3(np.array([0.4, -0.2, 1.0])), np.array([1.0, 0.0, 2.0]))  # world to master
    poses = {"tag_0": np.eye(4), "tag_1": T_master, HOCAP_SERIALS[0]: T_master @ HOCAP_WORLD}
    poses[HOCAP_SERIALS[1]] = T_master @ HOCAP_WORLD @ HOCAP_BESIDE
    rows = "".join(f"  '{key}': {T[:3].ravel().tolist()}\n" for key, T in poses.items())
    text = f"rs_master: '{HOCAP_SERIALS[1]}'\nextrinsics:\n{rows}"
    (root / "calibration" / "extrinsics" / "extrinsics_20231014.yaml").write_text(text)
    (root / "calibration" / "mano" / "subject_1.yaml").write_text(f"betas: {BETAS.tolist()}\n")
    T_cam_hand, T_cam_obj = motion()
    hands = []
    for side, T in (("right", T_cam_hand), ("left", left_hand_poses())):
        hand, at_rest = posed(mano, side)
        rot, trans = global_motion(HOCAP_WORLD @ T, at_rest.joints[0])
        coefficients = np.tile(bent(side) - hand.mean, (FRAMES, 1))  # its components are the axes
        hands.append(np.concatenate([rot, coefficients, trans], axis=1))
    hands[1][:LEFT_FROM] = -1.0
    box = np.tile(se3.rigid(None, np.array([0.2, 0.1, 0.9])), (FRAMES, 1, 1))
    objects = as_quaternions(HOCAP_WORLD @ np.stack([T_cam_obj, box, box]))
    objects[0, LOST] = -1.0
    worn = as_quaternions(hololens_poses())
    worn[HOLOLENS_LOST] = -1.0
    for name, values in (("poses_m", np.stack(hands)), ("poses_o", objects), ("poses_pv", worn)):
        np.save(sequence / f"{name}.npy", values.astype(np.float32))
    for name, mesh in zip(HOCAP_OBJECTS, (ball(0.03), trimesh.creation.box([0.1, 0.1, 0.1])), strict=False):
        (root / "models" / name).mkdir(parents=True)
        mesh.export(root / "models" / name / "cleaned_mesh_10000.obj")
    return root


HRDEXDB_CAMERAS = {
    "22641005": HOCAP_WORLD,
    "22641023": HOCAP_WORLD @ HOCAP_BESIDE,
    "22640000": HOCAP_WORLD @ se3.rigid(np.diag([-1.0, 1.0, -1.0]), np.array([0.0, 0.0, 0.3])),
}
"""Poses of the fixed cameras in the world; the last one is nearest, and looks away from the object."""
HRDEXDB_WORN, HRDEXDB_OBJECT = "25452062", "apple"


def write_hrdexdb(folder: Path, mano: Path, viewers: bool = False) -> Path:
    """HRDexDB's folder, with one human scene; with poses as texts, as its viewer describes it (``viewers``)."""
    root = folder / "v0"
    scene = root / "human" / HRDEXDB_OBJECT / "0"
    for place in (scene / "hand" / "mano", scene / "cam_param", scene / "object_6d"):
        place.mkdir(parents=True)
    T_cam_hand, T_cam_obj = motion()
    hand, bent_hand = posed(mano, "right")
    T_world_hand, T_world_obj = HOCAP_WORLD @ T_cam_hand, HOCAP_WORLD @ T_cam_obj
    corners = "".join("f {} {} {}\n".format(*face) for face in hand.model.faces + 1)
    for n in range(FRAMES):
        points = se3.transform(T_world_hand[n], bent_hand.vertices)
        vertices = "".join("v {:.9f} {:.9f} {:.9f}\n".format(*point) for point in points)
        (scene / "hand" / "mano" / f"{n:05d}.obj").write_text(vertices + corners)
    mesh = root / "assets" / ("mesh" if viewers else "mesh_v2") / HRDEXDB_OBJECT
    mesh.mkdir(parents=True)
    ball(0.03).export(mesh / f"{HRDEXDB_OBJECT}.obj")
    if viewers:
        for n, T in enumerate(T_world_obj):
            np.savetxt(scene / "object_6d" / f"pose_{n:06d}.txt", T)
    else:
        packed = root / "object_6d_pose_v2" / "human"
        packed.mkdir(parents=True)
        known = {f"frame_{n}": T for n, T in enumerate(T_world_obj) if n != LOST}
        np.savez(packed / f"{HRDEXDB_OBJECT}_0.npz", **known)
    np.save(scene / "C2R.npy", se3.rigid(np.diag([1.0, -1.0, -1.0]), np.array([0.5, 0.0, 0.0])))  # up is the world's -z
    lens = {"intrinsics_undistort": [[610.0, 0.0, 319.5], [0.0, 611.0, 239.5], [0.0, 0.0, 1.0]]}
    lens |= {"width": 640, "height": 480, "dist_params": [0.0] * 5}
    fixed = {name: se3.inverse(T)[:3].tolist() for name, T in HRDEXDB_CAMERAS.items()}
    (scene / "cam_param" / "intrinsics.json").write_text(json.dumps(dict.fromkeys(fixed, lens)))
    (scene / "cam_param" / "extrinsics.json").write_text(json.dumps(fixed))
    path = {str(n): se3.inverse(T)[:3].tolist() for n, T in enumerate(hololens_poses()) if n != HOLOLENS_LOST}
    worn = {"intrinsics": {HRDEXDB_WORN: lens}, "extrinsics": {HRDEXDB_WORN: path}}
    (scene / "cam_param" / "ego_calib.json").write_text(json.dumps(worn))
    return root


INDEX = "ZY20210800001/H1/C5/N11/S125/s03/T1"
NAME = f"H1--{INDEX.replace('/', '-')}--Bottle--right"
K = np.array([[1000.0, 0.0, 959.5], [0.0, 1010.0, 539.5], [0.0, 0.0, 1.0]])
RED, GREEN, BROWN = (128, 0, 0), (0, 128, 0), (128, 128, 0)


def write_hoi4d(folder: Path, mano: Path) -> Path:
    """HOI4D's folder, with one sequence, of the right hand."""
    root = folder / "HOI4D"
    T_cam_hand, T_cam_obj = motion()
    notes = root / "HOI4D_annotations" / INDEX
    (notes / "objpose").mkdir(parents=True)
    hands = root / "handpose" / "refinehandpose_right" / INDEX
    hands.mkdir(parents=True)
    _, at_rest = posed(mano, "right")
    rot, trans = global_motion(T_cam_hand, at_rest.joints[0])
    for n in range(FRAMES):
        angles = Rotation.from_matrix(T_cam_obj[n, :3, :3]).as_euler("XYZ")
        entry = {
            "label": "bottle",
            "center": dict(zip("xyz", T_cam_obj[n, :3, 3].tolist(), strict=True)),
            "rotation": dict(zip("xyz", angles.tolist(), strict=True)),
            "dimensions": {"length": 0.06, "width": 0.06, "height": 0.07},
        }
        key = "dataList" if n % 2 else "objects"  # both occur
        (notes / "objpose" / f"{n}.json").write_text(json.dumps({"info": "x", key: [entry, {}]}))
        hand = {
            "poseCoeff": np.concatenate([rot[n], bent()]).astype(np.float32),
            "beta": BETAS.astype(np.float32),
            "trans": trans[n].astype(np.float32),
            "kps2D": np.zeros((21, 2)),
        }
        (hands / f"{n}.pickle").write_bytes(pickle.dumps(hand, protocol=3))
    cads = root / "HOI4D_CAD_Model_for_release" / "rigid" / "Bottle"
    cads.mkdir(parents=True)
    ball(0.03).export(cads / "011.obj")
    camera = root / "camera_params" / "ZY20210800001"
    camera.mkdir(parents=True)
    np.save(camera / "intrin.npy", K)
    return root


def write_labels(root: Path, kind: str = "mask") -> None:
    """Labels of three rectangles: the object, the right hand, another object."""
    folder = root / "HOI4D_annotations" / INDEX / "2Dseg" / kind
    folder.mkdir(parents=True)
    image = np.zeros((1080, 1920, 3), np.uint8)
    image[100:201, 300:400] = RED
    image[300:400, 300:400] = GREEN
    image[500:600, 300:401] = BROWN
    content = cv2.imencode(".png", image[..., ::-1])[1].tobytes()
    for n in range(FRAMES):
        (folder / f"{n:05d}.png").write_bytes(content)


def profile() -> dict[str, Any]:
    """An open ball with random hinges and weights, lengths as in a hand [mm]."""
    rng = np.random.default_rng(3)
    ball = trimesh.creation.icosphere(subdivisions=2, radius=60.0)
    faces = ball.faces[~(ball.faces == 0).any(axis=1)]
    used, faces = np.unique(faces, return_inverse=True)
    weights = rng.dirichlet(0.2 * np.ones(17), len(used))
    axes = rng.normal(size=(22, 3))
    return {
        "hand_model": {
            "mesh_vertices": (ball.vertices[used] + [60.0, 0.0, 0.0]).tolist(),
            "mesh_triangles": faces.reshape(-1, 3).tolist(),
            "dense_bone_weights": weights.tolist(),
            "joint_rest_positions": rng.uniform(-40, 40, (22, 3)).tolist(),
            "joint_rotation_axes": (axes / np.linalg.norm(axes, axis=1, keepdims=True)).tolist(),
            "landmark_rest_positions": rng.uniform(-80, 80, (21, 3)).tolist(),
        }
    }


HOT3D_NAME = "P0000_0123abcd"
HOLD = "P0000--0123abcd--red_box--right"
HOT3D_FRAMES = 16
STEP = 33_333_333


def write_hot3d(folder):
    """A right hand (a ball) that touches a box in frames 2 to 13, seen by a Quest; a second object has no mesh."""
    sequence = folder / "sequences" / HOT3D_NAME
    sequence.mkdir(parents=True)
    times = 10**12 + STEP * np.arange(HOT3D_FRAMES)

    def poses(uid, offsets):
        return [
            [uid, t + 90_000, *x, 1, 0, 0, 0]
            for t, x in zip(times, np.broadcast_to(offsets, (HOT3D_FRAMES, 3)), strict=True)
        ]

    header = ["object_uid", "timestamp[ns]", "t_wo_x[m]", "t_wo_y[m]", "t_wo_z[m]", "q_wo_w", "q_wo_x", "q_wo_y"]
    header += ["q_wo_z"]
    # The hand's ball reaches from its wrist 12 cm to -x; the box begins there, but for the first and last frames.
    apart = np.where((np.arange(HOT3D_FRAMES) < 2) | (np.arange(HOT3D_FRAMES) > 13), 0.02, 0.0)
    box = np.stack([-0.122 - 0.04 - apart, np.zeros(HOT3D_FRAMES), np.full(HOT3D_FRAMES, 0.6)], axis=1)
    tables = {
        "headset_trajectory.csv": [[1, t, 0, 0, 0, 1, 0, 0, 0] for t in sorted([*times, *(times + 90_000)])],
        "dynamic_objects.csv": [*poses("111", box), *poses("222", [1.0, 0.0, 1.0])],
    }
    for name, rows in tables.items():
        with (sequence / name).open("w", newline="") as file:
            csv.writer(file).writerows([header, *rows])
    wrist = {"q_wxyz": [1, 0, 0, 0], "t_xyz": [0.0, 0.0, 0.6]}
    hands = {"1": {"wrist_xform": wrist, "joint_angles": [0.0] * 22}}
    lines = [json.dumps({"timestamp_ns": int(t), "hand_poses": hands}) for t in times]
    (sequence / "umetrack_hand_pose_trajectory.jsonl").write_text("\n".join(lines))
    (sequence / "umetrack_hand_user_profile.json").write_text(json.dumps(profile()))
    small, large = (
        {
            "T_Device_Camera": {"quaternion_wxyz": [1, 0, 0, 0], "translation_xyz": [0, 0, 0]},
            "imageHeight": height,
            "imageWidth": 640,
            "label": "camera-slam-left",
            "projectionParams": [300.0, 300.0, 319.5, height / 2 - 0.5, *[0.0] * 12],
        }
        for height in (480, 640)
    )
    (sequence / "camera_models.json").write_text(json.dumps([small, large]))
    assets = folder / "assets"
    assets.mkdir()
    instances = {"111": {"instance_name": "red_box"}, "222": {"instance_name": "ghost"}}
    (assets / "instance.json").write_text(json.dumps(instances))
    trimesh.creation.box(extents=[0.08, 0.1, 0.12]).export(assets / "111.glb")
    return folder
