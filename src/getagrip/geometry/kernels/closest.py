"""Fast signed distance to a rigid mesh: a coarse grid stores a near face per node, and the distance to it is exact.

Fingers are never far from the object, so a grid of about 10^5 nodes around it suffices. Interpolated distances would
round off walls thinner than the grid's cells (a mug's, a plate's); the exact distance to the nearest of the faces
stored at the nodes around a point does not. The sign is that of the pseudonormal of the nearest face, edge or corner
(Baerentzen and Aanaes, "Signed Distance Computation Using the Angle Weighted Pseudonormal", 2005): by the faces' own
normals, points far off a thin edge, a spoon's, would lie deep inside. ``signed_distance`` in tests/helpers/kernels.py
is the readable specification.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from getagrip.compiling import kernel
from getagrip.geometry.mesh import same_rows

GRID_SLACK_SPACINGS = 0.867
"""Maximum distance of a point in the grid from its nearest node, in spacings."""


@dataclass(frozen=True)
class FaceGrid:
    """A regular grid with the nearest face at each node; mesh and grid in the same frame.

    Attributes:
        corners: (F, 3, 3) corners of each face [m].
        normals: (F, 7, 3) unit pseudonormals, outward: at the corners a, b, c of each face, its edges ab, bc, ca, and
            itself.
        face: (X, Y, Z) the nearest face of each node.
        distance: (X, Y, Z) the signed distance of each node [m].
        origin: (3,) the first node [m].
        spacing: distance of neighbouring nodes [m].
    """

    corners: np.ndarray
    normals: np.ndarray
    face: np.ndarray
    distance: np.ndarray
    origin: np.ndarray
    spacing: float

    @property
    def tables(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, float]:
        """The fields in the kernels' order."""
        return self.corners, self.normals, self.face, self.distance, self.origin, self.spacing

    @staticmethod
    def of(corners: np.ndarray, margin: float, nodes: int = 64) -> FaceGrid:
        """Build the grid around faces (F, 3, 3), with a ``margin`` [m], and ``nodes`` along its longest side."""
        corners = np.ascontiguousarray(corners)
        low, high = corners.min(axis=(0, 1)) - margin, corners.max(axis=(0, 1)) + margin
        spacing = float((high - low).max() / (nodes - 1))
        shape = np.ceil((high - low) / spacing).astype(int) + 1
        face, part = np.full(tuple(shape), -1, np.int32), np.zeros(tuple(shape), np.int8)
        squared, point = np.full(face.shape, np.inf), np.zeros((*face.shape, 3))
        _seed(corners, low, spacing, face, part, squared, point)
        _spread(low, spacing, face, part, squared, point)
        normals = pseudonormals(corners)
        nodes_at = low + np.moveaxis(np.indices(face.shape), 0, -1) * spacing
        inside = np.sum(normals[face, part] * (nodes_at - point), axis=-1) < 0.0
        distance = np.where(inside, -1.0, 1.0) * np.sqrt(squared)
        return FaceGrid(corners, normals, face, distance, low, spacing)


def pseudonormals(corners: np.ndarray) -> np.ndarray:
    """Compute unit normals (F, 7, 3) at the corners, edges and inside of faces (F, 3, 3).

    Normals of shared corners and edges are averages of the faces', weighted by angle.
    """
    F = len(corners)
    vertex = same_rows(corners.reshape(-1, 3)).reshape(F, 3)
    along = np.roll(corners, -1, axis=1) - corners
    normal = np.cross(along[:, 0], along[:, 1])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    unit = along / np.maximum(np.linalg.norm(along, axis=2, keepdims=True), 1e-300)
    angle = np.arccos(np.clip(-np.sum(unit * np.roll(unit, 1, axis=1), axis=2), -1.0, 1.0))
    edge = same_rows(np.sort(np.stack([vertex, np.roll(vertex, -1, axis=1)], axis=-1).reshape(-1, 2)))
    out = np.empty((F, 7, 3))
    out[:, 6] = normal
    for at, ids, weight in ((slice(0, 3), vertex, angle), (slice(3, 6), edge.reshape(F, 3), np.ones((F, 3)))):
        total = np.zeros((ids.max() + 1, 3))
        np.add.at(total, ids, weight[..., None] * normal[:, None])
        out[:, at] = (total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300))[ids]
    return out


