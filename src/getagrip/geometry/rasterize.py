"""A z-buffer, and true masks and pictures of posed meshes rendered with it; no energy uses it.

Triangles are rasterised in homogeneous coordinates (Olano and Greer, "Triangle Scan Conversion using 2D Homogeneous
Coordinates", 1997). With p_i = K X_i the corners of a face, the ray through pixel q = (u, v, 1) meets its plane where
sum_i b_i p_i = z q, sum_i b_i = 1. So a = [p_0 p_1 p_2]^-1 q is b / z: the pixel is inside the face when no a_i is
negative, and 1 / z = sum_i a_i. Without a division by a corner's depth, faces that reach behind the camera need no
clipping: pixels nearer than ``MIN_ZBUFFER_DEPTH_M`` are dropped one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Int32, UInt8
from numpy import ndarray

from getagrip.compiling import kernel
from getagrip.geometry.mesh import vertex_normals
from getagrip.io.images import PackedMask

MIN_ZBUFFER_DEPTH_M = 0.02
"""Depth from which on surfaces are rendered [m]."""
MIN_OCCLUDER_FRACTION = 0.01
"""Fraction of the grasped object's silhouette that another object must cover to be an occluder. Smaller overlaps are
noise of the poses, such as a keyboard that cuts into the mouse on it."""
KEY_LIGHT_DIRECTION = np.array([-0.35, -0.6, -0.72])
"""Direction to the light in the camera frame: from above the left shoulder."""
Surface = tuple[Float[ndarray, "_V 3"], Int[ndarray, "_F 3"]]
"""Vertices in the camera frame [m] and faces."""
Colour = tuple[float, float, float]
"""Red, green, blue in [0, 1]."""


def depth_and_face(
    vertices_cam: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"], K: Float[ndarray, "3 3"], size: tuple[int, int]
) -> tuple[Float32[ndarray, "H W"], Int32[ndarray, "H W"]]:
    """Render the depth z [m] of the nearest surface (infinity: none) and its face (-1: none), both sides visible.

    ``vertices_cam`` are in the camera frame [m], ``size`` is (width, height) [px]. Pixels are sampled at their centres;
    among faces at the same depth the first is visible.
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
    """Render the mask of all surfaces: ``depth_and_face(...)[1] >= 0``, without the depths."""
    width, height = size
    mask = np.zeros((height, width), dtype=np.bool_)
    corners = np.ascontiguousarray(vertices_cam @ K.T, dtype=np.float64)
    _rasterise_coverage(corners, np.ascontiguousarray(faces, dtype=np.int64), width, height, 0, 0, mask)
    return mask


def render_packed(
    vertices_cam: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"], K: Float[ndarray, "3 3"], size: tuple[int, int]
) -> PackedMask:
    """Render the mask of all surfaces, packed: its cost grows with the pixels around them, not with the image."""
    corners = np.ascontiguousarray(vertices_cam @ K.T, dtype=np.float64)
    left, top, right, bottom = _image_part(corners, size)
    mask = np.zeros((bottom - top, right - left), dtype=np.bool_)
    _rasterise_coverage(corners, np.ascontiguousarray(faces, dtype=np.int64), *size, top, left, mask)
    return PackedMask.of(mask, top, left, size[::-1])


def _image_part(corners: Float[ndarray, "V 3"], size: tuple[int, int]) -> tuple[int, int, int, int]:
    """Return (left, top, right, bottom) of the pixels that faces may cover, as ``_face_pixel_box`` does of one."""
    if not len(corners):
        return 0, 0, 0, 0
    if corners[:, 2].min() < MIN_ZBUFFER_DEPTH_M:
        return 0, 0, *size
    uv = corners[:, :2] / corners[:, 2:]
    left, top = np.floor(np.clip(uv.min(axis=0) - 0.5, 0.0, size)).astype(int).tolist()
    right, bottom = np.ceil(np.clip(uv.max(axis=0) + 0.5, 0.0, size)).astype(int).tolist()
    return left, top, right, bottom


def interpolate_vertex_values(
    vertices_cam: Float[ndarray, "V 3"],
    faces: Int[ndarray, "F 3"],
    K: Float[ndarray, "3 3"],
    face: Int32[ndarray, "H W"],
    values: Float[ndarray, "V C"],
) -> Float[ndarray, "n C"]:
    """Interpolate vertices' values on the visible face, for every pixel with ``face >= 0`` in row-major order."""
    corners = np.ascontiguousarray(vertices_cam @ K.T, dtype=np.float64)
    faces, values = np.ascontiguousarray(faces, dtype=np.int64), np.ascontiguousarray(values)
    out = np.empty((np.count_nonzero(face >= 0), values.shape[1]))
    _interpolate_barycentric(corners, faces, face, values, out)
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


@kernel("f2 i2 i i i i b2", fastmath=False)
def _rasterise_coverage(
    p: ndarray, faces: ndarray, width: int, height: int, row0: int, column0: int, mask: ndarray
) -> None:
    """Mark the pixels with a face in ``_rasterise_depth``, in a part of the image from a row and column on."""
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
                if mask[i - row0, j - column0]:
                    continue
                u = j + 0.5
                b0, b1, b2 = a0x * u + r0, a1x * u + r1, a2x * u + r2
                if b0 < 0.0 or b1 < 0.0 or b2 < 0.0:
                    continue
                total = b0 + b1 + b2
                if total > 0.0 and volume / total >= MIN_ZBUFFER_DEPTH_M:
                    mask[i - row0, j - column0] = True


