"""Triangle meshes: reading, checking, normals, and the tables that silhouettes need."""

from __future__ import annotations

import io
import json
import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.errors import InputError, UsageError
from getagrip.geometry.obj import parse_obj
from getagrip.io import files
from getagrip.io.array_data import ArrayData, check_ids

SUFFIXES = (".obj", ".ply", ".stl", ".glb")
LARGEST, SMALLEST = 2.0, 0.005
"""Plausible sizes of hands and objects [m]."""
LARGEST_FILE = 128 * 2**20
"""Limit in bytes: parsing takes several times as much memory."""
PAIRS = 50_000
"""So many distances are computed at once."""


@dataclass(frozen=True, eq=False)
class Mesh(ArrayData):
    """A triangle mesh.

    Attributes:
        vertices: (V, 3) vertices in the mesh's own frame [m].
        faces: (F, 3) vertex ids of the corners of each face, counter-clockwise seen from outside.
    """

    vertices: Float[ndarray, "V 3"]
    faces: Int[ndarray, "F 3"]

    def __post_init__(self) -> None:
        super().__post_init__()
        check_ids("Mesh.faces", self.faces, len(self.vertices))

    @cached_property
    def diameter(self) -> float:
        """Largest distance between two vertices [m]."""
        return diameter(self.vertices)

    @cached_property
    def centre(self) -> Float[ndarray, "3"]:
        """Middle of the bounding box, in the mesh's own frame."""
        return (self.vertices.min(axis=0) + self.vertices.max(axis=0)) / 2.0

    @cached_property
    def normals(self) -> Float[ndarray, "V 3"]:
        """Unit vertex normals, faces weighted by their angle at the vertex."""
        return vertex_normals(self.vertices, self.faces)

    @cached_property
    def planes(self) -> Float[ndarray, "F 4"]:
        """Plane (n, d) of each face, n unit length: ``n . x + d > 0`` outside."""
        corners = self.vertices[self.faces]
        n = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        n /= np.maximum(np.linalg.norm(n, axis=1, keepdims=True), 1e-300)
        return np.concatenate([n, -np.sum(n * corners[:, 0], axis=1, keepdims=True)], axis=1)

    @cached_property
    def edges(self) -> Int[ndarray, "E 4"]:
        """Rows (v0, v1, f1, f2): face f1 runs from v0 to v1, face f2 from v1 to v0; f2 = F where there is none.

        Each half-edge stands in exactly one row. Edges of three or more faces, or of faces wound the same way, give
        several rows, so that any triangle soup is covered (see ``kernels.silhouette``).
        """
        return edge_table(self.faces)

    @cached_property
    def is_closed(self) -> bool:
        """Whether every half-edge has its opposite."""
        return bool(np.all(self.edges[:, 3] < len(self.faces)))

    @cached_property
    def vertex_areas(self) -> Float[ndarray, "V"]:
        """A third of the area of the faces around each vertex [m2]."""
        corners = self.vertices[self.faces]
        areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        return np.bincount(self.faces.ravel(), np.repeat(areas / 3.0, 3), minlength=len(self.vertices))

    @cached_property
    def volume(self) -> float:
        """Signed volume [m3]; positive for a closed mesh wound outward."""
        a, b, c = np.moveaxis(self.vertices[self.faces], 1, 0)
        return float(np.sum(a * np.cross(b, c)) / 6.0)


def vertex_normals(vertices: Float[ndarray, "*batch V 3"], faces: Int[ndarray, "F 3"]) -> Float[ndarray, "*batch V 3"]:
    """Unit vertex normals, faces weighted by their angle at the vertex; zero for vertices without faces."""
    corners = vertices[..., faces, :]
    along = np.roll(corners, -1, axis=-2) - corners
    lengths = np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-300)
    unit = along / lengths
    cosine = -np.sum(unit * np.roll(unit, 1, axis=-2), axis=-1)
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    face_normal = np.cross(along[..., 0, :], along[..., 1, :])
    face_normal /= np.maximum(np.linalg.norm(face_normal, axis=-1, keepdims=True), 1e-300)
    weighted = angle[..., None] * face_normal[..., None, :]
    flat = weighted.reshape(-1, faces.size, 3)
    out = np.zeros((len(flat), vertices.shape[-2], 3))
    for sums, rows in zip(out, flat, strict=True):
        for k in range(3):
            sums[:, k] = np.bincount(faces.ravel(), rows[:, k], minlength=vertices.shape[-2])
    normals = out.reshape(vertices.shape)
    return normals / np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-300)


