"""Colours of a mesh, at its vertices: the vertices' own (.ply, .obj, .glb), or a texture's (.obj with .mtl, .glb).

Scans are dense, so that colours of vertices tell as much as a picture does at the size of an object in a video, and
every step that merges, cuts, decimates or deforms a mesh keeps them. A coarse mesh with a texture is subdivided first.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.geometry.mesh import subdivide_surface
from getagrip.geometry.mesh_files.glb import names_glb_texture, parse_glb_colours
from getagrip.geometry.mesh_files.ply import names_ply_colours, parse_ply_colours
from getagrip.io import files

MAX_TEXTURED_BYTES, MAX_TEXTURE_SIDE_PX = 64 * 2**20, 8192
"""Limits of a textured .obj file and of a picture, and of the picture's sides."""

MAX_COARSE_FACES, EDGES_PER_SIDE, MAX_PAINTED_FACES = 4000, 40, 100_000
"""Maximum faces of a mesh that is subdivided; then, edges along its largest side, and about the maximum of faces."""


class ColouredPoints(NamedTuple):
    """Points of a mesh, in its file's unit, and their red, green and blue, 0 to 255."""

    points: Float[ndarray, "n 3"]
    colours: UInt8[ndarray, "n 3"]


def parse_colours(path: Path) -> ColouredPoints | None:
    """Parse the colours that a mesh file has at its vertices; None without any. Raises ``InputError``."""
    suffix = path.suffix.lower()
    if suffix == ".glb":
        return _glb_colours(path, np.inf)
    if suffix not in (".ply", ".obj"):
        return None
    content = files.strip_byte_order_mark(files.read_bytes(path, MAX_TEXTURED_BYTES * 2))
    found = parse_ply_colours(path, content) if suffix == ".ply" else _obj_colours(path, content)
    return None if found is None or not np.isfinite(found[0]).all() or not len(found[0]) else ColouredPoints(*found)


def has_colours(path: Path) -> bool:
    """Return whether ``read_mesh`` finds colours in a file: that of a .ply file's vertices."""
    if path.suffix.lower() != ".ply":
        return False
    with path.open("rb") as file:
        return names_ply_colours(file.read(2**16))


def names_texture(path: Path) -> bool:
    """Return whether an .obj file names a file of materials, or a .glb file has a texture. Raises ``InputError``."""
    if path.suffix.lower() not in (".obj", ".glb"):
        return False
    content = files.read_bytes(path, MAX_TEXTURED_BYTES * 2)
    return b"\nmtllib " in b"\n" + content if path.suffix.lower() == ".obj" else names_glb_texture(path, content)


def painted_edge(vertices: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"]) -> float:
    """Return the edge down to which a textured surface is subdivided, so that its vertices show the texture.

    Infinite where it has many faces, or would get too many.
    """
    if len(faces) > MAX_COARSE_FACES:
        return np.inf
    longest = float(np.ptp(vertices[faces].reshape(-1, 3), axis=0).max()) / EDGES_PER_SIDE
    return longest if _count_pieces(vertices, faces, longest) < MAX_PAINTED_FACES else np.inf


def _count_pieces(vertices: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"], longest: float) -> float:
    """Return about the maximum number of faces after subdivision; infinite for a point."""
    if not longest > 0.0:
        return np.inf
    sides = np.linalg.norm(vertices[faces] - vertices[np.roll(faces, 1, axis=1)], axis=2).max(axis=1)
    return float(np.sum(np.maximum(sides / longest, 1.0) ** 2))


def texture_colours(path: Path, longest: float = np.inf) -> ColouredPoints:
    """Read the texture's colour at each corner of a file's faces, subdivided until no edge is above ``longest``.

    Raises ``InputError`` for a file that does not read, or without a texture: beside an .obj file, in a .glb file.
    """
    if path.suffix.lower() == ".glb":
        if (found := _glb_colours(path, longest)) is None:
            raise InputError(path, "textures", "no colours", "a material with a texture in the file")
        return found
    lines = files.read_text(path, MAX_TEXTURED_BYTES).splitlines()
    corners, faces = _texture_coordinates(path, lines)
    if _count_pieces(corners[:, :3], faces, longest) < MAX_PAINTED_FACES:
        corners = subdivide_surface(corners, faces, longest)[0]
    placed, uv = np.split(corners, [3], axis=1)
    material = _named_file(path, lines, "mtllib")
    texture = _named_file(material, files.read_text(material, files.MAX_JSON_BYTES).splitlines(), "map_Kd")
    content = files.read_bytes(texture, MAX_TEXTURED_BYTES)
    at = np.array([0.0, 1.0]) + np.array([1.0, -1.0]) * (uv % 1.0)
    return ColouredPoints(placed, _picture_colours(texture, "", content, at))


def _picture_colours(path: Path, key: str, content: bytes, at: Float[ndarray, "n 2"]) -> UInt8[ndarray, "n 3"]:
    """Return the colours of a picture at places in it, to the right and down, from 0 to 1."""
    from getagrip.io.images import decode_image

    image = decode_image(path, key, content, MAX_TEXTURE_SIDE_PX)
    height, width = image.shape[:2]
    column, row = (np.clip(at * [width, height], 0, [width - 1, height - 1])).astype(int).T
    return image[row, column]


def _glb_colours(path: Path, longest: float) -> ColouredPoints | None:
    """Return the colours of a .glb file's parts at their corners, subdivided; None without any."""
    parts, images = parse_glb_colours(path, files.read_bytes(path, MAX_TEXTURED_BYTES * 2))
    if not parts:
        return None
    fine = sum(_count_pieces(part.corners[:, :3], part.faces, longest) for part in parts) < MAX_PAINTED_FACES
    corners = [subdivide_surface(part.corners, part.faces, longest)[0] if fine else part.corners for part in parts]
    light = [each[:, 5:] for each in corners]
    for image, content in images.items():
        shown = [n for n, part in enumerate(parts) if part.image == image]
        at = np.concatenate([corners[n][:, 3:5] for n in shown]) % 1.0
        painted = light_of(_picture_colours(path, f"images[{image}]", bytes(content), at))
        ends = np.cumsum([len(corners[n]) for n in shown])[:-1]
        for n, colours in zip(shown, np.split(painted, ends), strict=True):
            light[n] = light[n] * colours
    return ColouredPoints(np.concatenate(corners)[:, :3], colours_of_light(np.concatenate(light)))


def light_of(colours: UInt8[ndarray, "*n 3"]) -> Float[ndarray, "*n 3"]:
    """Return the intensities of light of colours, 0 to 1 (sRGB, IEC 61966-2-1)."""
    value = colours / 255.0
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def colours_of_light(light: Float[ndarray, "*n 3"]) -> UInt8[ndarray, "*n 3"]:
    """Return the colours of intensities of light, 0 to 1, the inverse of ``light_of``."""
    value = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1.0 / 2.4) - 0.055)
    return np.round(255.0 * value).astype(np.uint8)


