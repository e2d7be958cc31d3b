"""A z-buffer: the depth and the visible face at every pixel centre. For true masks and pictures, not for fitting.

Triangles are rasterised in homogeneous coordinates (Olano and Greer, "Triangle Scan Conversion using 2D Homogeneous
Coordinates", 1997). With p_i = K X_i the corners of a face, the ray through pixel q = (u, v, 1) meets its plane where
sum_i b_i p_i = z q, sum_i b_i = 1. So a = [p_0 p_1 p_2]^-1 q is b / z: the pixel is inside the face when no a_i is
negative, and 1 / z = sum_i a_i. Nothing is divided by the depth of a corner, so faces that reach behind the camera
need no clipping: what lies nearer than ``MIN_ZBUFFER_DEPTH_M`` is dropped pixel by pixel.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Int32
from numpy import ndarray

from getagrip.compiling import kernel

MIN_ZBUFFER_DEPTH_M = 0.02
"""Nothing nearer than this is drawn [m]."""


def depth_and_face(
    vertices_cam: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"], K: Float[ndarray, "3 3"], size: tuple[int, int]
) -> tuple[Float32[ndarray, "H W"], Int32[ndarray, "H W"]]:
    """Render the depth z [m] of the nearest surface (infinity: nothing) and its face (-1: nothing), both sides drawn.

    ``vertices_cam`` are in the camera frame [m], ``size`` is (width, height) [px]. Pixels are taken at their centres;
    of faces at the same depth the first is kept.
    """
    width, height = size
    depth = np.full((height, width), np.inf, dtype=np.float32)
    face = np.full((height, width), -1, dtype=np.int32)
    corners = np.ascontiguousarray(vertices_cam @ K.T, dtype=np.float64)
    _rasterise_depth(corners, np.ascontiguousarray(faces, dtype=np.int64), depth, face)
    return depth, face


def render_coverage(
    vertices_cam: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"], K: Float[ndarray, "3 3"], size: tuple[int, int]
) -> Bool[ndarray, "H W"]:
    """Return the pixels that show a surface: ``depth_and_face(...)[1] >= 0``, without the depths."""
    width, height = size
    mask = np.zeros((height, width), dtype=np.bool_)
    corners = np.ascontiguousarray(vertices_cam @ K.T, dtype=np.float64)
    _rasterise_coverage(corners, np.ascontiguousarray(faces, dtype=np.int64), mask)
    return mask


def interpolate_vertex_values(
    vertices_cam: Float[ndarray, "V 3"],
    faces: Int[ndarray, "F 3"],
    K: Float[ndarray, "3 3"],
    face: Int32[ndarray, "H W"],
    values: Float[ndarray, "V C"],
) -> Float[ndarray, "n C"]:
    """Interpolate values of the vertices on the visible face, for every pixel with ``face >= 0`` in row-major order."""
    corners = np.ascontiguousarray(vertices_cam @ K.T, dtype=np.float64)
    out = np.empty((np.count_nonzero(face >= 0), values.shape[1]))
    _interpolate_barycentric(
        corners, np.ascontiguousarray(faces, dtype=np.int64), face, np.ascontiguousarray(values), out
    )
    return out


@kernel("f2 i2 n2 f2 f2", fastmath=False)
def _interpolate_barycentric(p: ndarray, faces: ndarray, face: ndarray, values: ndarray, out: ndarray) -> None:
    n = 0
    for i in range(face.shape[0]):
        for j in range(face.shape[1]):
            f = face[i, j]
            if f < 0:
                continue
            c0, c1, c2 = faces[f, 0], faces[f, 1], faces[f, 2]
            a0, a1, a2, _ = _edge_functions(p[c0], p[c1], p[c2])
            u, v = j + 0.5, i + 0.5
            b0, b1, b2 = a0[0] * u + a0[1] * v + a0[2], a1[0] * u + a1[1] * v + a1[2], a2[0] * u + a2[1] * v + a2[2]
            total = b0 + b1 + b2
            for c in range(values.shape[1]):
                out[n, c] = (b0 * values[c0, c] + b1 * values[c1, c] + b2 * values[c2, c]) / total
            n += 1


@kernel("f2 i2 s2 n2", fastmath=False)
def _rasterise_depth(p: ndarray, faces: ndarray, depth: ndarray, face: ndarray) -> None:
    height, width = depth.shape
    for f in range(len(faces)):
        p0, p1, p2 = p[faces[f, 0]], p[faces[f, 1]], p[faces[f, 2]]
        left, right, top, bottom = _face_pixel_box(p0, p1, p2, width, height)
        if left >= right or top >= bottom:
            continue
        (a0x, a0y, a0z), (a1x, a1y, a1z), (a2x, a2y, a2z), volume = _edge_functions(p0, p1, p2)
        if volume == 0.0:  # seen edge-on, or no area
            continue
        for i in range(top, bottom):
            v = i + 0.5
            r0, r1, r2 = a0y * v + a0z, a1y * v + a1z, a2y * v + a2z
            for j in range(left, right):
                u = j + 0.5
                b0, b1, b2 = a0x * u + r0, a1x * u + r1, a2x * u + r2
                if b0 < 0.0 or b1 < 0.0 or b2 < 0.0:
                    continue
                total = b0 + b1 + b2
                if total <= 0.0:
                    continue
                z = volume / total
                if z >= MIN_ZBUFFER_DEPTH_M and np.float32(z) < depth[i, j]:
                    depth[i, j] = z
                    face[i, j] = f


@kernel("f2 i2 b2", fastmath=False)
def _rasterise_coverage(p: ndarray, faces: ndarray, mask: ndarray) -> None:
    """Mark the pixels that ``_rasterise_depth`` gives a face."""
    height, width = mask.shape
    for f in range(len(faces)):
        p0, p1, p2 = p[faces[f, 0]], p[faces[f, 1]], p[faces[f, 2]]
        left, right, top, bottom = _face_pixel_box(p0, p1, p2, width, height)
        if left >= right or top >= bottom:
            continue
        (a0x, a0y, a0z), (a1x, a1y, a1z), (a2x, a2y, a2z), volume = _edge_functions(p0, p1, p2)
        if volume == 0.0:
            continue
        for i in range(top, bottom):
            v = i + 0.5
            r0, r1, r2 = a0y * v + a0z, a1y * v + a1z, a2y * v + a2z
            for j in range(left, right):
                if mask[i, j]:
                    continue
                u = j + 0.5
                b0, b1, b2 = a0x * u + r0, a1x * u + r1, a2x * u + r2
                if b0 < 0.0 or b1 < 0.0 or b2 < 0.0:
                    continue
                total = b0 + b1 + b2
                if total > 0.0 and volume / total >= MIN_ZBUFFER_DEPTH_M:
                    mask[i, j] = True


@kernel(fastmath=False)
def _face_pixel_box(p0: ndarray, p1: ndarray, p2: ndarray, width: int, height: int) -> tuple[int, int, int, int]:
    """(left, right, top, bottom) of the pixels a face may cover; the whole image if it comes nearer than ``MIN_ZBUFFER_DEPTH_M``."""
    nearest, farthest = min(min(p0[2], p1[2]), p2[2]), max(max(p0[2], p1[2]), p2[2])
    if farthest < MIN_ZBUFFER_DEPTH_M:
        return 0, 0, 0, 0
    if nearest < MIN_ZBUFFER_DEPTH_M:
        return 0, width, 0, height
    u0, u1, u2 = p0[0] / p0[2], p1[0] / p1[2], p2[0] / p2[2]
    v0, v1, v2 = p0[1] / p0[2], p1[1] / p1[2], p2[1] / p2[2]
    # Clamped before the conversion: far outside the image a float may not fit an integer.
    left = int(np.floor(min(max(min(min(u0, u1), u2) - 0.5, 0.0), float(width))))
    right = int(np.ceil(min(max(max(max(u0, u1), u2) + 0.5, 0.0), float(width))))
    top = int(np.floor(min(max(min(min(v0, v1), v2) - 0.5, 0.0), float(height))))
    bottom = int(np.ceil(min(max(max(max(v0, v1), v2) + 0.5, 0.0), float(height))))
    return left, right, top, bottom


@kernel(fastmath=False)
def _edge_functions(p0: ndarray, p1: ndarray, p2: ndarray) -> tuple:
    """Return the rows of the adjugate of [p_0 p_1 p_2], and its determinant, both times the latter's sign.

    Row i is the edge opposite to corner i. It is negated exactly in the face across the edge, so that no pixel falls
    between two faces.
    """
    a0x, a0y, a0z = p1[1] * p2[2] - p1[2] * p2[1], p1[2] * p2[0] - p1[0] * p2[2], p1[0] * p2[1] - p1[1] * p2[0]
    a1x, a1y, a1z = p2[1] * p0[2] - p2[2] * p0[1], p2[2] * p0[0] - p2[0] * p0[2], p2[0] * p0[1] - p2[1] * p0[0]
    a2x, a2y, a2z = p0[1] * p1[2] - p0[2] * p1[1], p0[2] * p1[0] - p0[0] * p1[2], p0[0] * p1[1] - p0[1] * p1[0]
    volume = p0[0] * a0x + p0[1] * a0y + p0[2] * a0z
    s = 1.0 if volume > 0.0 else -1.0
    return (s * a0x, s * a0y, s * a0z), (s * a1x, s * a1y, s * a1z), (s * a2x, s * a2y, s * a2z), s * volume
