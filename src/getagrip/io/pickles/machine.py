"""A pickle is a program for a stack machine. This one has only the instructions that build data.

Python's own unpickler calls what a file names. Here a name is no more than text on the stack, and the instructions that
call something, or set its state, hand both over to stand-ins (``pickles.stand_ins``). Persistent ids, extension codes,
the classes of protocol 0 and buffers kept elsewhere are refused.
"""

from __future__ import annotations

import io
import pickletools
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol

import numpy as np

MAX_PICKLE_INSTRUCTIONS = 2**22
"""Each takes one byte or more of a file, and up to 224 bytes of memory: those of an empty set."""
Value = Any
"""On the stack: what an instruction meets there may be anything, and raises where it is not what it needs."""
PICKLE_KEY_TYPES = str | bytes | int | float | np.generic | None
"""Types that may be a key: tuples that share their parts take ages to hash."""


class PickleObjects(Protocol):
    """The meaning of the names in a pickle. Each method raises for what is not allowed."""

    def named(self, module: object, name: object) -> object:
        """Return the stand-in for a name."""

    def make(self, name: object, arguments: object) -> object:
        """Return the stand-in for the result of calling a name."""

    def build(self, target: object, state: object) -> None:
        """Set the state of a result of ``make``."""


def run_pickle(content: bytes, objects: PickleObjects) -> object:
    """Load the object in a pickle. A malformed one raises whatever its instructions meet: catch ``Exception``."""
    machine = _PickleMachine(objects)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of texts with escapes that Python does not know
        for name, argument in _instructions(content):
            if name not in _OPCODE_ACTIONS:
                raise ValueError(f"the instruction {name}")
            _OPCODE_ACTIONS[name](machine, argument)
    return machine.stack.pop()


def check_keys(values: Sequence[object]) -> Sequence[object]:
    """Check that values may be keys; raise ``ValueError`` otherwise."""
    for value in values:
        if not isinstance(value, PICKLE_KEY_TYPES):
            raise ValueError(f"a key of type {type(value).__name__}")
    return values


def _instructions(content: bytes) -> Iterator[tuple[str, Value]]:
    """Name and argument of each instruction before STOP. Arguments are no longer than the bytes that are there."""
    stream = io.BytesIO(content)
    for _ in range(MAX_PICKLE_INSTRUCTIONS):
        code = stream.read(1)
        if code not in _OPCODES:
            raise ValueError(f"the instruction {code!r}")
        opcode = _OPCODES[code]
        if opcode.name == "STOP":
            return
        if opcode.name == "STRING":  # before Python 3.12 pickletools takes ASCII only; Python 2 wrote arrays this way
            yield opcode.name, _python2_text(stream.readline())
        else:
            yield opcode.name, opcode.arg.reader(stream) if opcode.arg else None
    raise ValueError(f"more than {MAX_PICKLE_INSTRUCTIONS} instructions")


def _python2_text(line: bytes) -> str:
    """Parse a text of Python 2, in quotes and escaped, its bytes as Latin-1."""
    quoted = line.rstrip(b"\r\n")
    if len(quoted) < 2 or quoted[:1] not in {b"'", b'"'} or quoted[-1:] != quoted[:1]:
        raise ValueError("a text without quotes")
    return quoted[1:-1].decode("unicode_escape")


class _PickleMachine:
    def __init__(self, objects: PickleObjects) -> None:
        self.objects = objects
        self.stack: list[Value] = []
        self.below: list[list[Value]] = []
        """The stacks below the marks."""
        self.memo: dict[int, Value] = {}

    def push(self, value: Value) -> None:
        self.stack.append(value)

    def pop(self, count: int) -> list[Value]:
        """Pop the last values, in the order in which they were pushed."""
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
        """Take keys and values by turns into the last dictionary."""
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
"""Those that push their argument. LONG4 is not among them: its integers are too long to print."""
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
"""By name; the method of a machine that each is, and its argument. What is not in here is refused."""
