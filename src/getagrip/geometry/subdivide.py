"""A mesh with more vertices on the same surface: long edges are halved until none is left."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.geometry.mesh import Mesh

N_SUBDIVIDED_VERTICES = 4500
"""Vertices, about, of a mesh on which contact is counted by vertices."""
MAX_SUBDIVISION_PASSES = 24
"""Most rounds of halving: edges of any size are short after them."""


def subdivide_parts(parts: Sequence[Mesh], vertices: int = N_SUBDIVIDED_VERTICES) -> tuple[Mesh, Int[ndarray, "V"]]:
    """Join the parts of an object to one mesh without long edges, and return the part (0, 1, ...) of each vertex.

    It has about ``vertices`` vertices, or more where the parts have more.
    """
    longest = edge_length(sum(float(part.vertex_areas.sum()) for part in parts), vertices)
    made = [subdivide_surface(part.vertices, part.faces, longest) for part in parts]
    counts = [len(points) for points, _ in made]
    first = np.cumsum([0, *counts[:-1]])
    faces = np.concatenate([faces + start for (_, faces), start in zip(made, first, strict=True)])
    return Mesh(np.concatenate([points for points, _ in made]), faces), np.repeat(np.arange(len(parts)), counts)


def edge_length(area: float, vertices: int) -> float:
    """Return the ``longest`` edge [m] with which ``subdivide_surface`` makes about ``vertices`` vertices of a surface [m^2].

    A mesh has two triangles for each vertex; one of three edges e covers sqrt(3) / 4 e^2. Halving leaves edges about
    half as long as the longest: some were just too long.
    """
    return float(2.0 * np.sqrt(area / (2.0 * vertices) / (np.sqrt(3.0) / 4.0)))


def subdivide_surface(
    vertices: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"], longest: float
) -> tuple[Float[ndarray, "W 3"], Int[ndarray, "G 3"]]:
    """Subdivide a surface until no edge is above ``longest`` [m]; old vertices stay, new ones follow them.

    Each round halves the edges that are too long. A triangle with one of them becomes two, with two three, with three
    four. Neighbours share the new vertices, so a closed mesh stays closed.
    """
    for _ in range(MAX_SUBDIVISION_PASSES):
        edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]], axis=-1).reshape(-1, 2)
        unique, of = np.unique(edges, axis=0, return_inverse=True)
        ends = vertices[unique]
        long = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1) > longest
        if not long.any():
            break
        middle = np.where(long, len(vertices) + np.cumsum(long) - 1, -1)
        faces = _split_faces(faces, middle[of.reshape(-1, 3)])
        vertices = np.concatenate([vertices, ends[long].mean(axis=1)])
    return vertices, faces


def _split_faces(faces: Int[ndarray, "F 3"], middle: Int[ndarray, "F 3"]) -> Int[ndarray, "G 3"]:
    """Triangles, and the new vertices in the middle of their edges 01, 12 and 20 (-1: none), as smaller triangles."""
    halved = middle >= 0
    count = halved.sum(axis=1)
    # Corners are rolled so that one halved edge is the first, and of two the whole edge is the last.
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
