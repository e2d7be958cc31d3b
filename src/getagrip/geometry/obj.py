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
from getagrip.geometry.polygons import triangles
from getagrip.io import files

DECIMALS = 8
"""Digits of coordinates [m] in files that are written."""
MOST = 2**22
"""Vertices, and triangles."""
LONGEST_LINE = 2**20
"""Characters: of a polygon of a hundred thousand corners."""
_VERTEX = re.compile(rb"^v((?:[ \t]+[-+]?[\d.][-+\deE.]*){3})[ \t\r]*$", re.MULTILINE)
_TRIANGLE = re.compile(rb"^f((?:[ \t]+\d{1,9}(?:/[\d/]*)?){3})[ \t\r]*$", re.MULTILINE)
_ANY = {kind: re.compile(rb"^[ \t\v\f]*" + kind + rb"[ \t]", re.MULTILINE) for kind in (b"v", b"f")}


def parse_obj(path: Path, content: bytes) -> tuple[Float[ndarray, "V 3"], Int[ndarray, "F 3"]]:
    """Parse vertices, and faces with polygons cut into triangles.

    ``path`` is only named in errors: nothing is opened.

    Parts, materials, normals and textures are passed over. Raises ``InputError``, which names the line.
    """
    content = files.without_mark(content)
    if len(content) > 8 * MOST:  # the shortest line of a vertex has 8 bytes
        _check_counts(path, content)
    vertices, faces = _plain(content) or _by_line(path, content)
    if not len(faces):
        raise InputError(path, "faces", f"{len(vertices)} vertices and no faces", "a mesh with faces")
    if faces.max() >= len(vertices):
        raise InputError(path, "faces", f"a face with vertex {faces.max() + 1}", f"1 to {len(vertices)}")
    return vertices, faces


def obj_content(vertices: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"]) -> bytes:
    """Write plain triangles as an OBJ file, to 1e-8 m."""
    points = f"v {' '.join([f'%.{DECIMALS}f'] * 3)}\n" * len(vertices) % tuple(vertices.ravel().tolist())
    corners = "f %d %d %d\n" * len(faces) % tuple((faces + 1).ravel().tolist())
    return (points + corners).encode()


def _check_counts(path: Path, content: bytes) -> None:
    """Raise ``InputError`` for more lines of a kind than are allowed, before any is parsed."""
    lines = content.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").replace(b"\r", b"\n")
    for kind, found in _ANY.items():
        if sum(1 for _ in islice(found.finditer(lines), MOST + 1)) > MOST:
            raise InputError(path, "", f"more than {MOST} lines of {kind.decode()!r}", f"at most {MOST}")


def _plain(content: bytes) -> tuple[Float[ndarray, "V 3"], Int[ndarray, "F 3"]] | None:
    """Read a file of plain triangles, as most large ones are, ten times as fast; None for any other file."""
    other_line_ends = content.count(b"\r") != content.count(b"\r\n")
    if other_line_ends or b"\\" in content or max(content.count(b"v "), content.count(b"f ")) > MOST:
        return None
    points, corners = _VERTEX.findall(content), _TRIANGLE.findall(content)
    if (len(points), len(corners)) != tuple(sum(1 for _ in found.finditer(content)) for found in _ANY.values()):
        return None
    try:
        vertices = _numbers(b"".join(points), float)
        faces = _numbers(re.sub(rb"/[\d/]*", b"", b"".join(corners)), np.int64)
    except (ValueError, DeprecationWarning):  # text that is no number
        return None
    if len(vertices) != 3 * len(points) or len(faces) != 3 * len(corners) or faces.min(initial=1) < 1:
        return None
    return vertices.reshape(-1, 3), faces.reshape(-1, 3) - 1


def _numbers(text: bytes, kind: type) -> Shaped[ndarray, "n"]:
    """Numbers with spaces between. For text that is no number, numpy raises ``ValueError`` or, before 2.3, warns."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        return np.fromstring(text, dtype=kind, sep=" ")


def _by_line(path: Path, content: bytes) -> tuple[Float[ndarray, "V 3"], Int[ndarray, "F 3"]]:
    """Any file. Raises ``InputError``."""
    text = content.decode("utf-8", "replace")  # names and comments may be in any encoding
    vertices, counts, faces = array("d"), array("q"), array("q")
    lines = io.StringIO(text.replace("\\\r\n", " ").replace("\\\n", " "), newline=None)
    for number, line in enumerate(lines, start=1):
        if len(line) > LONGEST_LINE:
            raise InputError(path, f"line {number}", f"{len(line)} characters", f"at most {LONGEST_LINE}")
        words = line.partition("#")[0].split()
        try:
            if words and words[0] == "v":
                x, y, z = words[1:4]  # colours may follow
                vertices.extend((float(x), float(y), float(z)))
            elif words and words[0] == "f":
                corners = [_index(word, len(vertices) // 3) for word in words[1:]]
                if len(corners) < 3:
                    raise ValueError
                counts.append(len(corners))
                faces.extend(corners)
        except ValueError as error:
            expected = "v x y z" if words[0] == "v" else "f and three or more vertices, counted from 1"
            raise InputError(path, f"line {number}", files.shown(line.rstrip("\n")), expected) from error
        if len(vertices) > 3 * MOST or len(faces) - 2 * len(counts) > MOST:
            raise InputError(path, f"line {number}", f"more than {MOST} vertices or triangles", f"at most {MOST}")
    points = np.array(vertices, dtype=float).reshape(-1, 3)
    return points, triangles(path, points, np.array(counts, dtype=np.int64), np.array(faces, dtype=np.int64))


def _index(word: str, vertices: int) -> int:
    """Return the vertex of a corner ``v``, ``v/vt``, ``v//vn`` or ``v/vt/vn``.

    Negative ones count back from the latest.
    """
    index = int(word.partition("/")[0])
    if index == 0 or index < -vertices or index > 2**62:
        raise ValueError
    return index - 1 if index > 0 else vertices + index
