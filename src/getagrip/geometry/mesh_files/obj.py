"""Wavefront .obj files, read for their vertices and faces; and the triangulation of polygons, for .ply as well.

Convex polygons become fans, others are cut by ear clipping. Ours, not a library's: every polygon of n corners gives
n - 2 triangles with its boundary, even if it crosses itself: closed meshes stay closed. And the time is bounded.
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

OBJ_DECIMALS = 8
"""Decimals of written coordinates [m]."""
MAX_OBJ_ELEMENTS = 2**22
"""Maximum number of vertices, and of triangles."""
MAX_OBJ_LINE_CHARS = 2**20
"""Maximum length of a line: a polygon of about 100 000 corners."""
_VERTEX_LINE = re.compile(rb"^v((?:[ \t]+[-+]?[\d.][-+\deE.]*){3})[ \t\r]*$", re.MULTILINE)
_TRIANGLE_LINE = re.compile(rb"^f((?:[ \t]+\d{1,9}(?:/[\d/]*)?){3})[ \t\r]*$", re.MULTILINE)
_ELEMENT_LINES = {kind: re.compile(rb"^[ \t\v\f]*" + kind + rb"[ \t]", re.MULTILINE) for kind in (b"v", b"f")}
COLLINEAR_TOLERANCE = 1e-14
"""Twice the signed area at a corner below which it is straight, in a polygon of size about 1."""
MAX_SCALAR_TESTS = 50
"""Number of corners up to which each is tested in Python; more are tested by numpy at once, faster per corner."""
MAX_EAR_TESTS = 10_000_000
"""Maximum number of tests of corners against triangles, in a file's concave polygons: some seconds."""
POLYGON_CHUNK_CORNERS = 2**18
"""Number of polygons' corners processed at once."""


def parse_obj(path: Path, content: bytes) -> tuple[Float[ndarray, "V 3"], Int[ndarray, "F 3"]]:
    """Parse vertices, and faces with polygons cut into triangles; ``path`` is only named in errors.

    Parts, materials, normals and textures are ignored. Raises ``InputError``, which names the line.
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
    """Write triangles as an OBJ file, vertices [m] rounded to ``OBJ_DECIMALS``."""
    points = f"v {' '.join([f'%.{OBJ_DECIMALS}f'] * 3)}\n" * len(vertices) % tuple(vertices.ravel().tolist())
    corners = "f %d %d %d\n" * len(faces) % tuple((faces + 1).ravel().tolist())
    return (points + corners).encode()


def _check_element_counts(path: Path, content: bytes) -> None:
    """Raise ``InputError`` for too many lines of a kind, before any is parsed."""
    lines = content.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").replace(b"\r", b"\n")
    for kind, found in _ELEMENT_LINES.items():
        if sum(1 for _ in islice(found.finditer(lines), MAX_OBJ_ELEMENTS + 1)) > MAX_OBJ_ELEMENTS:
            got = f"more than {MAX_OBJ_ELEMENTS} lines of {kind.decode()!r}"
            raise InputError(path, "", got, f"at most {MAX_OBJ_ELEMENTS}")


def _parse_triangles_fast(content: bytes) -> tuple[Float[ndarray, "V 3"], Int[ndarray, "F 3"]] | None:
    """Parse a file of triangles only, as most large ones are, ten times as fast; None for any other file."""
    other_line_ends = content.count(b"\r") != content.count(b"\r\n")
    if other_line_ends or b"\\" in content or max(content.count(b"v "), content.count(b"f ")) > MAX_OBJ_ELEMENTS:
        return None
    points, corners = _VERTEX_LINE.findall(content), _TRIANGLE_LINE.findall(content)
    if [len(points), len(corners)] != [sum(1 for _ in one.finditer(content)) for one in _ELEMENT_LINES.values()]:
        return None
    try:
        vertices = _parse_obj_numbers(b"".join(points), float)
        faces = _parse_obj_numbers(re.sub(rb"/[\d/]*", b"", b"".join(corners)), np.int64)
    except (ValueError, DeprecationWarning):  # invalid numbers
        return None
    if len(vertices) != 3 * len(points) or len(faces) != 3 * len(corners) or faces.min(initial=1) < 1:
        return None
    return vertices.reshape(-1, 3), faces.reshape(-1, 3) - 1


def _parse_obj_numbers(text: bytes, kind: type) -> Shaped[ndarray, "n"]:
    """Parse numbers separated by spaces. Raises ``ValueError`` or, before numpy 2.3, ``DeprecationWarning``."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        return np.fromstring(text, dtype=kind, sep=" ")


def _parse_obj_lines(path: Path, content: bytes) -> tuple[Float[ndarray, "V 3"], Int[ndarray, "F 3"]]:
    """Parse any file, line by line. Raises ``InputError``."""
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
            got = f"more than {MAX_OBJ_ELEMENTS} vertices or triangles"
            raise InputError(path, f"line {number}", got, f"at most {MAX_OBJ_ELEMENTS}")
    points = np.array(vertices, dtype=float).reshape(-1, 3)
    return points, triangulate_polygons(path, points, np.array(counts, dtype=np.int64), np.array(faces, dtype=np.int64))


