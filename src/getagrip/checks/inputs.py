"""Checks of inputs: sizes and distances that a grasp makes plausible, the side of the hand, the order of frames.

While a grasp is stable, a point fixed in the hand stays near the centroid of the object's mask in every frame, and the
rendered hand over the ignored pixels that belong to the hand. Masks that fit much better in another order (reversed, or
shifted) are probably in the wrong one. Where hand and camera hardly move, all orders fit equally.

Masks that are a few frames late hardly displace their centroids; but the pixels of the hand are late, too, and its
outline shows a delay of a frame or two where it moves (``mask_delay``).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.checks.evidence import Evidence
from getagrip.clip.clip import frame_indices
from getagrip.geometry.mesh import face_areas
from getagrip.metrics.contact import close_holes

WRIST_JOINT, INDEX_MCP, MIDDLE_MCP, PINKY_MCP = 0, 5, 9, 17
"""Indices of the 21 joints: the wrist, and the first joints of three fingers."""
FOUR_FINGER_MCP_JOINTS, FOUR_FINGERTIP_JOINTS = np.array([5, 9, 13, 17]), np.array([8, 12, 16, 20])
HAND_PRIOR_DISTANCE_M = 0.15
"""Distance from the hand's middle at which the prior on the point has a hundredth of the weight of the masks [m]."""
MIN_SHIFTED_FRACTION = 0.6
"""Minimum fraction of the frames that overlap after a shift."""
MIN_ORDER_FRAMES, MAX_ORDER_FRAMES = 5, 60
"""Minimum and maximum number of frames whose order is checked."""
MIN_CENTROID_ERROR, MIN_HAND_OVERLAP = 0.05, 0.05
"""Minimum distance, in sizes of the mask, and minimum overlap that are distinguished."""


def size_at_scale(it: Evidence, scale: str, size: float) -> float:
    """Return ``size`` where the clip's scale is ``scale`` ("known" or "free"), else NaN."""
    return size if it.clip.scale == scale else np.nan


def lifted_hand_size(it: Evidence) -> float:
    """Return the size of a lifted hand, relative to a mean hand, where depth or the object's size determine it."""
    if it.clip.size_beside_hand:
        return 1.0 / it.scale
    return np.nan if it.clip.hand_scale == 1.0 else it.clip.hand_scale


def edge_share(it: Evidence) -> float:
    """Compute the fraction of the image's edge that the masks cover, median over frames; 1 for the background."""
    width, height = it.clip.size
    columns, rows = np.arange(width), np.arange(height)
    each = [
        (mask.grid(rows[[0, -1]], columns).mean(), mask.grid(rows, columns[[0, -1]]).mean()) for mask in it.shown.frames
    ]
    edges = np.array(each).T
    return float(np.median((width * edges[0] + height * edges[1]) / (width + height)))


def focal_jump(it: Evidence) -> float:
    """Compute the largest ratio of focal lengths of consecutive frames."""
    steps = np.abs(np.diff(np.log(it.clip.K[:, [0, 1], [0, 1]]), axis=0))
    return float(np.exp(steps.max(initial=0.0)))


def median_hand_object_gap(it: Evidence) -> float:
    """Compute the least distance of hand and object, median over frames [mm]; 0 in contact."""
    return 1e3 * float(np.median(np.maximum(it.to_object.min(axis=1), 0.0)))


def penetration_depth(it: Evidence) -> float:
    """Compute the depth of the hand's deepest point inside the object, median over frames [mm]."""
    return 1e3 * float(np.median(np.maximum(-it.to_object.min(axis=1), 0.0)))


def second_contact_gap(it: Evidence) -> float:
    """Compute the distance of the second nearest contact region of the hand, median over frames [mm]; 0 in contact."""
    regions = it.region_distance
    if regions.shape[1] < 2:
        return np.nan
    return 1e3 * float(np.median(np.maximum(np.sort(regions, axis=1)[:, 1], 0.0)))


def hole_share(it: Evidence) -> float:
    """Compute the fraction of the holes in the area of mesh and holes; holes are closed by fans."""
    mesh = it.clip.mesh
    area = face_areas(*close_holes(mesh.vertices, mesh.faces))
    return float(area[len(mesh.faces) :].sum() / area.sum())


def extents(it: Evidence) -> list[float]:
    """Compute the sides of the mesh's box along its principal axes, relative to the largest, in ascending order."""
    about = it.clip.mesh.vertices - it.clip.mesh.vertices.mean(axis=0)
    _, axes = np.linalg.eigh(np.cov(about.T))
    sides = np.sort(np.ptp(about @ axes, axis=0))
    return np.asarray(sides / sides[-1]).tolist()


def finger_bend(it: Evidence) -> float:
    """Compute the angle by which the fingers bend towards the palm, median over frames [degrees]; NaN without joints.

    It is negative for the hand of the other side. With the palm in front and the fingers up, a right hand's index is
    right of its little finger: the vector from little finger to index, crossed with wrist to fingers, points out of the
    palm, towards bent fingers.
    """
    joints = it.clip.hand.joints
    if joints is None:
        return np.nan
    along = _normalize(joints[:, MIDDLE_MCP] - joints[:, WRIST_JOINT])
    out = _normalize(np.cross(joints[:, INDEX_MCP] - joints[:, PINKY_MCP], along))
    fingers = (joints[:, FOUR_FINGERTIP_JOINTS] - joints[:, FOUR_FINGER_MCP_JOINTS]).mean(axis=1)
    angle = np.degrees(np.arctan2(np.sum(fingers * out, axis=1), np.abs(np.sum(fingers * along, axis=1))))
    return float(np.median(angle if it.clip.side == "right" else -angle))


