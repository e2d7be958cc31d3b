"""COLMAP's models, text and binary (colmap.github.io/format.html), and EPIC-Fields' JSON with the same content.

Images have world-to-camera poses, a quaternion (w, x, y, z) and a translation. The scale of a model is arbitrary.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.lens import Distortion
from getagrip.io import files
from getagrip.io.files import printable
from getagrip.readers.cameras.camera_path import CameraPath, Pinhole

MAX_COLMAP_BYTES = 2 * 2**30
"""Maximum size of a file."""
COLMAP_MODEL_FOLDERS = ("", "sparse", "sparse/0", "0", "dense/sparse")
"""Folders of models, relative to the path that the user names."""
COLMAP_CAMERA_MODELS = {
    0: ("SIMPLE_PINHOLE", 3), 1: ("PINHOLE", 4), 2: ("SIMPLE_RADIAL", 4), 3: ("RADIAL", 5), 4: ("OPENCV", 8),
    5: ("OPENCV_FISHEYE", 8), 6: ("FULL_OPENCV", 12), 7: ("FOV", 5), 8: ("SIMPLE_RADIAL_FISHEYE", 4),
    9: ("RADIAL_FISHEYE", 5), 10: ("THIN_PRISM_FISHEYE", 12), 11: ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    12: ("SIMPLE_DIVISION", 4), 13: ("DIVISION", 5), 14: ("SIMPLE_FISHEYE", 3), 15: ("FISHEYE", 4), 16: ("EUCM", 6),
}  # fmt: skip
"""Camera models by number: name and number of parameters."""
SINGLE_FOCAL_MODELS = (
    "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "SIMPLE_DIVISION",
    "SIMPLE_FISHEYE",
)  # fmt: skip

OPENCV_MODELS = (
    "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV", "OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE",
    "SIMPLE_FISHEYE", "FISHEYE",
)  # fmt: skip
"""Models whose distortion has OpenCV's coefficients, in its order, the last ones left out."""


class ColmapImage(NamedTuple):
    """An image of a model: its name, its camera's number, and its world-to-camera pose (w, x, y, z, tx, ty, tz)."""

    name: str
    camera: int
    pose: tuple[float, ...]


def read_colmap(path: Path) -> CameraPath | None:
    """Read a model from its folder, or from a folder above; None without a model. Raises ``InputError``."""
    folders = [path.parent] * path.name.startswith("images.")
    if path.is_dir():
        folders = [path / place for place in COLMAP_MODEL_FOLDERS]
        numbered = [one for one in files.folders_in(path / "sparse") if one.name.isdecimal() and one.name != "0"]
        folders += sorted(numbered, key=lambda one: int(one.name))
    models = [folder for folder in folders if any((folder / f"images.{end}").is_file() for end in ("bin", "txt"))]
    found = [_read_colmap_model(folder) for folder in models]
    return replace(found[0], others=tuple(found[1:])) if found else None


def _read_colmap_model(folder: Path) -> CameraPath:
    suffix = "bin" if (folder / "images.bin").is_file() and (folder / "cameras.bin").is_file() else "txt"
    source = files.inside(folder, f"images.{suffix}", "", "COLMAP's images")
    of_cameras = files.inside(folder, f"cameras.{suffix}", "", "COLMAP's cameras")
    try:
        content, cameras = files.read_bytes(source, MAX_COLMAP_BYTES), files.read_bytes(of_cameras, MAX_COLMAP_BYTES)
        if suffix == "bin":
            images, pinholes = list(_images_bin(content)), dict(_cameras_bin(cameras))
        else:
            images = list(_images_txt(files.strip_byte_order_mark(content).decode()))
            pinholes = dict(_cameras_txt(files.strip_byte_order_mark(cameras).decode()))
    except (ValueError, IndexError, KeyError, OverflowError, struct.error) as error:
        raise InputError(source, "", f"a damaged file ({error})", "a model as COLMAP writes it") from error
    return _colmap_path(f"COLMAP's model ({suffix})", source, images, pinholes)


