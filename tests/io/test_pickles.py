"""Pickles from strangers: what real files hold is read as it was, and forged ones get no further than an InputError."""

from __future__ import annotations

import json
import os
import pickle
import struct
import subprocess
import sys
from collections import OrderedDict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from getagrip.errors import InputError
from getagrip.io import pickles
from getagrip.io.pickles import machine, stand_ins

PATH = Path("a.pkl")
PROTOCOLS = range(6)
HERE = np.arange(24.0).reshape(2, 3, 4)
ARRAYS = {
    **{kind: np.arange(6).reshape(2, 3).astype(kind) for kind in ("?", "i1", "u1", "i2", "u4", "i8", "u8", "f2", "f4")},
    "big-endian": np.arange(6.0).reshape(2, 3).astype(">f8"),
    "Fortran": np.asfortranarray(HERE),
    "turned": HERE.transpose(1, 0, 2),
    "every other": HERE[:, ::2],
    "0-d": np.array(2.5),
    "empty": np.zeros((0, 3)),
    "text": np.array([["plate", "böwl"]]),
    "bytes": np.array([b"plate", b"a\0b"]),
}


def read(content: bytes) -> dict[str, object]:
    return pickles.read(PATH, content, "a dictionary")


def same(got: Any, given: np.ndarray) -> bool:
    """Whether an array is what it was, layout and byte order included, and can be written to."""
    layout = all(got.flags[flag] == given.flags[flag] for flag in ("C_CONTIGUOUS", "F_CONTIGUOUS"))
    own = type(got) is np.ndarray and got.flags.writeable and got.flags.aligned
    return own and layout and got.dtype == given.dtype and got.shape == given.shape and bool((got == given).all())


# -------------------------------------------------------------------------------------------------------- real files


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("name", ARRAYS)
def test_arrays_come_back_as_they_were(name: str, protocol: int) -> None:
    given = ARRAYS[name]
    got: Any = read(pickle.dumps({"a": given, "list": [{"b": given}]}, protocol=protocol))
    given = np.ascontiguousarray(given) if name == "every other" else given
    if name == "turned" and protocol < 5:  # its layout is kept by protocol 5 only
        given = np.ascontiguousarray(given)
    assert same(got["a"], given)
    assert got["list"][0]["b"] is got["a"]


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_everything_else_in_a_dictionary_of_arrays(protocol: int) -> None:
    given = {
        "scalars": [np.float32(0.1), np.float64(-1e300), np.int64(-5), np.uint8(255), np.bool_(True), np.str_("é")],
        "numbers": [0, 255, 256, -1, 70000, 2**40, -(2**70), 1.5, float("inf"), True, False, None],
        "texts": ("", "a", "böwl\n\\'\"\u2603", "long" * 100, b"", b"\xff\0", b"b" * 300),
        "nested": OrderedDict(a=(), b=[], c=((1,), (1, 2), (1, 2, 3), (1, 2, 3, 4)), d={}),
        "sets": [set(), {1, 2, "three"}],
        "keys": {1: "a", None: "b", b"c": "d", 2.5: "e"},
        7: "a key that is no text",
    }
    got = read(pickle.dumps(given, protocol=protocol))
    assert got == {str(key): value for key, value in given.items()}
    assert [type(x) for x in got["scalars"]] == [type(x) for x in given["scalars"]]


def test_dictionary_in_an_array_of_one_object(tmp_path: Path) -> None:
    given = {"a": HERE, "objects": np.array([{"x": 1}, None], dtype=object)}
    np.save(tmp_path / "a.npy", given, allow_pickle=True)
    got = pickles.read_file(tmp_path / "a.npy", "a dictionary")
    assert same(got["a"], HERE)
    assert got["objects"] == [{"x": 1}, None]


def python2(text: bytes) -> bytes:
    return repr(text)[1:].encode()  # Python 3's spelling of bytes is Python 2's of a text


