"""Stabilize hands between clicked frames against the footage, since no spline predicts a shaking camera.

Visible vertices of the hand on a clicked frame are tracked to the next one, and back, by optical flow (Lucas, Kanade,
IJCAI 1981; pyramids after Bouguet). In each frame in between, before the first and after the last clicked frame, the
similarity in the image from the hand's vertices to the tracked ones is applied to the hand.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt8
from numpy import ndarray

from getagrip.clip.read_arrays import MIN_CAMERA_RANGE_M
from getagrip.geometry import se3
from getagrip.geometry.camera import backproject, project
from getagrip.geometry.rasterize import depth_and_face
from getagrip.hands.from_2d.clicks import ClickedHands

MAX_FLOW_WIDTH_PX = 960
"""Maximum width of the reduced images [px]."""
LK_WINDOW_PX = 21
"""Side of the window that is compared around a point [px]."""
LK_PYRAMID_LEVELS = 3
"""Levels of the image pyramid above the image itself."""
ROUND_TRIP_TOLERANCE_PX = 1.0
"""Largest distance of a point, tracked to a frame and back, from its start [px]."""
MIN_TRACKED_POINTS = 12
"""Minimum number of tracked vertices of a clicked frame."""
CAUCHY_SCALE_PX = 3.0
"""Residual above which vertices count less [px]."""


def stabilize_hands(
    hands: ClickedHands,
    first: int,
    K: Float[ndarray, "3 3"],
    size: tuple[int, int],
    image: Callable[[int], UInt8[ndarray, "H W 3"]],
) -> ClickedHands:
    """Stabilize the hands between clicked frames; ``first`` is their first frame, ``size`` width and height [px]."""
    shrunk = min(1.0, MAX_FLOW_WIDTH_PX / size[0])
    small = round(size[0] * shrunk), round(size[1] * shrunk)
    K_small = np.diag([small[0] / size[0], small[1] / size[1], 1.0]) @ K
    hand = hands.hand
    vertices = se3.transform(hand.T_cam_hand, hand.vertices)
    vertices[..., 2] = np.maximum(vertices[..., 2], MIN_CAMERA_RANGE_M)
    uv = project(K_small, vertices)
    T = hand.T_cam_hand.copy()
    last = first + len(T) - 1
    for start, end in pairwise(sorted({first, last, *hands.keys})):
        frames = range(start, end + 1)
        followed: dict[int, list[tuple[TrackedVertices, float]]] = {n: [] for n in frames if n not in hands.keys}
        for key, order in ((start, frames), (end, frames[::-1])):
            if key in hands.keys and followed:
                seen = _visible_vertices(vertices[key - first], hand.faces, K_small, small)
                grey = (_downscale_grey(image(n), small) for n in order)
                for n, points in zip(order, _track_vertices(grey, uv[np.array(order) - first], seen), strict=True):
                    if n in followed:
                        followed[n].append((points, 1.0 / abs(n - key)))
        for n, points_and_shares in followed.items():
            moved = _fit_similarity(uv[n - first], points_and_shares)
            if moved is not None:
                T[n - first] = _apply_similarity(moved, T[n - first], K_small)
    return replace(hands, hand=replace(hand, T_cam_hand=T))


def _downscale_grey(image: UInt8[ndarray, "H W 3"], size: tuple[int, int]) -> UInt8[ndarray, "h w"]:
    import cv2

    return np.asarray(cv2.cvtColor(cv2.resize(image, size, interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2GRAY), np.uint8)


def _visible_vertices(
    vertices: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"], K: Float[ndarray, "3 3"], size: tuple[int, int]
) -> Int[ndarray, "n"]:
    """Return the vertices in view that the hand does not hide."""
    depth, _ = depth_and_face(vertices, faces, K, size)
    u, v = np.floor(project(K, vertices)).astype(int).T
    inside = (u >= 0) & (v >= 0) & (u < size[0]) & (v < size[1])
    near = vertices[:, 2] < depth[np.where(inside, v, 0), np.where(inside, u, 0)] + 0.004
    return np.flatnonzero(inside & near)


class TrackedVertices(NamedTuple):
    """Vertices tracked to a frame."""

    ids: Int[ndarray, "n"]
    uv: Float[ndarray, "n 2"]
    """[px]"""


def _track_vertices(
    grey: Iterator[UInt8[ndarray, "h w"]], uv: Float[ndarray, "T V 2"], ids: Int[ndarray, "n"]
) -> Iterator[TrackedVertices]:
    """Track vertices from the first image on, without lost ones; ``uv`` are all vertices' expected places [px]."""
    points = TrackedVertices(ids, uv[0, ids])
    yield points
    for k, (before, after) in enumerate(pairwise(grey)):
        if len(points.ids):
            old = (points.uv - 0.5).astype(np.float32)  # OpenCV's pixels have their middle at whole numbers
            step = (uv[k + 1, points.ids] - uv[k, points.ids]).astype(np.float32)
            new, found = _lucas_kanade(before, after, old, old + step)
            back, again = _lucas_kanade(after, before, new, new - step)
            kept = found & again & (np.linalg.norm(back - old, axis=1) < ROUND_TRIP_TOLERANCE_PX)
            points = TrackedVertices(points.ids[kept], new[kept].astype(float) + 0.5)
        yield points