def _obj_colours(path: Path, content: bytes) -> tuple[Float[ndarray, "n 3"], UInt8[ndarray, "n 3"]] | None:
    """Return the vertices of an .obj file and the colours behind their coordinates; None without any."""
    first = re.search(rb"^v[ \t](.*)$", content, re.MULTILINE)
    if first is None or len(first[1].split()) != 6:
        return None
    try:
        rows = np.array(
            [line.split()[1:7] for line in content.splitlines() if line[:2] in (b"v ", b"v\t")], dtype=float
        )
    except ValueError as error:
        raise InputError(path, "v", "vertices of which some have no colour", "x y z r g b in every line") from error
    if not (rows[:, 3:] >= 0.0).all() or not (rows[:, 3:] <= 1.0).all():
        raise InputError(path, "v", "colours beyond 0 to 1", "red, green and blue from 0 to 1 behind x y z")
    return rows[:, :3], np.round(255.0 * rows[:, 3:]).astype(np.uint8)


def _texture_coordinates(path: Path, lines: Sequence[str]) -> tuple[Float[ndarray, "n 5"], Int[ndarray, "m 3"]]:
    """Return corners of faces, with their texture coordinates behind their own, and the faces cut into triangles."""
    try:
        vertices = np.array([line.split()[1:4] for line in lines if line.startswith("v ")], dtype=float)
        points = np.array([line.split()[1:3] for line in lines if line.startswith("vt ")], dtype=float)
        polygons = [line.split()[1:] for line in lines if line.startswith("f ")]
        place = {word: n for n, word in enumerate(sorted({word for polygon in polygons for word in polygon}))}
        pairs = np.array([word.split("/")[:2] for word in place], dtype=int) - 1
        if pairs.min() < 0 or not (np.isfinite(vertices).all() and np.isfinite(points).all()):
            raise ValueError
        corners = np.concatenate([vertices[pairs[:, 0]], points[pairs[:, 1]]], axis=1)
        fans = [(p[0], *p[n : n + 2]) for p in polygons for n in range(1, len(p) - 1)]
        return corners, np.array([[place[word] for word in fan] for fan in fans], dtype=int).reshape(-1, 3)
    except (ValueError, IndexError) as error:
        raise InputError(
            path, "f", "faces without texture coordinates", "f v/vt ... in every face, counted from 1"
        ) from error


def _named_file(path: Path, lines: Sequence[str], key: str) -> Path:
    """Return the file beside ``path`` that a line with a key names. Raises ``InputError``."""
    name = next((line.split(maxsplit=1)[1].strip() for line in lines if line.strip().startswith(f"{key} ")), "")
    name = name.removeprefix("./")  # as exporters write it
    if not files.is_portable_name(name):
        raise InputError(path, key, files.shorten_value(name), "the name of a file in the same folder")
    return files.inside(path.parent, name, key, "a file in the same folder", path)