def edge_table(faces: Int[ndarray, "F 3"]) -> Int[ndarray, "E 4"]:
    """Pair the half-edges of a mesh; see ``Mesh.edges``."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    face = np.repeat(np.arange(len(faces)), 3)
    forward = (start < end).astype(np.int64)
    low, high = np.minimum(start, end), np.maximum(start, end)
    # The k-th forward half-edge of an edge is paired with its k-th backward one.
    order = np.lexsort((forward, high, low))
    key = np.stack([low, high, forward])[:, order]
    first = np.concatenate([[True], np.any(key[:, 1:] != key[:, :-1], axis=0)])
    position = np.arange(len(order))
    rank = np.empty_like(position)
    rank[order] = position - np.maximum.accumulate(np.where(first, position, 0))
    _, pair = np.unique(np.stack([low, high, rank]), axis=1, return_inverse=True)
    halves = np.full((pair.max() + 1, 2), -1)
    halves[pair.ravel(), forward] = position
    head = np.where(halves[:, 1] >= 0, halves[:, 1], halves[:, 0])
    both = halves.min(axis=1) >= 0
    f2 = np.where(both, face[halves[:, 0]], len(faces))
    return np.stack([start[head], end[head], face[head], f2], axis=1)


def diameter(points: Float[ndarray, "V 3"]) -> float:
    """Largest distance between two points [m], in memory that grows only linearly with their number.

    Let the direction of q - p be within an angle a of the unit vector u. Then (q - p) . u >= |q - p| cos(a), so p and q
    are near the extreme points along u. Triangles that cover half of all directions are divided until few such points
    are left; those without a pair that could exceed the best distance so far are dropped.
    """
    from scipy.spatial.distance import cdist

    points = np.unique(points, axis=0)
    rounding = 1e-12 * np.abs(points).max()
    best = 0.0
    triangles = [(np.diag([x, y, 1.0]), points, points) for x in (1.0, -1.0) for y in (1.0, -1.0)]
    while triangles:
        corners, low, high = triangles.pop()
        u = corners.sum(axis=0) / np.linalg.norm(corners.sum(axis=0))
        cosine = np.min(corners @ u / np.linalg.norm(corners, axis=1))
        down, up = low @ u, high @ u
        best = max(best, cdist(low[[down.argmin()]], high[[up.argmax()]]).item())
        least = best * cosine - rounding
        low, high = low[down <= up.max() - least], high[up >= down.min() + least]
        if len(low) * len(high) <= PAIRS or best * (1.0 - cosine) <= rounding:
            for some in np.array_split(low, 1 + len(low) * len(high) // PAIRS):
                best = max(best, cdist(some, high).max(initial=0.0))
        else:
            quarters = [*(0.5 * (corners + corner) for corner in corners), 0.5 * (corners.sum(axis=0) - corners)]
            triangles += [(quarter, low, high) for quarter in quarters]
    return float(best)


def read_mesh(path: str | Path) -> Mesh:
    """Read and check a triangle mesh in metres (.obj, .ply, .stl, .glb), its parts where the file's own transforms put
    them.

    Closed meshes that are wound inward are turned outward. Raises ``InputError`` for an unreadable file, no faces,
    degenerate faces, non-finite vertices or an absurd size.
    """
    path = Path(path)
    return checked_mesh(path, *parse_mesh(path))


def parse_mesh(path: Path) -> tuple[Float[ndarray, "..."], Int[ndarray, "..."]]:
    """Vertices and faces of a mesh file, not checked, in the file's own unit. Raises ``InputError``."""
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(path, "mesh", f"the suffix {files.shown(path.suffix)}", f"one of {', '.join(SUFFIXES)}")
    if not path.is_file():
        raise InputError(path, "mesh", "no such file", "a triangle mesh")
    content = files.read_bytes(path, LARGEST_FILE)
    vertices, faces = parse_obj(path, content) if suffix == ".obj" else _parse(path, suffix, content)
    if suffix == ".ply" and len(faces) < (promised := _ply_faces(content)):
        raise InputError(path, "faces", f"{len(faces)} faces", f"{promised}, as its header says; is it cut short?")
    return vertices, faces


def _parse(path: Path, suffix: str, content: bytes) -> tuple[Float[ndarray, "..."], Int[ndarray, "..."]]:
    """Vertices and faces of a .ply, .stl or .glb file, by trimesh. ``path`` is only named in errors."""
    import trimesh

    kind, stream = suffix[1:], io.BytesIO(content)  # without a path nothing beside the file is ever opened
    if suffix == ".glb":
        _check_glb(path, content)
    binary = len(content) >= 84 and len(content) == 84 + 50 * int.from_bytes(content[80:84], "little")
    if suffix == ".stl" and not binary:
        kind, stream = "stl_ascii", io.BytesIO(content.decode("utf-8", "replace").encode())
        if not stream.getvalue().lstrip().startswith(b"solid"):
            raise InputError(path, "mesh", "a file that does not parse", "a whole .stl file, binary or text")
    try:
        loaded = trimesh.load(stream, file_type=kind, force="mesh", process=False, skip_materials=True)
    except Exception as error:  # trimesh's readers raise whatever their parsers meet
        raise InputError(path, "mesh", f"a file that does not parse ({error})", f"a whole {suffix} file") from error
    vertices, faces = getattr(loaded, "vertices", ()), getattr(loaded, "faces", ())
    return np.asarray(vertices, dtype=float), np.asarray(faces, dtype=np.int64)


_PLY_FACES = re.compile(rb"^element face (\d{1,18})\s*$", re.MULTILINE)


