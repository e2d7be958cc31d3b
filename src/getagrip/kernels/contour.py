"""The contour of a silhouette: where it pulls, how strongly, and how a pose moves it.

Points are sampled along the silhouette edges, with an outward normal; those whose outside neighbour is uncovered lie on
the contour. The boundary integral over them is the exact gradient of E_mask, and their signed distance d to the
observed mask gives its curvature: weight h = step / max(|d|, delta), gradient sum(h d a), Hessian sum(h a a^T), a
being the derivative of the point along its normal by the local 7-vector (``se3``). For |d| > delta the gradient is that
of E_mask, and one step is a majorise-minimise step on it. ``reference.sample_contour`` and
``reference.normal_equations`` are the readable specifications.
"""

from __future__ import annotations

import numpy as np

from getagrip.compiling import kernel
from getagrip.kernels.silhouette import fma

U, V, Z, NX, NY, ROW_DISTANCE, ROW_WEIGHT = range(7)
"""Rows of a table of contour points: position [px of the full crop], depth [m], outward normal, distance, weight."""

_UINT64_ONE = np.uint64(1)


@kernel()
def sample_contour(uvz, edges, n_edges, zoom, step, bits, valid, lines, points):
    """Sample the visible contour every ``step`` pixels of the level into points (7, M); return how many.

    ``zoom`` is level pixels per pixel of the full crop. Points in ignored pixels are dropped. lines (12, E) is scratch.
    """
    most = points.shape[1]
    for k in range(n_edges):
        a, b = np.uint64(edges[0, k]), np.uint64(edges[1, k])
        x0, y0 = uvz[0, a] * zoom, uvz[1, a] * zoom
        dx, dy = uvz[0, b] * zoom - x0, uvz[1, b] * zoom - y0
        length = np.sqrt(dx * dx + dy * dy)
        inverse = 1.0 / length
        flip = 1.0 if edges[2, k] > 0 else -1.0
        w0 = 1.0 / uvz[2, a]
        lines[0, k], lines[1, k], lines[2, k], lines[3, k], lines[4, k] = x0, y0, dx, dy, length
        lines[5, k], lines[6, k], lines[7, k] = inverse, -flip * dy * inverse, flip * dx * inverse
        lines[8, k], lines[9, k] = w0, 1.0 / uvz[2, b] - w0
        lines[10, k], lines[11, k] = 0.75 * lines[6, k], 0.75 * lines[7, k]
    n, k, rest = 0, 0, 0.5 * step
    while k < n_edges and n < most:  # a step along an edge or on to the next, without branches: none is predictable
        length = lines[4, k]
        t = rest * lines[5, k]
        x, y = fma(t, lines[2, k], lines[0, k]), fma(t, lines[3, k], lines[1, k])
        ox, oy = x + lines[10, k], y + lines[11, k]
        points[U, n], points[V, n] = x / zoom, y / zoom
        points[Z, n] = 1.0 / fma(t, lines[9, k], lines[8, k])
        points[NX, n], points[NY, n] = lines[6, k], lines[7, k]
        on_edge = rest < length
        n += on_edge & _is_set(valid, x, y) & (not _is_set(bits, ox, oy))
        rest = rest + step if on_edge else rest - length
        k += not on_edge
    return n


@kernel()
def _is_set(bits, x, y):
    """Return whether (x, y) lies in a pixel of a square mask whose bit is set."""
    size = float(bits.shape[0])
    inside = (x >= 0.0) & (x < size) & (y >= 0.0) & (y < size)
    i, j = np.uint64(min(max(0.0, y), size - 1.0)), np.uint64(min(max(0.0, x), size - 1.0))  # 0 where it is no number
    return inside & ((bits[i, j >> np.uint64(6)] >> (j & np.uint64(63))) & _UINT64_ONE == _UINT64_ONE)


@kernel()
def sample_field(points, n, field, zoom, spacing, delta):
    """Fill in distance (bilinear in the signed distance field, ``zoom`` field pixels a pixel) and weight."""
    last = field.shape[0] - 1.000001
    for k in range(n):
        x = min(max(points[U, k] * zoom - 0.5, 0.0), last)
        y = min(max(points[V, k] * zoom - 0.5, 0.0), last)
        i, j = int(y), int(x)
        s, t = x - j, y - i
        top = field[i, j] + s * (field[i, j + 1] - field[i, j])
        bottom = field[i + 1, j] + s * (field[i + 1, j + 1] - field[i + 1, j])
        d = top + t * (bottom - top)
        points[ROW_DISTANCE, k] = d
        points[ROW_WEIGHT, k] = spacing / max(abs(d), delta)


