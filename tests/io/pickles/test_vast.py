"""Small pickles that would be vast in memory are refused before they are."""

from __future__ import annotations

import pickle
import struct
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from getagrip.errors import InputError
from getagrip.io import pickles
from helpers.pickle_files import in_a_child, read

LIMITED = """
import resource
import getagrip.hands.mano
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
    monkeypatch.setattr(pickles, "MAX_PICKLE_INSTRUCTIONS", 100)
    assert read(b"}" + b"]0" * 48 + b".") == {}
    with pytest.raises(InputError, match="more than 100 instructions"):
        read(b"}" + b"]0" * 50 + b".")
