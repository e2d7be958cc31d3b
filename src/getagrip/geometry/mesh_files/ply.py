"""Stanford's .ply files: vertices and polygons, as text or binary in either byte order.

Not read by trimesh, which cuts every polygon into a fan, and refuses binary files of polygons of several sizes.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files.obj import MAX_OBJ_ELEMENTS, triangulate_polygons
from getagrip.io import files

PLY_DTYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
PLY_BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
VERTEX_INDEX_PROPERTIES = ("vertex_indices", "vertex_index")
EXPECTED_PLY = "a whole .ply file"
MAX_RAGGED_ROWS = 2**20
"""Maximum number of rows read one by one: some seconds."""


class PlyProperty(NamedTuple):
    """A number or a list of numbers, in numpy's types."""

    name: str
    type: str
    counted: str
    """The type of a list's length; empty for a number."""


@dataclass(frozen=True)
class PlyElement:
    """A table: its name, number of rows and columns."""

    name: str
    length: int
    properties: list[PlyProperty]


Columns = dict[str, tuple[Int[ndarray, "n"], ndarray]]
"""For each property: the number of values in each row, and all values concatenated."""


def parse_ply(path: Path, content: bytes) -> tuple[Float[ndarray, "V 3"], Int[ndarray, "F 3"]]:
    """Parse vertices, and faces with polygons cut into triangles; ``path`` is only named in errors.

    Raises ``InputError``.
    """
    tables = _read_ply_tables(path, content)
    points = _ply_points(path, tables)
    of_faces = tables.get("face", Columns())
    polygons = next((of_faces[name] for name in VERTEX_INDEX_PROPERTIES if name in of_faces), None)
    if polygons is None or not len(polygons[0]):
        raise InputError(path, "faces", "no faces", "a mesh with faces")
    counts, corners = polygons
    few = np.flatnonzero(counts < 3)
    if few.size:
        raise InputError(path, "faces", f"face {few[0]} with {counts[few[0]]} corners", "three or more")
    if len(corners) - 2 * len(counts) > MAX_OBJ_ELEMENTS:
        raise InputError(path, "faces", f"more than {MAX_OBJ_ELEMENTS} triangles", f"at most {MAX_OBJ_ELEMENTS}")
    with np.errstate(invalid="ignore"):
        return points, triangulate_polygons(path, points, counts, corners.astype(np.int64))


def names_ply_colours(content: bytes) -> bool:
    """Return whether the header of a file, of which the beginning suffices, names red, green and blue."""
    header = content[: 2**16].partition(b"end_header")[0]
    return all(re.search(rb"property\s+(uchar|uint8)\s+" + name, header) for name in (b"red", b"green", b"blue"))


def parse_ply_colours(path: Path, content: bytes) -> tuple[Float[ndarray, "V 3"], UInt8[ndarray, "V 3"]] | None:
    """Parse vertices and their colours, 0 to 255; None without any. Raises ``InputError``."""
    if not names_ply_colours(content):
        return None
    tables = _read_ply_tables(path, content)
    points, columns = _ply_points(path, tables), tables.get("vertex", Columns())
    if not all(name in columns for name in ("red", "green", "blue")):
        return None  # of faces
    colours = np.stack([columns[name][1] for name in ("red", "green", "blue")], axis=1)
    with np.errstate(invalid="ignore"):
        return points, colours.astype(np.uint8)


def ply_content(mesh: Mesh) -> bytes:
    """Write a mesh with colours as a binary .ply file, every coordinate exactly [m]."""
    assert mesh.colours is not None
    rows = np.zeros(len(mesh.vertices), [("at", "<f8", 3), ("colour", "u1", 3)])
    rows["at"], rows["colour"] = mesh.vertices, mesh.colours
    corners = np.zeros(len(mesh.faces), [("count", "u1"), ("ids", "<i4", 3)])
    corners["count"], corners["ids"] = 3, mesh.faces
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    lines += [f"property double {axis}" for axis in "xyz"]
    lines += [f"property uchar {colour}" for colour in ("red", "green", "blue")]
    lines += [f"element face {len(corners)}", "property list uchar int vertex_indices", "end_header", ""]
    return "\n".join(lines).encode() + rows.tobytes() + corners.tobytes()


def _ply_points(path: Path, tables: Mapping[str, Columns]) -> Float[ndarray, "V 3"]:
    columns = tables.get("vertex")
    if columns is None:
        return np.zeros((0, 3))
    if not all(axis in columns for axis in "xyz"):
        raise InputError(path, "vertices", "no x, y and z", "three coordinates for each vertex")
    return np.stack([columns[axis][1] for axis in "xyz"], axis=1).astype(float)


def _read_ply_tables(path: Path, content: bytes) -> dict[str, Columns]:
    """Read the tables of a file by name. Raises ``InputError``."""
    content = files.strip_byte_order_mark(content)
    order, elements, start = _parse_ply_header(path, content)
    try:
        body = _TextBody(content[start:]) if order == "ascii" else _BinaryBody(content, start, PLY_BYTE_ORDERS[order])
    except (ValueError, DeprecationWarning) as error:
        raise InputError(path, "mesh", "words where numbers should be", EXPECTED_PLY) from error
    tables = dict[str, Columns]()
    for element in elements:
        key = {"vertex": "vertices", "face": "faces"}.get(element.name, "mesh")
        try:
            columns = _read_element_rows(element, body)
        except (ValueError, OverflowError) as error:
            got = f"fewer rows of {files.shorten_value(element.name)} than {element.length}, or other ones"
            raise InputError(path, key, got, f"{element.length}, as its header says; is it cut short?") from error
        if columns is None:
            rows = f"more than {MAX_RAGGED_ROWS} rows of {files.shorten_value(element.name)}"
            got = f"{rows} with lists of several lengths"
            raise InputError(path, key, got, "triangles: triangulate the mesh where it was made")
        tables[element.name] = columns
    return tables


