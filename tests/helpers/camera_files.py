"""Paths of a known camera, written as each program writes them."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

from getagrip.geometry import se3
from getagrip.io import arrays

COUNT = 5
NAMES = tuple(f"frame_{n:010d}" for n in range(1, COUNT + 1))
FX, FY, CX, CY = 610.0, 612.0, 318.0, 243.0
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def known(count: int = COUNT) -> np.ndarray:
    """``T_world_cam`` of a moving camera."""
    rng = np.random.default_rng(0)
    R = se3.exp_so3(np.cumsum(rng.normal(scale=0.1, size=(count, 3)), axis=0))
    return se3.rigid(R, np.cumsum(rng.normal(scale=0.05, size=(count, 3)), axis=0))


def xyzw(T: np.ndarray) -> np.ndarray:
    return se3.quaternion(T[:, :3, :3])[:, [1, 2, 3, 0]]


def colmap_txt(place: Path, T: np.ndarray) -> Path:
    world = se3.inverse(T)
    q, t = se3.quaternion(world[:, :3, :3]), world[:, :3, 3]
    lines = ["# Image list with two lines of data per image:"]
    for n, name in enumerate(NAMES):
        pose = " ".join(f"{value:.17g}" for value in (*q[n], *t[n]))
        lines += [f"{n + 1} {pose} 1 {name}.jpg", "1.5 2.5 -1 3.0 4.0 7" if n % 2 else ""]
    folder = place / "sparse" / "0"
    folder.mkdir(parents=True)
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    (folder / "cameras.txt").write_text(f"# Camera list\n1 OPENCV 640 480 {FX} {FY} {CX} {CY} 0.1 0 0 0\n")
    return place


def colmap_bin(place: Path, T: np.ndarray) -> Path:
    world = se3.inverse(T)
    q, t = se3.quaternion(world[:, :3, :3]), world[:, :3, 3]
    images = struct.pack("<Q", COUNT)
    for n, name in enumerate(NAMES):
        images += struct.pack("<I7dI", n + 1, *q[n], *t[n], 1) + f"{name}.jpg".encode() + b"\0"
        images += struct.pack("<Q", n) + n * struct.pack("<ddq", 1.0, 2.0, -1)
    (place / "images.bin").write_bytes(images)
    (place / "cameras.bin").write_bytes(struct.pack("<QIiQQ4d", 1, 1, 1, 640, 480, FX, FY, CX, CY))
    return place


def epic_fields(place: Path, T: np.ndarray) -> Path:
    world = se3.inverse(T)
    poses = np.hstack([se3.quaternion(world[:, :3, :3]), world[:, :3, 3]])
    camera = {"id": 1, "model": "OPENCV", "width": 640, "height": 480, "params": [FX, FY, CX, CY, 0.0, 0.0, 0.0, 0.0]}
    images = {f"{name}.jpg": pose.tolist() for name, pose in zip(NAMES, poses, strict=True)}
    (place / "P01_01.json").write_text(json.dumps({"camera": camera, "images": images, "points": [[0, 0, 0, 1, 1, 1]]}))
    return place / "P01_01.json"


def vipe(place: Path, T: np.ndarray) -> Path:
    for kind, data in (("pose", T), ("intrinsics", np.tile([FX, FY, CX, CY], (COUNT, 1)))):
        (place / kind).mkdir()
        arrays.write(place / kind / "video.npz", {"data": data, "inds": np.arange(1, COUNT + 1)})
    return place


def megasam(place: Path, T: np.ndarray) -> Path:
    K = np.array([[FX, 0.0, CX], [0.0, FX, CY], [0.0, 0.0, 1.0]])
    images = np.zeros((COUNT, 4, 4, 3), np.uint8)
    arrays.write(place / "x_sgd_cvd_hr.npz", {"cam_c2w": T, "intrinsic": K, "images": images})
    return place / "x_sgd_cvd_hr.npz"


def hawor(place: Path, T: np.ndarray) -> Path:
    (place / "SLAM").mkdir()
    slam = {"traj": np.hstack([T[:, :3, 3] / 3.0, xyzw(T)]), "scale": np.array(3.0), "tstamp": np.arange(COUNT)}
    slam |= {"img_focal": np.array(FX), "img_center": np.array([CX, CY])}
    arrays.write(place / "SLAM" / "hawor_slam_w_scale_0_5.npz", slam)
    return place


def arkit(place: Path, T: np.ndarray) -> Path:
    for n, pose in enumerate(T @ OPENGL):
        content = {"cameraPoseARFrame": pose.ravel().tolist(), "intrinsics": [FX, 0, CX, 0, FY, CY, 0, 0, 1], "time": n}
        (place / f"frame_{n + 1:05d}.json").write_text(json.dumps(content))
    (place / "info.json").write_text("{}")
    return place


def aria(place: Path, T: np.ndarray) -> Path:
    T_device_cam = se3.rigid(se3.exp_so3(np.array([0.1, 0.7, -0.2])), np.array([0.01, 0.02, 0.03]))
    T = T @ se3.inverse(T_device_cam)
    heads = ["graph_uid", "tracking_timestamp_us", "utc_timestamp_ns"]
    heads += [f"{axis}_world_device" for axis in ("tx", "ty", "tz", "qx", "qy", "qz", "qw")]
    heads += [f"gravity_{axis}_world" for axis in "xyz"]
    rows = np.hstack([T[:, :3, 3], xyzw(T), np.tile([0.0, 0.0, -9.81], (len(T), 1))])
    lines = [",".join(heads)]
    lines += [
        ",".join(["id", str(7_000_000 + 33_000 * n), "0", *map(repr, row.tolist())]) for n, row in enumerate(rows)
    ]
    (place / "slam").mkdir()
    (place / "slam" / "closed_loop_trajectory.csv").write_text("\n".join(lines) + "\n")
    q = se3.quaternion(T_device_cam[None, :3, :3])[0].tolist()
    pose = {"Translation": T_device_cam[:3, 3].tolist(), "UnitQuaternion": [q[0], q[1:]]}
    calibration = {"CameraCalibrations": [{"Label": "camera-rgb", "T_Device_Camera": pose}]}
    (place / "slam" / "online_calibration.jsonl").write_text(json.dumps(calibration) + "\n" + json.dumps({}) + "\n")
    return place


def tum(place: Path, T: np.ndarray) -> Path:
    rows = np.hstack([np.arange(len(T))[:, None] / 30.0, T[:, :3, 3], xyzw(T)])
    np.savetxt(place / "traj.txt", rows, fmt="%.17g", header="timestamp tx ty tz qx qy qz qw")
    return place / "traj.txt"


def kitti(place: Path, T: np.ndarray) -> Path:
    np.savetxt(place / "00.txt", T[:, :3].reshape(-1, 12), fmt="%.17g")
    return place / "00.txt"


def nerfstudio(place: Path, T: np.ndarray) -> Path:
    lens = {"fl_x": FX, "fl_y": FY, "cx": CX, "cy": CY, "w": 640, "h": 480, "camera_model": "PINHOLE"}
    each = zip(NAMES, T @ OPENGL, strict=True)
    frames = [{"file_path": f"./images/{name}.png", "transform_matrix": pose.tolist()} for name, pose in each]
    (place / "transforms.json").write_text(json.dumps({**lens, "frames": frames}))
    return place


def record3d(place: Path, T: np.ndarray) -> Path:
    T = T @ OPENGL
    content = {"w": 640, "h": 480, "fps": 60, "K": [FX, 0, 0, 0, FY, 0, CX, CY, 1]}
    content["poses"] = np.hstack([xyzw(T), T[:, :3, 3]]).tolist()
    (place / "metadata.json").write_text(json.dumps(content))
    return place


WRITERS: dict[str, tuple[Callable[[Path, np.ndarray], Path], str, bool]] = {
    "COLMAP, text": (colmap_txt, "COLMAP", False), "COLMAP, binary": (colmap_bin, "COLMAP", False),
    "EPIC-Fields": (epic_fields, "EPIC-Fields", False), "ViPE": (vipe, "ViPE", True),
    "MegaSaM": (megasam, "MegaSaM", False), "HaWoR": (hawor, "HaWoR", True), "ARKit": (arkit, "ARKit", True),
    "Aria": (aria, "Aria", True), "TUM": (tum, "TUM", False), "KITTI": (kitti, "KITTI", False),
    "nerfstudio": (nerfstudio, "nerfstudio", False), "Record3D": (record3d, "Record3D", True),
}  # fmt: skip