def read_epic_fields(path: Path) -> CameraPath | None:
    """Read a file of EPIC-Fields; None for other files. Raises ``InputError``."""
    if path.suffix.lower() != ".json":
        return None
    content = files.read_any_json(path)
    if not isinstance(content, dict):
        return None
    camera, poses = content.get("camera"), content.get("images")
    if not isinstance(camera, dict) or not isinstance(poses, dict):
        return None
    try:
        size = int(camera["width"]), int(camera["height"])
        pinhole = _pinhole_from_colmap(str(camera["model"]), size, [float(value) for value in camera["params"]])
        images = [ColmapImage(name, 0, tuple(map(float, pose))) for name, pose in poses.items()]
        if any(len(image.pose) != 7 for image in images):
            raise ValueError("7 numbers for each image")
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(path, "", f"a damaged file ({error})", "a file of EPIC-Fields") from error
    return _colmap_path("EPIC-Fields", path, images, {0: pinhole})


def _colmap_path(source: str, path: Path, images: list[ColmapImage], pinholes: dict[int, Pinhole]) -> CameraPath:
    if not images:
        raise InputError(path, "", "no images", "a model with images")
    poses = np.array([image.pose for image in images])
    T_world_cam = se3.inverse(se3.rigid(se3.from_quaternion(poses[:, :4]), poses[:, 4:]))
    of_images = tuple(pinholes[image.camera] for image in images if image.camera in pinholes)
    one = len({image.camera for image in images}) == 1
    known = of_images if len(of_images) == len(images) else ()
    names = tuple(image.name for image in images)
    return CameraPath(source, path, T_world_cam, names, pinholes=known[:1] if one else known)


def _pinhole_from_colmap(model: str, size: tuple[int, int], params: list[float]) -> Pinhole:
    """Convert a camera's parameters. Raises ``ValueError`` for unknown models."""
    if (model, len(params)) not in COLMAP_CAMERA_MODELS.values():
        raise ValueError(f"a camera {printable(model)} of {len(params)} parameters")
    if model in SINGLE_FOCAL_MODELS:
        f, cx, cy, *rest = params
        return Pinhole.of(f, f, cx, cy, size, _lens_from_colmap(model, rest))
    fx, fy, cx, cy, *rest = params
    return Pinhole.of(fx, fy, cx, cy, size, _lens_from_colmap(model, rest))


def _lens_from_colmap(model: str, rest: list[float]) -> Distortion | None:
    """Return the distortion by the parameters after the pinhole's; None if its model is not OpenCV's."""
    fisheye = "FISHEYE" in model
    if not fisheye and not any(rest):
        return Distortion()
    return Distortion((*rest, *[0.0] * (4 - len(rest))), fisheye) if model in OPENCV_MODELS else None


def _split_colmap_lines(text: str) -> Iterator[list[str]]:
    return (line.split() for line in text.splitlines() if not line.startswith("#"))


def _images_txt(text: str) -> Iterator[ColmapImage]:
    """Yield the images of ``images.txt``, two lines each; the second, of points, may be empty."""
    for words in list(_split_colmap_lines(text))[::2]:
        if words:
            yield ColmapImage(" ".join(words[9:]), int(words[8]), tuple(map(float, words[1:8])))


def _cameras_txt(text: str) -> Iterator[tuple[int, Pinhole]]:
    for words in filter(None, _split_colmap_lines(text)):
        number, model, width, height, *params = words
        yield int(number), _pinhole_from_colmap(model, (int(width), int(height)), [float(word) for word in params])


def _images_bin(content: bytes) -> Iterator[ColmapImage]:
    """Yield the images of ``images.bin``, without their points."""
    (count,), place = struct.unpack_from("<Q", content), 8
    for _ in range(count):
        _, *pose, camera = struct.unpack_from("<I7dI", content, place)
        end = content.index(b"\0", place + 64)
        name = content[place + 64 : end].decode()
        (points,) = struct.unpack_from("<Q", content, end + 1)
        place = end + 9 + 24 * points
        yield ColmapImage(name, camera, tuple(pose))


def _cameras_bin(content: bytes) -> Iterator[tuple[int, Pinhole]]:
    (count,), place = struct.unpack_from("<Q", content), 8
    for _ in range(count):
        number, kind, width, height = struct.unpack_from("<IiQQ", content, place)
        model, parameters = COLMAP_CAMERA_MODELS[kind]
        params: Float[ndarray, "n"] = np.frombuffer(content, "<f8", parameters, place + 24)
        place += 24 + 8 * parameters
        yield number, _pinhole_from_colmap(model, (width, height), params.tolist())
