"""Reading MANO's pickles without running what is in them.

The published files are Python 2 pickles that name numpy, scipy and chumpy classes. Here a pickle may name only what
stands in ``_allowed``: numpy's array builders, and empty stand-ins for chumpy's and scipy's classes that do nothing but
hold their state. Everything else (``os.system``, ``builtins.eval``, ...) is refused before it is looked up.
"""

from __future__ import annotations

import io
import pickle
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

from getagrip.errors import InputError

LARGEST = 64 * 2**20
"""Bytes of the largest file read; MANO's have 4 MB."""
MOST_VALUES, DEEPEST = 2**24, 32
"""Values in a file's lists and dictionaries, each as often as it is in one; lists within lists."""


def read_pickle(path: Path, content: bytes, what: str = "a MANO pickle") -> dict[str, object]:
    """The dictionary in a MANO pickle, chumpy and sparse arrays as plain arrays; or in one of other people's arrays.

    A dictionary in an array of one object, as ``np.save`` writes it, will do too. Raises ``InputError`` for pickles
    that name anything but arrays, are malformed, or hold no dictionary.
    """
    if len(content) > LARGEST:
        raise InputError(path, "", f"{len(content) / 2**20:.0f} MB", f"{what} of at most {LARGEST >> 20} MB")
    try:
        value = _ArraysOnly(io.BytesIO(content), encoding="latin1").load()
        if isinstance(value, ndarray) and value.dtype == object and value.shape == ():
            value = value.item()
        if not isinstance(value, dict):
            raise InputError(path, "", f"a pickled {type(value).__name__}", f"{what} (a dictionary)")
        check_bounded(path, value, what)
        return {str(key): _plain(item) for key, item in value.items()}
    except InputError:
        raise
    except _ForbiddenNameError as error:
        raise InputError(path, "", f"a pickle that names {error}", f"{what}; nothing in it was run") from error
    except Exception as error:  # damaged pickles raise whatever their opcodes meet
        raise InputError(path, "", f"a pickle that does not load ({error})", what) from error


def check_bounded(path: Path, value: object, what: str) -> None:
    """Refuse what is small in a file and without bounds in memory: a list that holds another twice, which holds ...

    Raises ``InputError``, also for what contains itself.
    """
    try:
        _bounded(value)
    except ValueError as error:
        raise InputError(path, "", str(error), f"{what}, of at most {MOST_VALUES} values") from error


def _bounded(value: object) -> Any:
    """The same value, or a ``ValueError``."""
    counts: dict[int, int] = {}

    def count(value: object, at: int) -> int:
        if not isinstance(value, dict | list | tuple):
            return 1
        if at > DEEPEST:
            raise ValueError(f"values nested more than {DEEPEST} deep")
        if id(value) not in counts:
            items = value.values() if isinstance(value, dict) else value
            counts[id(value)] = sum(count(item, at + 1) for item in items)
        return counts[id(value)]

    if (total := count(value, 0)) > MOST_VALUES:
        raise ValueError(f"lists of {total:.3g} values in all")
    return value


class _ForbiddenNameError(Exception):
    """A pickle names something that is no array."""


class _Inert:
    """Stands in for an object of chumpy or scipy: it holds the state, and has no behaviour."""

    def __init__(self, *_: object) -> None:
        self.state: dict[str, Any] = {}

    def __setstate__(self, state: object) -> None:
        if not isinstance(state, dict):
            raise ValueError(f"state of type {type(state).__name__}")
        self.state = state


class _ArraysOnly(pickle.Unpickler):
    def __init__(self, file: io.BytesIO, encoding: str) -> None:
        super().__init__(file, encoding=encoding)
        self._named = _allowed()

    def find_class(self, module: str, name: str) -> Any:
        try:
            return self._named[module, name]
        except KeyError:
            raise _ForbiddenNameError(f"{module}.{name}") from None


def _allowed() -> dict[tuple[str, str], Any]:
    """What a pickle may name. Stand-ins are made anew for each file, so that no file can alter them for the next."""
    from numpy._core.multiarray import scalar

    stand_ins = {kind: type(kind, (_Inert,), {}) for kind in ("Ch", "Select", "csc_matrix", "csr_matrix")}
    named: dict[tuple[str, str], Any] = {
        ("numpy", "ndarray"): ndarray,
        ("numpy", "dtype"): np.dtype,
        ("_codecs", "encode"): _latin1,
        ("collections", "OrderedDict"): dict,
        ("copy_reg", "_reconstructor"): _reconstructor,
        ("copyreg", "_reconstructor"): _reconstructor,
        ("__builtin__", "object"): object,
        ("builtins", "object"): object,
        ("__builtin__", "set"): set,
        ("builtins", "set"): set,
        ("chumpy", "Ch"): stand_ins["Ch"],
        ("chumpy.ch", "Ch"): stand_ins["Ch"],
        ("chumpy.reordering", "Select"): stand_ins["Select"],
    }
    for core in ("numpy.core.multiarray", "numpy._core.multiarray"):
        named[core, "_reconstruct"], named[core, "scalar"] = _empty, scalar
    for kind in ("csc", "csr"):
        for module in (f"scipy.sparse.{kind}", f"scipy.sparse._{kind}", "scipy.sparse"):
            named[module, f"{kind}_matrix"] = stand_ins[f"{kind}_matrix"]
    return named


def _empty(kind: type, shape: tuple[int, ...], _: object) -> object:
    """Numpy's arrays begin as empty ones, and are given their contents after that."""
    if kind is not ndarray or shape != (0,):
        raise _ForbiddenNameError(f"an array of shape {shape} without contents")
    return ndarray(shape)


def _latin1(text: str, encoding: str) -> bytes:
    """Protocol 2 spells bytes as ``_codecs.encode(text, 'latin1')``; no other codec is wanted."""
    if encoding != "latin1":
        raise _ForbiddenNameError(f"the codec {encoding!r}")
    return text.encode("latin1")


def _reconstructor(kind: type, base: type, _: object) -> object:
    """Python 2's way to spell ``object.__new__(kind)``."""
    if not issubclass(kind, _Inert) or base is not object:
        raise _ForbiddenNameError(f"copy_reg for {kind.__name__}")
    return kind()


def _plain(value: object) -> object:
    """A chumpy or sparse object as an array; anything else as it is."""
    if not isinstance(value, _Inert):
        return value
    state, kind = value.state, type(value).__name__
    if kind == "Ch":
        return _array(state["x"])
    if kind == "Select":  # chumpy's compute_r: some elements of the flattened array, in a new shape
        return _array(state["a"]).ravel()[_array(state["idxs"])].reshape(state["preferred_shape"])
    return _dense(kind, state)


def _array(value: object) -> ndarray:
    """What an object holds, as an array."""
    return np.asarray(_bounded(_plain(value)))


def _dense(kind: str, state: dict[str, Any]) -> ndarray:
    """A compressed sparse matrix in full; numpy refuses indices that lie outside."""
    rows, cols = (int(n) for n in state.get("_shape", state.get("shape", ())))
    starts, inner, data = (_array(state[key]) for key in ("indptr", "indices", "data"))
    if rows * cols > 2**24 or len(starts) != (cols if kind == "csc_matrix" else rows) + 1:
        raise ValueError(f"a {rows} x {cols} matrix with {len(starts)} starts")
    outer = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    out = np.zeros((rows, cols))
    out[(inner, outer) if kind == "csc_matrix" else (outer, inner)] = data
    return out