@kernel()
def closest_on_face(x, y, z, t, f):
    """Find the point of face f of corners t (F, 3, 3) nearest to a point.

    The last value is the part of the face that contains it (``FaceGrid.normals``). After Ericson, Real-Time Collision
    Detection, 5.1.5.
    """
    ax, ay, az = t[f, 0, 0], t[f, 0, 1], t[f, 0, 2]
    abx, aby, abz = t[f, 1, 0] - ax, t[f, 1, 1] - ay, t[f, 1, 2] - az
    acx, acy, acz = t[f, 2, 0] - ax, t[f, 2, 1] - ay, t[f, 2, 2] - az
    apx, apy, apz = x - ax, y - ay, z - az
    d1, d2 = abx * apx + aby * apy + abz * apz, acx * apx + acy * apy + acz * apz
    if d1 <= 0.0 and d2 <= 0.0:
        return ax, ay, az, 0
    bpx, bpy, bpz = x - t[f, 1, 0], y - t[f, 1, 1], z - t[f, 1, 2]
    d3, d4 = abx * bpx + aby * bpy + abz * bpz, acx * bpx + acy * bpy + acz * bpz
    if d3 >= 0.0 and d4 <= d3:
        return t[f, 1, 0], t[f, 1, 1], t[f, 1, 2], 1
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / (d1 - d3)
        return ax + v * abx, ay + v * aby, az + v * abz, 3
    cpx, cpy, cpz = x - t[f, 2, 0], y - t[f, 2, 1], z - t[f, 2, 2]
    d5, d6 = abx * cpx + aby * cpy + abz * cpz, acx * cpx + acy * cpy + acz * cpz
    if d6 >= 0.0 and d5 <= d6:
        return t[f, 2, 0], t[f, 2, 1], t[f, 2, 2], 2
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / (d2 - d6)
        return ax + w * acx, ay + w * acy, az + w * acz, 5
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 >= d3 and d5 >= d6:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return (
            t[f, 1, 0] + w * (t[f, 2, 0] - t[f, 1, 0]),
            t[f, 1, 1] + w * (t[f, 2, 1] - t[f, 1, 1]),
            t[f, 1, 2] + w * (t[f, 2, 2] - t[f, 1, 2]),
            4,
        )
    inverse = 1.0 / (va + vb + vc)
    v, w = vb * inverse, vc * inverse
    return ax + v * abx + w * acx, ay + v * aby + w * acy, az + v * abz + w * acz, 6


@kernel("f3 f1 f n3 t3 f3 f4")
def _seed(corners, low, spacing, face, part, squared, point):
    """Compute the exact nearest points of the nodes next to each face."""
    begin, end = np.empty(3, np.int64), np.empty(3, np.int64)
    for f in range(len(corners)):
        for k in range(3):
            a, b, c = corners[f, 0, k], corners[f, 1, k], corners[f, 2, k]
            least, most = min(min(a, b), c), max(max(a, b), c)
            begin[k] = max(0, int(np.floor((least - low[k]) / spacing)))
            end[k] = min(face.shape[k], int(np.ceil((most - low[k]) / spacing)) + 1)
        for i in range(begin[0], end[0]):
            x = low[0] + i * spacing
            for j in range(begin[1], end[1]):
                y = low[1] + j * spacing
                for k in range(begin[2], end[2]):
                    z = low[2] + k * spacing
                    px, py, pz, on = closest_on_face(x, y, z, corners, f)
                    d = (x - px) ** 2 + (y - py) ** 2 + (z - pz) ** 2
                    if d < squared[i, j, k]:
                        squared[i, j, k], face[i, j, k], part[i, j, k] = d, f, on
                        point[i, j, k, 0], point[i, j, k, 1], point[i, j, k, 2] = px, py, pz


