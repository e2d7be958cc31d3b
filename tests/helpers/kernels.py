"""What every kernel computes, in plain numpy: the readable specification that they are tested against.

Names and arguments follow the kernels'. Masks are boolean images here, not bits; lists of points are tables (7, M) with
the rows of ``contour`` (position, depth, normal, distance, weight). An object is posed as ``scale * R @ x + centre``,
with x relative to its centre; K is (fx, fy, cx, cy) [px].

Parts of kernels, which kernels alone can call, as functions that Python can.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numba import njit
from numpy import ndarray

from getagrip.compiling import NUMBA_OPTIONS
from getagrip.geometry.kernels.silhouette import MIN_SILHOUETTE_DEPTH_M, NX, NY, ROW_DISTANCE, ROW_WEIGHT, U, V, Z
from getagrip.geometry.se3 import hat


def project(
    vertices: Float[ndarray, "V 3"],
    R: Float[ndarray, "3 3"],
    centre: Float[ndarray, "3"],
    scale: float,
    K: Float[ndarray, "4"],
) -> Float[ndarray, "V 3"]:
    """Pixel coordinates and depth of posed vertices: ``u = fx x / z + cx``, ``v = fy y / z + cy``."""
    X = scale * vertices @ R.T + centre
    return np.stack([K[0] * X[:, 0] / X[:, 2] + K[2], K[1] * X[:, 1] / X[:, 2] + K[3], X[:, 2]], axis=1)


def silhouette(uvz: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"], shape: tuple[int, int]) -> Bool[ndarray, "h w"]:
    """A pixel is covered when its centre lies in the image of some face, whatever way the face is turned.

    A point is inside a triangle if a ray to the left crosses its boundary an odd number of times. An object that
    reaches nearer than ``MIN_SILHOUETTE_DEPTH_M`` covers no pixel.
    """
    mask = np.zeros(shape, bool)
    if uvz[:, 2].min() < MIN_SILHOUETTE_DEPTH_M:
        return mask
    for corners in uvz[faces, :2]:
        low = np.clip(np.floor(corners.min(axis=0)).astype(int), 0, shape[::-1])
        high = np.clip(np.ceil(corners.max(axis=0)).astype(int) + 1, 0, shape[::-1])
        window = mask[low[1] : high[1], low[0] : high[0]]
        v, u = np.indices(window.shape) + np.array([low[1], low[0]])[:, None, None] + 0.5
        inside = np.zeros(window.shape, bool)
        for (u0, v0), (u1, v1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            if v0 != v1:
                crosses = (v0 <= v) != (v1 <= v)
                inside ^= crosses & (u0 + (v - v0) * (u1 - u0) / (v1 - v0) <= u)
        window |= inside
    return mask


def mismatch(mask: Bool[ndarray, "h w"], observed: Bool[ndarray, "h w"], valid: Bool[ndarray, "h w"]) -> float:
    """E_mask (Eq. 6): the sum of ``C_o (M_o - Pi)^2`` over pixels."""
    return float(np.sum((mask != observed) & valid))


def mask_energy(
    uvz: Float[ndarray, "V 3"],
    faces: Int[ndarray, "F 3"],
    observed: Bool[ndarray, "h w"],
    valid: Bool[ndarray, "h w"],
    finer: int,
) -> float:
    """E_mask [px^2] of a silhouette drawn ``finer`` times finer than the masks: nearly smooth in the pose.

    Its limit, ``integral of C_o |M_o - Pi|`` over the plane, is what the contour's gradient is the gradient of.
    """
    fine = silhouette(uvz * [finer, finer, 1.0], faces, (finer * len(observed), finer * observed.shape[1]))
    observed, valid = (mask.repeat(finer, axis=0).repeat(finer, axis=1) for mask in (observed, valid))
    return mismatch(fine, observed, valid) / finer**2


def silhouette_edges(
    uvz: Float[ndarray, "V 3"], edges: Int[ndarray, "E 4"], faces: Int[ndarray, "F 3"]
) -> Int[ndarray, "n 3"]:
    """Edges (v0, v1, weight) between faces turned to and from the camera: ``weight = sign(f1) - sign(f2)``.

    A face is turned to the camera (sign 1) if its corners run counter-clockwise in the picture; no face has sign 0.
    """
    a, b, c = np.moveaxis(uvz[faces, :2], 1, 0)
    turn = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    sign = np.append(np.where(turn < 0, 1, -1), 0)
    weight = sign[edges[:, 2]] - sign[edges[:, 3]]
    return np.column_stack([edges[:, :2], weight])[weight != 0]


def sample_contour(
    uvz: Float[ndarray, "V 3"],
    edges: Int[ndarray, "n 3"],
    zoom: float,
    step: float,
    mask: Bool[ndarray, "h w"],
    valid: Bool[ndarray, "h w"],
) -> Float[ndarray, "7 M"]:
    """Points every ``step`` px of the level along the silhouette edges, those kept that lie on the visible contour.

    A point is kept if it lies in a valid pixel and 0.75 px outwards nothing is rendered. Its position is given in
    pixels of the crop; ``1/z`` is linear along an edge's image. Along an edge of positive weight with the direction
    (dx, dy), (-dy, dx) points outward.
    """
    a, b, weight = edges.T
    start, along = uvz[a, :2] * zoom, (uvz[b, :2] - uvz[a, :2]) * zoom
    length = np.linalg.norm(along, axis=1)
    end = np.cumsum(length)
    s = step * (np.arange(int((end[-1] if len(end) else 0.0) / step) + 1) + 0.5)
    k = np.searchsorted(end, s, side="right")
    s, k = s[k < len(end)], k[k < len(end)]
    t = ((s - end[k] + length[k]) / length[k])[:, None]
    at = start[k] + t * along[k]
    normal = np.sign(weight[k])[:, None] * np.stack([-along[k, 1], along[k, 0]], axis=1) / length[k, None]
    beside = _pixel(mask, at + 0.75 * normal)
    keep = _pixel(valid, at) & ~beside
    points = np.zeros((7, int(keep.sum())))
    points[[U, V]] = at[keep].T / zoom
    points[Z] = (1.0 / ((1 - t[:, 0]) / uvz[a[k], 2] + t[:, 0] / uvz[b[k], 2]))[keep]
    points[[NX, NY]] = normal[keep].T
    return points


def _pixel(mask: Bool[ndarray, "h w"], at: Float[ndarray, "M 2"]) -> Bool[ndarray, "M"]:
    """The mask at points; false outside of it."""
    j, i = np.floor(at).astype(int).T
    inside = (i >= 0) & (j >= 0) & (i < mask.shape[0]) & (j < mask.shape[1])
    return np.where(inside, mask[np.where(inside, i, 0), np.where(inside, j, 0)], False)


def sample_field(
    points: Float[ndarray, "7 M"], field: Float[ndarray, "s s"], zoom: float, spacing: float, delta: float
) -> Float[ndarray, "7 M"]:
    """The points with their distance d, bilinear in the field, and the weight ``spacing / max(|d|, delta)``."""
    from scipy.ndimage import map_coordinates

    out = points.copy()
    out[ROW_DISTANCE] = map_coordinates(field.astype(float), points[[V, U]] * zoom - 0.5, order=1, mode="nearest")
    out[ROW_WEIGHT] = spacing / np.maximum(np.abs(out[ROW_DISTANCE]), delta)
    return out


def match_boundary(
    points: Float[ndarray, "7 M"], targets: Float[ndarray, "Q 5"], gate: float, strength: float, delta: float
) -> tuple[Float[ndarray, "7 Q"], float]:
    """Per observed boundary point y the contour point x of least cost ``|x - y|^2 + gate (1 - n_x . n_y) < gate``.

    Its distance is measured along its own normal. The value is the sum of ``strength length sqrt(min(cost, gate))``.
    """
    matched, value = np.zeros((7, len(targets))), 0.0
    matched[Z] = 1.0
    for q, (x, y, nx, ny, length) in enumerate(targets):
        offset = points[[U, V]] - [[x], [y]]
        cost = np.sum(offset**2, axis=0) + gate * (1.0 - nx * points[NX] - ny * points[NY])
        least = cost.min(initial=gate)
        value += strength * length * np.sqrt(least)
        if least < gate:
            best = int(np.argmin(cost))
            matched[:ROW_DISTANCE, q] = points[:ROW_DISTANCE, best]
            d = offset[:, best] @ points[[NX, NY], best]
            matched[ROW_DISTANCE, q], matched[ROW_WEIGHT, q] = d, strength * length / max(abs(d), delta)
    return matched, value


def normal_equations(
    points: Float[ndarray, "7 M"], centre: Float[ndarray, "3"], K: Float[ndarray, "4"]
) -> tuple[Float[ndarray, "7"], Float[ndarray, "7 7"]]:
    """``g = sum h d a`` and ``H = sum h a a^T`` with ``a = n^T dp/dX [I, -hat(X - c), X - c]``."""
    g, H = np.zeros(7), np.zeros((7, 7))
    fx, fy, cx, cy = K
    for u, v, z, nx, ny, d, h in points.T:
        x, y = (u - cx) * z / fx, (v - cy) * z / fy
        dp_dX = np.array([[fx / z, 0.0, -fx * x / z**2], [0.0, fy / z, -fy * y / z**2]])
        r = np.array([x, y, z]) - centre
        a = np.array([nx, ny]) @ dp_dX @ np.column_stack([np.eye(3), -hat(r), r])
        g += h * d * a
        H += h * np.outer(a, a)
    return g, H


def distance_field(observed: Bool[ndarray, "h w"], valid: Bool[ndarray, "h w"]) -> Float[ndarray, "h w"]:
    """Signed distance of each pixel to the visible contour [px]: to the object outside of it, minus that to visible
    background inside; the difference of both where nothing is known. Contours run half a pixel from pixel centres."""
    from scipy.ndimage import distance_transform_edt

    background = valid & ~observed
    to_object, to_background = (
        distance_transform_edt(~mask) if mask.any() else np.full(observed.shape, 2.0 * len(observed))
        for mask in (observed, background)
    )
    return np.where(observed, 0.5 - to_background, np.where(background, to_object - 0.5, to_object - to_background))


def boundary_targets(
    observed: Bool[ndarray, "h w"], valid: Bool[ndarray, "h w"], field: Float[ndarray, "h w"], zoom: float, count: int
) -> Float[ndarray, "count 5"]:
    """At most ``count`` of the object's pixels with visible background beside them, moved onto the contour.

    Rows are position [px of the crop, ``zoom`` per pixel of the field], outward normal, and the length each stands for.
    """
    background = valid & ~observed
    beside = np.zeros_like(observed)
    beside[1:-1, 1:-1] = (
        background[:-2, 1:-1] | background[2:, 1:-1] | background[1:-1, :-2] | background[1:-1, 2:]
    ) & observed[1:-1, 1:-1]
    pixels = np.argwhere(beside)
    targets = np.zeros((count, 5))
    used = min(len(pixels), count)
    for q in range(used):
        i, j = pixels[(2 * q + 1) * len(pixels) // (2 * used)]
        slope = np.array([field[i, j + 1] - field[i, j - 1], field[i + 1, j] - field[i - 1, j]], dtype=float)
        normal = slope / (np.linalg.norm(slope) + 1e-12)
        targets[q, :2] = zoom * np.array([j + 0.5, i + 0.5]) - field[i, j] * normal
        targets[q, 2:4], targets[q, 4] = normal, zoom * len(pixels) / used
    return targets


def closest_on_faces(points: Float[ndarray, "P 3"], corners: Float[ndarray, "F 3 3"]) -> Float[ndarray, "P F 3"]:
    """The point of each face nearest to each point: on its plane if that is inside the face, else on an edge."""
    x = points[:, None]
    a, b, c = np.moveaxis(corners, 1, 0)
    n = np.cross(b - a, c - a)
    foot = x - np.sum((x - a) * n, axis=-1, keepdims=True) * n / np.sum(n * n, axis=-1, keepdims=True)
    inside = np.ones(foot.shape[:2], bool)
    best, least = foot, np.full(foot.shape[:2], np.inf)
    for p, q in ((a, b), (b, c), (c, a)):
        inside &= np.sum(np.cross(q - p, foot - p) * n, axis=-1) >= 0.0
        t = np.sum((x - p) * (q - p), axis=-1, keepdims=True) / np.sum((q - p) ** 2, axis=-1, keepdims=True)
        on_edge = p + np.clip(t, 0.0, 1.0) * (q - p)
        gap = np.sum((x - on_edge) ** 2, axis=-1)
        best = np.where((gap < least)[..., None], on_edge, best)
        least = np.minimum(gap, least)
    return np.where(inside[..., None], foot, best)


def signed_distance(
    points: Float[ndarray, "P 3"], corners: Float[ndarray, "F 3 3"], normals: Float[ndarray, "F 3"]
) -> tuple[Float[ndarray, "P"], Float[ndarray, "P 3"]]:
    """Distance to the nearest face, negative behind it, and its gradient; of equally near ones the most face-on."""
    away = points[:, None] - closest_on_faces(points, corners)
    gap = np.linalg.norm(away, axis=-1)
    height = np.sum(away * normals, axis=-1)
    tied = gap <= gap.min(axis=1, keepdims=True) * 1.000001
    face = np.argmax(np.where(tied, np.abs(height), -1.0), axis=1)
    rows = np.arange(len(points))
    d = np.where(height[rows, face] >= 0.0, 1.0, -1.0) * gap[rows, face]
    far = np.abs(d) > 1e-6
    direction = away[rows, face] / np.where(far, d, 1.0)[:, None]
    return d, np.where(far[:, None], direction, normals[face])


def screen(
    points: Float[ndarray, "Q 3"],
    R: Float[ndarray, "3 3"],
    centre: Float[ndarray, "3"],
    scale: float,
    distance: Float[ndarray, "X Y Z"],
    origin: Float[ndarray, "3"],
    spacing: float,
) -> tuple[Float[ndarray, "Q 3"], Float[ndarray, "Q"]]:
    """Points in the unscaled object's frame, ``R^T (x - centre) / scale``, and the distance at the nearest node."""
    local = (points - centre) @ R / scale
    node = np.floor((local - origin) / spacing + 0.5).astype(int)
    inside = np.all((node >= 0) & (node < distance.shape), axis=1)
    node[~inside] = 0
    return local, np.where(inside, distance[tuple(node.T)], np.inf)


def push(heights: Float[ndarray, "Q"], weight: float, tolerance: float) -> float:
    """E_push: ``weight * mean over contact vertices of max(0, -d - tolerance)``, d their signed distances [m]."""
    return float(weight * np.mean(np.maximum(0.0, -heights - tolerance)))


def pull(heights: Float[ndarray, "Q"], region: Int[ndarray, "f"], weight: float, max_distance: float) -> float:
    """E_pull: ``weight * mean over fingertips of min over their vertices of |d|``, at most ``max_distance`` [m].

    The vertices of fingertip k stand at ``region[k]:region[k + 1]``.
    """
    tips = [np.abs(heights[a:b]).min(initial=max_distance) for a, b in pairwise(region)]
    return float(weight * np.mean(tips))


def callable_part(part: Any) -> Any:
    """Return the part, compiled with its like's options."""
    return njit(**NUMBA_OPTIONS)(part.py_func)
