"""E_mask (Eq. 6) by the object's pose and by its shape: derivatives as in ``mask``, and by a warp of the mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.compiling import kernel
from getagrip.fitting.energy.mask import (
    DISTANCE_FIELD_SIZE_PX,
    MASK_CROP_SIZE_PX,
    MAX_CONTOUR_POINTS,
    Observation,
    SilhouetteMesh,
)
from getagrip.fitting.energy.term import PosesInCamera
from getagrip.geometry.kernels.silhouette import (
    N_COUNTER_BITS,
    NX,
    NY,
    ROW_DISTANCE,
    ROW_WEIGHT,
    U,
    V,
    Z,
    mismatch,
    project,
    rasterise,
    sample_contour,
    sample_field,
    silhouette_edges,
)
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.profile import Profile
from getagrip.geometry.warp import Warp

N_SHAPE_PARAMETERS = 27
"""Numbers of a warp: the displacement along each axis by each of 9 monomials (``Warp.by``)."""
N_UNWARP_STEPS = 4
"""Steps of the search for the point of the mesh that a warp displaces to a point of the contour."""


@dataclass(frozen=True)
class MaskByShape:
    """E_mask of N frames at one resolution, of B hypotheses with a shape each."""

    mesh: Mesh
    """The mesh that is warped."""
    centre: Float[ndarray, "3"]
    """The mesh's point that poses place, and about which the mesh is warped."""
    radius: float
    observation: Observation
    level: int
    """Side of the rendered masks [px]: 64, 128 or 256."""
    step: float
    """Distance between contour points [px of the level]."""
    delta: float
    """Distances below this count as this in the curvature [px of the crop]."""
    profile: Profile | None = None
    """The body of revolution whose radii are part of the shape; None: none are."""

    @property
    def radii(self) -> int:
        """The number of radii of the shape."""
        return 0 if self.profile is None else len(self.profile.before)

    def warp(self, shape: Float[ndarray, "9 3"], widths: Float[ndarray, "k"]) -> Warp:
        """Return the warp of a shape; ``widths`` are logarithms of the factors on the radii."""
        profile = None if self.profile is None else self.profile.widened(np.exp(widths))
        return Warp.by(self.centre, self.radius, shape, profile)

    def __call__(
        self, poses: PosesInCamera, shape: Float[ndarray, "B 9 3"], widths: Float[ndarray, "B k"]
    ) -> tuple[Float[ndarray, "B N"], Float[ndarray, "B N P"], Float[ndarray, "B N P P"]]:
        """Value, gradient and Hessian by each frame's local 7-vector, then by the warp's 27 numbers and the widths."""
        B, N = poses.centre.shape[:2]
        o = self.observation
        P = 7 + N_SHAPE_PARAMETERS + self.radii
        value, g, H = np.zeros((B, N)), np.zeros((B, N, P)), np.zeros((B, N, P, P))
        for b in range(B):
            warp = self.warp(shape[b], widths[b])
            warped = SilhouetteMesh.of(warp(self.mesh), self.centre)
            _evaluate_mask_by_shape(
                poses.R[b], poses.centre[b], poses.scale[b], *warped.tables, shape[b], *self._body(warp.profile),
                self.radius, o.K, o.observed[self.level], o.valid[self.level], o.field, self.step, self.delta,
                value[b], g[b], H[b],
            )  # fmt: skip
        return value, g, H

    def _body(self, profile: Profile | None) -> tuple[Float[ndarray, "4"], Float[ndarray, "k"]]:
        """Return axis, lowest height and step of heights; and radii: about the centre, in units of ``radius``."""
        if profile is None:
            return np.zeros(4), np.zeros(0)
        low, high = (profile.ends - self.centre[2]) / self.radius
        axis = (profile.axis - self.centre[:2]) / self.radius
        return np.array([*axis, low, (high - low) / (self.radii - 1)]), profile.after / self.radius