@pytest.mark.parametrize("protocol", [0, 2])
def test_pickles_of_python_2(protocol: int) -> None:
    """Its texts are bytes, its integers of two kinds, and numpy's modules had other names."""
    raw = HERE.astype("<f8").tobytes()
    if protocol == 0:
        content = (
            b"(dp0\nS'a'\np1\ncnumpy.core.multiarray\n_reconstruct\np2\n(cnumpy\nndarray\np3\n(I0\ntp4\nS'b'\np5\ntp6\n"
            b"Rp7\n(I1\n(I2\nI3\nL4L\ntp8\ncnumpy\ndtype\np9\n(S'f8'\np10\nI0\nI1\ntp11\nRp12\n(I3\nS'<'\np13\nNNN"
            b"I-1\nI-1\nI0\ntp14\nbI00\nS" + python2(raw) + b"\np15\ntp16\nbsS'name'\np17\nS" + python2(b"b\xf6wl'")
        )
        content += b'\np18\nsS"it\'s"\ncnumpy.core.multiarray\nscalar\n(g12\nS' + python2(raw[8:16]) + b"\ntRs."
    else:
        content = (
            b"\x80\x02}(U\x01acnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\0\x85U\x01b\x87R"
            b"(K\x01K\x02K\x03\x8a\x01\x04\x87cnumpy\ndtype\nU\x02f8K\0K\x01\x87Rq\0(K\x03U\x01<NNNJ\xff\xff\xff\xffJ"
            b"\xff\xff\xff\xffK\0tb\x89T" + struct.pack("<i", len(raw)) + raw + b"tbU\x04nameU\x05b\xf6wl'"
            b"U\x04it'scnumpy.core.multiarray\nscalar\nh\0U\x08" + raw[8:16] + b"\x86Ru."
        )
    got = read(content)
    assert same(got["a"], HERE)
    assert (got["name"], got["it's"]) == ("böwl'", 1.0)


# ------------------------------------------------------------------------------------------------------ forged files

CHILD = """
import json, pickle, sys
from pathlib import Path
import numpy as np
from getagrip.errors import InputError
from getagrip.hands.mano_pickle import read_pickle

def touch(value):
    repr(value)
    if isinstance(value, np.ndarray):
        value.copy().tolist()
    for part in value.values() if isinstance(value, dict) else value if isinstance(value, list | tuple) else ():
        touch(part)

done = {"read": 0, "refused": 0}
for content in pickle.load(sys.stdin.buffer):
    try:
        touch(read_pickle(Path("a.pkl"), content))
        done["read"] += 1
    except InputError as error:
        assert not isinstance(error.__cause__, MemoryError), content[:100]
        done["refused"] += 1
print(json.dumps(done))
"""


def in_a_child(contents: list[bytes], before: str = "") -> dict[str, int]:
    """How many of the pickles another process reads and refuses; it must survive them all."""
    child = subprocess.run(
        [sys.executable, "-X", "faulthandler", "-c", before + CHILD],
        input=pickle.dumps(contents), capture_output=True, timeout=120, check=False, env=os.environ,
    )  # fmt: skip
    assert child.returncode == 0, child.stderr.decode()[-2000:]
    done: dict[str, int] = json.loads(child.stdout)
    assert sum(done.values()) == len(contents)
    return done


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
    for module, name in stand_ins.NAMES:
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


# ------------------------------------------------------------------------------------- small files that would be vast

LIMITED = """
import resource
import getagrip.hands.mano_pickle
with open("/proc/self/statm") as file:
    size = int(file.read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (size + 2**30, size + 2**30))
"""
"""A gigabyte, and no more, for what follows."""


def often(make: bytes, count: int = 5000) -> bytes:
    """A list of what the same instructions give again and again."""
    return b"}X\x01\0\0\0a](" + make * count + b"es."


def memorised(value: Any, make: bytes) -> bytes:
    """A list of what is made from one value, which instructions get as ``h\\0``."""
    return pickle.dumps(value, protocol=2)[:-1] + b"q\x000" + often(make)


def sparse(**arrays: Any) -> bytes:
    """A dictionary of one sparse matrix."""
    state = pickle.dumps(arrays, protocol=2)[2:-1]
    return b"\x80\x02}X\x01\0\0\0acscipy.sparse.csc\ncsc_matrix\n)\x81" + state + b"bs."


def shared(container: Callable[[Any, Any], Any], times: int) -> Any:
    value: Any = container(1, 2)
    for _ in range(times):
        value = container(value, value)
    return value


def in_itself() -> list[Any]:
    itself: list[Any] = []
    itself.append(itself)
    return itself


