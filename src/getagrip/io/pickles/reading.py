"""Dictionaries of arrays out of untrusted pickles, within bounds."""

from __future__ import annotations

import io
from collections.abc import Collection, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.io.files import read_bytes
from getagrip.io.pickles.machine import run_pickle
from getagrip.io.pickles.stand_ins import (
    MAX_UNPICKLED_BYTES,
    DType,
    ForbiddenNameError,
    PickledArray,
    PickledInstance,
    PickledName,
    StandIns,
)

MAX_PICKLE_BYTES = 64 * 2**20
"""Bytes of the largest file read; MANO's have 4 MB."""
MAX_PICKLE_VALUES, MAX_PICKLE_DEPTH = 2**24, 32
"""Values in a file's lists and dictionaries, each as often as it is in one (8 bytes of a text or an array are a value);
lists within lists.
"""
NPY_MAGIC = b"\x93NUMPY"
NO_CLASSES: Mapping[tuple[str, str], str] = MappingProxyType({})


def read_pickle_file(path: Path, what: str, largest: int = MAX_PICKLE_BYTES) -> dict[str, object]:
    """Read the dictionary in a pickle, or in an ``.npy`` file that holds a pickled one (``np.save`` of a dictionary).

    As ``read_pickle_dict`` has it. Raises ``InputError``.
    """
    content = read_bytes(path, largest)
    if content[: len(NPY_MAGIC)] == NPY_MAGIC:
        stream = io.BytesIO(content)
        headers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
        try:
            shape, _, dtype = headers[np.lib.format.read_magic(stream)](stream)
        except Exception as error:  # the header is a Python literal: its parser raises many things
            raise InputError(path, "", f"an array whose header does not parse ({error})", what) from error
        if shape != () or not dtype.hasobject:
            raise InputError(path, "", f"an array of {dtype} of shape {shape}", what)
        content = content[stream.tell() :]
    return read_pickle_dict(path, content, what, largest=largest)


def read_pickle_dict(
    path: Path,
    content: bytes,
    what: str,
    classes: Mapping[tuple[str, str], str] = NO_CLASSES,
    largest: int = MAX_PICKLE_BYTES,
) -> dict[str, object]:
    """Read the dictionary in a pickle, or in a pickled array of one object, as ``np.save`` writes it.

    It holds arrays of numbers or text, and Python's own values. Objects of ``classes`` (module and name: kind) come as
    an ``PickledInstance`` of that kind; any other name is refused. ``what`` says in errors what is expected; a file of more
    than ``largest`` bytes is refused, and what takes more memory than one so large would. Raises ``InputError``,
    also for what is malformed, no dictionary, or small in the file and vast in memory.
    """
    value = read_pickle_content(path, content, what, classes, largest)
    if not isinstance(value, dict):
        raise InputError(path, "", f"a pickled {type(value).__name__}", f"{what} (a dictionary)")
    return value


def read_pickle_content(
    path: Path,
    content: bytes,
    what: str,
    classes: Mapping[tuple[str, str], str] = NO_CLASSES,
    largest: int = MAX_PICKLE_BYTES,
) -> object:
    """Read the content of a pickle, a dictionary or not; keys of a dictionary are text.

    Raises ``InputError``.
    """
    if len(content) > largest:
        raise InputError(path, "", f"{len(content) / 2**20:.0f} MB", f"{what} of at most {largest >> 20} MB")
    try:
        value = run_pickle(content, StandIns(classes, MAX_UNPICKLED_BYTES * (largest // MAX_PICKLE_BYTES)))
        check_bounded(path, value, what, MAX_PICKLE_VALUES * (largest // MAX_PICKLE_BYTES))
        value = _replace_stand_ins(value, {})
        return {str(key): item for key, item in value.items()} if isinstance(value, dict) else value
    except InputError:
        raise
    except ForbiddenNameError as error:
        raise InputError(path, "", f"a pickle that names {error}", f"{what}; nothing in it was run") from error
    except Exception as error:  # damaged pickles raise whatever their instructions meet
        raise InputError(path, "", f"a pickle that does not load ({error})", what) from error


def check_bounded(path: Path, value: object, what: str, most: int = MAX_PICKLE_VALUES) -> None:
    """Refuse what is small in a file and without bounds in memory: a list that holds another twice, which holds ...

    Raises ``InputError``, also for what contains itself.
    """
    sizes: dict[int, tuple[int, int]] = {}

    def size(value: object, depth: int) -> tuple[int, int]:
        """Count the values in one, and how deep they are nested."""
        if isinstance(value, float | int):  # most values, at once
            return 1, 0
        parts = _contained_values(value)
        if parts is None:
            return max(1, _size_in_bytes(value) // 8), 0
        if depth > MAX_PICKLE_DEPTH:  # before what follows, which would not end for a list that holds itself
            raise InputError(path, "", f"values nested more than {MAX_PICKLE_DEPTH} deep", what)
        if id(value) not in sizes:
            inner = [size(part, depth + 1) for part in parts]
            sizes[id(value)] = max(1, sum(n for n, _ in inner)), 1 + max((deep for _, deep in inner), default=0)
        if depth + sizes[id(value)][1] > MAX_PICKLE_DEPTH + 1:
            raise InputError(path, "", f"values nested more than {MAX_PICKLE_DEPTH} deep", what)
        return sizes[id(value)]

    if (total := size(value, 0)[0]) > most:
        raise InputError(path, "", f"lists of {total:.3g} values in all", f"{what}, of at most {most} values")


def _contained_values(value: object) -> Collection[object] | None:
    """Return the values that a value holds, or nothing for one that is whole."""
    match value:
        case dict():
            return value.values()
        case list() | tuple():
            return value
        case PickledInstance():
            return value.state.values()
        case PickledArray(content=list() as items):
            return items
    return None


def _size_in_bytes(value: object) -> int:
    """Return the size of a text or an array, torch's too."""
    if isinstance(value, str | bytes | bytearray):
        return len(value)
    return int(getattr(value.content if isinstance(value, PickledArray) else value, "nbytes", 0))


def _replace_stand_ins(value: object, done: dict[int, object]) -> object:
    """Replace stand-ins in a bounded value by arrays. What was shared still is, so that nothing grows."""
    if isinstance(value, float | int):
        return value
    match value:
        case PickledName():
            raise ForbiddenNameError(value.text)
        case DType() | PickledArray(content=None):
            raise ValueError("an array without contents")
        case PickledArray(content=ndarray() as numbers):
            return numbers
    if _contained_values(value) is None:
        return value
    if id(value) not in done:
        done[id(value)] = _rebuild_container(value, done)
    return done[id(value)]


def _rebuild_container(value: object, done: dict[int, object]) -> object:
    match value:
        case dict():
            return {key: _replace_stand_ins(item, done) for key, item in value.items()}
        case list():
            return [_replace_stand_ins(item, done) for item in value]
        case tuple():
            return tuple(_replace_stand_ins(item, done) for item in value)
        case PickledInstance():
            return PickledInstance(
                value.kind, {key: _replace_stand_ins(item, done) for key, item in value.state.items()}
            )
        case PickledArray(content=list() as items):  # of objects
            return _replace_stand_ins(items[0] if value.shape == () else items, done)
    raise AssertionError(f"{type(value).__name__} has no parts")
