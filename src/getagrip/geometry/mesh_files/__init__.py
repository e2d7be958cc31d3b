"""Mesh files (.obj, .ply, .stl, .glb), untrusted: reading, checking, writing."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.errors import InputError, UsageError, check_arguments
from getagrip.geometry.mesh import Mesh, face_areas, merge_vertices
from getagrip.geometry.mesh_files.colours import ColouredPoints, has_colours, parse_colours, texture_colours
from getagrip.geometry.mesh_files.glb import parse_glb
from getagrip.geometry.mesh_files.obj import obj_content, parse_obj
from getagrip.geometry.mesh_files.ply import parse_ply, ply_content
from getagrip.io import files

MESH_SUFFIXES = (".obj", ".ply", ".stl", ".glb")
MAX_MESH_EXTENT_M, MIN_MESH_EXTENT_M = 2.0, 0.005
"""Plausible sizes of hands and objects [m]."""
MAX_ORIGIN_DISTANCE_M = 100.0
"""Maximum distance of a mesh from its origin [m]; beyond, coordinates have too few digits for its shape."""
UNIT_HINT = " Scale the file to metres; of a clip's own mesh, getagrip clip new takes the unit (--unit mm, cm, in)"
MAX_MESH_BYTES = 128 * 2**20
"""Limit of a file; parsing takes several times as much memory."""


@check_arguments
def read_mesh(path: str | Path) -> Mesh:
    """Read and check a triangle mesh in metres (.obj, .ply, .stl, .glb), placed by the file's own transforms.

    Closed meshes wound inward are flipped. Raises ``InputError`` for an unreadable file, no faces, degenerate faces,
    non-finite vertices or an absurd size. Colours of vertices (.ply) are kept; those of a texture are read by
    ``read_textured_mesh``; ``getagrip clip new`` reads either.
    """
    path = Path(path)
    mesh = checked_mesh(path, *parse_mesh(path))
    return _with_colours(mesh, parse_colours(path) if has_colours(path) else None)


def read_textured_mesh(path: Path) -> Mesh:
    """Read a mesh as ``read_mesh``, with the colour of its texture (.obj, .glb) at each vertex.

    Raises ``InputError`` also for a texture that does not read, is not beside or in the mesh, or is missing.
    """
    return _with_colours(checked_mesh(path, *parse_mesh(path)), texture_colours(path))


def _with_colours(mesh: Mesh, painted: ColouredPoints | None) -> Mesh:
    return mesh if painted is None else mesh.coloured_like(*painted)


def parse_mesh(path: Path) -> tuple[Float[ndarray, "..."], Int[ndarray, "..."]]:
    """Parse unchecked vertices and faces of a mesh file, in the file's own unit. Raises ``InputError``."""
    suffix = path.suffix.lower()
    if suffix not in MESH_SUFFIXES:
        got = f"the suffix {files.shorten_value(path.suffix)}"
        raise InputError(path, "mesh", got, f"one of {', '.join(MESH_SUFFIXES)}")
    if not path.is_file():
        raise InputError(path, "mesh", "no such file", "a triangle mesh")
    parse = {".obj": parse_obj, ".glb": parse_glb, ".ply": parse_ply, ".stl": _parse_stl}[suffix]
    return parse(path, files.read_bytes(path, MAX_MESH_BYTES))


def _parse_stl(path: Path, content: bytes) -> tuple[Float[ndarray, "..."], Int[ndarray, "..."]]:
    """Parse vertices and faces of a .stl file by trimesh; ``path`` is only named in errors."""
    import trimesh

    kind, stream = "stl", io.BytesIO(content)  # a stream: trimesh cannot open files beside it
    binary = len(content) >= 84 and len(content) == 84 + 50 * int.from_bytes(content[80:84], "little")
    if not binary:
        kind, stream = "stl_ascii", io.BytesIO(files.strip_byte_order_mark(content).decode("utf-8", "replace").encode())
        if not stream.getvalue().lstrip().startswith(b"solid"):
            raise InputError(path, "mesh", "a file that does not parse", "a whole .stl file, binary or text")
    try:
        loaded = trimesh.load(stream, file_type=kind, force="mesh", process=False, skip_materials=True)
    except Exception as error:  # trimesh's parsers raise many types
        raise InputError(path, "mesh", f"a file that does not parse ({error})", "a whole .stl file") from error
    vertices, faces = getattr(loaded, "vertices", ()), getattr(loaded, "faces", ())
    return np.asarray(vertices, dtype=float), np.asarray(faces, dtype=np.int64)


