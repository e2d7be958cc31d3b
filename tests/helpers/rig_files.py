"""Calibrations of a known rig, written as each program writes them."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy import ndarray

from getagrip.geometry import se3

SIZE = (640, 480)
K = np.array([[610.0, 0.0, 322.5], [0.0, 612.0, 238.5], [0.0, 0.0, 1.0]])
"""In this package's pixels, whose corners are whole numbers."""
LENS = (0.01, -0.02, 0.001, 0.002)
NO_LENS: tuple[tuple[float, ...], bool] = ((), False)


def known_rig(cameras: int) -> ndarray:
    """Poses in a world of their own, none of them the first camera's."""
    n = np.arange(cameras)[:, None]
    return se3.rigid(se3.exp_so3(n * [0.1, 0.5, -0.2] + [0.3, 0.0, 0.1]), n * [0.4, 0.05, 0.1] + [1.0, 2.0, 3.0])


def own_rig(folder: Path, T: ndarray) -> Path:
    cameras = {
        name: {"T_world_cam": one.tolist(), "K": K.tolist(), "size": SIZE} for name, one in zip("abcd", T, strict=False)
    }
    folder.mkdir(exist_ok=True, parents=True)
    (folder / "rig.json").write_text(json.dumps(cameras))
    return folder / "rig.json"


def recording(folder: Path, T: ndarray) -> Path:
    of = {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2]}
    cameras = {name: {**of, "T_world_cam": one.tolist()} for name, one in zip(("111", "222"), T, strict=True)}
    (folder / "cameras.json").write_text(json.dumps(cameras))
    return folder


def kalibr(folder: Path, T: ndarray) -> Path:
    text = ""
    for n, one in enumerate(T):
        text += f"cam{n}:\n"
        if n:
            rows = "".join(f"  - {row}\n" for row in (se3.inverse(one) @ T[n - 1]).tolist())
            text += f"  T_cn_cnm1:\n{rows}"
        text += f"  cam_overlaps: [0]\n  camera_model: pinhole\n  distortion_coeffs: {list(LENS)}\n"
        text += "  distortion_model: equidistant\n"
        text += f"  intrinsics: [{K[0, 0]}, {K[1, 1]}, {K[0, 2] - 0.5}, {K[1, 2] - 0.5}]\n"
        text += f"  resolution: [{SIZE[0]}, {SIZE[1]}]\n  rostopic: /cam{n}/image_raw\n"
    (folder / "camchain.yaml").write_text(text)
    return folder / "camchain.yaml"


def matrix(values: ndarray) -> str:
    rows, cols = values.shape
    data = ", ".join(repr(float(x)) for x in values.ravel())
    return f"!!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: [ {data} ]\n"


def opencv_files(folder: Path, T: ndarray) -> Path:
    """A file for each camera; the frame is the first one's."""
    for n, (name, one) in enumerate(zip("xyz", T, strict=True)):
        in_cv = K - np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]])
        text = f"%YAML:1.0\n---\nimage_width: {SIZE[0]}\nimage_height: {SIZE[1]}\ncamera_matrix: {matrix(in_cv)}"
        text += f"distortion_coefficients: {matrix(np.array([LENS]))}"
        if n:
            to_camera = se3.inverse(one) @ T[0]
            text += f"R: {matrix(to_camera[:3, :3])}T: {matrix(to_camera[:3, 3:])}"
        (folder / f"{name}.yml").write_text(text)
    return folder


def dexycb(folder: Path, T: ndarray) -> Path:
    intrinsics, extrinsics = folder / "intrinsics", folder / "extrinsics_20200702_151821"
    intrinsics.mkdir(parents=True)
    extrinsics.mkdir()
    text = "extrinsics:\n  apriltag:\n" + "".join(f"  - {x}\n" for x in np.eye(4)[:3].ravel())
    for name, one in zip(("836212060125", "839512060362", "840412060917"), T, strict=True):
        text += f"  '{name}':\n" + "".join(f"  - {x!r}\n" for x in one[:3].ravel().tolist())
        of = f"fx: {K[0, 0]}\n  fy: {K[1, 1]}\n  ppx: {K[0, 2] - 0.5}\n  ppy: {K[1, 2] - 0.5}\n"
        (intrinsics / f"{name}_640x480.yml").write_text(f"color:\n  {of}depth:\n  fx: 380.0\n")
    (extrinsics / "extrinsics.yml").write_text(text + "master: '836212060125'\n")
    return extrinsics


def colmap(folder: Path, T: ndarray) -> Path:
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    params = f"{K[0, 0]} {K[1, 1]} {K[0, 2]} {K[1, 2]} " + " ".join(map(str, LENS))
    (model / "cameras.txt").write_text(f"1 OPENCV {SIZE[0]} {SIZE[1]} {params}\n")
    lines = []
    for n, (name, one) in enumerate(zip("abc", T, strict=True), start=1):
        to_camera = se3.inverse(one)
        pose = [*se3.quaternion(to_camera[:3, :3]).tolist(), *to_camera[:3, 3].tolist()]
        lines += [f"{n} {' '.join(map(repr, pose))} 1 {name}/0001.png", ""]
    (model / "images.txt").write_text("\n".join(lines) + "\n")
    return folder


def nerfstudio(folder: Path, T: ndarray) -> Path:
    """OpenGL's cameras, in a folder of images named like them."""
    opengl = T @ np.diag([1.0, -1.0, -1.0, 1.0])
    frames = [
        {"file_path": f"images/{name}.png", "transform_matrix": one.tolist()}
        for name, one in zip("abc", opengl, strict=True)
    ]
    of = {"fl_x": K[0, 0], "fl_y": K[1, 1], "cx": K[0, 2], "cy": K[1, 2], "w": SIZE[0], "h": SIZE[1]}
    bent = dict(zip(("k1", "k2", "p1", "p2"), LENS, strict=True))
    content = {**of, **bent, "camera_model": "OPENCV", "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(content))
    return folder


RigWriter = Callable[[Path, ndarray], Path]
RIG_WRITERS: dict[str, tuple[RigWriter, tuple[str, ...], tuple[tuple[float, ...], bool]]] = {
    "own": (own_rig, ("a", "b", "c"), NO_LENS),
    "recording": (recording, ("111", "222"), NO_LENS),
    "Kalibr": (kalibr, ("cam0", "cam1", "cam2"), (LENS, True)),
    "OpenCV": (opencv_files, ("x", "y", "z"), (LENS, False)),
    "DexYCB": (dexycb, ("836212060125", "839512060362", "840412060917"), NO_LENS),
    "COLMAP": (colmap, ("a", "b", "c"), (LENS, False)),
    "nerfstudio": (nerfstudio, ("a", "b", "c"), ((*LENS, 0.0), False)),
}
"""Of each program: the writer, the names of its cameras, and their lens."""
