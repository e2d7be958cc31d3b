"""MANO's pickles: Python 2's, that hold objects of chumpy and scipy among their arrays. No code in them is run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Shaped
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.io import pickles
from getagrip.io.pickles import Instance

WHAT = "a MANO pickle"
CLASSES = {
    ("chumpy", "Ch"): "Ch",
    ("chumpy.ch", "Ch"): "Ch",
    ("chumpy.reordering", "Select"): "Select",
    **{
        (module, f"{kind}_matrix"): kind
        for kind in ("csc", "csr")
        for module in (f"scipy.sparse.{kind}", f"scipy.sparse._{kind}", "scipy.sparse")
    },
}
LARGEST_MATRIX = 2**24
"""Numbers in a matrix, and of those that are selected from one."""


def read_pickle(path: Path, content: bytes) -> dict[str, object]:
    """The dictionary in a MANO pickle, chumpy's and sparse arrays as plain ones.

    Raises ``InputError`` for pickles that name anything but arrays, are malformed, or hold no dictionary.
    """
    values = pickles.read(path, content, WHAT, CLASSES)
    try:
        return {key: _plain(value) if isinstance(value, Instance) else value for key, value in values.items()}
    except Exception as error:  # what is wrong with a state is as various as states are
        raise InputError(path, "", f"a pickle that does not load ({error})", WHAT) from error


def _plain(value: Instance) -> Shaped[ndarray, "..."]:
    """A chumpy or sparse object as an array."""
    if value.kind == "Ch":
        return _array(value.state["x"])
    if value.kind == "Select":  # chumpy's compute_r: some elements of the flattened array, in a new shape
        whole, ids = value.state["a"], _array(value.state["idxs"])
        if ids.size > LARGEST_MATRIX:
            raise ValueError(f"{ids.size} selected elements")
        array = _array(whole.state["x"] if isinstance(whole, Instance) else whole)
        return array.ravel()[ids].reshape(value.state["preferred_shape"])
    return _dense(value.kind, value.state)


def _array(value: object) -> Shaped[ndarray, "..."]:
    if not isinstance(value, ndarray) or value.dtype.kind not in "biuf":
        raise ValueError(f"a {type(value).__name__} in place of an array of numbers")
    return value


def _dense(kind: str, state: dict[str, Any]) -> Float[ndarray, "R C"]:
    """A compressed sparse matrix in full."""
    rows, cols = (int(n) for n in state.get("_shape", state.get("shape", ())))
    starts, inner, data = (_array(state[key]) for key in ("indptr", "indices", "data"))
    outer_size, inner_size = (cols, rows) if kind == "csc" else (rows, cols)
    if min(rows, cols) < 0 or rows * cols > LARGEST_MATRIX or starts.shape != (outer_size + 1,):
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