def _normalize(v: Float[ndarray, "T 3"]) -> Float[ndarray, "T 3"]:
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=1, keepdims=True), 1e-12))


@dataclass(frozen=True)
class MaskDelay:
    """The delay of the masks behind the hands.

    Attributes:
        frames: delay in frames, counted by their names; negative: masks are early.
        times: factor by which hands overlap their pixels better without the delay; 1: no delay. NaN without pixels.
    """

    frames: int
    times: float

    def __str__(self) -> str:
        count = f"{abs(self.frames)} frame{'s' if abs(self.frames) > 1 else ''}"
        when = "late" if self.frames > 0 else "early"
        return f"masks seem to come {count} {when}: shifted, they would meet the hands {self.times:.2f} times better"


def centroid_error(it: Evidence) -> float:
    """Compute the distance of the masks' centroids from a point that moves with the hand [roots of the mask's area]."""
    here = np.flatnonzero(it.mask_area > 0)
    return _centroid_rmse(it, here, here) if len(here) >= MIN_ORDER_FRAMES else float("nan")


def reordering_gain(it: Evidence) -> float:
    """Compute the factor by which the masks fit the hands better in another order; 1: in none.

    The factor is the ratio of the centroids' errors, times the ratio of the overlaps of hands and ignored pixels, if
    any.
    """
    few = frame_indices(len(it.mask_area), MAX_ORDER_FRAMES)
    shown = it.mask_area > 0
    overlap = _pairwise_iou(it.drawn_hands, it.small_ignore) if it.masks.say_what_hides else None
    best = 1.0 if shown.sum() >= MIN_ORDER_FRAMES else float("nan")
    for frames, others in ((few[n], few[m]) for n, m in _candidate_orders(len(few))):
        both = shown[frames] & shown[others]
        n, m = frames[both], others[both]
        if len(n) < MIN_ORDER_FRAMES:
            continue
        times = _centroid_rmse(it, n, n) / max(_centroid_rmse(it, n, m), MIN_CENTROID_ERROR)
        if overlap is not None:
            times *= overlap[n, m].mean() / max(overlap[n, n].mean(), MIN_HAND_OVERLAP)
        best = max(best, times)
    return best


def mask_delay(it: Evidence) -> MaskDelay:
    """Find the shift at which the hands best overlap their masks or, without hand masks, the ignored pixels."""
    pixels, known = it.small_hand_pixels, it.masks.known
    best = MaskDelay(0, 1.0 if pixels[known].any() and len(pixels) >= MIN_ORDER_FRAMES else float("nan"))
    overlap, when = _pairwise_iou(it.drawn_hands, pixels), it.clip.time * it.clip.fps
    for frames, others in _frame_shifts(len(pixels)):
        both = known[frames] & known[others]
        n, m = frames[both], others[both]
        if 2 * len(n) < known.sum():
            continue
        times = float(overlap[n, m].mean() / max(overlap[n, n].mean(), MIN_HAND_OVERLAP))
        if times > best.times:
            best = MaskDelay(round(float(np.median(when[m] - when[n]))), times)
    return best


def _candidate_orders(count: int) -> Iterator[tuple[Int[ndarray, "n"], Int[ndarray, "n"]]]:
    """Yield frames and, for each, the frame whose mask it may have: reversed, and shifted either way."""
    every = np.arange(count)
    yield every, every[::-1]
    yield from _frame_shifts(count)


def _frame_shifts(count: int) -> Iterator[tuple[Int[ndarray, "n"], Int[ndarray, "n"]]]:
    """Yield frames, and the same frames shifted by one or more."""
    every = np.arange(count)
    for shift in range(1, int((1.0 - MIN_SHIFTED_FRACTION) * count) + 1):
        yield every[shift:], every[:-shift]
        yield every[:-shift], every[shift:]


def _centroid_rmse(it: Evidence, frames: Int[ndarray, "n"], masks: Int[ndarray, "n"]) -> float:
    """Root mean square distance of the masks' centroids from the projection of the best point fixed in the hand."""
    hand, K = it.clip.hand, it.clip.K[frames]
    middle = it.hand_middle[frames].mean(axis=0)
    P, uv, depth = K @ hand.T_cam_hand[frames, :3], it.centroids[masks], it.depth[frames]
    size = max(np.sqrt(np.median(it.mask_area[masks])), it.expected_size)
    rows = (P[:, :2] - uv[..., None] * P[:, 2:]) / (size * depth[:, None, None])  # (n, 2, 4): approximate pixel errors
    A, b = rows[..., :3].reshape(-1, 3), -(rows @ np.append(middle, 1.0)).ravel()
    ridge = 0.01 * len(frames) / HAND_PRIOR_DISTANCE_M**2
    p = np.linalg.solve(A.T @ A + ridge * np.eye(3), A.T @ b)
    return float(np.sqrt(np.sum((A @ p - b) ** 2) / len(frames)))


def _pairwise_iou(hands: Bool[ndarray, "T h w"], pixels: Bool[ndarray, "T h w"]) -> Float[ndarray, "T T"]:
    hands, pixels = (x.reshape(len(x), -1).astype(np.float32) for x in (hands, pixels))
    both = hands @ pixels.T
    either = hands.sum(axis=1)[:, None] + pixels.sum(axis=1)[None] - both
    return both / np.maximum(either, 1.0)
