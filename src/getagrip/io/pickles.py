"""Dictionaries of arrays in untrusted pickles, read within bounds and without running any code in them.

A pickle is a program for a stack machine; the machine here has only the instructions that build data. Python's
unpickler calls the functions that a file names. Here a name is text on the stack, and the instructions that call a
function or set an object's state pass both to ``StandIns``. Persistent ids, extension codes, classes of protocol 0 and
out-of-band buffers are refused.

Stand-ins replace numpy's builders. Numpy's ``dtype``, ``ndarray`` and ``scalar`` trust a pickle's state: a forged one
turns plain bytes into pointers. Here a type is one of plain numbers or text, of which only the byte order can be set,
and an array has exactly the bytes that its shape and type need.
"""

from __future__ import annotations

import io
import math
import pickletools
import re
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal, Protocol

import numpy as np
from jaxtyping import Shaped
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.io.files import printable, read_bytes, shorten_value

MAX_PICKLE_INSTRUCTIONS = 2**22
"""An instruction has at least one byte in the file, and takes up to 224 bytes of memory (an empty set)."""
Value = Any
"""A value on the stack, of any type; an instruction raises if it does not fit."""
PICKLE_KEY_TYPES = str | bytes | int | float | np.generic | None
"""Types of keys: tuples that share parts may take hours to hash."""


class PickleObjects(Protocol):
    """The meaning of the names in a pickle. Each method raises for forbidden names, arguments and states."""

    def named(self, module: object, name: object) -> object:
        """Return the stand-in for a name."""

    def make(self, name: object, arguments: object) -> object:
        """Return the stand-in for the result of calling a name."""

    def build(self, target: object, state: object) -> None:
        """Set the state of a result of ``make``."""


def run_pickle(content: bytes, objects: PickleObjects) -> object:
    """Load the object in a pickle. A malformed pickle may raise any ``Exception``."""
    machine = _PickleMachine(objects)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # texts with escapes unknown to Python
        for name, argument in _instructions(content):
            if name not in _OPCODE_ACTIONS:
                raise ValueError(f"the instruction {name}")
            _OPCODE_ACTIONS[name](machine, argument)
    return machine.stack.pop()


def check_keys(values: Sequence[object]) -> Sequence[object]:
    """Return values that may be keys. Raises ``ValueError`` for others."""
    for value in values:
        if not isinstance(value, PICKLE_KEY_TYPES):
            raise ValueError(f"a key of type {type(value).__name__}")
    return values


def _instructions(content: bytes) -> Iterator[tuple[str, Value]]:
    """Yield name and argument of each instruction before STOP. Arguments are no longer than the remaining bytes."""
    stream = io.BytesIO(content)
    for _ in range(MAX_PICKLE_INSTRUCTIONS):
        code = stream.read(1)
        if code not in _OPCODES:
            raise ValueError(f"the instruction {code!r}")
        opcode = _OPCODES[code]
        if opcode.name == "STOP":
            return
        if opcode.name == "STRING":  # Python 2 wrote arrays this way; pickletools before Python 3.12 takes ASCII only
            yield opcode.name, _python2_text(stream.readline())
        else:
            yield opcode.name, opcode.arg.reader(stream) if opcode.arg else None
    raise ValueError(f"more than {MAX_PICKLE_INSTRUCTIONS} instructions")


def _python2_text(line: bytes) -> str:
    """Parse a quoted and escaped text of Python 2, its bytes as Latin-1."""
    quoted = line.rstrip(b"\r\n")
    if len(quoted) < 2 or quoted[:1] not in {b"'", b'"'} or quoted[-1:] != quoted[:1]:
        raise ValueError("a text without quotes")
    return quoted[1:-1].decode("unicode_escape")


class _PickleMachine:
    def __init__(self, objects: PickleObjects) -> None:
        self.objects = objects
        self.stack: list[Value] = []
        self.below: list[list[Value]] = []
        """Stacks below the marks."""
        self.memo: dict[int, Value] = {}

    def push(self, value: Value) -> None:
        self.stack.append(value)

    def pop(self, count: int) -> list[Value]:
        """Pop the last values, in the order of their pushes."""
        return [self.stack.pop() for _ in range(count)][::-1]

    def mark(self) -> None:
        self.below.append(self.stack)
        self.stack = []

    def pop_marked(self) -> list[Value]:
        """Pop all values above the last mark, and the mark."""
        values, self.stack = self.stack, self.below.pop()
        return values

    def memorise(self, index: int) -> None:
        self.memo[index] = self.stack[-1]

    def last(self, kind: type) -> Value:
        if type(self.stack[-1]) is not kind:
            raise ValueError(f"a {type(self.stack[-1]).__name__} where a {kind.__name__} belongs")
        return self.stack[-1]

    def extend(self, values: list[Value]) -> None:
        self.last(list).extend(values)

    def update(self, pairs: list[Value]) -> None:
        """Add alternating keys and values to the last dictionary."""
        self.last(dict).update(zip(check_keys(pairs[::2]), pairs[1::2], strict=True))

    def add(self, values: list[Value]) -> None:
        self.last(set).update(check_keys(values))

    def dictionary(self) -> None:
        pairs = self.pop_marked()
        self.push({})
        self.update(pairs)

    def make(self) -> None:
        name, arguments = self.pop(2)
        self.push(self.objects.make(name, arguments))

    def build(self) -> None:
        (state,) = self.pop(1)
        self.objects.build(self.stack[-1], state)


