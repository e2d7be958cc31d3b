"""Exact silhouettes of triangle meshes as bit masks, their contour points, and the derivatives of these by a pose.

**Masks**, from the silhouette edges alone. A pixel is covered when some face covers it. Summed over faces, coverage is
a signed crossing count of edges: the edge between faces f1 and f2 counts ``sign(f1) - sign(f2)``, where a face's sign
is the side of its plane on which the camera is. Only silhouette edges have a non-zero weight, so only they are
scan-converted: each adds its weight to all pixels right of it, row by row, in four bit planes (a ripple-carry counter
modulo 16 over 64 pixels at a time). The mask is where the counter is not zero: exactly the mask of a triangle
rasteriser while fewer than 16 layers overlap (closed meshes count whole layers, open ones single faces).
``silhouette`` in tests/helpers/kernels.py is the readable specification.

**Contours**. Points are sampled along the silhouette edges, with an outward normal; a point with an uncovered outside
neighbour lies on the contour. The boundary integral over the contour is the exact gradient of E_mask, and the points'
signed distance d to the observed mask gives its curvature: weight h = step / max(|d|, delta), gradient sum(h d a),
Hessian sum(h a a^T), a being the derivative of the point along its normal by the local 7-vector (``se3``). For |d| >
delta the gradient is that of E_mask, and one step is a majorise-minimise step on it. ``sample_contour`` and
``normal_equations`` in tests/helpers/kernels.py are the readable specifications.

**Deforming meshes**, such as a hand: ``contours`` takes vertices in the camera frame for every frame, and returns the
nearest vertex of each contour point.
"""

from __future__ import annotations

import numpy as np
from numba import types
from numba.extending import intrinsic

from getagrip.compiling import kernel

MIN_SILHOUETTE_DEPTH_M = 0.02
"""Distance to the camera plane below which an object is not rendered [m]."""

N_COUNTER_BITS = 4
_ALL_BITS = np.uint64(0xFFFFFFFFFFFFFFFF)
_UINT64_ZERO = np.uint64(0)


@intrinsic
def popcount(typingctx, word):
    """Count the bits set in a 64-bit word."""

    def codegen(context, builder, signature, args):
        return builder.ctpop(args[0])

    return types.uint64(types.uint64), codegen


@intrinsic
def fma(typingctx, a, b, c):
    """Compute ``a b + c``, rounded once: sums keep their order, whatever the compiler does with the loop."""

    def codegen(context, builder, signature, args):
        return builder.fma(*args)

    return types.float64(types.float64, types.float64, types.float64), codegen


@kernel()
def project(vertices, R, centre, scale, K, uvz):
    """Project centred vertices (3, V), posed as ``scale R x + centre``, into uvz (3, V).

    Returns whether the object can be rendered: no vertex is nearer than ``MIN_SILHOUETTE_DEPTH_M``.
    """
    fx, fy, cx, cy = K[0], K[1], K[2], K[3]
    r00, r01, r02 = scale * R[0, 0], scale * R[0, 1], scale * R[0, 2]
    r10, r11, r12 = scale * R[1, 0], scale * R[1, 1], scale * R[1, 2]
    r20, r21, r22 = scale * R[2, 0], scale * R[2, 1], scale * R[2, 2]
    t0, t1, t2 = centre[0], centre[1], centre[2]
    too_near = 0  # loops that write one array each, and a count in place of a minimum: all go side by side
    for i in range(vertices.shape[1]):
        x, y, z = vertices[0, i], vertices[1, i], vertices[2, i]
        depth = fma(r22, z, fma(r21, y, fma(r20, x, t2)))
        uvz[2, i] = depth
        too_near += depth < MIN_SILHOUETTE_DEPTH_M
    for i in range(vertices.shape[1]):
        x, y, z = vertices[0, i], vertices[1, i], vertices[2, i]
        uvz[0, i] = fma(fx * fma(r02, z, fma(r01, y, fma(r00, x, t0))), 1.0 / uvz[2, i], cx)
    for i in range(vertices.shape[1]):
        x, y, z = vertices[0, i], vertices[1, i], vertices[2, i]
        uvz[1, i] = fma(fy * fma(r12, z, fma(r11, y, fma(r10, x, t1))), 1.0 / uvz[2, i], cy)
    return too_near == 0