def _lucas_kanade(
    before: UInt8[ndarray, "h w"],
    after: UInt8[ndarray, "h w"],
    old: Float32[ndarray, "n 2"],
    guess: Float32[ndarray, "n 2"],
) -> tuple[Float32[ndarray, "n 2"], Bool[ndarray, "n"]]:
    """Track points from an image to another; also return whether they were found."""
    import cv2

    steps = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 30, 0.01)
    settings = (LK_WINDOW_PX, LK_WINDOW_PX), LK_PYRAMID_LEVELS, steps, cv2.OPTFLOW_USE_INITIAL_FLOW
    new, found, _ = cv2.calcOpticalFlowPyrLK(before, after, old, guess, None, None, *settings)
    return np.asarray(new, np.float32), np.asarray(found)[:, 0] == 1


def _fit_similarity(
    uv: Float[ndarray, "V 2"], followed: Sequence[tuple[TrackedVertices, float]]
) -> tuple[complex, complex] | None:
    """Fit a, b such that a z + b takes the hand's vertices z = u + i v to the tracked ones; None with too few vertices.

    Vertices of each clicked frame have a weight.
    """
    kept = [(points, share) for points, share in followed if len(points.ids) >= MIN_TRACKED_POINTS and share > 0.0]
    if not kept:
        return None
    z = np.concatenate([uv[points.ids] for points, _ in kept]) @ [1.0, 1.0j]
    y = np.concatenate([points.uv for points, _ in kept]) @ [1.0, 1.0j]
    shares = np.concatenate([np.full(len(points.ids), share / len(points.ids)) for points, share in kept])
    a, b = 1.0 + 0.0j, 0.0 + 0.0j
    for _ in range(10):
        weight = shares / (1.0 + np.abs(a * z + b - y) ** 2 / CAUCHY_SCALE_PX**2)
        weight /= weight.sum()
        z0, y0 = weight @ z, weight @ y
        a = np.sum(weight * np.conj(z - z0) * (y - y0)) / np.sum(weight * np.abs(z - z0) ** 2)
        b = y0 - a * z0
    return complex(a), complex(b)


def _apply_similarity(
    similarity: tuple[complex, complex], T_cam_hand: Float[ndarray, "4 4"], K: Float[ndarray, "3 3"]
) -> Float[ndarray, "4 4"]:
    """Apply a similarity of the image to a hand: turn about its ray, depth and shift."""
    a, b = similarity
    u, v = project(K, T_cam_hand[None, :3, 3])[0]
    to = a * (u + 1j * v) + b
    t = backproject(K, np.array([[to.real, to.imag]]))[0] * T_cam_hand[2, 3] / abs(a)
    roll = se3.exp_so3(np.array([0.0, 0.0, np.angle(a)]))
    return se3.rigid(roll @ T_cam_hand[:3, :3], t)
