"""Silhouettes of a mesh that has another shape in every frame, a hand's, against masks, and their contour points.

The kernels of ``silhouette`` and ``contour`` do the work. Here the mesh comes as vertices in the camera frame, and each
contour point says which vertex it goes with.
"""

from __future__ import annotations

import numpy as np

from getagrip.compiling import kernel
from getagrip.kernels.contour import ROW_WEIGHT, U, V, Z, sample_contour, sample_field
from getagrip.kernels.silhouette import N_COUNTER_BITS, mismatch, project, rasterise, silhouette_edges


@kernel("f3 i2 i2 b f2 u3 u3 s3 f f u3 f1 f3 i2")
def contours(vertices, faces, edges, closed, K, observed, valid, field, step, delta, bits, value, points, nearest):
    """Fill in the silhouettes' bits, values, contour points and their nearest vertices, per frame.

    bits are (N, n, words); value (N,) counts the valid pixels that differ from the mask; points are (N, 7, M)
    (``kernels.contour``; weight 0 where there are no more); nearest (N, M) is the vertex nearest to each point.

    vertices (N, 3, V) are in the camera frame, faces (F, 3) and edges (4, E) those of the mesh, field (N, n, n) is the
    signed distance to the mask's contour, all at one resolution. Too near to the camera, a hand has infinite value.
    """
    uvz = np.empty((3, vertices.shape[2]))
    planes = np.zeros((4, len(faces)))
    sign = np.empty(len(faces) + 1, np.int64)
    edge = np.empty((3, edges.shape[1] + 1), np.int64)
    lines = np.empty((12, edges.shape[1] + 1))
    counters = np.empty((observed.shape[1], observed.shape[2], N_COUNTER_BITS), np.uint64)
    here, origin, least = np.zeros((3, 3)), np.zeros(3), np.empty(nearest.shape[1])
    here[0, 0] = here[1, 1] = here[2, 2] = 1.0
    for n in range(len(vertices)):
        X, fx, fy = vertices[n], K[n, 0], K[n, 1]
        for k in range(len(least)):
            nearest[n, k], least[k] = 0, np.inf
            for row in range(7):
                points[n, row, k] = 0.0
        if not project(X, here, origin, 1.0, K[n], uvz):
            for i in range(bits.shape[1]):
                for word in range(bits.shape[2]):
                    bits[n, i, word] = np.uint64(0)
            value[n] = np.inf
            continue
        for f in range(len(faces)):  # for a camera at the origin, the sign of the triple product is the face's side
            a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
            bx, by, bz = X[0, b] - X[0, a], X[1, b] - X[1, a], X[2, b] - X[2, a]
            cx, cy, cz = X[0, c] - X[0, a], X[1, c] - X[1, a], X[2, c] - X[2, a]
            planes[3, f] = -(
                X[0, a] * (by * cz - bz * cy) + X[1, a] * (bz * cx - bx * cz) + X[2, a] * (bx * cy - by * cx)
            )
        count = silhouette_edges(planes, edges, here, origin, 1.0, sign, edge)
        rasterise(uvz, edge, count, closed, 1.0, lines, counters, bits[n])
        value[n] = mismatch(bits[n], observed[n], valid[n])
        found = sample_contour(uvz, edge, count, 1.0, step, bits[n], valid[n], lines, points[n])
        sample_field(points[n], found, field[n], 1.0, step, delta)
        for k in range(found, len(least)):
            points[n, ROW_WEIGHT, k] = 0.0
        for i in range(uvz.shape[1]):  # points inside: they go side by side
            x, y, depth = uvz[0, i], uvz[1, i], uvz[2, i]
            for k in range(found):
                z = points[n, Z, k]
                du, dv, dz = (x - points[n, U, k]) * z / fx, (y - points[n, V, k]) * z / fy, depth - z
                d = du * du + dv * dv + dz * dz
                nearer = d < least[k]
                nearest[n, k] = i if nearer else nearest[n, k]
                least[k] = d if nearer else least[k]
