"""Closed triangle meshes made of rings: lofts, tubes that grow out of them, and tori.

A **loft** is a stack of rings; its last ring may lie inside the first (a vessel goes up outside and comes down inside).
A **tube** (handle, spout) leaves where 2 x 2 quads of the loft are taken out, so that the surface stays one closed
manifold: a mug has genus 1. All faces point outward, all lengths are metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.geometry.mesh import Mesh

_N_SECTION_POINTS = 8
"""Points of a tube's section: the corners and edge middles of the 2 x 2 quads that it replaces."""


@dataclass(frozen=True)
class Tube:
    """A bent bar with elliptical sections that starts, and perhaps ends, on a loft."""

    path: Float[ndarray, "P 3"]
    """Centre line [m]; its first point (and its last, unless ``capped``) picks the nearest vertex of the loft."""
    side: Float[ndarray, "3"]
    """Unit direction of the sections' width, normal to the path."""
    width: Float[ndarray, "P"]
    """Half widths, along ``side`` [m]."""
    height: Float[ndarray, "P"]
    """Half heights, across ``side`` [m]."""
    capped: bool = False
    """True if the tube ends in the air."""

    def sections(self, n: int = _N_SECTION_POINTS) -> Float[ndarray, "P n 3"]:
        """Return one ring per point of the path, counter-clockwise about the direction of travel."""
        tangent = np.gradient(self.path, axis=0)
        across = np.cross(tangent, self.side)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        phi = (np.arange(n) * 2.0 * np.pi / n)[:, None]
        u, v = self.width[:, None, None] * self.side, (self.height[:, None] * across)[:, None]
        return np.asarray(self.path[:, None] + np.cos(phi) * u + np.sin(phi) * v)


def loft(rings: Float[ndarray, "R N 3"], tubes: Sequence[Tube] = ()) -> Mesh:
    """Build a closed mesh from rings, each counter-clockwise about the direction to the next, with tubes on it.

    The first and the last ring are capped by a fan about their mean.
    """
    R, N, _ = rings.shape
    grid = np.arange(R * N).reshape(R, N)
    taken = np.zeros((R, N), dtype=bool)  # quad (i, j) lies between rings i, i + 1 and columns j, j + 1
    parts = [rings.reshape(-1, 3), rings[0].mean(axis=0)[None], rings[-1].mean(axis=0)[None]]
    faces = [_fan_triangles(R * N, grid[0][::-1]), _fan_triangles(R * N + 1, grid[-1])]
    for tube in tubes:
        offset = sum(len(part) for part in parts)
        ends = [_cut_hole(rings, taken, tube.path[0])] + (
            [] if tube.capped else [_cut_hole(rings, taken, tube.path[-1])]
        )
        inner = tube.sections()[1 : len(tube.path) if tube.capped else -1]
        start = _align_loop(rings.reshape(-1, 3), ends[0], inner[0])
        parts.append(inner.reshape(-1, 3))
        ids = np.concatenate([start[None], offset + np.arange(inner.size // 3).reshape(-1, _N_SECTION_POINTS)])
        if tube.capped:
            parts.append(inner[-1].mean(axis=0)[None])
            faces.append(_fan_triangles(offset + inner.size // 3, ids[-1]))
        else:  # seen along the tube, the hole where it ends runs the other way round
            ids = np.concatenate([ids, _align_loop(rings.reshape(-1, 3), ends[1][::-1], inner[-1])[None]])
        faces.append(walls(ids, np.zeros(ids.shape, dtype=bool)))
    faces.append(walls(grid, taken))
    vertices, triangles = np.concatenate(parts), np.concatenate(faces)
    used, triangles = np.unique(triangles, return_inverse=True)
    return Mesh(vertices[used], triangles.reshape(-1, 3).astype(np.int64))


def torus(path: Float[ndarray, "P 3"], side: Float[ndarray, "3"], radius: float) -> Mesh:
    """Make a closed ring of round section about a closed path (counter-clockwise about ``side``)."""
    tangent = np.roll(path, -1, axis=0) - np.roll(path, 1, axis=0)
    across = np.cross(tangent, side)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    phi = (np.arange(_N_SECTION_POINTS) * 2.0 * np.pi / _N_SECTION_POINTS)[:, None]
    rings = path[:, None] + radius * (np.cos(phi) * side + np.sin(phi) * across[:, None])
    ids = np.arange(rings.size // 3).reshape(-1, _N_SECTION_POINTS)
    faces = walls(np.concatenate([ids, ids[:1]]))
    return Mesh(rings.reshape(-1, 3), faces)


def merge_closed_meshes(meshes: Sequence[Mesh]) -> Mesh:
    """Join several closed parts to one mesh; they may overlap."""
    offsets = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    faces = [m.faces + offset for m, offset in zip(meshes, offsets[:-1], strict=True)]
    return Mesh(np.concatenate([m.vertices for m in meshes]), np.concatenate(faces))


def walls(ids: Int[ndarray, "R N"], taken: Bool[ndarray, "R N"] | None = None) -> Int[ndarray, "F 3"]:
    """Make two triangles per quad between successive rings of vertex ids, but for the quads taken out."""
    taken = np.zeros(ids.shape, dtype=bool) if taken is None else taken
    a, b = ids[:-1], np.roll(ids, -1, axis=1)[:-1]
    c, d = np.roll(ids, -1, axis=1)[1:], ids[1:]
    keep = ~taken[:-1].ravel()
    lower, upper = np.stack([a, b, c], -1).reshape(-1, 3)[keep], np.stack([a, c, d], -1).reshape(-1, 3)[keep]
    return np.concatenate([lower, upper])


def _fan_triangles(pole: int, ring: Int[ndarray, "N"]) -> Int[ndarray, "N 3"]:
    """Triangles between a vertex and a ring that is counter-clockwise seen from outside."""
    return np.stack([np.full(len(ring), pole), ring, np.roll(ring, -1)], axis=-1)


def _cut_hole(rings: Float[ndarray, "R N 3"], taken: ndarray, at: Float[ndarray, "3"]) -> Int[ndarray, "8"]:
    """Take the four quads around the vertex nearest to ``at`` out; their boundary, counter-clockwise from outside."""
    N = rings.shape[1]
    i, j = divmod(int(np.argmin(np.linalg.norm(rings[1:-1] - at, axis=-1))), N)
    i += 1
    for di in (-1, 0):
        for dj in (-1, 0):
            taken[i + di, (j + dj) % N] = True
    around = [(-1, -1), (-1, 0), (-1, 1), (0, 1), (1, 1), (1, 0), (1, -1), (0, -1)]
    return np.array([(i + di) * N + (j + dj) % N for di, dj in around])


def _align_loop(
    vertices: Float[ndarray, "V 3"], loop: Int[ndarray, "8"], ring: Float[ndarray, "8 3"]
) -> Int[ndarray, "8"]:
    """Rotate the loop so that it meets the ring with the least twist."""
    rolls = [np.roll(loop, k) for k in range(len(loop))]
    return min(rolls, key=lambda ids: float(np.linalg.norm(vertices[ids] - ring, axis=1).sum()))
