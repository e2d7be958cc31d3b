"""Triangle meshes: normals, sizes, edge tables for silhouettes, separate parts, simplification and subdivision."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Float, Int, Shaped, UInt8
from numpy import ndarray

from getagrip.io.array_data import ArrayData, check_finite, check_ids

MAX_MESH_FACES = 100_000
"""Maximum number of faces for fitting, metrics and rendering; 100 000 are millimetre-sized on a can."""
DISTANCE_CHUNK_SIZE = 50_000
"""Number of distances computed at once."""
MAX_DECIMATION_RATIO = 2
"""Ratio of resulting to requested faces above which edge collapse has failed."""
DECIMATION_AGGRESSIVENESS = (3.0, 7.0)
"""Aggressiveness of edge collapse, tried in turn. At the library's default 7 thin parts vanish: a notebook of 28 cm was
7 mm off on average, and 0.2 mm at 3. Rough meshes of a million faces need 7."""
MAX_MESH_PARTS = 500
"""Number of parts above which a mesh counts as a single part."""
PART_GAP_FRACTIONS = (0.02, 0.001)
"""Distance between parts below which they are one, for two closed parts and for others, as a fraction of the mesh's
size."""
N_SUBDIVIDED_VERTICES = 4500
"""Approximate number of vertices of a mesh whose contact is counted by vertices."""
MAX_SUBDIVISION_PASSES = 24
"""Maximum number of halvings: enough for edges of any length."""


@dataclass(frozen=True, eq=False)
class Mesh(ArrayData):
    """A triangle mesh.

    Attributes:
        vertices: (V, 3) vertices in the mesh's own frame [m].
        faces: (F, 3) vertex ids of the corners of each face, counter-clockwise seen from outside.
        colours: (V, 3) red, green and blue of each vertex, 0 to 255; None if unknown. Poses do not depend on them.
    """

    vertices: Float[ndarray, "V 3"]
    faces: Int[ndarray, "F 3"]
    colours: UInt8[ndarray, "V 3"] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_finite("Mesh.vertices", self.vertices)
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
        """Rows (v0, v1, f1, f2): face f1 runs from v0 to v1, face f2 from v1 to v0; f2 = F at a boundary.

        Each half-edge is in exactly one row. Edges of three or more faces, or of faces wound the same way, give several
        rows, so that any triangle soup is covered (see ``geometry.kernels.silhouette``).
        """
        return edge_table(self.faces)

    @cached_property
    def is_closed(self) -> bool:
        """True if every half-edge has its opposite."""
        return bool(np.all(self.edges[:, 3] < len(self.faces)))

    @cached_property
    def vertex_areas(self) -> Float[ndarray, "V"]:
        """A third of the area of the faces around each vertex [m2]."""
        areas = face_areas(self.vertices, self.faces)
        return np.bincount(self.faces.ravel(), np.repeat(areas / 3.0, 3), minlength=len(self.vertices))

    @cached_property
    def light(self) -> Mesh:
        """The mesh itself, or simplified to about ``MAX_MESH_FACES`` faces if it has more."""
        return cluster_vertices(self, MAX_MESH_FACES)

    def stands_for(self, whole: Mesh, done: str) -> list[str]:
        """Return a note if this mesh was fitted or measured (``done``) instead of the ``whole`` one; else nothing."""
        faces = len(whole.faces), len(self.faces)
        return [] if self is whole else [f"the mesh of {faces[0]} faces was {done} with {faces[1]}"]

    def coloured_like(self, points: Float[ndarray, "n 3"], colours: UInt8[ndarray, "n 3"]) -> Mesh:
        """Return the mesh with the colour of the nearest of some points at each vertex."""
        from scipy.spatial import cKDTree

        return Mesh(self.vertices, self.faces, colours[cKDTree(points).query(self.vertices)[1]])

    @cached_property
    def volume(self) -> float:
        """Signed volume [m3]; positive for a closed mesh wound outward."""
        a, b, c = np.moveaxis(self.vertices[self.faces], 1, 0)
        return float(np.sum(a * np.cross(b, c)) / 6.0)


def face_areas(vertices: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"]) -> Float[ndarray, "F"]:
    """Compute the area of each face [m2]."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return np.asarray(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))


