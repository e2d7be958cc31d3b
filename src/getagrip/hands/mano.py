"""MANO hands, from the user's own licensed ``MANO_RIGHT.pkl`` and ``MANO_LEFT.pkl`` (https://mano.is.tue.mpg.de).

This package contains nothing of MANO except the ids of five vertices, the fingertips in common use (manopth).

The published left hand has the x displacements of its shape space with the wrong sign; ``load`` negates them
(https://github.com/vchoutas/smplx/issues/48). It expects the published file: a repaired one would become wrong.
"""

from __future__ import annotations

import hashlib
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float, Int, Shaped
from numpy import ndarray

from getagrip.errors import InputError, UsageError
from getagrip.geometry.mesh import vertex_normals
from getagrip.hands.model import KNUCKLES, PARENTS, HandModel, Side, contact_regions, position_on_palm
from getagrip.io import arrays, files, pickles
from getagrip.io.files import Json
from getagrip.io.options import check_word
from getagrip.io.pickles import PickledInstance
from getagrip.io.terminal import cache_folder

MANO_ARRAY_SHAPES = {
    "v_template": (778, 3),
    "f": (1538, 3),
    "J_regressor": (16, 778),
    "weights": (778, 16),
    "shapedirs": (778, 3, 10),
    "posedirs": (778, 3, 135),
    "hands_components": (45, 45),
    "hands_mean": (45,),
    "kintree_table": (2, 16),
}
"""The arrays read from a MANO file, and their shapes."""
FINGERTIP_VERTICES = {"right": (745, 317, 444, 556, 673), "left": (745, 317, 445, 556, 673)}
"""Vertices at the tips of thumb, index, middle, ring and little finger, as in manopth, DexYCB and HO-3D."""
MANO_PALM_DIRECTION = np.array([0.0, -1.0, 0.0])
MANO_THUMB_DIRECTION = np.array([0.0, -1.0, -2.0])
"""Directions that palm and fingers, and the thumb's pad, face on the flat hand."""
EXPECTED_MANO_PICKLE = "a MANO pickle"
MANO_PICKLE_CLASSES = {
    ("chumpy", "Ch"): "Ch",
    ("chumpy.ch", "Ch"): "Ch",
    ("chumpy.reordering", "Select"): "Select",
    **{
        (module, f"{kind}_matrix"): kind
        for kind in ("csc", "csr")
        for module in (f"scipy.sparse.{kind}", f"scipy.sparse._{kind}", "scipy.sparse")
    },
}
MAX_MATRIX_ENTRIES = 2**24
"""Maximum number of entries in a matrix, and of entries selected from one."""


@dataclass(frozen=True)
class Mano:
    """A MANO hand and its principal components of pose.

    Attributes:
        model: the skinned hand.
        components: (45, 45) principal components as rows.
        mean: (45,) the mean pose, as rotation vectors [rad].
    """

    model: HandModel
    components: Float[ndarray, "45 45"]
    mean: Float[ndarray, "45"]

    def pose(
        self, values: Float[ndarray, "*batch P"], encoding: Literal["axis_angle", "pca"], flat_hand_mean: bool
    ) -> Float[ndarray, "*batch 45"]:
        """Convert a pose to the encoding of ``ShapedHand.with_pose``.

        ``axis_angle``: 45 numbers [rad]; ``pca``: up to 45 coefficients. With ``flat_hand_mean`` they are relative to
        the flat hand (full poses of HO-3D, HOI4D, HaMeR), without it to the mean pose (DexYCB, HOT3D, ARCTIC).
        No default: the wrong choice still looks like a hand. Raises ``UsageError`` for other sizes or encodings.
        """
        count = np.shape(values)[-1] if np.ndim(values) else 0
        if encoding == "pca" and 0 < count <= 45:
            values = np.asarray(values) @ self.components[:count]
        elif encoding != "axis_angle" or count != 45:
            got = f"{count} as {encoding!r}"
            raise UsageError(f"MANO pose must be 45 numbers as 'axis_angle' or 1 to 45 as 'pca' (got {got})")
        return np.asarray(values) + (0.0 if flat_hand_mean else self.mean)