_OPCODES = {opcode.code.encode("latin1"): opcode for opcode in pickletools.opcodes}
_PUSH_OPCODES = (
    "INT BININT BININT1 BININT2 LONG LONG1 FLOAT BINFLOAT STRING BINSTRING SHORT_BINSTRING UNICODE BINUNICODE "
    "SHORT_BINUNICODE BINUNICODE8 BINBYTES SHORT_BINBYTES BINBYTES8 BYTEARRAY8"
)
"""Opcodes that push their argument, without LONG4: its integers are too long to print."""
_OPCODE_ACTIONS: dict[str, Callable[[_PickleMachine, Value], object]] = {
    "PROTO": lambda m, version: None,
    "FRAME": lambda m, length: None,
    **dict.fromkeys(_PUSH_OPCODES.split(), _PickleMachine.push),
    "NONE": lambda m, _: m.push(None),
    "NEWTRUE": lambda m, _: m.push(True),
    "NEWFALSE": lambda m, _: m.push(False),
    "MARK": lambda m, _: m.mark(),
    "POP": lambda m, _: m.pop(1),
    "POP_MARK": lambda m, _: m.pop_marked(),
    "DUP": lambda m, _: m.push(m.stack[-1]),
    "EMPTY_TUPLE": lambda m, _: m.push(()),
    "TUPLE": lambda m, _: m.push(tuple(m.pop_marked())),
    "TUPLE1": lambda m, _: m.push(tuple(m.pop(1))),
    "TUPLE2": lambda m, _: m.push(tuple(m.pop(2))),
    "TUPLE3": lambda m, _: m.push(tuple(m.pop(3))),
    "EMPTY_LIST": lambda m, _: m.push([]),
    "LIST": lambda m, _: m.push(m.pop_marked()),
    "APPEND": lambda m, _: m.extend(m.pop(1)),
    "APPENDS": lambda m, _: m.extend(m.pop_marked()),
    "EMPTY_DICT": lambda m, _: m.push({}),
    "DICT": lambda m, _: m.dictionary(),
    "SETITEM": lambda m, _: m.update(m.pop(2)),
    "SETITEMS": lambda m, _: m.update(m.pop_marked()),
    "EMPTY_SET": lambda m, _: m.push(set()),
    "ADDITEMS": lambda m, _: m.add(m.pop_marked()),
    **dict.fromkeys(("PUT", "BINPUT", "LONG_BINPUT"), _PickleMachine.memorise),
    "MEMOIZE": lambda m, _: m.memorise(len(m.memo)),
    **dict.fromkeys(("GET", "BINGET", "LONG_BINGET"), lambda m, index: m.push(m.memo[index])),
    "GLOBAL": lambda m, names: m.push(m.objects.named(*names.split(" ", 1))),
    "STACK_GLOBAL": lambda m, _: m.push(m.objects.named(*m.pop(2))),
    "REDUCE": lambda m, _: m.make(),
    "NEWOBJ": lambda m, _: m.make(),
    "BUILD": lambda m, _: m.build(),
}
"""Effect of each allowed opcode on the machine, given its argument."""

MAX_UNPICKLED_BYTES = 2**27
"""Limit of all objects made from one pickle. Honest ones need twice the file's size; forged ones reuse its bytes."""
NUMPY_TYPE_PATTERN = re.compile(r"b1|[iu][1248]|f[248]|[SU][1-9][0-9]{0,8}")
"""Numpy's names for booleans, integers, floats and texts of a fixed length."""
MAX_CODE_POINT = 0x10FFFF


class ForbiddenNameError(Exception):
    """A pickle names a function or class that arrays do not need."""


@dataclass(frozen=True, slots=True)
class PickledName:
    """An allowed name, as text that can neither be called nor changed."""

    text: str


