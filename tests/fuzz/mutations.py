"""Changed files that keep most of their structure: what a damaged, a mistaken or a hostile writer might have written.

Each kind of file has a function that takes it apart, changes one part, and puts it together again, with checksums that
are right, so that the change gets past the first check. Choices are hypothesis's, so that findings shrink.
"""

from __future__ import annotations

import copy
import json
import pickletools
import re
import struct
import zlib
from collections.abc import Callable
from pathlib import PurePath
from typing import Any, Protocol, TypeVar

from hypothesis import strategies as st
from hypothesis.strategies import SearchStrategy

from fuzz import containers

T = TypeVar("T")


class Draw(Protocol):
    """hypothesis's: a value of a strategy."""

    def __call__(self, strategy: SearchStrategy[T], /) -> T: ...


Mutation = Callable[[Draw, bytes], bytes]

PLACES = ("missing", "folder", "fifo", "link to itself")
"""What may stand in a file's place."""
Changes = dict[str, bytes | str]
"""New bytes of files, or one of ``PLACES``, by their paths."""

TEXTS = (
    "", " ", "..", "../outside/secret", "/etc/passwd", "a/b", "a\0b", "\x1b[2J", "\u202e", "\ud800", "0", "-1", "1e309",
    "nan", "inf", "9" * 400, "x" * 5000, "right", "left", "none", "1_0", "\u0661", "0x10", "{", "[", "NaN", "#",
    "%s", "\\",
)  # fmt: skip
NUMBERS = (
    0, 1, -1, 2, 0.5, -0.0, 1e-320, 1e-30, 1e3, 1e6, 1e30, 1e200, 1e308, -1e308, float("nan"), float("inf"), 255, 256,
    2**15, 2**16, 2**31 - 1, 2**31, 2**32, 2**53 + 1, 2**63 - 1, 2**63, 2**64, 10**400, -(10**30),
)  # fmt: skip
SIZES = (0, 1, 2, 3, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF)
DEEP: Any = []
for _ in range(200):
    DEEP = [DEEP]
VAST = ["x" * 1_000_000, *[""] * 1000]
"""As an array of numpy's, 4 GB."""
VALUES = (VAST, None, True, False, *TEXTS, *NUMBERS, [], {}, [[]], [None], [{}], {"": 0}, [1, "a"], [[1], [1, 2]], DEEP)


@st.composite
def changes(draw: Draw, files: dict[str, bytes]) -> Changes:
    """One to three changes of some files, usually of one."""
    out: Changes = {}
    path = draw(st.sampled_from(sorted(files)))
    for _ in range(draw(st.sampled_from([1, 1, 1, 2, 2, 3]))):
        if draw(st.integers(0, 39)) == 39:
            out[path] = draw(st.sampled_from(PLACES))
        before = out.get(path, files[path])
        if isinstance(before, bytes):
            out[path] = changed(draw, path, before)
        if draw(st.integers(0, 3)) == 3:
            path = draw(st.sampled_from(sorted(files)))
    return out


def changed(draw: Draw, path: str, content: bytes) -> bytes:
    """One change of a file, mostly of its kind; of its bytes where it is not of that kind (any more)."""
    mutation = KINDS.get(PurePath(path).suffix.lower(), text)
    if draw(st.integers(0, 5)) == 5:
        mutation = some_bytes
    try:
        return mutation(draw, content)
    except containers.UnknownError:
        return some_bytes(draw, content)


def pick(draw: Draw, count: int) -> int:
    """An index below ``count``."""
    if not count:
        raise containers.UnknownError
    return draw(st.integers(0, count - 1))


def some_bytes(draw: Draw, content: bytes) -> bytes:
    """A file cut short, with bytes changed, left out, doubled or put in."""
    at = draw(st.integers(0, len(content)))
    length = draw(st.sampled_from([1, 1, 2, 4, 8, 100]))
    part = content[at : at + length]
    kind = draw(st.sampled_from(["cut", "set", "set", "set", "out", "twice", "in", "number", "empty"]))
    if kind in ("cut", "empty"):
        return content[: at if kind == "cut" else 0]
    if kind == "set":
        part = part[:2]
        new = bytes([draw(st.integers(0, 255))]) * len(part)
    elif kind == "twice":
        new = part * draw(st.sampled_from([2, 50]))
    elif kind == "in":
        part, new = b"", draw(st.binary(min_size=1, max_size=8))
    elif kind == "number":
        new = struct.pack(draw(st.sampled_from(["<I", ">I", "<H", ">H", "<Q"])), draw(st.sampled_from(SIZES[:8])))
        part = content[at : at + len(new)]
    else:
        new = b""
    return content[:at] + new + content[at + len(part) :]