@kernel()
def silhouette_edges(planes, edges, R, centre, scale, sign, out):
    """Collect the silhouette edges into out (3, E) as (v0, v1, weight); return their number.

    planes (4, F) and edges (4, E) are the mesh's tables, sign (F + 1) is scratch. The weight is even for closed meshes.
    """
    o0 = -(R[0, 0] * centre[0] + R[1, 0] * centre[1] + R[2, 0] * centre[2]) / scale
    o1 = -(R[0, 1] * centre[0] + R[1, 1] * centre[1] + R[2, 1] * centre[2]) / scale
    o2 = -(R[0, 2] * centre[0] + R[1, 2] * centre[1] + R[2, 2] * centre[2]) / scale
    F = planes.shape[1]
    for f in range(F):
        side = planes[0, f] * o0 + planes[1, f] * o1 + planes[2, f] * o2 + planes[3, f]
        sign[f] = 1 if side > 0.0 else -1
    sign[F] = 0
    n = 0
    for e in range(edges.shape[1]):
        out[0, n] = e
        n += sign[np.uint64(edges[2, e])] != sign[np.uint64(edges[3, e])]
    for k in range(n):
        at = np.uint64(out[0, k])
        weight = sign[np.uint64(edges[2, at])] - sign[np.uint64(edges[3, at])]
        out[0, k], out[1, k], out[2, k] = edges[0, at], edges[1, at], weight
    return n


@kernel()
def rasterise(uvz, edges, n_edges, closed, zoom, lines, planes, bits, row0=0, word0=0):  # noqa: PLR0912 - loops
    """Fill the first n silhouette edges (coordinates times zoom) into bits (height, words), 64 pixels a word.

    lines (5, E) and planes (height, words, 4) are scratch. Pixel j of a row is bit j % 64 of word j // 64. The bits may
    be a part of the image, from row row0 and word word0 on, that contains all of the object in the image.
    """
    height, words = bits.shape
    width = np.uint64(64 * words)
    first_row, last_row, first_column = float(row0), float(row0 + height), 64.0 * word0
    n, top, bottom = 0, last_row, first_row
    for k in range(n_edges):  # those that cross the middle of a row, without branches: none is predictable
        a, b, weight = np.uint64(edges[0, k]), np.uint64(edges[1, k]), edges[2, k]
        x0, y0, x1, y1 = uvz[0, a] * zoom, uvz[1, a] * zoom, uvz[0, b] * zoom, uvz[1, b] * zoom
        up = y0 > y1
        upper_x, upper_y = x1 if up else x0, y1 if up else y0
        lower_x, lower_y = x0 if up else x1, y0 if up else y1
        first = max(first_row, np.ceil(upper_y - 0.5))
        last = min(last_row, np.ceil(lower_y - 0.5))
        slope = (lower_x - upper_x) / (lower_y - upper_y)
        lines[0, n], lines[1, n] = first, last
        lines[2, n], lines[3, n] = fma(first + (0.5 - upper_y), slope, upper_x - 0.5), slope
        lines[4, n] = -weight if up else weight
        crosses = first < last
        n += crosses
        top, bottom = min(top, first) if crosses else top, max(bottom, last) if crosses else bottom
    begin, end = int(top) - row0, int(bottom) - row0
    for row in range(height):
        for word in range(words):
            bits[row, word] = _UINT64_ZERO
    for row in range(begin, end):
        for word in range(words):
            for p in range(N_COUNTER_BITS):
                planes[row, word, p] = _UINT64_ZERO
    for k in range(n):
        x, slope, weight = lines[2, k], lines[3, k], lines[4, k]
        times = int(abs(weight)) // 2 if closed else int(abs(weight))
        down = _UINT64_ZERO if weight > 0.0 else _ALL_BITS
        for row in range(np.uint64(lines[0, k] - first_row), np.uint64(lines[1, k] - first_row)):
            column = np.uint64(max(np.ceil(min(x, 1e6)) - first_column, 0.0))
            x += slope
            if column >= width:
                continue
            for _ in range(times):
                suffix = _ALL_BITS << (column & np.uint64(63))
                for word in range(column >> np.uint64(6), np.uint64(words)):
                    carry = suffix
                    for p in range(N_COUNTER_BITS):
                        old = planes[row, word, p]
                        planes[row, word, p] = old ^ carry
                        carry &= old ^ down
                        if carry == _UINT64_ZERO:
                            break
                    suffix = _ALL_BITS
    for row in range(begin, end):
        for word in range(words):
            bits[row, word] = planes[row, word, 0] | planes[row, word, 1] | planes[row, word, 2] | planes[row, word, 3]


