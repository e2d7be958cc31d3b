"""Dictionaries of arrays out of pickles from strangers, within bounds."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from types import MappingProxyType

from numpy import ndarray

from getagrip.errors import InputError
from getagrip.io.pickles.machine import run
from getagrip.io.pickles.stand_ins import Array, DType, ForbiddenNameError, Instance, Name, StandIns

LARGEST = 64 * 2**20
"""Bytes of the largest file read; MANO's have 4 MB."""
MOST_VALUES, DEEPEST = 2**24, 32
"""Values in a file's lists and dictionaries, each as often as it is in one (8 bytes of a text or an array are a value);
lists within lists.
"""
NO_CLASSES: Mapping[tuple[str, str], str] = MappingProxyType({})


def read(
    path: Path, content: bytes, what: str, classes: Mapping[tuple[str, str], str] = NO_CLASSES
) -> dict[str, object]:
    """The dictionary in a pickle, or in a pickled array of one object, as ``np.save`` writes it.

    It holds arrays of numbers or text, and Python's own values. Objects of ``classes`` (module and name: kind) come as
    an ``Instance`` of that kind; any other name is refused. ``what`` says in errors what is expected. Raises
    ``InputError``, also for what is malformed, no dictionary, or small in the file and vast in memory.
    """
    if len(content) > LARGEST:
        raise InputError(path, "", f"{len(content) / 2**20:.0f} MB", f"{what} of at most {LARGEST >> 20} MB")
    try:
        value = run(content, StandIns(classes))
        check_bounded(path, value, what)
        value = _finished(value, {})
        if not isinstance(value, dict):
            raise InputError(path, "", f"a pickled {type(value).__name__}", f"{what} (a dictionary)")
        return {str(key): item for key, item in value.items()}
    except InputError:
        raise
    except ForbiddenNameError as error:
        raise InputError(path, "", f"a pickle that names {error}", f"{what}; nothing in it was run") from error
    except Exception as error:  # damaged pickles raise whatever their instructions meet
        raise InputError(path, "", f"a pickle that does not load ({error})", what) from error


def check_bounded(path: Path, value: object, what: str) -> None:
    """Refuse what is small in a file and without bounds in memory: a list that holds another twice, which holds ...

    Raises ``InputError``, also for what contains itself.
    """
    sizes: dict[int, tuple[int, int]] = {}

    def size(value: object, depth: int) -> tuple[int, int]:
        """How many values there are in one, and how deep they are nested."""
        if isinstance(value, float | int):  # most values, at once
            return 1, 0
        parts = _parts(value)
        if parts is None:
            return max(1, _bytes(value) // 8), 0
        if depth > DEEPEST:  # before what follows, which would not end for a list that holds itself
            raise InputError(path, "", f"values nested more than {DEEPEST} deep", what)
        if id(value) not in sizes:
            inner = [size(part, depth + 1) for part in parts]
            sizes[id(value)] = max(1, sum(n for n, _ in inner)), 1 + max((deep for _, deep in inner), default=0)
        if depth + sizes[id(value)][1] > DEEPEST + 1:
            raise InputError(path, "", f"values nested more than {DEEPEST} deep", what)
        return sizes[id(value)]

    if (total := size(value, 0)[0]) > MOST_VALUES:
        raise InputError(path, "", f"lists of {total:.3g} values in all", f"{what}, of at most {MOST_VALUES} values")


def _parts(value: object) -> Collection[object] | None:
    """The values that a value holds, or nothing for one that is whole."""
    match value:
        case dict():
            return value.values()
        case list() | tuple():
            return value
        case Instance():
            return value.state.values()
        case Array(content=list() as items):
            return items
    return None


def _bytes(value: object) -> int:
    """Of a text or an array, torch's too."""
    if isinstance(value, str | bytes | bytearray):
        return len(value)
    return int(getattr(value.content if isinstance(value, Array) else value, "nbytes", 0))


def _finished(value: object, done: dict[int, object]) -> object:
    """A bounded value with arrays for their stand-ins. What was shared still is, so that nothing grows."""
    if isinstance(value, float | int):
        return value
    match value:
        case Name():
            raise ForbiddenNameError(value.text)
        case DType() | Array(content=None):
            raise ValueError("an array without contents")
        case Array(content=ndarray() as numbers):
            return numbers
    if _parts(value) is None:
        return value
    if id(value) not in done:
        done[id(value)] = _rebuilt(value, done)
    return done[id(value)]


def _rebuilt(value: object, done: dict[int, object]) -> object:
    match value:
        case dict():
            return {key: _finished(item, done) for key, item in value.items()}
        case list():
            return [_finished(item, done) for item in value]
        case tuple():
            return tuple(_finished(item, done) for item in value)
        case Instance():
            return Instance(value.kind, {key: _finished(item, done) for key, item in value.state.items()})
        case Array(content=list() as items):  # of objects
            return _finished(items[0] if value.shape == () else items, done)
    raise AssertionError(f"{type(value).__name__} has no parts")
