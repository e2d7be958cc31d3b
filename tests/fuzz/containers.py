"""Files that hold others, taken apart and put together again: arrays, archives, images, scenes, databases."""

from __future__ import annotations

import io
import sqlite3
import struct
import tempfile
import tokenize
import warnings
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

import numpy as np
from hypothesis import strategies as st

if TYPE_CHECKING:
    from fuzz.mutations import Draw, Mutation

PNG = b"\x89PNG\r\n\x1a\n"
DTYPES = ("<f2", "<f4", ">f8", "<i1", "<i8", "<u8", "<c16", "?", "<U3", "S3", "<M8[s]", "V8", "O", "f4,i2")
SHAPES = ("(-1,)", "(1000000000,)", "(4611686018427387904, 4)", "(0,)", "()", "(2, -1)", "[3]", "3", "(1,) * 9**9")
NUMBERS = (0.0, 1.0, -1.0, np.nan, np.inf, 1e-320, 1e-9, 1e4, 1e30, 1e308, -1e308, 255.0, 2.0**31, 2.0**63)


class UnknownError(Exception):
    """The content is not, or no longer, of its kind."""


def npy_header(content: bytes) -> tuple[bytes, bytes]:
    """The header of an ``.npy`` file, and what follows."""
    if content[:7] != b"\x93NUMPY\x01" or len(content) < 10:
        raise UnknownError
    end = 10 + struct.unpack("<H", content[8:10])[0]
    return content[:end], content[end:]


def npy(draw: Draw, content: bytes) -> bytes:
    """An array with a few numbers changed, of another type or shape, or with a header that lies."""
    try:
        array = np.load(io.BytesIO(content), allow_pickle=False)
    except (ValueError, OSError, EOFError, SyntaxError, TypeError, tokenize.TokenError) as error:
        raise UnknownError from error
    kind = draw(st.sampled_from(["some", "some", "some", "all", "scale", "type", "shape", "shape", "lie"]))
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            if kind == "lie":
                return _lying(draw, content)
            return _saved(_changed(draw, array.copy(), kind))
        except (ValueError, TypeError, OverflowError) as error:  # not for arrays of this type
            raise UnknownError from error


def _changed(draw: Draw, array: np.ndarray, kind: str) -> np.ndarray:
    if kind in ("some", "all", "scale") and not array.size:
        raise UnknownError
    value = draw(st.sampled_from(NUMBERS) | st.floats())
    if array.dtype.kind == "U" and kind != "type":
        array = array.astype("<U20")
        array.flat[draw(st.integers(0, max(array.size - 1, 0)))] = draw(st.sampled_from(["", "..", "\x1b", "0", "a"]))
    elif kind == "some":
        at = draw(st.integers(0, array.size - 1))
        array.reshape(-1)[at : at + draw(st.sampled_from([1, 1, 3, 16]))] = np.array(value).astype(array.dtype)
    elif kind == "all":
        array[...] = np.array(value).astype(array.dtype)
    elif kind == "scale":
        array = (array * draw(st.sampled_from([-1.0, 1e3, 1e-3, 1e9, 1e-9]))).astype(array.dtype)
    elif kind == "type":
        array = array.astype(draw(st.sampled_from(DTYPES)))
    else:
        array = _reshaped(draw, array)
    return array


def _reshaped(draw: Draw, array: np.ndarray) -> np.ndarray:
    kind = draw(st.sampled_from(["flat", "first", "last", "none", "more", "axis", "turned", "one", "columns"]))
    if kind == "flat":
        return array.reshape(-1)
    if kind == "axis":
        return array[None]
    if kind == "turned":
        return array.T
    if array.ndim == 0 or not array.size:
        raise UnknownError
    if kind == "columns":
        return array[..., :-1]
    return {
        "first": array[:1], "last": array[:-1], "none": array[:0], "more": np.concatenate([array, array]),
        "one": array.reshape(-1)[0],
    }[kind]  # fmt: skip


def _lying(draw: Draw, content: bytes) -> bytes:
    header, rest = npy_header(content)
    start = header.index(b"'shape': ") + 9
    end = header.index(b")", start) + 1
    new = header[10:start] + draw(st.sampled_from(SHAPES)).encode() + header[end:]
    new = new.rstrip() + b"\n"
    return content[:8] + struct.pack("<H", len(new)) + new + rest