def _parse_ply_header(path: Path, content: bytes) -> tuple[str, list[PlyElement], int]:
    """Parse the header: format, elements, and the position of the first row. Raises ``InputError``."""
    end = content.find(b"end_header", 0, 2**16)
    after = content.find(b"\n", end) + 1
    if not content.startswith(b"ply") or end < 0 or not after:
        raise InputError(path, "mesh", "a file without a header of .ply", EXPECTED_PLY)
    order, elements = "", list[PlyElement]()
    for line in content[:end].decode("ascii", "replace").splitlines():
        try:
            match line.split():
                case ["format", name, *_] if name in PLY_BYTE_ORDERS:
                    order = name
                case ["element", name, length] if 0 <= int(length) <= MAX_OBJ_ELEMENTS:
                    elements.append(PlyElement(name, int(length), []))
                case ["property", "list", counted, kind, name] if PLY_DTYPES[counted][0] != "f":
                    elements[-1].properties.append(PlyProperty(name, PLY_DTYPES[kind], PLY_DTYPES[counted]))
                case ["property", kind, name]:
                    elements[-1].properties.append(PlyProperty(name, PLY_DTYPES[kind], ""))
                case ["ply"] | ["comment" | "obj_info", *_] | []:
                    pass
                case _:
                    raise ValueError
        except (ValueError, KeyError, IndexError) as error:
            raise InputError(path, "mesh", f"the line {line[:80]!r} in its header", EXPECTED_PLY) from error
    if not order:
        raise InputError(path, "mesh", "no format in its header", f"one of {', '.join(PLY_BYTE_ORDERS)}")
    return order, elements, after


class _TextBody:
    """The numbers of a text file."""

    def __init__(self, content: bytes) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            self.values = np.fromstring(content.decode("ascii", "replace"), sep=" ")
        self.at = 0

    def table(self, element: PlyElement, counts: list[int]) -> Columns | None:
        """Read all rows of an element whose lists have the lengths ``counts``; None if any row's differ."""
        width = sum(count + bool(p.counted) for p, count in zip(element.properties, counts, strict=True))
        values = self.values[self.at : self.at + element.length * width]
        if len(values) < element.length * width:
            return None
        rows = values.reshape(element.length, width)
        columns, column = Columns(), 0
        for p, count in zip(element.properties, counts, strict=True):
            if p.counted and (rows[:, column] != count).any():
                return None
            column += bool(p.counted)
            columns[p.name] = np.full(element.length, count), rows[:, column : column + count].ravel()
            column += count
        self.at += element.length * width
        return columns

    def take(self, kind: str, count: int) -> ndarray:
        """Read the next ``count`` numbers."""
        if not 0 <= count <= len(self.values) - self.at:
            raise ValueError
        self.at += count
        return self.values[self.at - count : self.at]


class _BinaryBody:
    """The numbers of a binary file."""

    def __init__(self, content: bytes, start: int, order: str) -> None:
        self.content, self.at, self.order = content, start, order

    def table(self, element: PlyElement, counts: list[int]) -> Columns | None:
        """Read all rows of an element whose lists have the lengths ``counts``; None if any row's differ."""
        fields: list[tuple[str, str, int]] = []
        for n, (p, count) in enumerate(zip(element.properties, counts, strict=True)):
            fields += [(f"count{n}", self.order + p.counted, 1)] if p.counted else []
            fields.append((f"value{n}", self.order + p.type, count))
        dtype = np.dtype([(name, kind, (size,)) for name, kind, size in fields])
        if len(self.content) - self.at < element.length * dtype.itemsize:
            return None
        rows = np.frombuffer(self.content, dtype, element.length, self.at)
        columns = Columns()
        for n, (p, count) in enumerate(zip(element.properties, counts, strict=True)):
            if p.counted and (rows[f"count{n}"] != count).any():
                return None
            columns[p.name] = np.full(element.length, count), rows[f"value{n}"].ravel()
        self.at += element.length * dtype.itemsize
        return columns

    def take(self, kind: str, count: int) -> ndarray:
        """Read the next ``count`` numbers of a type."""
        dtype = np.dtype(self.order + kind)
        if not 0 <= count <= (len(self.content) - self.at) // dtype.itemsize:
            raise ValueError
        self.at += count * dtype.itemsize
        return np.frombuffer(self.content, dtype, count, self.at - count * dtype.itemsize)


def _read_element_rows(element: PlyElement, body: _TextBody | _BinaryBody) -> Columns | None:
    """Read the rows of an element: at once if all lists are as long as the first row's, else one by one.

    None if there are more than ``MAX_RAGGED_ROWS``. Raises ``ValueError`` and ``OverflowError`` for missing data.
    """
    start, counts = body.at, list[int]()
    for p in element.properties if element.length else []:
        counts.append(int(body.take(p.counted, 1)[0]) if p.counted else 1)
        body.take(p.type, counts[-1])
    body.at = start
    table = body.table(element, counts) if element.length else Columns()
    if table is not None:
        return table
    if element.length > MAX_RAGGED_ROWS:
        return None
    lengths: list[list[int]] = [[] for _ in element.properties]
    values: list[list[ndarray]] = [[] for _ in element.properties]
    for _ in range(element.length):
        for n, p in enumerate(element.properties):
            lengths[n].append(int(body.take(p.counted, 1)[0]) if p.counted else 1)
            values[n].append(body.take(p.type, lengths[n][-1]))
    return {p.name: (np.array(lengths[n]), np.concatenate(values[n])) for n, p in enumerate(element.properties)}
