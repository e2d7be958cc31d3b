"""DexYCB's calibration: YAML files, of Python's own types only tuples in them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.io.files import read_bytes, shorten_value

MAX_YAML_BYTES = 2**16
"""Limit in bytes of a description; DexYCB's have a few hundred."""
TABLE_TAG = "apriltag"
"""On the table, z up."""


def read_dexycb_intrinsics(path: Path) -> Float[ndarray, "3 3"]:
    """Read the intrinsics of the colour camera [px]. Raises ``InputError``."""
    colour = read_yaml(path).get("color")
    wanted = [colour.get(key) if isinstance(colour, dict) else None for key in ("fx", "fy", "ppx", "ppy")]
    fx, fy, ppx, ppy = (float(v) if isinstance(v, float | int) else np.nan for v in wanted)
    if not (np.isfinite([fx, fy, ppx, ppy]).all() and fx > 0.0 and fy > 0.0):
        raise InputError(path, "color", shorten_value(colour), "fx, fy, ppx, ppy in pixels, fx and fy above 0")
    # DexYCB counts from the centre of the first pixel, this package from its corner.
    return np.array([[fx, 0.0, ppx + 0.5], [0.0, fy, ppy + 0.5], [0.0, 0.0, 1.0]])


def read_table_camera(path: Path, serial: str) -> Float[ndarray, "4 4"]:
    """Read the pose of a camera in the frame of the tag on the table. Raises ``InputError``."""
    value = read_yaml(path).get("extrinsics")
    T_master = {}
    for key in (serial, TABLE_TAG):  # both in the frame of one of the cameras
        values = value.get(key) if isinstance(value, dict) else None
        numbers = values if isinstance(values, list | tuple) else []
        if len(numbers) != 12 or not all(isinstance(v, float | int) for v in numbers):
            raise InputError(path, f"extrinsics.{key}", shorten_value(values), "12 numbers, [R | t] row by row")
        T_master[key] = np.vstack([np.array(numbers, dtype=float).reshape(3, 4), [0.0, 0.0, 0.0, 1.0]])
        if not se3.is_rigid(T_master[key]):
            raise InputError(path, f"extrinsics.{key}", "a matrix that is no rigid motion", "[R | t] in metres")
    return np.asarray(se3.inverse(T_master[TABLE_TAG]) @ T_master[serial])


def read_yaml(path: Path) -> dict[str, object]:
    """Read a YAML mapping; of Python's own types only tuples are allowed, which DexYCB's calibration holds.

    Raises ``InputError``.
    """
    import yaml

    class Loader(yaml.SafeLoader):  # type: ignore[misc]
        """YAML's own types and tuples, without aliases, by which a small file can unfold to a huge one."""

        def compose_node(self, parent: object, index: object) -> object:
            if self.check_event(yaml.AliasEvent):
                raise yaml.YAMLError("an alias")
            return super().compose_node(parent, index)

    Loader.add_constructor("tag:yaml.org,2002:python/tuple", Loader.construct_sequence)
    try:
        content = yaml.load(read_bytes(path, MAX_YAML_BYTES), Loader)
    except Exception as error:  # what is no date, number or truth value raises whatever its parser meets
        raise InputError(path, "", f"text that is no plain YAML ({error})", "a YAML mapping") from error
    if not isinstance(content, dict):
        raise InputError(path, "", f"a YAML {type(content).__name__}", "a YAML mapping")
    return content
