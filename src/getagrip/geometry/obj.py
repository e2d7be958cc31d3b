"""Wavefront .obj files: the vertices and the faces; the rest is ignored."""

from __future__ import annotations

import io
import re
import warnings
from array import array
from itertools import islice
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, Shaped
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.geometry.polygons import triangulate_polygons
from getagrip.io import files

OBJ_DECIMALS = 8
"""Digits of coordinates [m] in files that are written."""
MAX_OBJ_ELEMENTS = 2**22
"""Vertices, and triangles."""
MAX_OBJ_LINE_CHARS = 2**20
"""Characters: of a polygon of a hundred thousand corners."""
_VERTEX_LINE = re.compile(rb"^v((?:[ \t]+[-+]?[\d.][-+\deE.]*){3})[ \t\r]*$", re.MULTILINE)
_TRIANGLE_LINE = re.compile(rb"^f((?:[ \t]+\d{1,9}(?:/[\d/]*)?){3})[ \t\r]*$", re.MULTILINE)
_ELEMENT_LINES = {kind: re.compile(rb"^[ \t\v\f]*" + kind + rb"[ \t]", re.MULTILINE) for kind in (b"v", b"f")}


def parse_obj(path: Path, content: bytes) -> tuple[Float[ndarray, "V 3"], Int[ndarray, "F 3"]]:
    """Parse vertices, and faces with polygons cut into triangles.

    ``path`` is only named in errors: nothing is opened.

    Parts, materials, normals and textures are passed over. Raises ``InputError``, which names the line.
    """
    content = files.strip_byte_order_mark(content)
    if len(content) > 8 * MAX_OBJ_ELEMENTS:  # the shortest line of a vertex has 8 bytes
        _check_element_counts(path, content)
    vertices, faces = _parse_triangles_fast(content) or _parse_obj_lines(path, content)
    if not len(faces):
        raise InputError(path, "faces", f"{len(vertices)} vertices and no faces", "a mesh with faces")
    if faces.max() >= len(vertices):
        raise InputError(path, "faces", f"a face with vertex {faces.max() + 1}", f"1 to {len(vertices)}")
    return vertices, faces


def obj_content(vertices: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"]) -> bytes:
    """Write plain triangles as an OBJ file, to 1e-8 m."""
    points = f"v {' '.join([f'%.{OBJ_DECIMALS}f'] * 3)}\n" * len(vertices) % tuple(vertices.ravel().tolist())
    corners = "f %d %d %d\n" * len(faces) % tuple((faces + 1).ravel().tolist())
    return (points + corners).encode()


def _check_element_counts(path: Path, content: bytes) -> None:
    """Raise ``InputError`` for more lines of a kind than are allowed, before any is parsed."""
    lines = content.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").replace(b"\r", b"\n")
    for kind, found in _ELEMENT_LINES.items():
        if sum(1 for _ in islice(found.finditer(lines), MAX_OBJ_ELEMENTS + 1)) > MAX_OBJ_ELEMENTS:
            raise InputError(
                path, "", f"more than {MAX_OBJ_ELEMENTS} lines of {kind.decode()!r}", f"at most {MAX_OBJ_ELEMENTS}"
            )


def _parse_triangles_fast(content: bytes) -> tuple[Float[ndarray, "V 3"], Int[ndarray, "F 3"]] | None:
    """Read a file of plain triangles, as most large ones are, ten times as fast; None for any other file."""
    other_line_ends = content.count(b"\r") != content.count(b"\r\n")
    if other_line_ends or b"\\" in content or max(content.count(b"v "), content.count(b"f ")) > MAX_OBJ_ELEMENTS:
        return None
    points, corners = _VERTEX_LINE.findall(content), _TRIANGLE_LINE.findall(content)
    if (len(points), len(corners)) != tuple(
        sum(1 for _ in found.finditer(content)) for found in _ELEMENT_LINES.values()
    ):
        return None
    try:
        vertices = _parse_obj_numbers(b"".join(points), float)
        faces = _parse_obj_numbers(re.sub(rb"/[\d/]*", b"", b"".join(corners)), np.int64)
    except (ValueError, DeprecationWarning):  # text that is no number
        return None
    if len(vertices) != 3 * len(points) or len(faces) != 3 * len(corners) or faces.min(initial=1) < 1:
        return None
    return vertices.reshape(-1, 3), faces.reshape(-1, 3) - 1


def _parse_obj_numbers(text: bytes, kind: type) -> Shaped[ndarray, "n"]:
    """Numbers with spaces between. For text that is no number, numpy raises ``ValueError`` or, before 2.3, warns."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        return np.fromstring(text, dtype=kind, sep=" ")


def _parse_obj_lines(path: Path, content: bytes) -> tuple[Float[ndarray, "V 3"], Int[ndarray, "F 3"]]:
    """Any file. Raises ``InputError``."""
    text = content.decode("utf-8", "replace")  # names and comments may be in any encoding
    vertices, counts, faces = array("d"), array("q"), array("q")
    lines = io.StringIO(text.replace("\\\r\n", " ").replace("\\\n", " "), newline=None)
    for number, line in enumerate(lines, start=1):
        if len(line) > MAX_OBJ_LINE_CHARS:
            raise InputError(path, f"line {number}", f"{len(line)} characters", f"at most {MAX_OBJ_LINE_CHARS}")
        words = line.partition("#")[0].split()
        try:
            if words and words[0] == "v":
                x, y, z = words[1:4]  # colours may follow
                vertices.extend((float(x), float(y), float(z)))
            elif words and words[0] == "f":
                corners = [_parse_vertex_index(word, len(vertices) // 3) for word in words[1:]]
                if len(corners) < 3:
                    raise ValueError
                counts.append(len(corners))
                faces.extend(corners)
        except ValueError as error:
            expected = "v x y z" if words[0] == "v" else "f and three or more vertices, counted from 1"
            raise InputError(path, f"line {number}", files.shorten_value(line.rstrip("\n")), expected) from error
        if len(vertices) > 3 * MAX_OBJ_ELEMENTS or len(faces) - 2 * len(counts) > MAX_OBJ_ELEMENTS:
            raise InputError(
                path,
                f"line {number}",
                f"more than {MAX_OBJ_ELEMENTS} vertices or triangles",
                f"at most {MAX_OBJ_ELEMENTS}",
            )
    points = np.array(vertices, dtype=float).reshape(-1, 3)
    return points, triangulate_polygons(path, points, np.array(counts, dtype=np.int64), np.array(faces, dtype=np.int64))


def _parse_vertex_index(word: str, vertices: int) -> int:
    """Return the vertex of a corner ``v``, ``v/vt``, ``v//vn`` or ``v/vt/vn``.

    Negative ones count back from the latest.
    """
    index = int(word.partition("/")[0])
    if index == 0 or index < -vertices or index > 2**62:
        raise ValueError
    return index - 1 if index > 0 else vertices + index