@kernel("f1 f n3 t3 f3 f4")
def _spread(low, spacing, face, part, squared, point):
    """Propagate nearest points from node to node, in eight sweeps."""
    nx, ny, nz = face.shape
    for sweep in range(8):
        di, dj, dk = 1 - 2 * (sweep & 1), 1 - (sweep & 2), 1 - (sweep & 4) // 2
        for i_th in range(nx):
            i = i_th if di > 0 else nx - 1 - i_th
            x = low[0] + i * spacing
            for j_th in range(ny):
                j = j_th if dj > 0 else ny - 1 - j_th
                y = low[1] + j * spacing
                for k_th in range(nz):
                    k = k_th if dk > 0 else nz - 1 - k_th
                    z = low[2] + k * spacing
                    for axis in range(3):
                        a, b, c = i - di * (axis == 0), j - dj * (axis == 1), k - dk * (axis == 2)
                        if not (0 <= a < nx and 0 <= b < ny and 0 <= c < nz) or face[a, b, c] < 0:
                            continue
                        d = (x - point[a, b, c, 0]) ** 2 + (y - point[a, b, c, 1]) ** 2 + (z - point[a, b, c, 2]) ** 2
                        if d < squared[i, j, k]:
                            squared[i, j, k], face[i, j, k], part[i, j, k] = d, face[a, b, c], part[a, b, c]
                            for m in range(3):
                                point[i, j, k, m] = point[a, b, c, m]


@kernel()
def screen(points, R, centre, scale, distance, origin, spacing, local, rough):
    """Move points (Q, 3) into the frame of a posed object, and look up the nearest node's distance.

    Fills local (Q, 3) [m, of the unscaled object], rough (Q,) [m, likewise]: infinite beyond the grid. The exact
    distance differs from the rough one by at most ``SLACK * spacing``: for most points the rough one is enough.
    """
    inverse = 1.0 / scale
    nx, ny, nz = distance.shape
    for q in range(len(points)):
        x, y, z = points[q, 0] - centre[0], points[q, 1] - centre[1], points[q, 2] - centre[2]
        a = (R[0, 0] * x + R[1, 0] * y + R[2, 0] * z) * inverse
        b = (R[0, 1] * x + R[1, 1] * y + R[2, 1] * z) * inverse
        c = (R[0, 2] * x + R[1, 2] * y + R[2, 2] * z) * inverse
        local[q, 0], local[q, 1], local[q, 2] = a, b, c
        i, j, k = (a - origin[0]) / spacing + 0.5, (b - origin[1]) / spacing + 0.5, (c - origin[2]) / spacing + 0.5
        inside = 0.0 <= i < nx and 0.0 <= j < ny and 0.0 <= k < nz
        rough[q] = distance[int(i), int(j), int(k)] if inside else np.inf


@kernel()
def signed_distance(x, y, z, corners, normals, face, origin, spacing):
    """Compute the signed distance to the mesh and its gradient: (d, n0, n1, n2), d < 0 inside, n of unit length.

    d is to the nearest of the faces stored at the eight nodes around the point, which must lie in the grid.
    """
    i = min(max(int((x - origin[0]) / spacing), 0), face.shape[0] - 2)
    j = min(max(int((y - origin[1]) / spacing), 0), face.shape[1] - 2)
    k = min(max(int((z - origin[2]) / spacing), 0), face.shape[2] - 2)
    none = np.int64(-1)
    least, nearest, part, seen, seen_before = np.inf, none, 0, none, none
    dx, dy, dz = 0.0, 0.0, 0.0
    for node in range(8):
        f = np.int64(face[i + (node & 1), j + (node >> 1 & 1), k + (node >> 2)])
        if f in (nearest, seen, seen_before):
            continue
        seen, seen_before = f, seen
        px, py, pz, on = closest_on_face(x, y, z, corners, f)
        ex, ey, ez = x - px, y - py, z - pz
        squared = ex * ex + ey * ey + ez * ez
        if squared < least:
            least, nearest, part, dx, dy, dz = squared, f, on, ex, ey, ez
    d = np.sqrt(least)
    n0, n1, n2 = normals[nearest, part, 0], normals[nearest, part, 1], normals[nearest, part, 2]
    sign = 1.0 if n0 * dx + n1 * dy + n2 * dz >= 0.0 else -1.0
    if d > 1e-6:
        n0, n1, n2 = sign * dx / d, sign * dy / d, sign * dz / d
    return sign * d, n0, n1, n2
