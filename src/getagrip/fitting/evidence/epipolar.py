"""Views whose masks contradict each other by the geometry of their cameras alone, before any fit.

Two cameras and a point span a plane. Of all planes through the line between the cameras (epipolar planes), those that
meet an object are an interval of angles about that line, and both cameras see its ends: the object's silhouettes touch
them. So the intervals of two views must be equal, whatever the object and its pose. A camera at another place or
turned, other intrinsics, mirrored images, another scene or another time shift a view's interval.

A hidden object may reach as far as its occluders. So of each view two intervals are known: that of the object's visible
pixels, and that of these and of all ignored pixels; the first of one view must be within the second of the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
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
    seen = {OWN_VIEW: _SeenClip(clip, masks, np.tile(np.eye(4), (len(clip), 1, 1)))}
    for view in views_of(clip):
        seen[view.name] = _SeenClip(clip_in_view(clip, view), view.masks, view.T_cam_view)
    apart = {pair: _contradiction(seen[pair[0]], seen[pair[1]]) for pair in combinations(seen, 2)}
    out = dict[str, float]()
    while True:
        wrong = {pair: value for pair, value in apart.items() if value > MAX_CONTRADICTION and not {*pair} & {*out}}
        if not wrong:
            return out
        total = {name: sum(v for pair, v in wrong.items() if name in pair) for name in seen if name != OWN_VIEW}
        worst = max(total, key=lambda name: total[name])
        out[worst] = max(value for pair, value in wrong.items() if worst in pair)


@dataclass(frozen=True)
class _SeenClip:
    """A clip as one of its views shows it, its masks, and ``T_cam_view``."""

    clip: Clip
    masks: Masks
    T_cam_view: Float[ndarray, "T 4 4"]

    @cached_property
    def observed(self) -> Bool[ndarray, "T"]:
        return self.masks.observed

    @cached_property
    def draws_hand(self) -> bool:
        """True if the hand is rendered as the occluder, since the masks say of none."""
        return not self.masks.say_what_hides

    @cached_property
    def outlines(self) -> dict[int, _Outline | None]:
        """Outlines of the frames that were asked for; None where the object touches the border."""
        return {}

    def outline(self, n: int) -> _Outline | None:
        """Compute the outline of a frame once; None where the object touches the border."""
        if n not in self.outlines:
            self.outlines[n] = self._outline(n)
        return self.outlines[n]

    def _outline(self, n: int) -> _Outline | None:
        one = self.masks.take(np.array([n]))
        if self.draws_hand:
            one = occluded_by_hand(self.clip.take(np.array([n])), one)
        box = (0, 0, *self.clip.size)
        pixels = pack_masks(one.object).frames[0].part(box)
        if _touches_border(pixels):
            return None
        T, K, possible = self.T_cam_view[n], self.clip.K[n], pixels | pack_masks(one.ignore).frames[0].part(box)
        return _Outline(T[:3, 3], *(_hull_rays(K, part) @ T[:3, :3].T for part in (pixels, possible)))


def _touches_border(pixels: Bool[ndarray, "H W"]) -> bool:
    return bool(pixels[[0, -1]].any() or pixels[:, [0, -1]].any())


def _hull_rays(K: Float[ndarray, "3 3"], pixels: Bool[ndarray, "H W"]) -> Float[ndarray, "k 3"]:
    """Return the rays through the corners of the convex hull of some pixels, in the camera frame."""
    v, u = np.nonzero(pixels)
    hull = cv2.convexHull(np.stack([u, v], axis=1).astype(np.int32))[:, 0] + 0.5
    uv1 = backproject(K[None], hull[None].astype(float))[0]
    return np.asarray(uv1)


def _contradiction(one: _SeenClip, other: _SeenClip) -> float:
    """Compute the median contradiction of two views over frames that both show [widths]; NaN without any."""
    rows = np.flatnonzero(one.observed & other.observed)
    rows = rows[frame_indices(len(rows), N_AGREEMENT_FRAMES)] if len(rows) else rows
    both = []
    for n in rows.tolist():
        mine, theirs = one.outline(n), other.outline(n)
        if mine is not None and theirs is not None and np.isfinite(value := _frame_contradiction(mine, theirs)):
            both.append(value)
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