def checked_mesh(path: Path, vertices: Float[ndarray, "..."], faces: Int[ndarray, "..."]) -> Mesh:
    """Check a mesh, merge its vertices and wind it outward. Raises ``InputError`` for an unusable mesh."""
    if faces.size == 0 or vertices.size == 0:
        raise InputError(path, "faces", "no faces", "a mesh with faces")
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise InputError(path, "vertices", f"the shape {vertices.shape}", "three coordinates for each vertex")
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise InputError(path, "faces", f"the shape {faces.shape}", "triangles")
    if not np.isfinite(vertices).all():
        raise InputError(path, "vertices", "NaN or infinite coordinates", "finite coordinates [m]")
    if faces.min() < 0 or faces.max() >= len(vertices):
        bad = faces.min() if faces.min() < 0 else faces.max()
        raise InputError(path, "faces", f"the vertex index {bad}", f"0 to {len(vertices) - 1}, counted from 0")
    used, faces = used_vertices(vertices, faces)
    vertices = vertices[used]
    extent = float(np.ptp(vertices, axis=0).max())
    check_size(path, "vertices", extent, "the object", UNIT_HINT)
    away = float(np.abs(vertices.mean(axis=0)).max())
    if away > MAX_ORIGIN_DISTANCE_M:
        most = f"at most {MAX_ORIGIN_DISTANCE_M:g} m"
        expected = f"{most}: so far off, as in a map, its shape has too few digits; move it"
        raise InputError(path, "vertices", f"an object {away:.4g} m from its origin", expected)
    bad = np.flatnonzero(face_areas(vertices, faces) < 1e-12 * extent**2)
    if bad.size:
        raise InputError(path, "faces", f"{bad.size} faces without area (first: {bad[0]})", "triangles with an area")
    mesh = Mesh(vertices, faces)
    return Mesh(mesh.vertices, mesh.faces[:, ::-1].copy()) if mesh.is_closed and mesh.volume < 0 else mesh


def used_vertices(
    vertices: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"]
) -> tuple[Int[ndarray, "U"], Int[ndarray, "F 3"]]:
    """Return the used vertices' indices, one per position, and the renumbered faces; formats like .stl repeat them."""
    used, remapped = np.unique(merge_vertices(vertices)[faces], return_inverse=True)
    return used, remapped.reshape(faces.shape)


def drop_degenerate_faces(vertices: Float[ndarray, "..."], faces: Int[ndarray, "..."]) -> Int[ndarray, "..."]:
    """Drop faces without area, which scans and CAD models may have; invalid faces are left for ``checked_mesh``."""
    are_triangles = vertices.shape[1:] == (3,) and faces.shape[1:] == (3,) and faces.size
    if not are_triangles or faces.min() < 0 or faces.max() >= len(vertices):
        return faces
    with np.errstate(invalid="ignore", over="ignore"):
        least = 5e-12 * np.ptp(vertices[faces.ravel()], axis=0).max(initial=0.0) ** 2
        return faces[face_areas(vertices, faces) > least]


def check_size(path: Path, key: str, extent: float, what: str, units: str = "") -> None:
    """Raise ``InputError`` for an absurdly large or small hand or object; ``units`` is advice for other units."""
    got = f"{what} {extent:.4g} m large"
    if extent > MAX_MESH_EXTENT_M:
        raise InputError(path, key, got, f"at most {MAX_MESH_EXTENT_M:g} m; are these millimetres?{units}")
    if extent < MIN_MESH_EXTENT_M:
        raise InputError(path, key, got, f"at least {MIN_MESH_EXTENT_M:g} m; is the unit the metre?{units}")


@check_arguments
def write_mesh(mesh: Mesh, path: str | Path) -> Path:
    """Write a mesh as .obj, .ply, .stl or .glb, and return its path; .ply keeps colours.

    Raises ``UsageError`` for other suffixes.
    """
    path = Path(path)
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise UsageError(f"unknown suffix {path.suffix!r} of {path}; choose from {', '.join(MESH_SUFFIXES)}")
    if path.suffix.lower() == ".ply" and mesh.colours is not None:
        files.write_bytes(path, ply_content(mesh))
        return path
    if path.suffix.lower() == ".obj":
        files.write_bytes(path, obj_content(mesh.vertices, mesh.faces))
        return path
    import trimesh

    stream = io.BytesIO()
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(stream, file_type=path.suffix[1:].lower())
    files.write_bytes(path, stream.getvalue())
    return path
