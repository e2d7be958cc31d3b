"""Forged and damaged pickles get no further than an error: no crash, and no code of theirs runs."""

from __future__ import annotations

import pickle
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from getagrip.errors import InputError
from getagrip.io import pickles
from helpers.pickle_files import ARRAYS, HERE, PROTOCOLS, in_a_child, read


class Call:
    """Unpickles by a call, and a state for its result."""

    def __init__(self, *reduced: Any) -> None:
        self.reduced = reduced

    def __reduce__(self) -> tuple[Any, ...]:
        return self.reduced


reconstruct, scalar = np.zeros(0).__reduce__()[0], np.float64(0).__reduce__()[0]


OBJECT = np.dtype(object)


POINTERS = struct.pack("<Q", 0x4141414141414141)


KINDS = (
    "f8", "i8", "u1", "b1", "f16", "c16", "O8", "O", "O4", "|O8", "object", "V8", "V16", "S8", "S0", "U2", "U0", "M8",
    "M8[ns]", "m8", "i3", "", "f8,O8", "(2,)f8", "(2,)O8", "P", "p", "g", "S999999999", "S-1", "U9999999999", "\0", 8,
    None,
)  # fmt: skip


STATES = (
    (3, "<", None, None, None, -1, -1, 0),
    (3, "|", None, None, None, -1, -1, 63),
    (3, "|", None, None, None, 8, 8, 0),
    (3, "<", None, None, None, 16, 1, 0),
    (3, "<", None, None, None, -8, -8, 0),
    (3, "<", None, None, None, 2**31 - 1, 1, 0),
    (3, "<", None, None, None, 0, 0, 255),
    (3, "|", None, ("a",), {"a": (OBJECT, 0)}, 8, 1, 0),
    (3, "|", None, ("a", "b"), {"a": (OBJECT, 0), "b": (OBJECT, 4096)}, 16, 1, 0),
    (3, "|", None, ("a",), {"b": (OBJECT, 0)}, 8, 1, 63),
    (3, "|", None, ("a",), {}, 8, 1, 0),
    (3, "|", (OBJECT, (1,)), None, None, 8, 8, 0),
    (3, "|", (OBJECT, (-1,)), None, None, 8, 8, 0),
    (3, "|", (OBJECT, (2**40,)), None, None, 8, 8, 0),
    (4, "|", None, None, None, -1, -1, 0, {"metadata": OBJECT}),
    (4, "<", None, None, None, -1, -1, 0, (b"ns", 1, 1, 1)),
    (3, "=", None, None, None, -1, -1, 0),
    (3, "x", None, None, None, -1, -1, 0),
    (3, "", None, None, None, -1, -1, 0),
    (3, ">", None, None, None, -1, -1, 0),
    (3,),
    (),
    0,
    {"type": int, "itemsize": 0},
    (None, {"itemsize": 0, "flags": 0}),
)


SHAPES = (
    (1,), (), (2,), (0,), (-1,), (-1, -1), (2**62, 4), (2**32, 2**32), (2**64,), (0, 2**62), (1,) * 40, ("1",), (1.0,),
    (True,), (None,), [1], 1, None,
)  # fmt: skip


CONTENTS = (POINTERS, POINTERS * 2, b"", POINTERS[:7], "A" * 8, "\u2603" * 8, bytearray(POINTERS), [1], [], None, 8)


def array_of(kind: Any, state: Any, shape: Any = (1,), raw: Any = POINTERS, fortran: Any = False) -> Call:
    dtype = Call(np.dtype, (kind, False, True), state)
    return Call(reconstruct, (np.ndarray, (0,), b"b"), (1, shape, dtype, fortran, raw))


def forged_arrays() -> Iterator[Any]:
    plain = STATES[0]
    for kind in KINDS:
        for state in STATES:
            dtype = Call(np.dtype, (kind, False, True), state)
            yield array_of(kind, state)
            yield Call(scalar, (dtype, POINTERS))
            yield dtype
    for kind in ("f8", "O8", "S8", "U2"):
        for shape in SHAPES:
            yield array_of(kind, plain, shape)
            for raw in CONTENTS:
                yield array_of(kind, plain, shape, raw, fortran=True)
    for raw in CONTENTS:
        yield Call(scalar, (Call(np.dtype, ("O8", False, True), STATES[1]), raw))
        yield Call(scalar, (Call(np.dtype, ("O8", False, True), plain), raw))
    for state in (None, (), (1,), (1, (1,), np.dtype("f8"), False), (1, (1,), "f8", False, POINTERS), {"shape": (9,)}):
        yield Call(reconstruct, (np.ndarray, (0,), b"b"), state)
    for arguments in (
        (np.ndarray, (10**10,), b"d"),
        (np.ndarray, (1,), b"O"),
        (np.dtype, (0,), b"b"),
        (object, (), b""),
    ):
        yield Call(reconstruct, arguments)