@kernel(fastmath=False)
def _face_pixel_box(p0: ndarray, p1: ndarray, p2: ndarray, width: int, height: int) -> tuple[int, int, int, int]:
    """Return (left, right, top, bottom) of the pixels a face may cover; all for one nearer than the minimum depth."""
    nearest, farthest = min(min(p0[2], p1[2]), p2[2]), max(max(p0[2], p1[2]), p2[2])
    if farthest < MIN_ZBUFFER_DEPTH_M:
        return 0, 0, 0, 0
    if nearest < MIN_ZBUFFER_DEPTH_M:
        return 0, width, 0, height
    u0, u1, u2 = p0[0] / p0[2], p1[0] / p1[2], p2[0] / p2[2]
    v0, v1, v2 = p0[1] / p0[2], p1[1] / p1[2], p2[1] / p2[2]
    # Clamped before the conversion: a float far outside the image may not fit an integer.
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


def nearest_surface(
    surfaces: Sequence[Surface], K: Float[ndarray, "3 3"], size: tuple[int, int]
) -> Int[ndarray, "H W"]:
    """Render the index of the nearest surface at each pixel (-1: none)."""
    vertices, faces = _concatenate_surfaces(surfaces)
    owner = np.repeat(np.arange(len(surfaces)), [len(f) for _, f in surfaces])
    return np.append(owner, -1)[depth_and_face(vertices, faces, K, size)[1]]  # no face, -1, is the last entry


def true_masks(
    grasped: Surface,
    hands: Sequence[Surface],
    others: Sequence[Surface],
    K: Float[ndarray, "3 3"],
    size: tuple[int, int],
) -> tuple[Bool[ndarray, "H W"], Bool[ndarray, "H W"], Bool[ndarray, "H W"]]:
    """Render the masks of the grasped object, of ignored pixels, and of the grasping hand (the first), where visible.

    A pixel is ignored if its nearest surface is a hand, or another object that occludes the grasped one. Other objects
    are background, where the grasped object is known not to be. An occluder is ignored as a whole, so that the ignored
    area does not reveal the silhouette behind it.
    """
    part = nearest_surface([grasped, *hands, *others], K, size)  # 0: grasped, then hands, then others
    ignore = (part > 0) & (part <= len(hands))
    if others:
        shown = np.bincount(part[render_coverage(*grasped, K, size)], minlength=1 + len(hands) + len(others))
        for k in range(1 + len(hands), len(shown)):
            if shown[k] > MIN_OCCLUDER_FRACTION * shown.sum():
                ignore |= part == k
    return part == 0, ignore, (part == 1) & bool(hands)


def render_rgb(
    meshes: Sequence[tuple[Float[ndarray, "_V 3"], Int[ndarray, "_F 3"], Colour | Float[ndarray, "_V 3"]]],
    K: Float[ndarray, "3 3"],
    size: tuple[int, int],
    background: UInt8[ndarray, "H W 3"] | Colour | None = None,
) -> UInt8[ndarray, "H W 3"]:
    """Render meshes in the camera frame, lit and smoothly shaded, four samples a pixel.

    A mesh has one colour, or one per vertex, interpolated on faces. ``background`` is an image of ``size`` (width,
    height) [px], a colour, or None for white.
    """
    width, height = size
    behind = background / 255.0 if isinstance(background, ndarray) else np.array(background or (1.0, 1.0, 1.0))
    picture = np.broadcast_to(behind, (height, width, 3)).astype(np.float32, order="C")
    if meshes:
        vertices, faces = _concatenate_surfaces([(v, f) for v, f, _ in meshes])
        brightness = _lambert(vertices, np.concatenate([vertex_normals(v, f) for v, f, _ in meshes]))
        colours = np.concatenate([np.broadcast_to(np.asarray(colour), v.shape) for v, _, colour in meshes])
        K2 = np.diag([2.0, 2.0, 1.0]) @ K
        _, face = depth_and_face(vertices, faces, K2, (2 * width, 2 * height))
        values = np.concatenate([brightness[:, None], colours], axis=1)
        lit = interpolate_vertex_values(vertices, faces, K2, face, values)
        covered = face >= 0
        filled = (np.flatnonzero(covered.any(axis=axis)) // 2 for axis in (1, 0))
        box = tuple(slice(at[0], at[-1] + 1) if at.size else slice(0, 0) for at in filled)
        fine = np.repeat(np.repeat(picture[box], 2, axis=0), 2, axis=1)
        twice = tuple(slice(2 * side.start, 2 * side.stop) for side in box)
        fine[covered[twice]] = np.clip(lit[:, :1] * lit[:, 1:], 0.0, 1.0)
        picture[box] = (fine[::2, ::2] + fine[::2, 1::2] + fine[1::2, ::2] + fine[1::2, 1::2]) / 4.0
    return np.asarray(np.round(255.0 * picture), dtype=np.uint8)


def _lambert(points: Float[ndarray, "n 3"], normals: Float[ndarray, "n 3"]) -> Float[ndarray, "n"]:
    """Compute the brightness under ambient light, a key light, and a head light against flat shadows."""
    to_eye = -points / np.linalg.norm(points, axis=1, keepdims=True)
    n = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    facing = np.sum(n * to_eye, axis=1)
    n = np.where(facing[:, None] < 0.0, -n, n)  # the inside of an open mesh is lit as well
    key = np.clip(n @ (KEY_LIGHT_DIRECTION / np.linalg.norm(KEY_LIGHT_DIRECTION)), 0.0, 1.0)
    return np.asarray(0.3 + 0.5 * key + 0.3 * np.abs(facing))


def _concatenate_surfaces(surfaces: Sequence[Surface]) -> Surface:
    offsets = [0, *accumulate(len(v) for v, _ in surfaces)]
    faces = np.concatenate([f + o for (_, f), o in zip(surfaces, offsets, strict=False)])
    return np.concatenate([v for v, _ in surfaces]), faces