def chain(length: int) -> list[Any]:
    """Lists within lists, the innermost first: each is one deep when it is come across."""
    lists: list[Any] = [[]]
    for _ in range(length):
        lists.append([lists[-1]])
    return lists


ONE = np.zeros(1, np.int32)
MEGABYTE = np.zeros(2**20, np.uint8)
VAST = {
    "memo": b"}r\xff\xff\xff\xff.",
    "memo of protocol 0": b"}p99999999999\n.",
    "length of bytes": b"}X\x01\0\0\0a\x8e" + struct.pack("<Q", 2**40) + b"s.",
    "length of a bytearray": b"}X\x01\0\0\0a\x96" + struct.pack("<Q", 2**40) + b"s.",
    "encoded text": memorised("x" * 2**20, b"c_codecs\nencode\nh\0X\x06\0\0\0latin1\x86R"),
    "arrays of the same bytes": memorised(
        MEGABYTE.tobytes(),
        b"cnumpy._core.numeric\n_frombuffer\n(h\0cnumpy\ndtype\nX\x02\0\0\0u1\x85RJ\0\0\x10\0\x85X\x01\0\0\0CtR",
    ),
    "scalars of the same bytes": memorised(
        b"x" * 2**20, b"cnumpy.core.multiarray\nscalar\ncnumpy\ndtype\nX\x08\0\0\0S1048576\x85Rh\0\x86R"
    ),
    "sets of the same list": memorised(list(range(2**18)), b"c__builtin__\nset\nh\0\x85R"),
    "dictionaries of the same list": memorised([[n, n] for n in range(2**16)], b"ccollections\nOrderedDict\nh\0\x85R"),
    "one array in a list": pickle.dumps({"a": [MEGABYTE] * 5000}),
    "one text in a list": pickle.dumps({"a": ["x" * 2**20] * 5000}),
    "shared lists": pickle.dumps({"a": shared(lambda a, b: [a, b], 30)}),
    "shared empty lists": pickle.dumps({"a": shared(lambda a, b: [] if a == 1 else [a, b], 30)}),
    "shared lists in arrays": pickle.dumps({"a": shared(lambda a, b: np.array([[a, b], None], dtype=object), 30)}),
    "a list in itself": pickle.dumps({"a": in_itself()}),
    "a chain of lists": pickle.dumps({"a": chain(900)}),
    "a key of shared tuples": b"}(" + b"K\x01\x85" + b"2\x86" * 60 + b"K\x01u.",
    "a set of shared tuples": b"}X\x01\0\0\0a\x8f(" + b"K\x01\x85" + b"2\x86" * 60 + b"\x90s.",
    "a name of shared tuples": b"}X\x01\0\0\0a" + 2 * (b"K\x01\x85" + b"2\x86" * 60) + b"\x93s.",
    "sparse starts": sparse(_shape=(1, 2), data=ONE, indices=ONE, indptr=np.array([0, 2**40, 2**41])),
    "sparse starts that fall": sparse(_shape=(1, 2), data=ONE, indices=ONE, indptr=np.array([0, 2**40, 1])),
    "sparse starts that wrap": sparse(_shape=(1, 2), data=ONE, indices=ONE, indptr=np.array([0, 2**63, 1], np.uint64)),
    "sparse shape": sparse(_shape=(2**40, 1), data=ONE, indices=ONE, indptr=np.array([0, 1])),
    "more values than places": sparse(_shape=(1, 1), data=MEGABYTE, indices=MEGABYTE, indptr=np.array([0, 2**20])),
}  # fmt: skip


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the limit is set as Linux does")
@pytest.mark.slow
def test_small_files_take_little_memory() -> None:
    """A memo is as large as what is in it, whatever its indices: those two files are read."""
    assert in_a_child(list(VAST.values()), LIMITED) == {"read": 2, "refused": len(VAST) - 2}


def test_long_programs_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """An empty container takes a byte in the file and hundreds in memory."""
    monkeypatch.setattr(machine, "MOST_INSTRUCTIONS", 100)
    assert read(b"}" + b"]0" * 48 + b".") == {}
    with pytest.raises(InputError, match="more than 100 instructions"):
        read(b"}" + b"]0" * 50 + b".")
