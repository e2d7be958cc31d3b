"""Pickles that are read: arrays, dictionaries, files of Python 2."""

from __future__ import annotations

import pickle
import struct
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from getagrip.io import pickles
from helpers.pickle_files import ARRAYS, HERE, PROTOCOLS, read, same


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
    got = pickles.read_pickle_file(tmp_path / "a.npy", "a dictionary")
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