@kernel("f3 f2 f f2 f2 i2 b f2 f1 f1 f f2 u3 u3 s3 f f f1 f2 f3")
def _evaluate_mask_by_shape(
    R, centre, scale, vertices, planes, edges, closed, shape, body, radii, radius, K, observed, valid, field, step,
    delta, value, g, H,
):  # fmt: skip
    """Fill in value (N,), g (N, P), H (N, P, P) of one hypothesis."""
    P = g.shape[1]
    size, words = observed.shape[1], observed.shape[2]
    zoom = size / MASK_CROP_SIZE_PX
    E = edges.shape[1] + 1
    uvz = np.empty((3, vertices.shape[1]))
    sign = np.empty(planes.shape[1] + 1, np.int64)
    edge = np.empty((3, E), np.int64)
    lines = np.empty((12, E))
    counters = np.empty((size, words, N_COUNTER_BITS), np.uint64)
    bits = np.empty((size, words), np.uint64)
    points = np.empty((7, MAX_CONTOUR_POINTS))
    x, monomial, a = np.empty(3), np.empty(9), np.zeros(P)
    for n in range(len(value)):
        if not project(vertices, R[n], centre[n], scale, K[n], uvz):
            value[n] = np.inf
            continue
        edges_here = silhouette_edges(planes, edges, R[n], centre[n], scale, sign, edge)
        rasterise(uvz, edge, edges_here, closed, zoom, lines, counters, bits)
        value[n] = mismatch(bits, observed[n], valid[n]) / (zoom * zoom)
        count = sample_contour(uvz, edge, edges_here, zoom, step, bits, valid[n], lines, points)
        sample_field(points, count, field[n], DISTANCE_FIELD_SIZE_PX / MASK_CROP_SIZE_PX, step / zoom, delta)
        fx, fy, cx, cy = K[n, 0], K[n, 1], K[n, 2], K[n, 3]
        for k in range(count):
            u, v, z, nx, ny = points[U, k] - cx, points[V, k] - cy, points[Z, k], points[NX, k], points[NY, k]
            h, d = points[ROW_WEIGHT, k], points[ROW_DISTANCE, k]
            a[0], a[1], a[2] = nx * fx / z, ny * fy / z, -(nx * u + ny * v) / z
            r0, r1, r2 = u * z / fx - centre[n, 0], v * z / fy - centre[n, 1], z - centre[n, 2]
            a[3], a[4], a[5] = r1 * a[2] - r2 * a[1], r2 * a[0] - r0 * a[2], r0 * a[1] - r1 * a[0]
            a[6] = r0 * a[0] + r1 * a[1] + r2 * a[2]
            for i in range(3):
                x[i] = (R[n, 0, i] * r0 + R[n, 1, i] * r1 + R[n, 2, i] * r2) / (scale * radius)
            _unwarp_monomials(x, shape, monomial)
            for i in range(3):
                along = scale * radius * (R[n, 0, i] * a[0] + R[n, 1, i] * a[1] + R[n, 2, i] * a[2])
                x[i] = along
                for m in range(9):
                    a[7 + 3 * m + i] = along * monomial[m]
            if len(radii):
                _fill_by_widths(x, shape, monomial, body, radii, a)
            for i in range(P):
                g[n, i] += h * d * a[i]
                for j in range(P):
                    H[n, i, j] += h * a[i] * a[j]


@kernel()
def _fill_by_widths(along, shape, y, body, radii, a):
    """Fill in the derivatives by the widths: logarithms of the radii.

    ``along`` (3,) are the derivatives by the contour point after the warp, ``y`` holds the monomials at its place
    before the warp, where the radii have been changed.
    """
    s = np.zeros(9)
    for m in range(9):
        for i in range(3):
            s[m] += along[i] * shape[m, i]
    by_x = along[0] + s[0] + 2.0 * y[0] * s[3] + y[1] * s[4] + y[2] * s[5]
    by_y = along[1] + s[1] + y[0] * s[4] + 2.0 * y[1] * s[6] + y[2] * s[7]
    place = min(max((y[2] - body[2]) / body[3], 0.0), len(radii) - 1.0)
    k = min(int(place), len(radii) - 2)
    share = place - k
    out_x, out_y = y[0] - body[0], y[1] - body[1]
    r = max(np.sqrt(out_x * out_x + out_y * out_y), 1e-12)
    outward = (out_x * by_x + out_y * by_y) / max(r, (1.0 - share) * radii[k] + share * radii[k + 1])
    for j in range(len(radii)):
        a[7 + N_SHAPE_PARAMETERS + j] = 0.0
    a[7 + N_SHAPE_PARAMETERS + k] = outward * (1.0 - share) * radii[k]
    a[8 + N_SHAPE_PARAMETERS + k] = outward * share * radii[k + 1]


@kernel()
def _unwarp_monomials(x, shape, monomial):
    """Compute the monomials, but 1, at the place that the shape (9, 3) displaces to x."""
    y0, y1, y2 = x[0], x[1], x[2]
    for step in range(N_UNWARP_STEPS + 1):
        monomial[0], monomial[1], monomial[2] = y0, y1, y2
        monomial[3], monomial[4], monomial[5] = y0 * y0, y0 * y1, y0 * y2
        monomial[6], monomial[7], monomial[8] = y1 * y1, y1 * y2, y2 * y2
        if step < N_UNWARP_STEPS:
            y0, y1, y2 = x[0], x[1], x[2]
            for m in range(9):
                y0 -= monomial[m] * shape[m, 0]
                y1 -= monomial[m] * shape[m, 1]
                y2 -= monomial[m] * shape[m, 2]