def from_buffers() -> Iterator[Any]:
    """Protocol 5's way to make an array."""
    make = np._core.numeric._frombuffer
    for kind, state in (("f8", STATES[0]), ("O8", STATES[0]), ("O8", STATES[1]), ("V8", STATES[7])):
        dtype = Call(np.dtype, (kind, False, True), state)
        for shape in SHAPES:
            for order in ("C", "F", "K", "A", None):
                yield Call(make, (POINTERS, dtype, shape, order))
        for axes in ((0,), (1,), (-1,), (0, 0), (), "0", None):
            yield Call(make, (POINTERS, dtype, (1,), "K", axes))


def mutants(count: int) -> Iterator[bytes]:
    """Valid pickles with some bytes changed, moved or left out."""
    rng = np.random.default_rng(0)
    arrays = {
        "a": HERE,
        "o": np.array([{}, "x"], dtype=object),
        "t": ARRAYS["text"],
        "s": np.float32(1),
        "l": [1, (2,)],
    }
    whole = [pickle.dumps(arrays, protocol=protocol) for protocol in PROTOCOLS]
    for n in range(count):
        content = bytearray(whole[n % len(whole)])
        for _ in range(rng.integers(1, 4)):
            at, length = (int(i) for i in rng.integers([0, 1], [len(content), 9]))
            other = int(rng.integers(0, len(content)))
            replaced = (rng.bytes(1), content[other : other + length], b"")[rng.integers(0, 3)]
            content[at : at + max(1, len(replaced))] = replaced
        yield bytes(content)


@pytest.mark.slow
def test_forged_states_get_no_further_than_an_error() -> None:
    """Bytes that claim to be objects, sizes that are not those of the bytes: each is refused or harmless."""
    forged = (*forged_arrays(), *from_buffers())
    contents = [pickle.dumps({"x": value}, protocol=2 + 2 * (n % 2)) for n, value in enumerate(forged)]
    assert in_a_child(contents)["refused"] > 0.8 * len(contents)


@pytest.mark.slow
def test_damaged_pickles_get_no_further_than_an_error() -> None:
    done = in_a_child(list(mutants(2000)))
    assert min(done.values()) > 100


def test_what_was_named_stays_as_it_is() -> None:
    """No state can be set on what a name stands for, by whatever instruction the pickle comes by it."""
    harm = b"N}X\x04\0\0\0harmK\x01s\x86"  # attributes of an object with slots
    for module, name in pickles.ALLOWED_PICKLE_NAMES:
        for instruction in (b"", b")R", b")\x81", b")}\x92", b"0(i%s\n%s\n" % (module.encode(), name.encode())):
            named = b"c%s\n%s\n" % (module.encode(), name.encode())
            for state in (harm, b"}X\x04\0\0\0harmK\x01s"):
                with pytest.raises(InputError):
                    read(b"}X\x01\0\0\0a" + named + instruction + state + b"bs.")


@pytest.mark.parametrize(
    "instructions",
    [
        b"(inumpy\ndtype\n", b"(cnumpy\ndtype\no", b"cnumpy\nndarray\n)}\x92", b"\x82\x01", b"\x83\x01\x01",
        b"\x84\x01\0\0\0", b"P1\n", b"K\x01Q", b"\x97", b"C\x01a\x98", b"cos\nsystem\n", b"K\x01K\x02\x93",
        b"cnumpy\nload\n", b"cnumpy\ndtype\n", b"cnumpy\ndtype\nX\x02\0\0\0f8\x85R", b"]K\x01K\x02s", b"}K\x01a",
        b"]}\x90", b"K\x01}b", b"X\x01\0\0\0a}b", b"X\x01\0\0\0a)R", b"h\x05", b"g-1\n", b"0000000", b"1", b"t",
        b"\x85\x86\x87", b"\xff", b"S'a\n", b"Sa'\n", b"I1_\n\n", b"X\xff\0\0\0a",
        b"\x8e\xff\xff\xff\xff\xff\xff\xff\x7f", b"\x96\0\0\0\0\xff\0\0\0", b"(K\x01d", b"",
    ],
)  # fmt: skip
def test_only_instructions_that_build_data(instructions: bytes) -> None:
    with pytest.raises(InputError):
        read(b"\x80\x04}X\x01\0\0\0a" + instructions + b"s.")