@dataclass(eq=False, slots=True)
class DType:
    """A stand-in for ``numpy.dtype``."""

    kind: str
    order: str = "="


@dataclass(eq=False, slots=True)
class PickledArray:
    """A stand-in for an array whose content is set later: numbers, text, or a list of objects."""

    content: ndarray | list[object] | None = None
    shape: tuple[int, ...] = ()


@dataclass(eq=False, slots=True)
class PickledInstance:
    """A stand-in for an object of an accepted class: its state, without behaviour."""

    kind: str
    state: dict[str, object] = field(default_factory=dict)


ALLOWED_PICKLE_NAMES = {
    ("numpy", "ndarray"): PickledName("ndarray"),
    ("numpy", "dtype"): PickledName("dtype"),
    ("_codecs", "encode"): PickledName("encode"),
    ("collections", "OrderedDict"): PickledName("OrderedDict"),
    **{(module, "_reconstructor"): PickledName("_reconstructor") for module in ("copy_reg", "copyreg")},
    **{(m, name): PickledName(name) for m in ("__builtin__", "builtins") for name in ("object", "set", "bytes")},
    **{
        (f"numpy.{core}.{module}", name): PickledName(name)
        for core in ("core", "_core")
        for module, name in (("multiarray", "_reconstruct"), ("multiarray", "scalar"), ("numeric", "_frombuffer"))
    },
}


class StandIns:
    """The stand-ins of one pickle; ``classes`` maps module and name to the kinds of ``PickledInstance``."""

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
        """Return the stand-in for a call as numpy writes it. Raises ``ForbiddenNameError`` for all other arguments."""
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
        """Build Python's own types, by their names in pickles, and instances of accepted classes."""
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
        """Build an array with its own memory from exactly its bytes, which come as text from Python 2."""
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
            raise ValueError("invalid Unicode")
        return flat.reshape(shape, order=order).copy(order)

    def _count(self, made: int) -> None:
        self._bytes_made += made
        if self._bytes_made > self._most_bytes:
            raise ValueError(f"objects of more than {self._most_bytes >> 20} MB in all")


MAX_PICKLE_BYTES = 64 * 2**20
"""Limit of a file; MANO's have 4 MB."""
MAX_PICKLE_VALUES, MAX_PICKLE_DEPTH = 2**24, 32
"""Limits of a file: values in lists and dictionaries, counted once per occurrence (8 bytes of a text or an array are a
value); and levels of nested lists."""
NPY_MAGIC = b"\x93NUMPY"
NO_CLASSES: Mapping[tuple[str, str], str] = MappingProxyType({})


def read_pickle_file(path: Path, what: str, largest: int = MAX_PICKLE_BYTES) -> dict[str, object]:
    """Read a pickled dictionary, also in an ``.npy`` file (``np.save`` of a dictionary), as ``read_pickle_dict`` does.

    Raises ``InputError``.
    """
    content = read_bytes(path, largest)
    if content[: len(NPY_MAGIC)] == NPY_MAGIC:
        stream = io.BytesIO(content)
        headers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
        try:
            shape, _, dtype = headers[np.lib.format.read_magic(stream)](stream)
        except Exception as error:  # the header is a Python literal: its parser raises many types
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

    Its values are arrays of numbers or text, and Python's own types. Objects of ``classes`` (module and name: kind)
    become a ``PickledInstance`` of that kind. ``what`` names the expected file in errors. Raises ``InputError`` for any
    other name, more than ``largest`` bytes or the memory of a file of that size, and for all but a dictionary.
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
    """Read any value in a pickle as ``read_pickle_dict`` does; keys of a dictionary become text."""
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
    except Exception as error:  # damaged pickles raise many types
        raise InputError(path, "", f"a pickle that does not load ({error})", what) from error


def check_bounded(path: Path, value: object, what: str, most: int = MAX_PICKLE_VALUES) -> None:
    """Raise ``InputError`` for a value too large once unpacked (a list that holds another twice, which holds ...).

    A list that contains itself is too large.
    """
    sizes: dict[int, tuple[int, int]] = {}

    def size(value: object, depth: int) -> tuple[int, int]:
        """Return the number of contained values, and the levels of nesting."""
        if isinstance(value, float | int):  # most values, at once
            return 1, 0
        parts = _contained_values(value)
        if parts is None:
            return max(1, _size_in_bytes(value) // 8), 0
        if depth > MAX_PICKLE_DEPTH:  # first: the recursion would not end for a list that contains itself
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
    """Return the values inside a container; None for other values."""
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
    """Replace stand-ins in a bounded value by arrays. Shared parts stay shared, so that memory does not grow."""
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
