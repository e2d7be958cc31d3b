"""Wavefront .obj files: the vertices and the faces; the rest is ignored.

Polygons cut into triangles: fans where they are convex, ears where not.
"""

from __future__ import annotations

import io
import re
import warnings
from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice, pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.io import files

COLLINEAR_TOLERANCE = 1e-14
"""Corners that turn less are straight, in polygons about 1 large."""
MAX_SCALAR_TESTS = 50
"""Corners that are tested one by one; more are tested at once, each in a fraction of the time."""
MAX_EAR_TESTS = 10_000_000
"""Most tests of corners against triangles, in the concave polygons of a file: some seconds."""
POLYGON_CHUNK_CORNERS = 2**18
"""Corners of polygons that are looked at at a time."""


@dataclass
class EarTestBudget:
    """Number of further tests that a file may take."""

    left: int


def triangulate_polygons(
    path: Path, points: Float[ndarray, "V 3"], counts: Int[ndarray, "n"], corners: Int[ndarray, "c"]
) -> Int[ndarray, "F 3"]:
    """Triangulate polygons with ``counts`` corners each (3 or more), which are listed one after the other.

    Those of a polygon that is no plane one of these points are a fan. Raises ``InputError`` for polygons that take too
    long to be cut.
    """
    starts, firsts = np.cumsum(counts) - counts, np.cumsum(counts - 2) - (counts - 2)
    made, effort = np.empty((int(np.sum(counts - 2)), 3), dtype=np.int64), EarTestBudget(MAX_EAR_TESTS)
    for count in np.unique(counts):
        of_count, step = np.flatnonzero(counts == count), max(1, POLYGON_CHUNK_CORNERS // int(count))
        for begin in range(0, len(of_count), step):
            rows = of_count[begin : begin + step]
            polygons = corners[starts[rows, None] + np.arange(count)]
            made[firsts[rows, None] + np.arange(count - 2)] = _triangulate_equal_sized(path, points, polygons, effort)
    return made


def _triangulate_equal_sized(
    path: Path, points: Float[ndarray, "V 3"], polygons: Int[ndarray, "n N"], effort: EarTestBudget
) -> Int[ndarray, "n f 3"]:
    """Triangulate polygons that have the same number of corners."""
    count = polygons.shape[1]
    n = np.arange(1, count - 1)
    cut: ndarray = polygons[:, np.stack([np.zeros_like(n), n, n + 1], axis=1)]
    if count == 3 or not len(points):
        return cut
    known: Bool[ndarray, "n"] = np.all((polygons >= 0) & (polygons < len(points)), axis=1)
    flat = _in_plane(points[np.where(known[:, None], polygons, 0)])
    concave = known & ~_are_convex(flat)
    if count == 4:
        cut[concave] = np.where(
            _split_at_first(flat[concave])[:, None, None], cut[concave], _split_second_diagonal(polygons[concave])
        )
        return cut
    for row in np.flatnonzero(concave):
        cut[row] = polygons[row][np.array(_clip_ears(path, flat[row], effort))]
    return cut


def _split_at_first(flat: Float[ndarray, "n 4 2"]) -> Bool[ndarray, "n"]:
    """Return whether the diagonal from a quad's first corner lies in it; one of the two diagonals does."""
    a, b, c, d = np.moveaxis(flat, 1, 0)
    return (_twice_signed_areas(a, b, c) > 0) & (_twice_signed_areas(a, c, d) > 0)


def _split_second_diagonal(quads: Int[ndarray, "n 4"]) -> Int[ndarray, "n 2 3"]:
    """Quads cut at the diagonal from their second corner."""
    return quads[:, np.array([[1, 2, 3], [1, 3, 0]])]


def _clip_ears(path: Path, flat: Float[ndarray, "N 2"], effort: EarTestBudget) -> list[tuple[int, int, int]]:
    """N - 2 triangles of a simple polygon in the plane, by its corners, turning as it turns.

    Corners are cut off that are convex and whose triangle holds no other corner, or that are straight where there are
    none. A polygon that has neither, as one that crosses itself, is cut into a fan from there on. Plain numbers, since
    most polygons have few corners.
    """
    at: list[list[float]] = flat.tolist()
    count = len(at)
    before, after = [n - 1 for n in range(count)], [n + 1 for n in range(count)]
    before[0], after[-1] = count - 1, 0
    turn = [_twice_signed_area(at[before[n]], at[n], at[after[n]]) for n in range(count)]
    reflex = {n for n in range(count) if turn[n] <= 0}
    is_reflex = np.array(turn) <= 0
    cut: list[tuple[int, int, int]] = []
    n = passed = 0
    while count > 3:
        a, c = before[n], after[n]
        convex, straight = turn[n] > COLLINEAR_TOLERANCE, passed > count and abs(turn[n]) <= COLLINEAR_TOLERANCE
        few = len(reflex) <= MAX_SCALAR_TESTS
        if convex:
            effort.left -= 1 + (len(reflex) if few else 20 * MAX_SCALAR_TESTS + len(flat) // 4)
        if effort.left < 0:
            got = f"concave polygons, one of {len(flat)} corners, that take too long to be cut"
            raise InputError(path, "faces", got, "triangles; triangulate the mesh first")
        if convex and few:
            convex = not any(_triangle_contains(at[a], at[n], at[c], at[r]) for r in reflex)
        elif convex:
            convex = not _triangle_contains_any(flat[a], flat[n], flat[c], flat[is_reflex])
        if straight or convex:
            cut.append((a, n, c))
            after[a], before[c] = c, a
            turn[n] = np.inf
            for k in (a, c):
                turn[k] = _twice_signed_area(at[before[k]], at[k], at[after[k]])
            for k in (a, n, c):
                is_reflex[k] = turn[k] <= 0
                (reflex.add if turn[k] <= 0 else reflex.discard)(k)
            count, passed = count - 1, 0
        elif passed > 2 * count:
            break
        n, passed = c, passed + 1
    rest = [n]
    while len(rest) < count:
        rest.append(after[rest[-1]])
    return cut + [(n, b, c) for b, c in pairwise(rest[1:])]


def _twice_signed_area(a: Sequence[float], b: Sequence[float], c: Sequence[float]) -> float:
    """Twice the signed area of a triangle, positive where it is counter-clockwise."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _triangle_contains(a: Sequence[float], b: Sequence[float], c: Sequence[float], point: Sequence[float]) -> bool:
    """Return whether a point is in a counter-clockwise triangle, edges included and corners not."""
    inside = (
        _twice_signed_area(a, b, point) >= 0
        and _twice_signed_area(b, c, point) >= 0
        and _twice_signed_area(c, a, point) >= 0
    )
    return inside and point not in (a, b, c)


def _triangle_contains_any(
    a: Float[ndarray, "2"], b: Float[ndarray, "2"], c: Float[ndarray, "2"], points: Float[ndarray, "n 2"]
) -> bool:
    """Return whether any of many points is in a triangle, as ``_triangle_contains`` defines it."""
    inside = (
        (_twice_signed_areas(a, b, points) >= 0)
        & (_twice_signed_areas(b, c, points) >= 0)
        & (_twice_signed_areas(c, a, points) >= 0)
    )
    corner = np.any([(points == point).all(axis=1) for point in (a, b, c)], axis=0)
    return bool((inside & ~corner).any())


def _in_plane(points: Float[ndarray, "n N 3"]) -> Float[ndarray, "n N 2"]:
    """Corners in their polygon's plane, counter-clockwise; zeros where it has no area or is not finite.

    The plane's normal is Newell's.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        off = points - points.mean(axis=1, keepdims=True)
        extent = np.abs(off).max(axis=(1, 2))[:, None, None]
        off = off / np.where(extent > 0, extent, 1.0)
        normal = np.cross(off, np.roll(off, -1, axis=1)).sum(axis=1)
        length = np.linalg.norm(normal, axis=1)
        plane = np.isfinite(length) & (length > 1e-12)
    off, normal = np.where(plane[:, None, None], off, 0.0), np.where(plane[:, None], normal, [0.0, 0.0, 1.0])
    normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    across = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal), axis=1)])
    across = across / np.linalg.norm(across, axis=1, keepdims=True)
    up = np.cross(normal, across)
    return np.stack([(off * across[:, None]).sum(axis=-1), (off * up[:, None]).sum(axis=-1)], axis=-1)


def _twice_signed_areas(
    a: Float[ndarray, "*n 2"], b: Float[ndarray, "*m 2"], c: Float[ndarray, "*k 2"]
) -> Float[ndarray, "*l"]:
    """Twice the signed areas of triangles, positive where they are counter-clockwise."""
    ab, ac = b - a, c - a
    return np.asarray(ab[..., 0] * ac[..., 1] - ab[..., 1] * ac[..., 0])


def _are_convex(flat: Float[ndarray, "n N 2"]) -> Bool[ndarray, "n"]:
    """Which polygons turn back at no corner and go round once."""
    before, after = np.roll(flat, 1, axis=1), np.roll(flat, -1, axis=1)
    turns_left: Bool[ndarray, "n"] = np.all(_twice_signed_areas(before, flat, after) >= -1e-12, axis=1)
    if flat.shape[1] < 5:
        return turns_left
    step = after - flat
    angle = np.arctan2(step[..., 1], step[..., 0])
    turned = np.mod(np.diff(angle, axis=1, append=angle[:, :1]), 2 * np.pi)
    return turns_left & (turned.sum(axis=1) < 3 * np.pi)


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