def load(path: str | Path, side: Side) -> Mano:
    """Read a published MANO file safely: no code in it is run.

    The arrays are cached as ``.npz`` in the user's cache folder, named by the file's SHA-256. Raises ``InputError`` for
    a missing, hostile or malformed file, or the other hand's, and ``UsageError`` for an unknown side.
    """
    check_word("side", side, Side)
    path = Path(path)
    content = files.read_bytes(path, pickles.MAX_PICKLE_BYTES)
    cache = cache_folder() / f"mano-{hashlib.sha256(content).hexdigest()}.npz"
    values = _read_mano_cache(cache)
    if values is None:
        values = check_mano_arrays(path, read_mano_pickle(path, content))
        # On a full or read-only disk, the pickle is read again the next time.
        with suppress(OSError), files.new_file(cache) as part:
            np.savez_compressed(part, **values)  # type: ignore[arg-type]
    return _make_mano(path, values, side)


def check_mano_arrays(path: Path, values: dict[str, object]) -> dict[str, ndarray]:
    """Return the arrays of a MANO file, checked. Raises ``InputError`` for wrong shapes and non-finite numbers."""
    found = {}
    for key, shape in MANO_ARRAY_SHAPES.items():
        if key not in values:
            raise InputError(path, key, "nothing", f"an array of shape {shape}")
        value = values[key]
        if not isinstance(value, ndarray) or value.dtype.kind not in "fiu" or value.shape != shape:
            got = f"shape {value.shape} of {value.dtype}" if isinstance(value, ndarray) else type(value).__name__
            raise InputError(path, key, got, f"numbers of shape {shape}")
        if not np.isfinite(value).all():
            raise InputError(path, key, "NaN or infinite numbers", "finite numbers")
        found[key] = value.astype(np.int64) if key in {"f", "kintree_table"} else value.astype(float)
    if found["f"].min() < 0 or found["f"].max() >= len(found["v_template"]):
        raise InputError(path, "f", f"vertex {found['f'].max()}", f"indices below {len(found['v_template'])}")
    if tuple(found["kintree_table"][0, 1:]) != PARENTS[1:]:
        raise InputError(path, "kintree_table", str(found["kintree_table"][0, 1:]), f"MANO's tree {PARENTS[1:]}")
    return found


def _make_mano(path: Path, values: dict[str, ndarray], side: Side) -> Mano:
    template, shape = values["v_template"], values["shapedirs"].copy()
    joints = values["J_regressor"] @ template
    found = "right" if joints[0, 0] > 0 else "left"  # a right hand's wrist is towards +x
    if found != side:
        raise InputError(path, "v_template", f"a {found} hand", f"a {side} hand")
    if side == "left":
        shape[:, 0] *= -1.0
    weights = values["weights"] / values["weights"].sum(axis=1, keepdims=True)
    found_regions = mano_contact_regions(template, values["f"], joints, weights)
    empty = next((name for name, ids in found_regions.items() if len(ids) == 0), None)
    if empty is not None:
        raise InputError(path, "weights", f"no vertex in the region {empty}", "MANO's skinning weights")
    model = HandModel(
        name="mano",
        side=side,
        template=template,
        faces=values["f"],
        joints=joints,
        weights=weights,
        tips=np.array(FINGERTIP_VERTICES[side]),
        regions=found_regions,
        shape_names=tuple(f"beta{k}" for k in range(10)),
        shape_directions=shape,
        joint_directions=np.tensordot(values["J_regressor"], shape, axes=1),
        shape_spread=np.ones(10),
        pose_directions=values["posedirs"],
    )
    return Mano(model, values["hands_components"], values["hands_mean"])


def mano_contact_regions(
    template: Float[ndarray, "V 3"],
    faces: Int[ndarray, "F 3"],
    joints: Float[ndarray, "16 3"],
    weights: Float[ndarray, "V 16"],
) -> dict[str, Int[ndarray, "_"]]:
    """Return the contact regions of a flat hand of either side, skinned to MANO's joints (``hands.model``).

    A fingertip's pad faces the direction of its finger, perpendicular to the finger.
    """
    normals = vertex_normals(template, faces)
    of_fingers = np.stack([weights[:, knuckle : knuckle + 3] for knuckle in KNUCKLES], axis=1)
    length, across = position_on_palm(template, joints[0], joints[KNUCKLES[1]], joints[KNUCKLES[4]])
    last = np.array(KNUCKLES) + 2
    along = _unit(joints[last] - joints[last - 1])
    faced = np.stack([MANO_THUMB_DIRECTION, *[MANO_PALM_DIRECTION] * 4])
    faced = _unit(faced - np.sum(faced * along, axis=1, keepdims=True) * along)
    return contact_regions(weights[:, 0], of_fingers, normals @ faced.T, normals @ MANO_PALM_DIRECTION, length, across)


