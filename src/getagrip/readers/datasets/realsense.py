"""YAML files of recordings by RealSense cameras, as DexYCB and HO-Cap have them: calibrations and descriptions.

<serial>.yaml       color: fx, fy, ppx, ppy [px]
extrinsics.yaml     extrinsics: by serial number or tag, its pose in the frame of one of the cameras, 12 numbers [m]
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.io.files import is_portable_name, read_yaml, shorten_value

MAX_YAML_NUMBER = 1e9
"""Maximum absolute number in a calibration."""
MAX_NAMES = 1000
"""Maximum length of a list of names."""
COLOUR_CAMERA_KEYS = ("fx", "fy", "ppx", "ppy")


def _as_float(value: object) -> float:
    """Convert a number of a YAML file; NaN for anything else."""
    return float(value) if isinstance(value, float | int) and abs(value) < MAX_YAML_NUMBER else np.nan


def read_colour_intrinsics(path: Path) -> Float[ndarray, "3 3"]:
    """Read the intrinsics of the colour camera [px]. Raises ``InputError``."""
    colour = read_yaml(path).get("color")
    fx, fy, ppx, ppy = (_as_float(colour.get(k) if isinstance(colour, dict) else None) for k in COLOUR_CAMERA_KEYS)
    if not (np.isfinite([fx, fy, ppx, ppy]).all() and fx > 0.0 and fy > 0.0):
        raise InputError(path, "color", shorten_value(colour), "fx, fy, ppx, ppy in pixels, fx and fy above 0")
    # RealSense counts from the centre of the first pixel, this package from its corner.
    return np.array([[fx, 0.0, ppx + 0.5], [0.0, fy, ppy + 0.5], [0.0, 0.0, 1.0]])


def read_extrinsics(path: Path, keys: Sequence[str]) -> Float[ndarray, "n 4 4"]:
    """Read poses of cameras or tags, all in the frame of one of the cameras, by name. Raises ``InputError``."""
    value = read_yaml(path).get("extrinsics")
    poses = {str(key): values for key, values in value.items()} if isinstance(value, dict) else {}
    T_master = []
    for key in keys:
        values = poses.get(key)
        numbers = [_as_float(number) for number in values] if isinstance(values, list | tuple) else []
        if len(numbers) != 12 or not np.isfinite(numbers).all():
            raise InputError(path, f"extrinsics.{key}", shorten_value(values), "12 numbers, [R | t] row by row")
        T_master.append(np.vstack([np.reshape(numbers, (3, 4)), [0.0, 0.0, 0.0, 1.0]]))
        if not se3.is_rigid(T_master[-1]):
            raise InputError(path, f"extrinsics.{key}", "a matrix that is not a rigid motion", "[R | t] in metres")
    return np.stack(T_master)


def parse_names(path: Path, entry: Mapping[str, object], key: str) -> list[str]:
    """Parse a list of different names that can be parts of paths; at least one. Raises ``InputError``."""
    value = entry.get(key)
    names = [str(name) for name in value] if isinstance(value, list) and len(value) < MAX_NAMES else []
    if not names or len(set(names)) < len(names) or not all(map(is_portable_name, names)):
        raise InputError(path, key, shorten_value(value), "a list of different names")
    return names


def parse_integer(path: Path, entry: Mapping[str, object], key: str, least: int, most: int) -> int:
    """Parse a whole number. Raises ``InputError``."""
    value = entry.get(key)
    if type(value) is not int or not least <= value <= most:
        raise InputError(path, key, shorten_value(value), f"a whole number from {least} to {most}")
    return value
