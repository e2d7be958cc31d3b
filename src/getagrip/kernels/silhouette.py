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
from numba import njit, types
from numba.extending import intrinsic

OPTIONS = {
    "cache": True, "nogil": True, "error_model": "numpy", "fastmath": {"contract", "reassoc", "nsz", "arcp"},
    "forceinline": True,
}  # fmt: skip
"""How all kernels are compiled; NaN and infinity keep their meaning.

Kernels that others call become parts of these. Else each caller has a copy, optimised in its own way; of several copies
in a process the first to be loaded counts, and that is another one where kernels come from the cache: other last bits.
"""

NEAR = 0.02
"""Objects nearer than this to the camera plane are not rendered [m]."""

PLANES = 4
_ALL = np.uint64(0xFFFFFFFFFFFFFFFF)
_ZERO = np.uint64(0)


@intrinsic
def popcount(typingctx, word):
    """Number of bits set in a 64-bit word."""

    def codegen(context, builder, signature, args):
        return builder.ctpop(args[0])

    return types.uint64(types.uint64), codegen


@njit(**OPTIONS)
def project(vertices, R, centre, scale, K, uvz):
    """Project centred vertices (3, V), posed as ``scale R x + centre``, into uvz (3, V); return the smallest depth."""
    fx, fy, cx, cy = K[0], K[1], K[2], K[3]
    r00, r01, r02 = scale * R[0, 0], scale * R[0, 1], scale * R[0, 2]
    r10, r11, r12 = scale * R[1, 0], scale * R[1, 1], scale * R[1, 2]
    r20, r21, r22 = scale * R[2, 0], scale * R[2, 1], scale * R[2, 2]
    t0, t1, t2 = centre[0], centre[1], centre[2]
    nearest = np.inf
    for i in range(vertices.shape[1]):
        x, y, z = vertices[0, i], vertices[1, i], vertices[2, i]
        depth = r20 * x + r21 * y + r22 * z + t2
        inverse = 1.0 / depth
        uvz[0, i] = fx * (r00 * x + r01 * y + r02 * z + t0) * inverse + cx
        uvz[1, i] = fy * (r10 * x + r11 * y + r12 * z + t1) * inverse + cy
        uvz[2, i] = depth
        nearest = min(nearest, depth)
    return nearest


@njit(**OPTIONS)
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
        n += sign[edges[2, e]] != sign[edges[3, e]]
    for k in range(n):
        e = out[0, k]
        out[0, k], out[1, k], out[2, k] = edges[0, e], edges[1, e], sign[edges[2, e]] - sign[edges[3, e]]
    return n


@njit(**OPTIONS)
def rasterise(uvz, edges, n_edges, closed, zoom, planes, bits):
    """Scan-convert the first n silhouette edges (coordinates times zoom) into bits (height, words), 64 pixels a word.

    planes (4, height, words) is scratch. Pixel j of a row is bit j % 64 of word j // 64.
    """
    height, words = bits.shape
    width = 64 * words
    planes[:] = _ZERO
    for k in range(n_edges):
        a, b, weight = edges[0, k], edges[1, k], edges[2, k]
        x0, y0, x1, y1 = uvz[0, a] * zoom, uvz[1, a] * zoom, uvz[0, b] * zoom, uvz[1, b] * zoom
        if y0 > y1:
            x0, y0, x1, y1, weight = x1, y1, x0, y0, -weight
        first = max(0.0, np.ceil(y0 - 0.5))
        last = min(float(height), np.ceil(y1 - 0.5))
        if first >= last:
            continue
        slope = (x1 - x0) / (y1 - y0)
        x = x0 + (first + 0.5 - y0) * slope - 0.5
        times = abs(weight) // 2 if closed else abs(weight)
        for row in range(int(first), int(last)):
            column = int(max(np.ceil(min(x, 1e6)), 0.0))
            x += slope
            if column >= width:
                continue
            for _ in range(times):
                suffix = _ALL << np.uint64(column & 63)
                for word in range(column >> 6, words):
                    carry = suffix
                    for p in range(PLANES):
                        old = planes[p, row, word]
                        planes[p, row, word] = old ^ carry
                        carry &= old if weight > 0 else ~old
                        if carry == _ZERO:
                            break
                    suffix = _ALL
    for row in range(height):
        for word in range(words):
            bits[row, word] = planes[0, row, word] | planes[1, row, word] | planes[2, row, word] | planes[3, row, word]


@njit(**OPTIONS)
def mismatch(bits, observed, valid):
    """Number of valid pixels in which two bit masks differ: E_mask (Eq. 6), at the resolution of the masks."""
    total = np.uint64(0)
    for row in range(bits.shape[0]):
        for word in range(bits.shape[1]):
            total += popcount((bits[row, word] ^ observed[row, word]) & valid[row, word])
    return float(total)


@njit(**OPTIONS)
def silhouettes(R, centre, scale, vertices, planes, edges, closed, K, bits):
    """Masks of one object in many poses: R (P, 3, 3), centre (P, 3), scale (P,), K (P, 4) -> bits (P, height, W)."""
    uvz = np.empty_like(vertices)
    sign = np.empty(planes.shape[1] + 1, np.int64)
    edge = np.empty((3, edges.shape[1] + 1), np.int64)
    counters = np.empty((PLANES, bits.shape[1], bits.shape[2]), np.uint64)
    for p in range(len(R)):
        bits[p] = _ZERO
        if project(vertices, R[p], centre[p], scale[p], K[p], uvz) >= NEAR:
            n = silhouette_edges(planes, edges, R[p], centre[p], scale[p], sign, edge)
            rasterise(uvz, edge, n, closed, 1.0, counters, bits[p])


def pack(masks: np.ndarray) -> np.ndarray:
    """Boolean masks (..., H, W) as bits (..., H, ceil(W / 64)), 64 pixels a word; missing pixels are zero."""
    missing = -masks.shape[-1] % 64
    padded = np.pad(masks, [(0, 0)] * (masks.ndim - 1) + [(0, missing)])
    return np.ascontiguousarray(np.packbits(padded, axis=-1, bitorder="little")).view(np.uint64)


def unpack(bits: np.ndarray, width: int) -> np.ndarray:
    """Boolean masks (..., H, width) of bits (..., H, words)."""
    return np.unpackbits(bits.view(np.uint8), axis=-1, bitorder="little")[..., :width].astype(bool)
