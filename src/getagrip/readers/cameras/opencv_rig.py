"""Rigs by files of OpenCV (``cv::FileStorage``, YAML or JSON) and of programs that write the same matrices.

Layouts: a file, or a folder of files, of a pair, as of ``stereoCalibrate`` (``M1``, ``D1``, ``M2``, ``D2``, ``R``,
``T``; in OpenCV's sample ``intrinsics.yml`` and ``extrinsics.yml``); a folder with a file for each camera, named like
it; or a file with a mapping for each camera. Each camera has ``camera_matrix``, ``distortion_coefficients`` and, unless
the frame is its own, ``R`` (a matrix, or a vector as of ``solvePnP``) and ``T``, which take points of the common frame
(of a pair: the first camera's) into the camera's. Pixel centres are whole numbers. Lengths are in the board's unit.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.lens import Distortion
from getagrip.io import files
from getagrip.io.files import printable, shorten_value
from getagrip.readers.cameras.camera_path import Pinhole
from getagrip.readers.cameras.rig import Rig, RigCamera
from getagrip.readers.cameras.rig_files import OWN_KEYS, YAML_SUFFIXES, image_size, lens_of, numbers

MATRIX_KEYS = {
    "K": ("cameramatrix", "intrinsicmatrix", "mtx", "m", "k"),
    "D": ("distortioncoefficients", "distortioncoeffs", "distcoeffs", "distortion", "dist", "d"),
    "R": ("r", "rvec", "rotation", "rotationmatrix"),
    "T": ("t", "tvec", "translation", "translationvector"),
}
"""Names of a camera's matrices, in small letters without separators."""
SIZE_KEYS = ("imagesize", "size", "resolution")
FISHEYE_MODELS = ("equidistant", "fisheye", "kannalabrandt")
PAIRS = (("1", "2"), ("left", "right"), ("l", "r"), ("0", "1"))
"""Ends of the names of a pair's matrices."""
PAIR_NAMES = {"1": "camera1", "2": "camera2", "l": "left", "r": "right", "0": "camera0"}
SUFFIXES = (*YAML_SUFFIXES, ".json")

Values = Mapping[str, object]


def read_opencv_rig(path: Path) -> Rig | None:
    """Read a calibration of several cameras, a file or a folder; None for other files. Raises ``InputError``."""
    paths = files.list_files(path, SUFFIXES) if path.is_dir() else [path] * (path.suffix.lower() in SUFFIXES)
    if path.is_dir():
        paths = [files.inside(path, one.name, "", "a camera's calibration") for one in paths]
    contents = {one: values for one in paths if (values := _read_values(one))}
    if not contents:
        return None
    source = path if path.is_dir() else next(iter(contents))
    whole = {key: value for values in contents.values() for key, value in values.items()}
    for first, second in PAIRS:
        if _find(whole, "K", first) is not None and _find(whole, "K", second) is not None:
            return _pair(source, whole, (first, second))
    alone = {one.stem: values for one, values in contents.items() if _find(values, "K") is not None}
    if not alone:  # a mapping for each camera
        alone = {
            str(name): _plain(value)
            for values in contents.values()
            for name, value in values.items()
            if isinstance(value, dict) and OWN_KEYS[0] not in value and _find(_plain(value), "K") is not None
        }
    if not alone:
        return None
    cameras = [RigCamera(name, _pinhole(source, name, of), _pose(source, name, of)) for name, of in alone.items()]
    if (lost := [name for name, of in alone.items() if _find(of, "T") is None]) and len(lost) > 1:
        got = f"no R and T of {', '.join(map(printable, lost))}"
        raise InputError(source, "", got, "the pose of each camera; stereoCalibrate writes those of a pair")
    return Rig("OpenCV's calibration", source, tuple(cameras), metric=False)


def _read_values(path: Path) -> Values:
    """Read a file's values by plain names; none of a file of another kind."""
    if path.suffix.lower() == ".json":
        content = files.read_any_json(path)
        return _plain(content) if isinstance(content, dict) else {}
    return _plain(files.read_yaml(path))


def _plain(content: object) -> Values:
    """Return values by names in small letters without separators; names of cameras, whose values are mappings, stay."""
    assert isinstance(content, dict)
    inner = {key for key, value in content.items() if isinstance(value, dict) and "data" not in value}
    return {str(k) if k in inner else str(k).lower().replace("_", "").replace("-", ""): v for k, v in content.items()}