def _unit(v: Float[ndarray, "n 3"]) -> Float[ndarray, "n 3"]:
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))


def _read_mano_cache(cache: Path) -> dict[str, ndarray] | None:
    if not cache.is_file():
        return None
    state = cache.stat()
    try:
        return _cached_mano_arrays(cache, state.st_mtime_ns, state.st_size)
    except InputError:
        return None  # a damaged cache is made again


@lru_cache(maxsize=2)  # one per side, used by every clip
def _cached_mano_arrays(cache: Path, changed: int, size: int) -> dict[str, ndarray]:
    return check_mano_arrays(cache, dict(arrays.read(cache, MANO_ARRAY_SHAPES.__contains__)))


def read_mano_pickle(path: Path, content: bytes) -> dict[str, object]:
    """Read the dictionary in a MANO pickle; chumpy's and sparse arrays become plain ones.

    Raises ``InputError`` for malformed pickles, names other than arrays', and all but a dictionary.
    """
    values = pickles.read_pickle_dict(path, content, EXPECTED_MANO_PICKLE, MANO_PICKLE_CLASSES)
    try:
        return {key: _expand_chumpy(one) if isinstance(one, PickledInstance) else one for key, one in values.items()}
    except Exception as error:  # a malformed state may raise any type
        raise InputError(path, "", f"a pickle that does not load ({error})", EXPECTED_MANO_PICKLE) from error


def _expand_chumpy(value: PickledInstance) -> Shaped[ndarray, "..."]:
    """Convert a chumpy or sparse object to an array."""
    if value.kind == "Ch":
        return _require_array(value.state["x"])
    if value.kind == "Select":  # chumpy's compute_r: some elements of the flattened array, in a new shape
        whole, ids = value.state["a"], _require_array(value.state["idxs"])
        if ids.size > MAX_MATRIX_ENTRIES:
            raise ValueError(f"{ids.size} selected elements")
        array = _require_array(whole.state["x"] if isinstance(whole, PickledInstance) else whole)
        return array.ravel()[ids].reshape(value.state["preferred_shape"])
    return _expand_sparse(value.kind, value.state)


def _require_array(value: object) -> Shaped[ndarray, "..."]:
    if not isinstance(value, ndarray) or value.dtype.kind not in "biuf":
        raise ValueError(f"a {type(value).__name__} in place of an array of numbers")
    return value


def _expand_sparse(kind: str, state: Json) -> Float[ndarray, "R C"]:
    """Expand a compressed sparse matrix."""
    rows, cols = (int(n) for n in (state["_shape"] if "_shape" in state else state.get("shape", ())))
    starts, inner, data = (_require_array(state[key]) for key in ("indptr", "indices", "data"))
    outer_size, inner_size = (cols, rows) if kind == "csc" else (rows, cols)
    if min(rows, cols) < 0 or rows * cols > MAX_MATRIX_ENTRIES or starts.shape != (outer_size + 1,):
        raise ValueError(f"a {rows} x {cols} matrix with {starts.size} starts")
    if data.shape != inner.shape or data.ndim != 1 or data.size > rows * cols:
        raise ValueError(f"{data.size} values at {inner.size} places of a {rows} x {cols} matrix")
    if starts[0] != 0 or starts[-1] != data.size or (starts[1:] < starts[:-1]).any():
        raise ValueError(f"starts that do not rise from 0 to {data.size}")
    if data.size and not 0 <= inner.min() <= inner.max() < inner_size:
        raise ValueError(f"indices from {inner.min()} to {inner.max()} of {inner_size}")
    outer = np.repeat(np.arange(outer_size), np.diff(starts))
    out = np.zeros((rows, cols))
    out[(inner, outer) if kind == "csc" else (outer, inner)] = data
    return out