def vertex_normals(vertices: Float[ndarray, "*batch V 3"], faces: Int[ndarray, "F 3"]) -> Float[ndarray, "*batch V 3"]:
    """Compute unit vertex normals, faces weighted by their angle at the vertex; zero for vertices without faces."""
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
    """Pair the half-edges of a mesh (``Mesh.edges``). Tables of very large meshes are not cached."""
    if len(faces) > MAX_MESH_FACES:
        return _pair_half_edges(faces)
    return _cached_edge_table(np.ascontiguousarray(faces, dtype=np.int64).tobytes()).copy()


@lru_cache(maxsize=8)  # a hand, its closed surface and some objects, posed repeatedly
def _cached_edge_table(content: bytes) -> Int[ndarray, "E 4"]:
    return _pair_half_edges(np.frombuffer(content, np.int64).reshape(-1, 3))


def _pair_half_edges(faces: Int[ndarray, "F 3"]) -> Int[ndarray, "E 4"]:
    """Compute ``edge_table``. Half-edge h starts at corner h % 3 of face h // 3."""
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    key = np.minimum(start, end).astype(np.int64)
    key *= 2 * (int(faces.max()) + 1)
    key += 2 * np.maximum(start, end) + (start < end)  # the last bit: forward
    order = np.argsort(key, kind="stable")
    key = key[order]
    forward = (key & 1).astype(np.int8)
    # The k-th forward half-edge of an edge is paired with its k-th backward one.
    first = np.concatenate([[True], key[1:] != key[:-1]])
    rank = np.arange(len(key))
    rank -= np.maximum.accumulate(np.where(first, rank, 0))
    key >>= 1
    first[1:] = key[1:] != key[:-1]
    begins = np.flatnonzero(first)
    del key  # memory, with a million faces
    pairs = np.maximum.reduceat(rank, begins) + 1
    rank += np.repeat(np.cumsum(pairs) - pairs, np.diff(begins, append=len(rank)))
    halves = np.full((pairs.sum(), 2), -1)
    halves[rank, forward] = order
    head = np.where(halves[:, 1] >= 0, halves[:, 1], halves[:, 0])
    f2 = np.where(halves.min(axis=1) >= 0, halves[:, 0] // 3, len(faces))
    return np.stack([start[head], end[head], head // 3, f2], axis=1)


def diameter(points: Float[ndarray, "V 3"]) -> float:
    """Compute the largest distance between two points [m], with memory linear in their number.

    If the direction of q - p is within an angle a of the unit vector u, then (q - p) . u >= |q - p| cos(a): p and q are
    near the extreme points along u. Triangles that cover half of all directions are divided until few such points are
    left, and dropped if no pair of theirs can exceed the best distance so far.
    """
    points = np.unique(points, axis=0)
    rounding = 1e-12 * np.abs(points).max()
    best = 0.0
    triangles = [(np.diag([x, y, 1.0]), points, points) for x in (1.0, -1.0) for y in (1.0, -1.0)]
    while triangles:
        corners, low, high = triangles.pop()
        u = corners.sum(axis=0) / np.linalg.norm(corners.sum(axis=0))
        cosine = np.min(corners @ u / np.linalg.norm(corners, axis=1))
        down, up = low @ u, high @ u
        best = max(best, float(np.linalg.norm(low[down.argmin()] - high[up.argmax()])))
        least = best * cosine - rounding
        low, high = low[down <= up.max() - least], high[up >= down.min() + least]
        if len(low) * len(high) <= DISTANCE_CHUNK_SIZE or best * (1.0 - cosine) <= rounding:
            for some in np.array_split(low, 1 + len(low) * len(high) // DISTANCE_CHUNK_SIZE):
                best = max(best, float(np.sqrt(squared_distances(some, high).max(initial=0.0))))
        else:
            quarters = [*(0.5 * (corners + corner) for corner in corners), 0.5 * (corners.sum(axis=0) - corners)]
            triangles += [(quarter, low, high) for quarter in quarters]
    return float(best)


def squared_distances(a: Float[ndarray, "n 3"], b: Float[ndarray, "m 3"]) -> Float[ndarray, "n m"]:
    """Compute the squared distances between all points of two sets [m^2].

    scipy.spatial would do, but loading it takes longer than reading a clip.
    """
    x, y, z = (np.subtract.outer(a[:, i], b[:, i]) for i in range(3))
    return np.asarray(x * x + y * y + z * z)


def merge_vertices(vertices: Float[ndarray, "V 3"]) -> Int[ndarray, "V"]:
    """Return the index of the first vertex at each vertex's position."""
    place = same_rows(vertices)
    _, first = np.unique(place, return_index=True)
    return np.asarray(first[place], dtype=np.int64)


def separate_parts(vertices: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"]) -> list[Int[ndarray, "n"]]:
    """Return the face indices of each separate part of a mesh, the largest part first.

    Components with touching bounding boxes are one part, such as a mug and its handle; so are closed ones that nearly
    touch (``PART_GAP_FRACTIONS``). With ``MAX_MESH_PARTS`` components or more, all are one part.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    if not len(faces):
        return []
    ids = merge_vertices(vertices)[faces]
    ends = np.concatenate([ids[:, [0, 1]], ids[:, [1, 2]]])
    joined = coo_matrix((np.ones(len(ends)), ends.T), shape=(len(vertices),) * 2)
    _, of_face = np.unique(connected_components(joined, directed=False)[1][ids[:, 0]], return_inverse=True)
    if of_face.max() >= MAX_MESH_PARTS:
        return [np.arange(len(faces))]
    parts = [np.flatnonzero(of_face == k) for k in range(of_face.max() + 1)]
    boxes = np.array([[f(vertices[faces[part].ravel()], axis=0) for f in (np.min, np.max)] for part in parts])
    closed = np.array([_is_closed_manifold(ids[part]) for part in parts])
    room = np.where(
        closed[:, None] & closed, *np.ptp(vertices[faces.ravel()], axis=0).max() * np.array(PART_GAP_FRACTIONS)
    )
    gap = np.maximum(boxes[:, None, 0] - boxes[None, :, 1], boxes[None, :, 0] - boxes[:, None, 1]).max(axis=-1)
    _, group = connected_components(coo_matrix(gap <= room), directed=False)
    together = [np.concatenate([parts[k] for k in np.flatnonzero(group == g)]) for g in range(group.max() + 1)]
    return sorted(together, key=lambda part: -float(np.ptp(vertices[faces[part].ravel()], axis=0).max()))


def _is_closed_manifold(faces: Int[ndarray, "F 3"]) -> bool:
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return bool((np.unique(edges, axis=0, return_counts=True)[1] == 2).all())


def cluster_vertices(mesh: Mesh, faces: int) -> Mesh:
    """Simplify a very large mesh to about ``faces`` faces by vertex clustering, which is fast.

    Vertices in the same cell of a grid become their mean, and faces with two corners in one cell vanish: no vertex
    moves farther than a cell, on smooth surfaces much less. A closed mesh stays closed. Colours are those of a vertex
    in the cell. A mesh with no more than ``faces`` faces and vertices (a triangle soup has three per face) is returned
    unchanged.
    """
    if len(mesh.faces) <= faces and len(mesh.vertices) <= faces:
        return mesh
    cell = np.sqrt(2.0 * mesh.vertex_areas.sum() / faces)
    group = same_rows(np.floor(mesh.vertices / cell))
    sums = [np.bincount(group, axis) for axis in mesh.vertices.T]
    means = np.stack(sums, axis=1) / np.bincount(group)[:, None]
    a, b, c = corners = group[mesh.faces].T
    used, kept = np.unique(corners.T[(a != b) & (b != c) & (c != a)], return_inverse=True)
    if not len(used):
        return mesh
    colours = None if mesh.colours is None else mesh.colours[np.unique(group, return_index=True)[1][used]]
    return Mesh(means[used], kept.reshape(-1, 3), colours)


def decimate(mesh: Mesh, faces: int) -> Mesh:
    """Simplify a mesh to about ``faces`` faces by quadric edge collapse; triangle soups by ``cluster_vertices``.

    Each vertex has the colour of the nearest one of the whole mesh.
    """
    if len(mesh.faces) <= faces:
        return mesh
    import fast_simplification

    few = mesh
    for haste in DECIMATION_AGGRESSIVENESS:
        v, f = fast_simplification.simplify(
            few.vertices.astype(np.float32), few.faces.astype(np.int32), target_count=faces, agg=haste
        )
        few = Mesh(np.asarray(v, dtype=float), np.asarray(f, dtype=np.int64))
        if len(f) <= MAX_DECIMATION_RATIO * faces:
            break
    else:
        few = cluster_vertices(few, faces)
    return few if mesh.colours is None else few.coloured_like(mesh.vertices, mesh.colours)


def same_rows(rows: Shaped[ndarray, "N K"]) -> Int[ndarray, "N"]:
    """Return each row's number, with distinct rows numbered 0, 1, ... in lexicographic order."""
    order = np.lexsort(rows.T[::-1])
    in_order = rows[order]
    new = np.any(in_order[1:] != in_order[:-1], axis=1)
    number = np.zeros(len(rows), dtype=np.int64)
    number[order[1:]] = np.cumsum(new)
    return number


def subdivide_parts(parts: Sequence[Mesh], vertices: int = N_SUBDIVIDED_VERTICES) -> tuple[Mesh, Int[ndarray, "V"]]:
    """Join the parts of an object to one mesh without long edges, and return the part (0, 1, ...) of each vertex.

    The mesh has about ``vertices`` vertices, or more if the parts have more.
    """
    longest = edge_length(sum(float(part.vertex_areas.sum()) for part in parts), vertices)
    made = [subdivide_surface(part.vertices, part.faces, longest) for part in parts]
    counts = [len(points) for points, _ in made]
    first = np.cumsum([0, *counts[:-1]])
    faces = np.concatenate([faces + start for (_, faces), start in zip(made, first, strict=True)])
    return Mesh(np.concatenate([points for points, _ in made]), faces), np.repeat(np.arange(len(parts)), counts)


def edge_length(area: float, vertices: int) -> float:
    """Return the ``longest`` edge [m] for which ``subdivide_surface`` gives an area [m2] about ``vertices`` vertices.

    A mesh has two triangles per vertex; one with three edges e covers sqrt(3) / 4 e^2. After halving, edges are about
    half the longest on average, since some were just too long.
    """
    return float(2.0 * np.sqrt(area / (2.0 * vertices) / (np.sqrt(3.0) / 4.0)))


def subdivide_surface(
    vertices: Float[ndarray, "V C"], faces: Int[ndarray, "F 3"], longest: float
) -> tuple[Float[ndarray, "W C"], Int[ndarray, "G 3"]]:
    """Subdivide a surface until no edge is above ``longest`` [m]; new vertices follow the old ones.

    Columns of the vertices behind their coordinates, such as those of a texture, are interpolated, too.

    Each pass halves the edges that are too long: a triangle with one, two or three of them becomes two, three or four.
    Neighbours share the new vertices, so a closed mesh stays closed.
    """
    for _ in range(MAX_SUBDIVISION_PASSES):
        edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]], axis=-1).reshape(-1, 2)
        unique, of = np.unique(edges, axis=0, return_inverse=True)
        ends = vertices[unique]
        long = np.linalg.norm((ends[:, 1] - ends[:, 0])[:, :3], axis=-1) > longest
        if not long.any():
            break
        middle = np.where(long, len(vertices) + np.cumsum(long) - 1, -1)
        faces = _split_faces(faces, middle[of.reshape(-1, 3)])
        vertices = np.concatenate([vertices, ends[long].mean(axis=1)])
    return vertices, faces


def _split_faces(faces: Int[ndarray, "F 3"], middle: Int[ndarray, "F 3"]) -> Int[ndarray, "G 3"]:
    """Split triangles at the new vertices in the middle of their edges 01, 12 and 20 (-1: none)."""
    halved = middle >= 0
    count = halved.sum(axis=1)
    # Corners are rolled such that a single halved edge is the first, and of two halved ones the other is the last.
    one, after_whole = np.argmax(halved, axis=1), (np.argmin(halved, axis=1) + 1) % 3
    first = np.choose(count, [0, one, after_whole, 0])
    order = (first[:, None] + np.arange(3)) % 3
    (a, b, c), (ab, bc, ca) = np.take_along_axis(faces, order, 1).T, np.take_along_axis(middle, order, 1).T

    def where(n: int, *triangles: tuple[Int[ndarray, "F"], ...]) -> list[Int[ndarray, "_ 3"]]:
        return [np.stack(triangle, axis=1)[count == n] for triangle in triangles]

    return np.concatenate(
        where(0, (a, b, c))
        + where(1, (a, ab, c), (ab, b, c))
        + where(2, (a, ab, c), (ab, bc, c), (ab, b, bc))
        + where(3, (a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
    )
