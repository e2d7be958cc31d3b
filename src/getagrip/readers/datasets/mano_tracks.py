"""Inputs that several datasets share: hands from MANO's parameters and the user's MANO files, and the YCB models."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from tyro.conf import arg

from getagrip.clip import HandTrack
from getagrip.errors import InputError, MissingOptionError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files import MESH_SUFFIXES, read_mesh
from getagrip.hands import mano
from getagrip.hands.model import SIDE_MIRROR, Side, hand_track, root_transform
from getagrip.io import arrays
from getagrip.io.files import shorten_value

MANO_FILE_NAMES: dict[Side, str] = {"left": "MANO_LEFT.pkl", "right": "MANO_RIGHT.pkl"}


def mano_folder(folder: Path | None, dataset: str) -> Path:
    """Return the folder with the user's MANO files. Raises ``UsageError`` without a folder or files in it."""
    if folder is None:
        raise MissingOptionError(
            f"missing --mano: {dataset} holds its hands as parameters of MANO; the folder of "
            f"{' and '.join(MANO_FILE_NAMES.values())} (https://mano.is.tue.mpg.de)"
        )
    if not any((folder / name).is_file() for name in MANO_FILE_NAMES.values()):
        raise UsageError(f"--mano must be a folder with {' and '.join(MANO_FILE_NAMES.values())} (got {folder})")
    return folder


def load_mano_hand(folder: Path, side: Side, repaired: bool = True) -> mano.Mano:
    """Load a MANO hand; unless ``repaired``, with the faulty shape space of the published left hand.

    Betas fitted with the published left hand give the true surface only with its fault (``hands.mano``). Raises
    ``InputError``.
    """
    hand = mano.load(folder / MANO_FILE_NAMES[side], side)
    if side == "right" or repaired:
        return hand
    shape, joints = (d * SIDE_MIRROR[:, None] for d in (hand.model.shape_directions, hand.model.joint_directions))
    return replace(hand, model=replace(hand.model, shape_directions=shape, joint_directions=joints))


def mano_hand_track(
    hand: mano.Mano,
    rotation: Float[ndarray, "T 3"],
    pose: Float[ndarray, "T 45"],
    translation: Float[ndarray, "T 3"],
    shape: Float[ndarray, "10"],
    flat_hand_mean: bool,
    T_cam: Float[ndarray, "*T 4 4"],
) -> HandTrack:
    """Return the hand in each frame, from MANO's parameters as rotation vectors [rad] and translations [m].

    ``T_cam`` transforms the parameters' frame to the camera frame.
    """
    shaped = hand.model.with_shape(shape)
    posed = shaped.with_pose(hand.pose(pose, "axis_angle", flat_hand_mean))
    return hand_track(posed, T_cam @ root_transform(se3.exp_so3(rotation), translation, shaped.joints[0]))


def check_mano_numbers(
    path: Path, entry: Mapping[str, object], key: str, shape: tuple[int, ...], of: str = ""
) -> Float[ndarray, "..."]:
    """Check that an array is finite and has a shape; -1 stands for any length above 0, leading axes of 1 are dropped.

    ``of`` names ``entry`` in errors, where it is nested in another dictionary. Raises ``InputError``.
    """
    name = f"{of}.{key}" if of else key
    if key not in entry:
        raise InputError(path, name, "no such key", "the key")
    value: object = entry[key]
    if isinstance(value, list | tuple):
        value = arrays.from_lists(value)
    if not isinstance(value, ndarray):
        raise InputError(path, name, shorten_value(entry[key]), f"numbers of shape {shape}")
    if value.dtype.kind not in "fiu":
        raise InputError(path, name, f"an array of {value.dtype}", f"numbers of shape {shape}")
    if value.size == abs(int(np.prod(shape))) and -1 not in shape:
        value = value.reshape(shape)
    return arrays.floats(path, {name: value}, name, shape, kinds="fiu")


Models = Annotated[Path | None, arg(metavar="DIR", help_behavior_hint="(default: ROOT/models)")]
"""The option for the folder of the YCB models."""


def ycb_models_folder(root: Path, value: Path | None) -> Path:
    """Return the folder of the YCB models, by default ``models`` in ``root``. Raises ``UsageError`` without it."""
    models = value or root / "models"
    if not models.is_dir():
        raise UsageError(f"--meshes must be the folder of the YCB models (got {models}, not a folder)")
    return models


def read_ycb_mesh(models: Path, name: str) -> Mesh:
    """Read a YCB model [m]. Raises ``InputError``, also where the folder has no model of the name."""
    found = find_mesh(models, name)
    if found is None:
        raise InputError(models, name, "no mesh of it", f"{name}.obj or {name}/*.obj")
    return found


@lru_cache
def find_mesh(models: Path, name: str) -> Mesh | None:
    """Find ``<name>.obj`` (or another format), or as YCB has it, ``<name>/textured_simple.obj``; else None."""
    for path in (*(models / f"{name}{suffix}" for suffix in MESH_SUFFIXES), models / name / "textured_simple.obj"):
        if path.is_file():
            return read_mesh(path)
    return None