@kernel()
def match_boundary(points, n, targets, gate, strength, delta, matched):
    """Pull the nearest contour point with a similar normal to each observed boundary point (the coverage term).

    targets (Q, 5) holds position, outward normal and boundary length. Writes one point per target into matched (7, Q),
    its residual along its own normal as the distance; weight 0 where nothing is near. Returns the term's value, the
    sum of length times distance, distances capped at the square root of the gate.
    """
    Q = len(targets)
    lanes = (Q + 7) // 8 * 8
    aims, least, at = np.zeros((4, lanes)), np.empty(lanes), np.empty(lanes, np.int64)
    for q in range(lanes):
        least[q], at[q] = gate, -1
    for q in range(Q):
        for row in range(4):
            aims[row, q] = targets[q, row]
    for k in range(n):  # targets inside: they go side by side, eight at once
        u, v, mx, my = points[U, k], points[V, k], points[NX, k], points[NY, k]
        for q in range(lanes):
            dx, dy = u - aims[0, q], v - aims[1, q]
            alike = aims[2, q] * mx + aims[3, q] * my
            cost = dx * dx + dy * dy + gate * (1.0 - alike)
            nearer = cost < least[q]
            at[q] = k if nearer else at[q]
            least[q] = cost if nearer else least[q]
    value = 0.0
    for q in range(Q):
        for row in range(7):
            matched[row, q] = 1.0 if row == Z else 0.0
        length = targets[q, 4]
        value += strength * length * np.sqrt(least[q])
        if at[q] >= 0:
            k = at[q]
            for row in range(5):
                matched[row, q] = points[row, k]
            d = (points[U, k] - targets[q, 0]) * points[NX, k] + (points[V, k] - targets[q, 1]) * points[NY, k]
            matched[ROW_DISTANCE, q] = d
            matched[ROW_WEIGHT, q] = strength * length / max(abs(d), delta)
    return value


@kernel()
def accumulate(points, n, centre, K, g, H):
    """Add n points to the normal equations: g (7,) += sum h d a, upper half of H (7, 7) += sum h a a^T."""
    fx, fy, cx, cy = K[0], K[1], K[2], K[3]
    c0, c1, c2 = centre[0], centre[1], centre[2]
    g0 = g1 = g2 = g3 = g4 = g5 = g6 = 0.0
    h00 = h01 = h02 = h03 = h04 = h05 = h06 = h11 = h12 = h13 = h14 = h15 = h16 = 0.0
    h22 = h23 = h24 = h25 = h26 = h33 = h34 = h35 = h36 = h44 = h45 = h46 = h55 = h56 = h66 = 0.0
    for k in range(n):
        u, v, z, nx, ny = points[U, k] - cx, points[V, k] - cy, points[Z, k], points[NX, k], points[NY, k]
        h = points[ROW_WEIGHT, k]
        hd = h * points[ROW_DISTANCE, k]
        inverse = 1.0 / z
        a0, a1, a2 = nx * fx * inverse, ny * fy * inverse, -(nx * u + ny * v) * inverse
        r0, r1, r2 = u * z / fx - c0, v * z / fy - c1, z - c2
        a3, a4, a5 = r1 * a2 - r2 * a1, r2 * a0 - r0 * a2, r0 * a1 - r1 * a0
        a6 = r0 * a0 + r1 * a1 + r2 * a2
        g0 += hd * a0
        g1 += hd * a1
        g2 += hd * a2
        g3 += hd * a3
        g4 += hd * a4
        g5 += hd * a5
        g6 += hd * a6
        b0, b1, b2, b3, b4, b5, b6 = h * a0, h * a1, h * a2, h * a3, h * a4, h * a5, h * a6
        h00 += b0 * a0
        h01 += b0 * a1
        h02 += b0 * a2
        h03 += b0 * a3
        h04 += b0 * a4
        h05 += b0 * a5
        h06 += b0 * a6
        h11 += b1 * a1
        h12 += b1 * a2
        h13 += b1 * a3
        h14 += b1 * a4
        h15 += b1 * a5
        h16 += b1 * a6
        h22 += b2 * a2
        h23 += b2 * a3
        h24 += b2 * a4
        h25 += b2 * a5
        h26 += b2 * a6
        h33 += b3 * a3
        h34 += b3 * a4
        h35 += b3 * a5
        h36 += b3 * a6
        h44 += b4 * a4
        h45 += b4 * a5
        h46 += b4 * a6
        h55 += b5 * a5
        h56 += b5 * a6
        h66 += b6 * a6
    for i, x in enumerate((g0, g1, g2, g3, g4, g5, g6)):
        g[i] += x
    for i, x in enumerate((h00, h01, h02, h03, h04, h05, h06)):
        H[0, i] += x
    for i, x in enumerate((h11, h12, h13, h14, h15, h16)):
        H[1, i + 1] += x
    for i, x in enumerate((h22, h23, h24, h25, h26)):
        H[2, i + 2] += x
    for i, x in enumerate((h33, h34, h35, h36)):
        H[3, i + 3] += x
    for i, x in enumerate((h44, h45, h46)):
        H[4, i + 4] += x
    for i, x in enumerate((h55, h56)):
        H[5, i + 5] += x
    H[6, 6] += h66
