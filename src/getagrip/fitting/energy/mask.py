"""E_mask (Eq. 6): pixels in which the rendered and the observed object mask differ, where nothing hides them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.compiling import kernel
from getagrip.fitting.energy.term import PosesInCamera, Quadratic
from getagrip.fitting.observation import DISTANCE_FIELD_SIZE_PX, MASK_CROP_SIZE_PX, Observation
from getagrip.geometry.mesh import Mesh
from getagrip.kernels.contour import accumulate, match_boundary, sample_contour, sample_field
from getagrip.kernels.silhouette import N_COUNTER_BITS, mismatch, project, rasterise, silhouette_edges

MAX_CONTOUR_POINTS = 1500
"""Contour points kept per image; far more than any 256-pixel contour gives at the steps in use."""


@dataclass(frozen=True)
class SilhouetteMesh:
    """A mesh as the silhouette kernels read it: coordinates about its centre, one array per component."""

    vertices: Float[ndarray, "3 V"]
    planes: Float[ndarray, "4 F"]
    edges: ndarray
    closed: bool

    @property
    def tables(self) -> tuple[ndarray, ndarray, ndarray, bool]:
        """The fields, as the kernels take them."""
        return self.vertices, self.planes, self.edges, self.closed

    @staticmethod
    def of(mesh: Mesh, centre: Float[ndarray, "3"]) -> SilhouetteMesh:
        """Build the tables of a mesh about a given centre."""
        planes = mesh.planes.copy()
        planes[:, 3] += planes[:, :3] @ centre
        return SilhouetteMesh(
            vertices=np.ascontiguousarray((mesh.vertices - centre).T),
            planes=np.ascontiguousarray(planes.T),
            edges=np.ascontiguousarray(mesh.edges.T),
            closed=mesh.is_closed,
        )


@dataclass(frozen=True)
class MaskTerm:
    """E_mask of N frames at one resolution."""

    mesh: SilhouetteMesh
    observation: Observation
    level: int = MASK_CROP_SIZE_PX
    """Side of the rendered masks [px]: 64, 128 or 256."""
    step: float = 2.0
    """Distance between contour points [px of the level]."""
    delta: float = 1.0
    """Distances below this count as this in the curvature [px of the crop]."""
    coverage: float = 0.0
    """Weight of the pull from observed boundary points to the rendered contour; it finds thin objects."""
    name: str = "mask"

    def __call__(self, poses: PosesInCamera, bound: Float[ndarray, "B"]) -> Quadratic:
        found, o = Quadratic.zero(poses), self.observation
        _evaluate_mask(
            poses.R, poses.centre, poses.scale, *self.mesh.tables, o.K, o.observed[self.level], o.valid[self.level],
            o.field, o.targets, self.step, self.delta, self.coverage, bound, found.value, found.g, found.H,
        )  # fmt: skip
        return found


@kernel("f4 f3 f1 f2 f2 i2 b f2 u3 u3 s3 f3 f f f f1 f2 f3 f4")
def _evaluate_mask(
    R, centre, scale, vertices, planes, edges, closed, K, observed, valid, field, targets, step, delta, coverage, bound,
    value, g, H,
):  # fmt: skip
    """Fill in value (B, N), g (B, N, 7), H (B, N, 7, 7)."""
    B, N = value.shape
    size, words = observed.shape[1], observed.shape[2]
    zoom = size / MASK_CROP_SIZE_PX
    E = edges.shape[1] + 1
    uvz = np.empty((N, 3, vertices.shape[1]))
    sign = np.empty(planes.shape[1] + 1, np.int64)
    edge = np.empty((N, 3, E), np.int64)
    n_edges = np.empty(N, np.int64)
    lines = np.empty((12, E))
    counters = np.empty((size, words, N_COUNTER_BITS), np.uint64)
    bits = np.empty((N, size, words), np.uint64)
    points = np.empty((7, MAX_CONTOUR_POINTS))
    matched = np.empty((7, targets.shape[1]))
    pixel = 1.0 / (zoom * zoom)
    gate = 4.0 * (20.0 / zoom) ** 2
    for b in range(B):
        total = 0.0
        for n in range(N):
            if not project(vertices, R[b, n], centre[b, n], scale[b], K[n], uvz[n]):
                value[b, n] = np.inf
                total = np.inf
                break
            n_edges[n] = silhouette_edges(planes, edges, R[b, n], centre[b, n], scale[b], sign, edge[n])
            rasterise(uvz[n], edge[n], n_edges[n], closed, zoom, lines, counters, bits[n])
            value[b, n] = pixel * mismatch(bits[n], observed[n], valid[n])
            total += value[b, n]
            if total > bound[b]:  # the step is rejected, whatever the other frames say
                break
        if total > bound[b] or total == np.inf:
            continue
        for n in range(N):
            count = sample_contour(uvz[n], edge[n], n_edges[n], zoom, step, bits[n], valid[n], lines, points)
            sample_field(points, count, field[n], DISTANCE_FIELD_SIZE_PX / MASK_CROP_SIZE_PX, step / zoom, delta)
            if coverage > 0.0:
                match_boundary(points, count, targets[n], gate, coverage, delta, matched)
            for some, many in ((points, count), (matched, targets.shape[1] if coverage > 0.0 else 0)):
                accumulate(some, many, centre[b, n], K[n], g[b, n], H[b, n])
            for i in range(1, 7):
                for j in range(i):
                    H[b, n, i, j] = H[b, n, j, i]