def _saved(array: np.ndarray) -> bytes:
    out = io.BytesIO()
    np.lib.format.write_array(out, np.asarray(array), allow_pickle=True)
    return out.getvalue()


def zipped(draw: Draw, content: bytes, kinds: Mapping[str, Mutation], otherwise: Mutation) -> bytes:
    """A zip with one member changed, left out, renamed, doubled, or of much that packs well."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = [(info.filename, archive.read(info)) for info in archive.infolist()]
    except Exception as error:  # zipfile raises whatever it meets
        raise UnknownError from error
    if not members:
        raise UnknownError
    n = draw(st.integers(0, len(members) - 1))
    name, data = members[n]
    suffix = PurePath(name).suffix
    kind = draw(st.sampled_from(["data", "data", "data", "data", "data", "out", "name", "twice", "vast", "other"]))
    if kind == "data":
        members[n] = name, kinds.get(suffix, otherwise)(draw, data)
    elif kind == "out":
        del members[n]
    elif kind == "name":
        members[n] = draw(st.sampled_from(["../outside/x", "/x", "", "x", "a/b"])) + suffix, data
    elif kind == "twice":
        members.append((name, data))
    elif kind == "vast":
        members[n] = name, data + b"\0" * 2**24
    else:
        members[n] = name, members[draw(st.integers(0, len(members) - 1))][1]
    out = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        warnings.simplefilter("ignore")  # a name twice
        for name, data in members:
            archive.writestr(zipfile.ZipInfo(name), data)
    return out.getvalue()


def png_chunks(content: bytes) -> list[tuple[bytes, bytes]]:
    """The name and the data of each chunk."""
    if not content.startswith(PNG):
        raise UnknownError
    at, chunks = len(PNG), []
    while at + 12 <= len(content):
        (length,) = struct.unpack(">I", content[at : at + 4])
        chunks.append((content[at + 4 : at + 8], content[at + 8 : at + 8 + length]))
        at += 12 + length
    try:
        zlib.decompress(b"".join(data for name, data in chunks if name == b"IDAT"))
    except zlib.error as error:
        raise UnknownError from error
    return chunks


def png(chunks: list[tuple[bytes, bytes]]) -> bytes:
    """A PNG of chunks."""
    return PNG + b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data)) for name, data in chunks
    )


def glb_parts(content: bytes) -> tuple[bytes, bytes]:
    """The JSON and the numbers of a binary glTF."""
    if content[:4] != b"glTF" or len(content) < 20:
        raise UnknownError
    (length,) = struct.unpack("<I", content[12:16])
    return content[20 : 20 + length], content[28 + length :]


def glb(document: bytes, numbers: bytes) -> bytes:
    """A binary glTF of both."""
    document += b" " * (-len(document) % 4)
    numbers += b"\0" * (-len(numbers) % 4)
    chunks = (
        struct.pack("<I4s", len(document), b"JSON") + document + struct.pack("<I4s", len(numbers), b"BIN\0") + numbers
    )
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def database(draw: Draw, content: bytes, value: Any) -> bytes:
    """An SQLite database after one statement."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.sqlite"
        path.write_bytes(content)
        try:
            with sqlite3.connect(path) as db:
                db.text_factory = bytes
                tables = [t.decode() for (t,) in db.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
                table = draw(st.sampled_from(tables)) if tables else ""
                columns = [row[1].decode() for row in db.execute(f'PRAGMA table_info("{table}")')]
                column = draw(st.sampled_from(columns)) if columns else ""
                statement = draw(st.sampled_from(STATEMENTS)).format(table=table, column=column)
                db.execute(statement, (value,) if "?" in statement else ())
            db.close()
        except (sqlite3.Error, UnicodeError) as error:
            raise UnknownError from error
        return path.read_bytes()


STATEMENTS = (
    *["UPDATE OR IGNORE {table} SET {column} = ?"] * 8, "UPDATE OR IGNORE {table} SET {column} = CAST(? AS BLOB)",
    "DELETE FROM {table}", "DROP TABLE {table}", "ALTER TABLE {table} ADD COLUMN extra", "PRAGMA user_version = 7",
    "CREATE VIEW other AS SELECT * FROM {table}", "ALTER TABLE {table} RENAME COLUMN {column} TO other",
    "CREATE TRIGGER other AFTER UPDATE ON {table} BEGIN DELETE FROM {table}; END", "PRAGMA application_id = 3",
    "CREATE INDEX other ON {table}(abs({column}))",
)  # fmt: skip
