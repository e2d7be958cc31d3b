"""Two masks of a frame, carried from the key before and the key after, merged into one.

Where they differ the object has come into view since one of the keys, or was lost on the way from it. Which of the two
it is shows in the colours: a cut decides, by those of the keys and by how near and how sure the keys are. Then the
border is drawn anew.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float32, Int32, UInt8
from numpy import ndarray

from getagrip.annotate.carried_masks import (
    BORDER_SIGMA_PX,
    MAX_COLOUR_LOG_RATIO,
    MAX_SIGNED_DISTANCE_PX,
    SEEN_PIXEL_CONFIDENCE,
    TrackedMask,
    is_occluded,
    place_in_window,
    refine_border,
    signed_distance,
)
from getagrip.annotate.colour_cut import ColourHistogram, LocalColourHistogram, colour_log_ratio, edge_cost, minimal_cut
from getagrip.annotate.shared_flow import SmallFrame

SIDE_PRIOR_WEIGHT = 0.5
"""Weight of the sides beside the colours' mean, in multiples of one ``BORDER_SIGMA_PX``."""
AGREED_PIXEL_COST = 10.0
"""Cost of a pixel on the other side than where both have it."""
MIN_BORDER_CERTAINTY, AGREED_BORDER_CERTAINTY = 0.1, 0.2
"""Certainty of the merged border, when it is drawn anew, where the two differ, and where they are alike: from 0,
colours alone, to 1. Near to a key it is that key's."""


def merge_masks(
    one: TrackedMask, other: TrackedMask, share: float, frame: SmallFrame, colours: Sequence[ColourHistogram]
) -> tuple[TrackedMask, float]:
    """Make one mask of two of a frame, whose ``frame`` is of the size at which they were carried.

    ``share`` is how far the frame is from the key of ``one`` to the other's, 0 to 1; ``colours`` are the keys'. Also
    returned is its confidence, from the agreement of the two (intersection over union) where both are known.
    """
    left, top = np.minimum(one.corner, other.corner).tolist()
    ends = [np.add(each.corner, each.inside.shape[:0:-1]) for each in (one, other)]
    width, height = (np.maximum(*ends) - (left, top)).tolist()
    (a, known_a), (b, known_b) = (place_in_window(each, (left, top), (width, height)) for each in (one, other))
    trust_a, trust_b = (1.0 - share) * one.trust, share * other.trust
    weight_a, weight_b = trust_a * known_a + 1e-6, trust_b * known_b + 1e-6
    share_b = weight_b / (weight_a + weight_b)
    inside = (a + (b - a) * share_b).astype(np.float32)
    front_a, front_b = (np.clip(each[1:], -2.0 * BORDER_SIGMA_PX, 2.0 * BORDER_SIGMA_PX) for each in (a, b))
    inside[1:] = front_a + (front_b - front_a) * (trust_b + 1e-6) / (trust_a + trust_b + 2e-6)
    hidden = is_occluded(inside)
    shown_a, shown_b = known_a >= SEEN_PIXEL_CONFIDENCE / 2.0, known_b >= SEEN_PIXEL_CONFIDENCE / 2.0
    both = shown_a & shown_b & (inside[1:] <= 0).all(axis=0)
    in_a, in_b = a[0] > 0, b[0] > 0
    union = np.count_nonzero(both & (in_a | in_b))
    agreement = np.count_nonzero(both & in_a & in_b) / union if union else 1.0
    part = slice(top, top + height), slice(left, left + width)
    image, at = frame.image[part], frame.bins[part]
    if (inside[0] > -MAX_SIGNED_DISTANCE_PX).any() and at.size:
        side_a, side_b = (np.clip(each[0] / BORDER_SIGMA_PX, -2.0, 2.0) for each in (a, b))
        likely = colour_log_ratio(at, colours[0]) + _merge_ground_evidence((one, other), (left, top), (width, height))
        likely = np.clip(likely, -MAX_COLOUR_LOG_RATIO, MAX_COLOUR_LOG_RATIO)
        in_a, in_b = np.where(shown_b & ~shown_a, in_b, in_a), np.where(shown_a & ~shown_b, in_a, in_b)
        alike = AGREED_BORDER_CERTAINTY * np.exp(-np.square((a[0] - b[0]) / BORDER_SIGMA_PX)) * (shown_a & shown_b)
        nearest = np.square(np.maximum(weight_a, weight_b))
        certain = np.maximum(MIN_BORDER_CERTAINTY, np.maximum(alike, nearest)).astype(np.float32)
        found = _resolve_disagreement(image, in_a, in_b, side_a + (side_b - side_a) * share_b, likely * ~hidden)
        inside[0] = _redraw_border(image, at, found, certain, likely, colours[0], hidden)
    known = np.maximum(known_a, known_b)
    confidence = _merge_confidence(agreement, share, one.trust, other.trust)
    return one._replace(corner=(left, top), inside=inside, known=known), confidence


def _merge_confidence(agreement: float, share: float, trust: float, other_trust: float) -> float:
    """Return how much of the merged mask is expected to be right.

    A pixel is lost where both sides are wrong, and hardly near to a key. What lies beyond a cut does not count: the
    other side's trust does.
    """
    if trust > 0.0 and other_trust > 0.0:
        return float(1.0 - 4.0 * share * (1.0 - share) * (1.0 - agreement) ** 2)
    return float(min(agreement, max(trust, other_trust)))


def _resolve_disagreement(
    image: UInt8[ndarray, "h w 3"],
    one: Bool[ndarray, "h w"],
    other: Bool[ndarray, "h w"],
    sides: Float32[ndarray, "h w"],
    likely: Float32[ndarray, "h w"],
) -> Bool[ndarray, "h w"]:
    """Return what is in both masks, and what ``sides`` and colours speak for of what is in one of them."""
    cost = np.where(
        one ^ other, -(likely + SIDE_PRIOR_WEIGHT * sides), np.where(one, -AGREED_PIXEL_COST, AGREED_PIXEL_COST)
    )
    return minimal_cut(cost.astype(np.float32), edge_cost(image), np.add(one, other, dtype=np.float32) / 2.0)


def _merge_ground_evidence(
    some: Sequence[TrackedMask], corner: tuple[int, int], size: tuple[int, int]
) -> Float32[ndarray, "h w"]:
    """Return how unlike the ground pixels are: that ground which fits best, where one does."""
    found = np.zeros((len(some), *size[::-1]), np.float32)
    for out, each in zip(found, some, strict=True):
        (left, top), (h, w) = np.subtract(each.corner, corner).tolist(), each.unlike.shape
        out[top : top + h, left : left + w] = each.unlike
    least = found.min(axis=0)
    return np.where(least < 0.0, least, found.max(axis=0))


def _redraw_border(
    image: UInt8[ndarray, "h w 3"],
    at: Int32[ndarray, "h w"],
    found: Bool[ndarray, "h w"],
    certain: Float32[ndarray, "h w"],
    likely: Float32[ndarray, "h w"],
    colours: ColourHistogram,
    hidden: Bool[ndarray, "h w"],
) -> Float32[ndarray, "h w"]:
    """Return signed distances from the border that colours draw: the keys' and those near to it in this image."""
    inside = signed_distance(found)
    x, y = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in found.shape[::-1]))
    here = colour_log_ratio(at, colours, LocalColourHistogram.of(at, found, ~hidden & (np.abs(inside) > 1.0)), (x, y))
    return refine_border(
        image, inside, certain, np.clip(here, -MAX_COLOUR_LOG_RATIO, MAX_COLOUR_LOG_RATIO) + likely, hidden
    )