@kernel()
def mismatch(bits, observed, valid):
    """Count the valid pixels that differ between two bit masks: E_mask (Eq. 6), at the resolution of the masks."""
    total = np.uint64(0)
    for row in range(bits.shape[0]):
        for word in range(bits.shape[1]):
            total += popcount((bits[row, word] ^ observed[row, word]) & valid[row, word])
    return float(total)


def silhouettes(
    R: np.ndarray,
    centre: np.ndarray,
    scale: np.ndarray,
    vertices: np.ndarray,
    planes: np.ndarray,
    edges: np.ndarray,
    closed: bool,
    K: np.ndarray,
    bits: np.ndarray,
    first: np.ndarray | None = None,
) -> None:
    """Render masks of one object in many poses.

    R (P, 3, 3), centre (P, 3), scale (P,), K (P, 4) -> bits (P, height, W), which may be parts of the images, from the
    rows and words ``first`` (P, 2) on, that contain all of the object in the image.
    """
    first = np.zeros((len(R), 2), dtype=np.int64) if first is None else first
    _render_silhouettes(R, centre, scale, vertices, planes, edges, closed, K, first, bits)


@kernel("f3 f2 f1 f2 f2 i2 b f2 i2 u3")
def _render_silhouettes(R, centre, scale, vertices, planes, edges, closed, K, first, bits):
    uvz = np.empty(vertices.shape)
    sign = np.empty(planes.shape[1] + 1, np.int64)
    edge = np.empty((3, edges.shape[1] + 1), np.int64)
    lines, counters = (
        np.empty((5, edges.shape[1] + 1)),
        np.empty((bits.shape[1], bits.shape[2], N_COUNTER_BITS), np.uint64),
    )
    for p in range(len(R)):
        if project(vertices, R[p], centre[p], scale[p], K[p], uvz):
            n = silhouette_edges(planes, edges, R[p], centre[p], scale[p], sign, edge)
            rasterise(uvz, edge, n, closed, 1.0, lines, counters, bits[p], first[p, 0], first[p, 1])
        else:
            for row in range(bits.shape[1]):
                for word in range(bits.shape[2]):
                    bits[p, row, word] = _UINT64_ZERO


def pack(masks: np.ndarray) -> np.ndarray:
    """Pack boolean masks (..., H, W) as bits (..., H, ceil(W / 64)), 64 pixels a word; missing pixels are zero."""
    missing = -masks.shape[-1] % 64
    padded = np.pad(masks, [(0, 0)] * (masks.ndim - 1) + [(0, missing)])
    return np.ascontiguousarray(np.packbits(padded, axis=-1, bitorder="little")).view(np.uint64)


def unpack(bits: np.ndarray, width: int) -> np.ndarray:
    """Unpack bits (..., H, words) to boolean masks (..., H, width)."""
    return np.unpackbits(bits.view(np.uint8), axis=-1, bitorder="little", count=width).view(bool)


U, V, Z, NX, NY, ROW_DISTANCE, ROW_WEIGHT = range(7)
"""Rows of a table of contour points: position [px of the full crop], depth [m], outward normal, distance, weight."""

_UINT64_ONE = np.uint64(1)


@kernel()
def sample_contour(uvz, edges, n_edges, zoom, step, bits, valid, lines, points):
    """Sample the visible contour every ``step`` pixels of the level into points (7, M); return their number.

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
    its residual along its own normal as the distance; weight 0 without a near contour point. Returns the term's value,
    the sum of length times distance, distances capped at the square root of the gate.
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


@kernel("f3 i2 i2 b f2 u3 u3 s3 f f u3 f1 f3 i2")
def contours(vertices, faces, edges, closed, K, observed, valid, field, step, delta, bits, value, points, nearest):
    """Fill in the silhouettes' bits, values, contour points and their nearest vertices, per frame.

    bits are (N, n, words); value (N,) counts the valid pixels that differ from the mask; points are (N, 7, M), unused
    ones with weight 0; nearest (N, M) is each point's nearest vertex.

    vertices (N, 3, V) are in the camera frame, faces (F, 3) and edges (4, E) those of the mesh, field (N, n, n) is the
    signed distance to the mask's contour, all at one resolution. A hand too near to the camera has infinite value.
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
