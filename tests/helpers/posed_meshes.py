"""Closed, open, compound and broken meshes, random poses of them, and what the kernels make of both."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from numpy import ndarray

from getagrip.fitting.energy.mask import SilhouetteMesh
from getagrip.geometry import se3
from getagrip.geometry.kernels import silhouette
from getagrip.geometry.kernels.silhouette import N_COUNTER_BITS
from getagrip.geometry.mesh import Mesh
from getagrip.synthetic import objects
from helpers.clips import box
from helpers.kernels import callable_part

project, rasterise, silhouette_edges = (
    callable_part(part) for part in (silhouette.project, silhouette.rasterise, silhouette.silhouette_edges)
)

SEEDS = st.integers(0, 2**32 - 1)
"""Random numbers come from numpy, not from hypothesis, which loves the round ones: pixel centres exactly on an edge."""


def soup(seed: int) -> Mesh:
    """Triangles that share vertices but no sense: edges of one to several faces, wound any way."""
    rng = np.random.default_rng(seed)
    faces = np.array([rng.permutation(12)[:3] for _ in range(10)])
    return Mesh(rng.uniform(-0.05, 0.05, (12, 3)), faces)


def sheet() -> Mesh:
    """An open, curved sheet."""
    x, y = np.meshgrid(np.linspace(-0.05, 0.05, 6), np.linspace(-0.04, 0.04, 5))
    at = np.arange(30).reshape(5, 6)
    a, b, c, d = (at[i : i + 4, j : j + 5].ravel() for i in (0, 1) for j in (0, 1))
    vertices = np.stack([x, y, 5.0 * x**2], axis=-1).reshape(-1, 3)
    return Mesh(vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)]))


def two_boxes() -> Mesh:
    """Two closed parts that cut through each other, the second wound inward."""
    a, b = box(0.09, 0.05, 0.03), box(0.03, 0.08, 0.06)
    return Mesh(np.concatenate([a.vertices, b.vertices + 0.01]), np.concatenate([a.faces, b.faces[:, ::-1] + 8]))


MESHES = {
    "box": box(0.1, 0.06, 0.04),
    "mug": objects.mug(),
    "two boxes": two_boxes(),
    "sheet": sheet(),
    "soup": soup(3),
}
WHICH = st.sampled_from(sorted(MESHES))
SIZE = 64


def pose(seed: int, away: float = 0.4) -> tuple[ndarray, ndarray, float, ndarray]:
    """R, centre, scale, K: something of the size of a hand in a picture of 64 pixels, at times partly outside."""
    rng = np.random.default_rng(seed)
    R = se3.exp_so3(rng.normal(size=3) * 2.0)
    centre = np.array([*rng.uniform(-0.08, 0.08, 2), away + rng.uniform(-0.1, 0.1)])
    K = np.array([170.0, 175.0, 31.0, 33.0]) + rng.uniform(-2.0, 2.0, 4)
    return R, centre, float(rng.uniform(0.7, 1.4)), K


def tables(mesh: Mesh) -> SilhouetteMesh:
    return SilhouetteMesh.of(mesh, np.zeros(3))


def outlined(mesh: Mesh, seed: int) -> tuple[ndarray, ndarray, ndarray]:
    """Projected vertices (3, V), outline edges (3, n), and the mask as bits, by the kernels."""
    R, centre, scale, K = pose(seed)
    t = tables(mesh)
    uvz, edge = np.empty_like(t.vertices), np.empty((3, t.edges.shape[1] + 1), np.int64)
    project(t.vertices, R, centre, scale, K, uvz)
    n = silhouette_edges(t.planes, t.edges, R, centre, scale, np.empty(len(mesh.faces) + 1, np.int64), edge)
    bits = np.empty((SIZE, 1), np.uint64)
    lines, planes = np.empty((5, len(edge[0]))), np.empty((SIZE, 1, N_COUNTER_BITS), np.uint64)
    rasterise(uvz, edge, n, t.closed, 1.0, lines, planes, bits)
    return uvz, edge[:, :n], bits


def blobs(seed: int, size: int = SIZE) -> tuple[ndarray, ndarray]:
    """A mask of overlapping discs, and pixels that count: all but a disc."""
    rng = np.random.default_rng(seed)
    i, j = np.indices((size, size)) + 0.5

    def disc() -> ndarray:
        y, x = rng.uniform(0.2, 0.8, 2) * size
        return np.asarray((i - y) ** 2 + (j - x) ** 2 < (rng.uniform(0.08, 0.25) * size) ** 2)

    seen = disc() | disc()
    return seen, ~disc() | seen