def _ply_faces(content: bytes) -> int:
    """How many faces the header of a .ply file promises."""
    found = _PLY_FACES.search(content[: content.find(b"end_header")])
    return int(found[1]) if found else 0


def _check_glb(path: Path, content: bytes) -> None:
    """Refuse a .glb whose vertices or faces are not stored plainly (trimesh reads zeros), or too often repeated."""
    try:
        if content[:4] != b"glTF" or content[16:20] != b"JSON":
            raise ValueError("no glTF header")
        tree = json.loads(content[20 : 20 + int.from_bytes(content[12:16], "little")])
        compressed = [name for name in tree.get("extensionsRequired", []) if "compress" in name]
        corners = []
        for mesh in tree.get("meshes", []):
            used = [(part["attributes"]["POSITION"], part.get("indices")) for part in mesh["primitives"]]
            arrays = [[tree["accessors"][n] for n in pair if n is not None] for pair in used]
            stored = all("bufferView" in array for pair in arrays for array in pair)
            compressed += [] if stored else ["arrays without data"]
            corners.append(sum(pair[-1]["count"] for pair in arrays))
        total = sum(corners[node["mesh"]] for node in tree.get("nodes", []) if "mesh" in node)
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(path, "mesh", f"a file that does not parse ({error})", "a whole .glb file") from error
    if compressed:
        raise InputError(path, "mesh", files.plain(str(compressed[0])), "a .glb exported without compression")
    if total > LARGEST_FILE // 12:
        raise InputError(path, "nodes", f"{total} corners of faces in all", f"at most {LARGEST_FILE // 12}")


def checked_mesh(path: Path, vertices: Float[ndarray, "..."], faces: Int[ndarray, "..."]) -> Mesh:
    """The mesh, vertices merged and wound outward, or an ``InputError`` that says what is wrong with it."""
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
    used, remapped = np.unique(merged(vertices)[faces], return_inverse=True)  # formats like .stl repeat vertices
    vertices, faces = vertices[used], remapped.reshape(faces.shape)
    extent = float(np.ptp(vertices, axis=0).max())
    check_size(path, "vertices", extent, "the object")
    corners = vertices[faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    bad = np.flatnonzero(area < 1e-12 * extent**2)
    if bad.size:
        raise InputError(path, "faces", f"{bad.size} faces without area (first: {bad[0]})", "triangles with an area")
    mesh = Mesh(vertices, faces)
    return Mesh(mesh.vertices, mesh.faces[:, ::-1].copy()) if mesh.is_closed and mesh.volume < 0 else mesh


def with_area(vertices: Float[ndarray, "..."], faces: Int[ndarray, "..."]) -> Int[ndarray, "..."]:
    """The faces that have an area: scans and CADs hold some that have none, which show nothing.

    All are returned where they are no triangles of these vertices: ``checked_mesh`` says what is wrong with them.
    """
    if vertices.ndim != 2 or faces.ndim != 2 or not faces.size or faces.min() < 0 or faces.max() >= len(vertices):
        return faces
    with np.errstate(invalid="ignore", over="ignore"):
        a, b, c = np.moveaxis(vertices[faces[:, :3]], 1, 0)
        doubled = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        return faces[doubled > 1e-11 * np.ptp(vertices, axis=0).max(initial=0.0) ** 2]


def merged(vertices: Float[ndarray, "V 3"]) -> Int[ndarray, "V"]:
    """For each vertex the index of the first vertex at the same place."""
    _, first, inverse = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    return np.asarray(first[inverse.ravel()], dtype=np.int64)


def check_size(path: Path, key: str, extent: float, what: str) -> None:
    """Raise ``InputError`` when a hand or an object is absurdly large or small."""
    if extent > LARGEST:
        raise InputError(path, key, f"{what} {extent:.4g} m large", f"at most {LARGEST:g} m; are these millimetres?")
    if extent < SMALLEST:
        raise InputError(path, key, f"{what} {extent:.4g} m large", f"at least {SMALLEST:g} m; is the unit the metre?")


def write_mesh(mesh: Mesh, path: str | Path) -> Path:
    """Write a mesh as .obj, .ply, .stl or .glb, and return its path. Raises ``UsageError`` for other suffixes."""
    import trimesh

    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise UsageError(f"{path}: got the suffix {path.suffix!r}, expected one of {', '.join(SUFFIXES)}")
    stream = io.BytesIO()
    trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(stream, file_type=path.suffix[1:].lower())
    files.write_bytes(path, stream.getvalue())
    return path


def decimate(mesh: Mesh, faces: int) -> Mesh:
    """A mesh of about ``faces`` faces with nearly the same shape (quadric edge collapse), or the mesh itself."""
    if len(mesh.faces) <= faces:
        return mesh
    import fast_simplification

    v, f = fast_simplification.simplify(
        mesh.vertices.astype(np.float32), mesh.faces.astype(np.int32), target_count=faces
    )
    return Mesh(np.asarray(v, dtype=float), np.asarray(f, dtype=np.int64))