def json_text(draw: Draw, content: bytes) -> bytes:
    """JSON with one value changed."""
    try:
        tree = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise containers.UnknownError from error
    holder = [tree]
    places = _places(holder)
    where, key = places[pick(draw, len(places))]
    _change_item(draw, where, key, places)
    try:
        return json.dumps(holder[0] if holder else None).encode()
    except (ValueError, RecursionError) as error:  # it holds itself
        raise containers.UnknownError from error


def _places(holder: list[Any], most: int = 20_000) -> list[tuple[Any, Any]]:
    """Each item of nested lists and dictionaries: what holds it, and its index or key."""
    found: list[tuple[Any, Any]] = []
    waiting: list[Any] = [holder]
    while waiting and len(found) < most:
        it = waiting.pop()
        for key in range(len(it)) if isinstance(it, list) else [*it]:
            found.append((it, key))
            if isinstance(it[key], list | dict):
                waiting.append(it[key])
    return found


def _change_item(draw: Draw, where: Any, key: Any, places: list[tuple[Any, Any]]) -> None:
    kind = draw(st.sampled_from(["value", "value", "value", "out", "twice", "other", "list", "number", "key", "half"]))
    now = where[key]
    if kind == "out":
        del where[key]
    elif kind == "twice" and isinstance(where, list):
        where.insert(key, copy.deepcopy(now))
    elif kind == "other":
        other, at = places[pick(draw, len(places))]
        where[key] = copy.deepcopy(other[at]) if _still(other, at) else None
    elif kind == "list":
        where[key] = [now]
    elif kind == "number" and isinstance(now, int | float) and abs(now) < 1e300:
        where[key] = now * draw(st.sampled_from([-1, 1000, 0.001, 1e6, 1e-6, 1.5]))
    elif kind == "key" and isinstance(where, dict):
        where[draw(st.sampled_from(TEXTS))] = where.pop(key)
    elif kind == "half" and isinstance(now, list | str):
        where[key] = now[: len(now) // 2]
    else:
        where[key] = draw(st.sampled_from(VALUES) | st.floats() | st.text(max_size=4))


def _still(where: Any, key: Any) -> bool:
    return key in where if isinstance(where, dict) else key < len(where)


def json_lines(draw: Draw, content: bytes) -> bytes:
    """JSON, a value a line, with one changed."""
    lines = content.split(b"\n")
    n = pick(draw, len(lines))
    lines[n] = json_text(draw, lines[n])
    return b"\n".join(lines)


TOKEN = re.compile(rb"([^\s,:;/\"'\[\]{}()]+)")


def text(draw: Draw, content: bytes) -> bytes:
    """Lines of words and numbers, with one of them changed."""
    kind = draw(st.sampled_from(["word", "word", "word", "number", "line out", "line twice", "lines", "other"]))
    if kind.startswith("line"):
        lines = content.split(b"\n")
        n = pick(draw, len(lines))
        if kind == "line out":
            del lines[n]
        elif kind == "line twice":
            lines.insert(n, lines[n])
        else:
            m = pick(draw, len(lines))
            lines[n], lines[m] = lines[m], lines[n]
        return b"\n".join(lines)
    words = TOKEN.split(content[: 2**20])
    n = 2 * pick(draw, len(words) // 2) + 1
    if kind == "other":
        words[n] = words[2 * pick(draw, len(words) // 2) + 1]
    else:
        new = draw(st.sampled_from(TEXTS)) if kind == "word" else str(draw(st.sampled_from(NUMBERS)))
        words[n] = new.encode("utf-8", "surrogatepass")
    return b"".join(words) + content[2**20 :]


OPCODES = (
    b"cos\nsystem\n", b"cbuiltins\neval\n", b"cnumpy\nndarray\n", b"cnumpy.core.multiarray\n_reconstruct\n",
    b"(", b")", b"t", b"l", b"d", b"R", b"b", b"o", b"0", b"1", b"2", b"a", b"e", b"s", b"u", b"\x85", b"\x86",
    b"\x87", b"\x93", b"\x81", b"\x88", b"N", b"]", b"}", b"K\x05", b"J\xff\xff\xff\x7f", b"F1e400\n",
    b"L99999999999999999999L\n", b"h\x00", b"q\x00", b"\x94", b"B\x00\x00\x00\x7f", b"T\xff\xff\xff\xff",
    b"X\x02\x00\x00\x00\xff\xff", b"\x8b\x04\x00\x00\x00abcd", b"j\xff\xff\xff\x00", b"r\xff\xff\xff\x7f",
    b"P1\n", b"Q", b"\x82\x01", b"\x96\xff\xff\xff\xff\x00\x00\x00\x00", b".",
)  # fmt: skip


def pickled(draw: Draw, content: bytes) -> bytes:
    """A pickle with an instruction changed."""
    try:
        starts = [place or 0 for _, _, place in pickletools.genops(content)]
    except Exception as error:  # it parses what a change before has left
        raise containers.UnknownError from error
    ends = [*starts[1:], len(content)]
    parts = [content[a:b] for a, b in zip(starts, ends, strict=True)]
    n = pick(draw, len(parts))
    kind = draw(st.sampled_from(["new", "in", "in", "out", "twice", "other", "number", "name"]))
    if kind == "new":
        parts[n] = draw(st.sampled_from(OPCODES))
    elif kind == "in":
        parts.insert(n, draw(st.sampled_from(OPCODES)))
    elif kind == "out":
        del parts[n]
    elif kind == "twice":
        parts.insert(n, parts[n])
    elif kind == "other":
        parts[n] = parts[pick(draw, len(parts))]
    elif kind == "number":
        parts[n] = b"G" + struct.pack(">d", draw(st.floats()))
    else:
        named = [i for i, part in enumerate(parts) if part[:1] in b"cX\x8c"]
        parts[named[pick(draw, len(named))]] = b"\x8c\x04frob"
    return b"".join(parts)


def npy(draw: Draw, content: bytes) -> bytes:
    """An array changed, or, in its place, a pickle."""
    header, rest = containers.npy_header(content)
    if b"'O'" in header:
        return header + pickled(draw, rest)
    return containers.npy(draw, content)


def npz(draw: Draw, content: bytes) -> bytes:
    """One of several arrays changed, left out, renamed or doubled."""
    return containers.zipped(draw, content, {".npy": npy}, some_bytes)


def archive(draw: Draw, content: bytes) -> bytes:
    """One member of a zip changed."""
    return containers.zipped(draw, content, KINDS, some_bytes)


def png(draw: Draw, content: bytes) -> bytes:
    """A chunk of a PNG changed, its checksum right."""
    chunks = containers.png_chunks(content)
    n = pick(draw, len(chunks))
    name, data = chunks[n]
    kind = draw(st.sampled_from(["data", "data", "pixels", "out", "twice", "text", "palette", "first"]))
    if kind == "data":
        chunks[n] = name, some_bytes(draw, data)
    elif kind == "pixels":
        pixels = zlib.decompress(b"".join(data for name, data in chunks if name == b"IDAT"))
        others = [chunk for chunk in chunks if chunk[0] != b"IDAT"]
        chunks = [*others[:-1], (b"IDAT", zlib.compress(some_bytes(draw, pixels))), *others[-1:]]
    elif kind == "out":
        del chunks[n]
    elif kind == "twice":
        chunks.insert(n, chunks[n])
    elif kind == "text":
        chunks.insert(1, (b"zTXt", b"a\0\0" + zlib.compress(b"\0" * 2**24)))
    elif kind == "palette":
        chunks.insert(1, (b"tRNS", draw(st.binary(max_size=8))))
    else:
        head = bytearray(chunks[0][1])
        at = pick(draw, len(head))
        head[at] = draw(st.sampled_from([0, 1, 2, 3, 4, 6, 8, 16, 127, 255]))
        chunks[0] = chunks[0][0], bytes(head)
    return containers.png(chunks)


def glb(draw: Draw, content: bytes) -> bytes:
    """The JSON or the numbers of a binary glTF changed, its lengths right."""
    document, numbers = containers.glb_parts(content)
    if draw(st.integers(0, 2)) == 2:
        numbers = some_bytes(draw, numbers)
    else:
        document = json_text(draw, document)
    return containers.glb(document, numbers)


def database(draw: Draw, content: bytes) -> bytes:
    """A cell, a row or the schema of an SQLite database changed."""
    value = draw(st.sampled_from([*TEXTS, *[n for n in NUMBERS if abs(n) < 2**63], None, b"\0\xff", b"x" * 100_000]))
    return containers.database(draw, content, value)


KINDS: dict[str, Mutation] = {
    ".json": json_text, ".jsonl": json_lines, ".npy": npy, ".npz": npz, ".pkl": pickled, ".pickle": pickled,
    ".png": png, ".glb": glb, ".sqlite": database, ".zip": archive,
    ".jpg": some_bytes, ".mp4": some_bytes, ".tar": some_bytes, ".stl": some_bytes, ".pt": archive,
}  # fmt: skip
"""By suffix; the others are text."""