def _find(values: Values, what: str, end: str = "") -> object:
    """Return the value of one of the names of a matrix; None without any, or for a number, as of nerfstudio's k1."""
    found = (values.get(name + end) for name in MATRIX_KEYS[what])
    return next((value for value in found if isinstance(value, dict | list)), None)


def _matrix(path: Path, key: str, value: object) -> Float[ndarray, "r c"]:
    """Return a matrix of OpenCV, or lists of numbers. Raises ``InputError``."""
    if isinstance(value, dict):
        rows, cols = value.get("rows"), value.get("cols")
        data = numbers(path, f"{key}.data", value.get("data"), (-1,))
        if type(rows) is not int or type(cols) is not int or min(rows, cols) < 1 or rows * cols != len(data):
            got = f"{shorten_value(rows)} x {shorten_value(cols)} of {len(data)} numbers"
            raise InputError(path, key, got, "rows and cols whose product is the number of data")
        return data.reshape(rows, cols)
    flat = not (isinstance(value, list) and value and isinstance(value[0], list))
    return np.atleast_2d(numbers(path, key, value, (-1,) if flat else (-1, -1)))


def _pinhole(path: Path, name: str, of: Values, end: str = "") -> Pinhole:
    shown = printable(name)
    K = _matrix(path, f"{shown}.camera_matrix", _find(of, "K", end))
    if K.shape != (3, 3) and K.size != 9:
        raise InputError(path, f"{shown}.camera_matrix", f"{K.shape[0]} x {K.shape[1]} numbers", "3 x 3")
    K = K.reshape(3, 3) + np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]])
    size = None
    if {"imagewidth", "imageheight"} <= {*of}:
        size = image_size(path, f"{shown}.image_width", [of["imagewidth"], of["imageheight"]])
    elif (stated := next((of[key] for key in SIZE_KEYS if key in of), None)) is not None:
        size = image_size(path, f"{shown}.image_size", stated)
    model = str(of.get("distortionmodel", "")).lower().replace("_", "")
    fisheye = model in FISHEYE_MODELS or of.get("fisheyemodel") in (1, True) or of.get("fisheye") in (1, True)
    lens, stored = Distortion(), _find(of, "D", end)
    if stored is not None:
        coefficients = _matrix(path, f"{shown}.distortion_coefficients", stored).ravel().tolist()
        lens = lens_of(path, f"{shown}.distortion_coefficients", coefficients, fisheye)
    return Pinhole(K, size, lens)


def _pose(path: Path, name: str, of: Values) -> Float[ndarray, "4 4"]:
    """Return the pose of a camera in the common frame, which is its own without R and T. Raises ``InputError``."""
    R, t = _find(of, "R"), _find(of, "T")
    if R is None and t is None:
        return np.eye(4)
    shown = printable(name)
    turn = _matrix(path, f"{shown}.R", R)
    if turn.size not in (3, 9):
        raise InputError(path, f"{shown}.R", f"{turn.size} numbers", "9 of a matrix, or 3 of a vector of rotation")
    turn = turn.reshape(3, 3) if turn.size == 9 else se3.exp_so3(turn.ravel())
    place = _matrix(path, f"{shown}.T", t).ravel()
    if place.size != 3:
        raise InputError(path, f"{shown}.T", f"{place.size} numbers", "3")
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = turn, place
    if not se3.is_rigid(T):
        raise InputError(path, f"{shown}.R", "a matrix that is not a rotation", "a rotation")
    return np.asarray(se3.inverse(se3.rigid(se3.nearest_rotation(turn), place)))


def _pair(path: Path, whole: Values, ends: tuple[str, str]) -> Rig:
    if _find(whole, "R") is None or _find(whole, "T") is None:
        raise InputError(path, "R", "no R and T", "the pose of the pair; name the folder if another file has it")
    first, second = (PAIR_NAMES.get(end, end) for end in ends)
    if ends == ("0", "1"):
        second = "camera1"
    cameras = (
        RigCamera(first, _pinhole(path, first, whole, ends[0]), np.eye(4)),
        RigCamera(second, _pinhole(path, second, whole, ends[1]), _pose(path, second, whole)),
    )
    return Rig("OpenCV's calibration of a pair", path, cameras, metric=False)
