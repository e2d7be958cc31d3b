"""Wavefront .obj files: the vertices and the faces, which is all of them that is about shape."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.io import files


def parse_obj(path: Path, content: bytes) -> tuple[Float[ndarray, "V 3"], Int[ndarray, "F 3"]]:
    """Vertices, and faces with polygons cut into fans. ``path`` is only named in errors: nothing is opened.

    Parts, materials, normals and textures are passed over. Raises ``InputError``, which names the line.
    """
    text = content.decode("utf-8-sig", "replace")  # names and comments may be in any encoding
    vertices: list[list[float]] = []
    faces: list[tuple[int, int, int]] = []
    for number, line in enumerate(text.replace("\\\r\n", " ").replace("\\\n", " ").splitlines(), start=1):
        words = line.partition("#")[0].split()
        try:
            if words and words[0] == "v":
                x, y, z = words[1:4]  # colours may follow
                vertices.append([float(x), float(y), float(z)])
            elif words and words[0] == "f":
                corners = [_index(word, len(vertices)) for word in words[1:]]
                if len(corners) < 3:
                    raise ValueError
                faces += [(corners[0], b, c) for b, c in pairwise(corners[1:])]
        except ValueError as error:
            expected = "v x y z" if words[0] == "v" else "f and three or more vertices, counted from 1"
            raise InputError(path, f"line {number}", files.shown(line), expected) from error
    if not faces:
        raise InputError(path, "faces", f"{len(vertices)} vertices and no faces", "a mesh with faces")
    ids = np.array(faces, dtype=np.int64)
    if ids.max() >= len(vertices):
        raise InputError(path, "faces", f"a face with vertex {ids.max() + 1}", f"1 to {len(vertices)}")
    return np.array(vertices), ids


def _index(word: str, vertices: int) -> int:
    """The vertex of a corner ``v``, ``v/vt``, ``v//vn`` or ``v/vt/vn``; below zero it counts back from the latest."""
    index = int(word.partition("/")[0])
    if index == 0 or index < -vertices or index > 2**62:
        raise ValueError
    return index - 1 if index > 0 else vertices + index
