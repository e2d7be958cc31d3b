"""Exact silhouettes of triangle meshes as bit masks, from the silhouette edges alone.

A pixel is covered when some face covers it. Summed over faces, coverage is a signed crossing count of edges: the edge
between faces f1 and f2 counts ``sign(f1) - sign(f2)``, where a face's sign says on which side of its plane the camera
is. Only silhouette edges have a non-zero weight, so only they are scan-converted: each adds its weight to all
pixels right of it, row by row, in four bit planes (a ripple-carry counter modulo 16 over 64 pixels at a time). The mask
is where the counter is not zero: exactly the mask of a triangle rasteriser while fewer than 16 layers overlap (closed
meshes count whole layers, open ones single faces). ``reference.silhouette`` is the readable specification.
"""

from __future__ import annotations

import numpy as np
from numba import types
from numba.extending import intrinsic

from getagrip.compiling import kernel

MIN_SILHOUETTE_DEPTH_M = 0.02
"""Objects nearer than this to the camera plane are not rendered [m]."""

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
    """Compute ``a b + c``, rounded once: sums keep their order, however the loop around them is compiled."""

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
    """Collect the silhouette edges into out (3, E) as (v0, v1, weight); return how many.

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
def rasterise(uvz, edges, n_edges, closed, zoom, lines, planes, bits):  # noqa: PLR0912 - loops for slices
    """Fill the first n silhouette edges (coordinates times zoom) into bits (height, words), 64 pixels a word.

    lines (5, E) and planes (height, words, 4) are scratch. Pixel j of a row is bit j % 64 of word j // 64.
    """
    height, words = bits.shape
    width = np.uint64(64 * words)
    n, top, bottom = 0, float(height), 0.0
    for k in range(n_edges):  # those that cross the middle of a row, without branches: none is predictable
        a, b, weight = np.uint64(edges[0, k]), np.uint64(edges[1, k]), edges[2, k]
        x0, y0, x1, y1 = uvz[0, a] * zoom, uvz[1, a] * zoom, uvz[0, b] * zoom, uvz[1, b] * zoom
        up = y0 > y1
        upper_x, upper_y = x1 if up else x0, y1 if up else y0
        lower_x, lower_y = x0 if up else x1, y0 if up else y1
        first = max(0.0, np.ceil(upper_y - 0.5))
        last = min(float(height), np.ceil(lower_y - 0.5))
        slope = (lower_x - upper_x) / (lower_y - upper_y)
        lines[0, n], lines[1, n] = first, last
        lines[2, n], lines[3, n] = fma(first + (0.5 - upper_y), slope, upper_x - 0.5), slope
        lines[4, n] = -weight if up else weight
        crosses = first < last
        n += crosses
        top, bottom = min(top, first) if crosses else top, max(bottom, last) if crosses else bottom
    begin, end = int(top), int(bottom)
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
        for row in range(np.uint64(lines[0, k]), np.uint64(lines[1, k])):
            column = np.uint64(max(np.ceil(min(x, 1e6)), 0.0))
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
    """Count the valid pixels in which two bit masks differ: E_mask (Eq. 6), at the resolution of the masks."""
    total = np.uint64(0)
    for row in range(bits.shape[0]):
        for word in range(bits.shape[1]):
            total += popcount((bits[row, word] ^ observed[row, word]) & valid[row, word])
    return float(total)


@kernel("f3 f2 f1 f2 f2 i2 b f2 u3")
def silhouettes(R, centre, scale, vertices, planes, edges, closed, K, bits):
    """Render masks of one object in many poses.

    R (P, 3, 3), centre (P, 3), scale (P,), K (P, 4) -> bits (P, height, W).
    """
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
            rasterise(uvz, edge, n, closed, 1.0, lines, counters, bits[p])
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
    return np.unpackbits(bits.view(np.uint8), axis=-1, bitorder="little")[..., :width].astype(bool)
