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

from getagrip.io.files import plain, shown
from getagrip.io.pickles.machine import plain_keys

MOST_BYTES = 2**27
"""Most bytes of all that one pickle makes. Honest ones need twice the file's size: many objects can be made of the same
bytes."""
TYPES = re.compile(r"b1|[iu][1248]|f[248]|[SU][1-9][0-9]{0,8}")
"""Numpy's names for booleans, integers, floats and texts of a fixed length."""
LARGEST_CHARACTER = 0x10FFFF


class ForbiddenNameError(Exception):
    """A pickle names something that is no array."""


@dataclass(frozen=True, slots=True)
class Name:
    """An allowed name, as text: it cannot be called, and nothing of it can be set."""

    text: str


@dataclass(eq=False, slots=True)
class DType:
    """Stands in for ``numpy.dtype``."""

    kind: str
    order: str = "="


@dataclass(eq=False, slots=True)
class Array:
    """Stands in for an array that is built after it was made: of numbers or text, or a list of objects."""

    content: ndarray | list[object] | None = None
    shape: tuple[int, ...] = ()


@dataclass(eq=False, slots=True)
class Instance:
    """Stands in for an object of a class that the reader asked for: it holds the state, and has no behaviour."""

    kind: str
    state: dict[str, object] = field(default_factory=dict)


NAMES = {
    ("numpy", "ndarray"): Name("ndarray"),
    ("numpy", "dtype"): Name("dtype"),
    ("_codecs", "encode"): Name("encode"),
    ("collections", "OrderedDict"): Name("OrderedDict"),
    **{(module, "_reconstructor"): Name("_reconstructor") for module in ("copy_reg", "copyreg")},
    **{(module, name): Name(name) for module in ("__builtin__", "builtins") for name in ("object", "set", "bytes")},
    **{
        (f"numpy.{core}.{module}", name): Name(name)
        for core in ("core", "_core")
        for module, name in (("multiarray", "_reconstruct"), ("multiarray", "scalar"), ("numeric", "_frombuffer"))
    },
}


class StandIns:
    """The stand-ins of one pickle; ``classes`` gives the kinds of ``Instance``, by module and name."""

    def __init__(self, classes: Mapping[tuple[str, str], str], most_bytes: int = MOST_BYTES) -> None:
        self._names = NAMES | {key: Name(kind) for key, kind in classes.items()}
        self._kinds = frozenset(classes.values())
        self._bytes_made, self._most_bytes = 0, most_bytes

    def named(self, module: object, name: object) -> Name:
        if not (isinstance(module, str) and isinstance(name, str)):
            raise ValueError("a name that is no text")
        if (module, name) not in self._names:
            raise ForbiddenNameError(plain(f"{module}.{name}"))
        return self._names[module, name]

    def make(self, name: object, arguments: object) -> object:
        """Return the stand-in for the arguments that numpy writes; all others are refused, as a forbidden name is."""
        match name, arguments:
            case Name("dtype"), (str() as kind, *_):
                return DType(kind)
            case Name("_reconstruct"), (Name("ndarray"), (0,), _):
                return Array()
            case Name("scalar"), (DType() as dtype, raw):
                return self._array(dtype, (), raw)[()]
            case Name("_frombuffer"), (raw, DType() as dtype, tuple() as shape, "C" | "F" as order):
                return self._array(dtype, shape, raw, order)
            case Name("_frombuffer"), (raw, DType() as dtype, tuple() as shape, "K", tuple() as axes):
                return self._array(dtype, shape, raw).transpose(axes)
        return self._make_of_python(name, arguments)

    def _make_of_python(self, name: object, arguments: object) -> object:
        """Build Python's own types, as pickles name them, and the classes that the reader asked for."""
        match name, arguments:
            case Name("encode"), (str() as text, "latin1"):  # bytes in a pickle of protocol 2
                self._count(len(text))
                return text.encode("latin1")
            case Name("bytes"), ():
                return b""
            case Name("OrderedDict"), ():
                return {}
            case Name("OrderedDict"), (list() as pairs,):
                self._count(128 * len(pairs))
                plain_keys([key for key, _ in pairs])
                return dict(pairs)
            case Name("set"), (list() as items,):
                self._count(128 * len(items))
                return set(plain_keys(items))
            case (Name(kind), ()) | (Name("_reconstructor"), (Name(kind), Name("object"), None)) if kind in self._kinds:
                return Instance(kind)
        if not isinstance(name, Name):
            raise ValueError(f"a call of a {type(name).__name__}")
        raise ForbiddenNameError(f"{name.text} with other arguments than arrays need")

    def build(self, target: object, state: object) -> None:
        """Set the byte order of a type, the content of an array, or the state of an instance."""
        match target, state:
            case DType(), (_, "<" | ">" | "|" as order, *_):
                target.order = order
            case Array(), (_, tuple() as shape, DType("O8" | "O4"), _, list() as items):
                if shape != (len(items),) and (shape, len(items)) != ((), 1):
                    raise ValueError(f"{len(items)} objects in an array of another shape")
                target.content, target.shape = items, shape
            case Array(), (_, tuple() as shape, DType() as dtype, fortran, raw):
                target.content, target.shape = self._array(dtype, shape, raw, "F" if fortran else "C"), shape
            case Instance(), dict():
                target.state = state
            case _:
                raise ValueError(f"an unexpected state of {type(target).__name__}")

    def _array(
        self, dtype: DType, shape: tuple[int, ...], raw: object, order: Literal["C", "F"] = "C"
    ) -> Shaped[ndarray, "..."]:
        """Build an array of its own memory, from exactly as many bytes; from Python 2 they come as text."""
        if not isinstance(raw, str | bytes | bytearray):
            raise ValueError(f"an array made of {type(raw).__name__}")
        if not TYPES.fullmatch(dtype.kind):
            raise ValueError(f"an array of type {shown(dtype.kind)}")
        if len(shape) > 32 or not all(type(n) is int and 0 <= n < 2**31 for n in shape):
            raise ValueError("an impossible shape")
        if math.prod(shape) * np.dtype(dtype.kind).itemsize != len(raw):
            raise ValueError(f"{len(raw)} bytes for an array of type {dtype.kind} and shape {shape}")
        self._count(len(raw))
        flat = np.frombuffer(raw.encode("latin1") if isinstance(raw, str) else raw, dtype.order + dtype.kind)
        if dtype.kind[0] == "U" and flat.view(f"{dtype.order}u4").max(initial=0) > LARGEST_CHARACTER:
            raise ValueError("text that is no Unicode")
        return flat.reshape(shape, order=order).copy(order)

    def _count(self, made: int) -> None:
        self._bytes_made += made
        if self._bytes_made > self._most_bytes:
            raise ValueError(f"objects of more than {self._most_bytes >> 20} MB in all")
