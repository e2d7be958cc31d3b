"""Stand-ins for the names in a pickle of arrays: numpy's builders, spelt out so that numpy's own are never called.

Numpy's ``dtype``, ``ndarray`` and ``scalar`` trust the state that a pickle gives them: a forged one turns plain bytes
into pointers. Here a type is one of plain numbers or text, its byte order is all that can be set, and an array has
exactly as many bytes as its shape and type take.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Shaped
from numpy import ndarray

from getagrip.io.files import printable, shorten_value
from getagrip.io.pickles.machine import check_keys

MAX_UNPICKLED_BYTES = 2**27
"""Most bytes of all that one pickle makes. Honest ones need twice the file's size: many objects can be made of the same
bytes."""
NUMPY_TYPE_PATTERN = re.compile(r"b1|[iu][1248]|f[248]|[SU][1-9][0-9]{0,8}")
"""Numpy's names for booleans, integers, floats and texts of a fixed length."""
MAX_CODE_POINT = 0x10FFFF


class ForbiddenNameError(Exception):
    """A pickle names something that is no array."""


@dataclass(frozen=True, slots=True)
class PickledName:
    """An allowed name, as text: it cannot be called, and nothing of it can be set."""

    text: str


@dataclass(eq=False, slots=True)
class DType:
    """Stands in for ``numpy.dtype``."""

    kind: str
    order: str = "="


@dataclass(eq=False, slots=True)
class PickledArray:
    """Stands in for an array that is built after it was made: of numbers or text, or a list of objects."""

    content: ndarray | list[object] | None = None
    shape: tuple[int, ...] = ()


@dataclass(eq=False, slots=True)
class PickledInstance:
    """Stands in for an object of a class that the reader asked for: it holds the state, and has no behaviour."""

    kind: str
    state: dict[str, object] = field(default_factory=dict)


ALLOWED_PICKLE_NAMES = {
    ("numpy", "ndarray"): PickledName("ndarray"),
    ("numpy", "dtype"): PickledName("dtype"),
    ("_codecs", "encode"): PickledName("encode"),
    ("collections", "OrderedDict"): PickledName("OrderedDict"),
    **{(module, "_reconstructor"): PickledName("_reconstructor") for module in ("copy_reg", "copyreg")},
    **{
        (module, name): PickledName(name)
        for module in ("__builtin__", "builtins")
        for name in ("object", "set", "bytes")
    },
    **{
        (f"numpy.{core}.{module}", name): PickledName(name)
        for core in ("core", "_core")
        for module, name in (("multiarray", "_reconstruct"), ("multiarray", "scalar"), ("numeric", "_frombuffer"))
    },
}


class StandIns:
    """The stand-ins of one pickle; ``classes`` gives the kinds of ``PickledInstance``, by module and name."""

    def __init__(self, classes: Mapping[tuple[str, str], str], most_bytes: int = MAX_UNPICKLED_BYTES) -> None:
        self._names = ALLOWED_PICKLE_NAMES | {key: PickledName(kind) for key, kind in classes.items()}
        self._kinds = frozenset(classes.values())
        self._bytes_made, self._most_bytes = 0, most_bytes

    def named(self, module: object, name: object) -> PickledName:
        if not (isinstance(module, str) and isinstance(name, str)):
            raise ValueError("a name that is no text")
        if (module, name) not in self._names:
            raise ForbiddenNameError(printable(f"{module}.{name}"))
        return self._names[module, name]

    def make(self, name: object, arguments: object) -> object:
        """Return the stand-in for the arguments that numpy writes; all others are refused, as a forbidden name is."""
        match name, arguments:
            case PickledName("dtype"), (str() as kind, *_):
                return DType(kind)
            case PickledName("_reconstruct"), (PickledName("ndarray"), (0,), _):
                return PickledArray()
            case PickledName("scalar"), (DType() as dtype, raw):
                return self._array(dtype, (), raw)[()]
            case PickledName("_frombuffer"), (raw, DType() as dtype, tuple() as shape, "C" | "F" as order):
                return self._array(dtype, shape, raw, order)
            case PickledName("_frombuffer"), (raw, DType() as dtype, tuple() as shape, "K", tuple() as axes):
                return self._array(dtype, shape, raw).transpose(axes)
        return self._make_of_python(name, arguments)

    def _make_of_python(self, name: object, arguments: object) -> object:
        """Build Python's own types, as pickles name them, and the classes that the reader asked for."""
        match name, arguments:
            case PickledName("encode"), (str() as text, "latin1"):  # bytes in a pickle of protocol 2
                self._count(len(text))
                return text.encode("latin1")
            case PickledName("bytes"), ():
                return b""
            case PickledName("OrderedDict"), ():
                return {}
            case PickledName("OrderedDict"), (list() as pairs,):
                self._count(128 * len(pairs))
                check_keys([key for key, _ in pairs])
                return dict(pairs)
            case PickledName("set"), (list() as items,):
                self._count(128 * len(items))
                return set(check_keys(items))
            case (PickledName(kind), ()) | (
                PickledName("_reconstructor"),
                (PickledName(kind), PickledName("object"), None),
            ) if kind in self._kinds:
                return PickledInstance(kind)
        if not isinstance(name, PickledName):
            raise ValueError(f"a call of a {type(name).__name__}")
        raise ForbiddenNameError(f"{name.text} with other arguments than arrays need")

    def build(self, target: object, state: object) -> None:
        """Set the byte order of a type, the content of an array, or the state of an instance."""
        match target, state:
            case DType(), (_, "<" | ">" | "|" as order, *_):
                target.order = order
            case PickledArray(), (_, tuple() as shape, DType("O8" | "O4"), _, list() as items):
                if shape != (len(items),) and (shape, len(items)) != ((), 1):
                    raise ValueError(f"{len(items)} objects in an array of another shape")
                target.content, target.shape = items, shape
            case PickledArray(), (_, tuple() as shape, DType() as dtype, fortran, raw):
                target.content, target.shape = self._array(dtype, shape, raw, "F" if fortran else "C"), shape
            case PickledInstance(), dict():
                target.state = state
            case _:
                raise ValueError(f"an unexpected state of {type(target).__name__}")

    def _array(
        self, dtype: DType, shape: tuple[int, ...], raw: object, order: Literal["C", "F"] = "C"
    ) -> Shaped[ndarray, "..."]:
        """Build an array of its own memory, from exactly as many bytes; from Python 2 they come as text."""
        if not isinstance(raw, str | bytes | bytearray):
            raise ValueError(f"an array made of {type(raw).__name__}")
        if not NUMPY_TYPE_PATTERN.fullmatch(dtype.kind):
            raise ValueError(f"an array of type {shorten_value(dtype.kind)}")
        if len(shape) > 32 or not all(type(n) is int and 0 <= n < 2**31 for n in shape):
            raise ValueError("an impossible shape")
        if math.prod(shape) * np.dtype(dtype.kind).itemsize != len(raw):
            raise ValueError(f"{len(raw)} bytes for an array of type {dtype.kind} and shape {shape}")
        self._count(len(raw))
        flat = np.frombuffer(raw.encode("latin1") if isinstance(raw, str) else raw, dtype.order + dtype.kind)
        if dtype.kind[0] == "U" and flat.view(f"{dtype.order}u4").max(initial=0) > MAX_CODE_POINT:
            raise ValueError("text that is no Unicode")
        return flat.reshape(shape, order=order).copy(order)

    def _count(self, made: int) -> None:
        self._bytes_made += made
        if self._bytes_made > self._most_bytes:
            raise ValueError(f"objects of more than {self._most_bytes >> 20} MB in all")
