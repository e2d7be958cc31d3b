"""Paths of a known camera, written as each program writes them.

Files of masks by other programs: label images, COCO, SAM 2.

EXR files as OpenCV and others write them: scan lines of one or several channels.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

from getagrip.geometry import se3
from getagrip.io import arrays

SIZE = (20, 14)
FRAMES = ("000003", "000004")


def labels(seed: int = 0) -> ndarray:
    return np.random.default_rng(seed).integers(0, 4, (2, *SIZE[::-1]))


def write_png(path: Path, values: ndarray, depth: int, kind: int, palette: bool = False) -> None:
    """A PNG made by hand: any depth, grey or palette indices."""
    height, width = values.shape

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    rows = b""
    for row in values:
        bits = "".join(f"{int(v):0{depth}b}" for v in row)
        bits += "0" * (-len(bits) % 8)
        rows += b"\0" + bytes(int(bits[i : i + 8], 2) for i in range(0, len(bits), 8))
    content = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, kind, 0, 0, 0))
    if palette:
        content += chunk(b"PLTE", bytes(range(3, 3 + 3 * 2 ** min(depth, 4))))
    path.write_bytes(content + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


def label_folder(folder: Path) -> Path:
    folder.mkdir()
    for name, values in zip(FRAMES, labels(), strict=True):
        write_png(folder / f"frame_{int(name)}.png", values, 8, 3, palette=True)
    return folder


def encoded(mask: ndarray, compressed: bool) -> dict[str, Any]:
    """COCO's run lengths, by its own definition."""
    flat = mask.T.ravel()
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flat]).astype(int)) != 0)
    counts = np.diff([0, *edges, flat.size]).tolist()
    if not compressed:
        return {"size": list(mask.shape), "counts": counts}
    text = ""
    for i, count in enumerate(counts):
        x = count - counts[i - 2] if i > 2 else count
        more = True
        while more:
            c, x = x & 31, x >> 5
            more = x != -1 if c & 16 else x != 0
            text += chr((c | 32 if more else c) + 48)
    return {"size": list(mask.shape), "counts": text}


def coco(path: Path, compressed: bool = True) -> Path:
    images = [
        {"id": n, "file_name": f"rgb/{name}.jpg", "width": SIZE[0], "height": SIZE[1]} for n, name in enumerate(FRAMES)
    ]
    annotations = [
        {"image_id": n, "category_id": k, "segmentation": encoded(labels()[n] == k, compressed)}
        for n in range(2)
        for k in (1, 2, 3)
    ]
    categories = [{"id": 1, "name": "cup"}, {"id": 2, "name": "hand"}, {"id": 3, "name": "table"}]
    path.write_text(json.dumps({"images": images, "annotations": annotations, "categories": categories}))
    return path


def segments_of(frames: int, kind: Any = bool) -> dict[int, dict[int, ndarray]]:
    """SAM 2's dictionary, as its example collects it."""
    return {n: {k: (labels()[n % 2] == k)[None].astype(kind) for k in (1, 2, 3)} for n in range(frames)}


def youtube_vis(path: Path) -> None:
    """A region of each thing in each frame, and none in some."""
    videos = [{"id": 1, "file_names": [f"take/{name}.jpg" for name in FRAMES], "width": SIZE[0], "height": SIZE[1]}]
    annotations = [
        {
            "id": k, "video_id": 1, "category_id": k,
            "segmentations": [encoded(labels()[n] == k, True) if n or k < 3 else None for n in range(2)],
        }
        for k in (1, 2, 3)
    ]  # fmt: skip
    path.write_text(json.dumps({"videos": videos, "annotations": annotations}))


def label_me(folder: Path) -> None:
    folder.mkdir()
    for name in FRAMES:
        shapes: list[dict[str, Any]] = [
            {"label": "1", "points": [[3, 2], [9, 2], [9, 6]], "shape_type": "polygon", "group_id": 4},
            {"label": "2", "points": [[11, 8], [18, 12]], "shape_type": "rectangle", "group_id": None},
        ]
        content = {"shapes": shapes, "imageWidth": SIZE[0], "imageHeight": SIZE[1]}
        (folder / f"{name}.json").write_text(json.dumps(content))


def masklets(path: Path) -> None:
    """SA-V's, of the frames 0 and 4."""
    listed = [[encoded(labels()[n] == k, True) for k in (1, 2)] for n in range(2)]
    path.write_text(json.dumps({"masklet": listed, "masklet_id": [1, 2], "video_frame_count": 8.0}))


def array_folder(folder: Path) -> None:
    folder.mkdir()
    for name, values in zip(FRAMES, labels(), strict=True):
        np.save(folder / f"mask_{name}.npy", values.astype(np.uint16))


TYPES = {"<f2": 1, "<f4": 2}


def exr(channels: dict[str, ndarray], compression: int = 3) -> bytes:
    """The bytes of a file: channels (H, W) of float16 or float32; compression 0 none, 2 ZIPS, 3 ZIP."""
    height, width = next(iter(channels.values())).shape
    listed = b"".join(
        name.encode() + b"\0" + struct.pack("<iiii", TYPES[channels[name].dtype.str], 0, 1, 1)
        for name in sorted(channels)
    )
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    header = b"".join(
        name + b"\0" + kind + b"\0" + struct.pack("<i", len(value)) + value
        for name, kind, value in (
            (b"channels", b"chlist", listed + b"\0"),
            (b"compression", b"compression", bytes([compression])),
            (b"dataWindow", b"box2i", window),
            (b"displayWindow", b"box2i", window),
            (b"lineOrder", b"lineOrder", b"\0"),
        )
    )
    start = struct.pack("<ii", 20000630, 2) + header + b"\0"
    lines = {0: 1, 2: 1, 3: 16}[compression]
    blocks = []
    for y in range(0, height, lines):
        rows = range(y, min(y + lines, height))
        plain = b"".join(channels[name][row].tobytes() for row in rows for name in sorted(channels))
        packed = plain if compression == 0 else min(deflated(plain), plain, key=len)
        blocks.append(struct.pack("<ii", y, len(packed)) + packed)
    at = len(start) + 8 * len(blocks) + np.cumsum([0, *map(len, blocks[:-1])])
    return start + struct.pack(f"<{len(blocks)}q", *at) + b"".join(blocks)


def deflated(plain: bytes) -> bytes:
    """Bytes as ZIP stores them: even ones before odd ones, differences of neighbours, deflated."""
    values = np.frombuffer(plain, np.uint8)
    apart = np.concatenate([values[::2], values[1::2]]).astype(int)
    steps = np.concatenate([apart[:1], np.diff(apart) + 128])
    return zlib.compress((steps % 256).astype(np.uint8).tobytes())


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