def _parse_vertex_index(word: str, vertices: int) -> int:
    """Parse the vertex id of a corner ``v``, ``v/vt``, ``v//vn`` or ``v/vt/vn``; negative: counted from the latest."""
    index = int(word.partition("/")[0])
    if index == 0 or index < -vertices or index > 2**62:
        raise ValueError
    return index - 1 if index > 0 else vertices + index


@dataclass
class EarTestBudget:
    """The number of tests left for a file."""

    left: int


def triangulate_polygons(
    path: Path, points: Float[ndarray, "V 3"], counts: Int[ndarray, "n"], corners: Int[ndarray, "c"]
) -> Int[ndarray, "F 3"]:
    """Triangulate polygons with ``counts`` corners each (3 or more), concatenated in ``corners``: n - 2 triangles each.

    Degenerate polygons, and polygons with invalid vertex ids, become fans. Raises ``InputError`` for polygons that
    would take too long.
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
    """Triangulate polygons with N corners each."""
    count = polygons.shape[1]
    n = np.arange(1, count - 1)
    cut: ndarray = polygons[:, np.stack([np.zeros_like(n), n, n + 1], axis=1)]
    if count == 3 or not len(points):
        return cut
    known: Bool[ndarray, "n"] = np.all((polygons >= 0) & (polygons < len(points)), axis=1)
    flat = _in_plane(points[np.where(known[:, None], polygons, 0)])
    concave = known & ~_are_convex(flat)
    if count == 4:
        second_diagonal = polygons[concave][:, np.array([[1, 2, 3], [1, 3, 0]])]
        cut[concave] = np.where(_is_first_diagonal_inside(flat[concave])[:, None, None], cut[concave], second_diagonal)
        return cut
    for row in np.flatnonzero(concave):
        cut[row] = polygons[row][np.array(_clip_ears(path, flat[row], effort))]
    return cut


def _is_first_diagonal_inside(flat: Float[ndarray, "n 4 2"]) -> Bool[ndarray, "n"]:
    """Return whether the diagonal from a quad's first corner is inside; at least one of the two diagonals is."""
    a, b, c, d = np.moveaxis(flat, 1, 0)
    return (_twice_signed_areas(a, b, c) > 0) & (_twice_signed_areas(a, c, d) > 0)


def _clip_ears(path: Path, flat: Float[ndarray, "N 2"], effort: EarTestBudget) -> list[tuple[int, int, int]]:
    """Triangulate a planar polygon: N - 2 triangles of its corners, with its orientation.

    Convex corners whose triangle contains no other corner are cut off; if none is left, straight corners. A polygon
    without either, such as one that crosses itself, becomes a fan from that point on. Scalar arithmetic, since most
    polygons have few corners.
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
    """Compute twice the signed area of a triangle, positive if counter-clockwise."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _triangle_contains(a: Sequence[float], b: Sequence[float], c: Sequence[float], point: Sequence[float]) -> bool:
    """Return whether a point is in a counter-clockwise triangle, edges included, corners excluded."""
    inside = (
        _twice_signed_area(a, b, point) >= 0
        and _twice_signed_area(b, c, point) >= 0
        and _twice_signed_area(c, a, point) >= 0
    )
    return inside and point not in (a, b, c)


def _triangle_contains_any(
    a: Float[ndarray, "2"], b: Float[ndarray, "2"], c: Float[ndarray, "2"], points: Float[ndarray, "n 2"]
) -> bool:
    """Return whether any point is in a triangle, as ``_triangle_contains`` defines it."""
    inside = np.all([_twice_signed_areas(p, q, points) >= 0 for p, q in ((a, b), (b, c), (c, a))], axis=0)
    corner = np.any([(points == point).all(axis=1) for point in (a, b, c)], axis=0)
    return bool((inside & ~corner).any())


def _in_plane(points: Float[ndarray, "n N 3"]) -> Float[ndarray, "n N 2"]:
    """Project corners to their polygon's plane, counter-clockwise; zeros for one without area or not finite.

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
    """Compute twice the signed areas of triangles, positive if counter-clockwise."""
    ab, ac = b - a, c - a
    return np.asarray(ab[..., 0] * ac[..., 1] - ab[..., 1] * ac[..., 0])


def _are_convex(flat: Float[ndarray, "n N 2"]) -> Bool[ndarray, "n"]:
    """Return whether each polygon turns left at every corner, and by one full turn in total."""
    before, after = np.roll(flat, 1, axis=1), np.roll(flat, -1, axis=1)
    turns_left: Bool[ndarray, "n"] = np.all(_twice_signed_areas(before, flat, after) >= -1e-12, axis=1)
    if flat.shape[1] < 5:
        return turns_left
    step = after - flat
    angle = np.arctan2(step[..., 1], step[..., 0])
    turned = np.mod(np.diff(angle, axis=1, append=angle[:, :1]), 2 * np.pi)
    return turns_left & (turned.sum(axis=1) < 3 * np.pi)
