"""Views whose masks contradict each other by the geometry of their cameras alone, before any fit.

Two cameras and a point span a plane. Of all planes through the line between the cameras (epipolar planes), those that
meet an object are an interval of angles about that line, and both cameras see its ends: the object's silhouettes touch
them. So the intervals of two views must be equal, whatever the object and its pose. A camera at another place or
turned, other intrinsics, mirrored images, another scene or another time shift a view's interval.

A hidden object may reach as far as its occluders. So of each view two intervals are known: that of the object's visible
pixels, and that of these and of all ignored pixels; the first of one view must be within the second of the other.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import cv2
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.clip import Clip, Masks
from getagrip.clip.clip import frame_indices
from getagrip.clip.masks import occluded_by_hand
from getagrip.clip.views import clip_in_view, views_of
from getagrip.geometry.camera import backproject
from getagrip.io.images import pack_masks

N_AGREEMENT_FRAMES = 12
"""Number of frames that are compared, evenly spread over those that both views show."""
MAX_CONTRADICTION = 0.12
"""Maximum difference of the intervals, median over frames [widths of the object's interval]."""
MIN_BASELINE_M, MIN_BASELINE_ANGLE = 0.01, np.radians(5.0)
"""Minimum distance of two cameras [m], and minimum angle of the object's direction from the line between them: below,
the interval says nothing."""
OWN_VIEW = ""
"""Name of the clip's own view."""


@dataclass(frozen=True)
class _Outline:
    """Rays of a view through the hulls of a frame's pixels, in the clip's camera frame, from the camera's place."""

    eye: Float[ndarray, "3"]
    seen: Float[ndarray, "k 3"]
    possible: Float[ndarray, "m 3"]


def contradicting_views(clip: Clip, masks: Masks) -> dict[str, float]:
    """Find the further views of a clip that contradict it, or each other; return their contradictions [widths].

    The view with the largest contradictions is left out, then all others are compared again. Of two views the further
    one is left out.
    """
    if not views_of(clip):
        return {}
    outlines = {OWN_VIEW: _outlines(clip, masks, np.tile(np.eye(4), (len(clip), 1, 1)))}
    for view in views_of(clip):
        outlines[view.name] = _outlines(clip_in_view(clip, view), view.masks, view.T_cam_view)
    apart = {pair: _contradiction(outlines[pair[0]], outlines[pair[1]]) for pair in combinations(outlines, 2)}
    out = dict[str, float]()
    while True:
        wrong = {pair: value for pair, value in apart.items() if value > MAX_CONTRADICTION and not {*pair} & {*out}}
        if not wrong:
            return out
        total = {name: sum(v for pair, v in wrong.items() if name in pair) for name in outlines if name != OWN_VIEW}
        worst = max(total, key=lambda name: total[name])
        out[worst] = max(value for pair, value in wrong.items() if worst in pair)


def _outlines(clip: Clip, masks: Masks, T_cam_view: Float[ndarray, "T 4 4"]) -> Mapping[int, _Outline]:
    """Compute the outlines of a view in the frames that show the object whole, but for occluders."""
    rows = np.flatnonzero(masks.observed)
    rows = rows[frame_indices(len(rows), N_AGREEMENT_FRAMES)] if len(rows) else rows
    some = masks.take(rows)
    if len(rows) and not some.say_what_hides:
        some = occluded_by_hand(clip.take(rows), some)
    out = {}
    for n, shown, hidden in zip(
        rows.tolist(), pack_masks(some.object).frames, pack_masks(some.ignore).frames, strict=True
    ):
        box = (0, 0, *clip.size)
        pixels = shown.part(box)
        if _touches_border(pixels):
            continue
        T, K = T_cam_view[n], clip.K[n]
        seen, possible = (_hull_rays(K, part) @ T[:3, :3].T for part in (pixels, pixels | hidden.part(box)))
        out[n] = _Outline(T[:3, 3], seen, possible)
    return out


def _touches_border(pixels: Bool[ndarray, "H W"]) -> bool:
    return bool(pixels[[0, -1]].any() or pixels[:, [0, -1]].any())


def _hull_rays(K: Float[ndarray, "3 3"], pixels: Bool[ndarray, "H W"]) -> Float[ndarray, "k 3"]:
    """Return the rays through the corners of the convex hull of some pixels, in the camera frame."""
    v, u = np.nonzero(pixels)
    hull = cv2.convexHull(np.stack([u, v], axis=1).astype(np.int32))[:, 0] + 0.5
    uv1 = backproject(K[None], hull[None].astype(float))[0]
    return np.asarray(uv1)


def _contradiction(one: Mapping[int, _Outline], other: Mapping[int, _Outline]) -> float:
    """Compute the median contradiction of two views over the frames that both show [widths]; NaN without any."""
    both = [found for n in one.keys() & other.keys() if np.isfinite(found := _frame_contradiction(one[n], other[n]))]
    return float(np.median(both)) if both else float("nan")


def _frame_contradiction(one: _Outline, other: _Outline) -> float:
    """Compute how far either view's visible interval leaves the other's possible one, in its width; NaN if unknown."""
    baseline = other.eye - one.eye
    length = float(np.linalg.norm(baseline))
    if length < MIN_BASELINE_M:
        return float("nan")
    along = baseline / length
    middle = one.seen.mean(axis=0)
    across = middle - (middle @ along) * along
    if np.linalg.norm(across) < np.sin(MIN_BASELINE_ANGLE) * np.linalg.norm(middle):
        return float("nan")
    across /= np.linalg.norm(across)
    beside = np.cross(along, across)

    def interval(rays: Float[ndarray, "k 3"]) -> tuple[float, float]:
        angles = np.arctan2(rays @ beside, rays @ across)
        return float(angles.min()), float(angles.max())

    (low, high), (least, most) = interval(one.seen), interval(one.possible)
    (other_low, other_high), (other_least, other_most) = interval(other.seen), interval(other.possible)
    beyond = max(other_least - low, high - other_most, least - other_low, other_high - most, 0.0)
    return beyond / max(0.5 * (high - low + other_high - other_low), 1e-6)
