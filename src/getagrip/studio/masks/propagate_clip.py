"""Propagate the label maps of a few key frames to all frames.

Each mask is propagated as a signed distance from its border (``propagate_frame``): from the key frame before forwards,
and from the key frame after backwards; it depends on these two alone. Both are merged: where they differ, the object
has come into view since one of the key frames, or was lost on the way from it. A minimal cut decides, by the colours
and the background of the key frames, and by distance and trust of both. At last the border is redrawn at full size.

The confidence of a frame is the fraction of its mask that is expected to be right: 1 on key frames, 0 from the frame on
in which the object is lost. Between two key frames a pixel is wrong only if both masks are wrong; confidence is high
near either. Before the first key frame, after the last and up to a cut it is the trust of the single mask.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Int32, UInt8
from numpy import ndarray

from getagrip.errors import UsageError
from getagrip.studio.masks.graph_cut import (
    ColourHistogram,
    LocalColourHistogram,
    colour_log_ratio,
    edge_cost,
    minimal_cut,
)
from getagrip.studio.masks.propagate_frame import (
    BORDER_SIGMA_PX,
    MAX_COLOUR_LOG_RATIO,
    MAX_SIGNED_DISTANCE_PX,
    SEEN_PIXEL_CONFIDENCE,
    TRACKED_LABELS,
    Hands,
    Images,
    TrackedMask,
    is_occluded,
    keyframe_histograms,
    place_in_window,
    refine_border,
    signed_distance,
    track_mask,
)
from getagrip.studio.masks.small_frames import ArrayFile, SmallFrame, SmallFrames
from getagrip.studio.store.labels import HAND_LABEL, OBJECT_LABEL, OCCLUDER_LABEL

OBJECT_WORKING_SIZE_PX, SPARSE_WORKING_SIZE_PX = 200.0, 100.0
"""Longer side of the object in the reduced images in which masks are propagated, and of those of a few frames [px]."""
MAX_UPSCALED_PIXELS = 1e6
"""Number of pixels up to which images of small objects are enlarged for this."""
MIN_COMPONENT_AREA_RATIO = 0.25
"""Area of a component, as a fraction of the largest one's, below which it may not be the object."""
VANISHED_AREA_FRACTION, SHRUNK_AREA_FRACTION, MAX_SHRINKING_FRAMES = 0.05, 0.4, 60
"""Area, as a fraction of the key frame's, below which the object is lost; area below which it is shrinking: it is lost
from the shrinking's start, at most this number of frames earlier."""
ADJACENCY_KERNEL_PX = 9
"""Side of the square around a pixel within which other pixels are adjacent [px]."""
SIDE_PRIOR_WEIGHT = 0.5
"""Weight of signed distances, in multiples of ``BORDER_SIGMA_PX``, relative to the log ratio of colours."""
AGREED_PIXEL_COST = 10.0
"""Cost of a pixel whose label differs from both masks' common label."""
MIN_BORDER_CERTAINTY, AGREED_BORDER_CERTAINTY = 0.1, 0.2
"""Certainty of the merged border before it is redrawn, where both masks differ and where they agree; 0: colours alone
decide. Near a key frame the certainty is higher."""
BORDER_SEARCH_PX = 2.5
"""Largest shift of the border at full size [px of the reduced size]."""
SIDE_INTERIOR_PX = 0.8
"""Distance from the border beyond which pixels count for the colours of their side [px of the reduced size]."""
COLOUR_WINDOW_RADIUS_PX = 4.0
"""Half side of the squares in which colours are averaged: small, but reaching both sides from any place of the border
[px of the reduced size]."""
BORDER_SMOOTHING_PX = 0.5
"""Standard deviation of the Gaussian that smooths the border [px of the reduced size]."""
SIDE_COLOUR_SIGMA = 4.0
"""Standard deviation of a side's colours [of 255]."""


class PropagatedLabels(NamedTuple):
    """The label map of a frame."""

    frame: int
    labels: UInt8[ndarray, "H W"]
    """0, ``OBJECT_LABEL``, ``OCCLUDER_LABEL`` or ``HAND_LABEL``."""
    confidence: float
    """0 (the object is lost) to 1 (as drawn)."""


class KeyframeSpan(NamedTuple):
    """Consecutive frames, ends included, whose masks come from the same key frames."""

    first: int
    last: int
    keys: tuple[int, ...]
    """The key frame itself; else the key frames before and after, one or two."""


def keyframe_spans(keys: Iterable[int], first: int, last: int) -> Iterator[KeyframeSpan]:
    """Yield the spans between ``keys`` that make up the frames ``first`` to ``last``, both included, in order."""
    for before, after in pairwise([None, *sorted(keys), None]):
        if before is not None:
            yield KeyframeSpan(before, before, (before,))
        start, end = first if before is None else before + 1, last if after is None else after - 1
        if start <= end:
            yield KeyframeSpan(start, end, tuple(key for key in (before, after) if key is not None))


def propagate_labels(
    image: Images,
    keys: Mapping[int, UInt8[ndarray, "H W"]],
    first: int,
    last: int,
    known: Container[int] = (),
    hand: Hands = lambda _: None,
    working_size_px: float | None = None,
) -> Iterator[PropagatedLabels]:
    """Yield the label maps of the frames ``first`` to ``last``, both included, in order; key frames' are unchanged.

    ``keys`` are the key frames' label maps. ``hand`` returns the visible hand, if it is known; a hand drawn on a key
    frame replaces it up to the adjacent key frames. ``working_size_px`` is the longer side of the object in the reduced
    images, by default ``OBJECT_WORKING_SIZE_PX``.

    Spans are skipped if all their frames are ``known``. Images are read from one key frame to the next and back. Raises
    ``UsageError`` where no key frame shows the object, or key frames are outside the interval or of different sizes.
    """
    _check_keyframes(keys, first, last)
    for span in keyframe_spans(keys, first, last):
        if not all(n in known for n in range(span.first, span.last + 1)):
            own = {n: keys[n] for n in span.keys}
            yield from _propagate_span(image, own, span, hand, working_size_px or OBJECT_WORKING_SIZE_PX)


def propagate_sparsely(
    image: Images, keys: Mapping[int, UInt8[ndarray, "H W"]], first: int, last: int, count: int, hand: Hands
) -> Iterator[PropagatedLabels]:
    """Yield the label maps of about ``count`` frames, evenly spread, and of the key frames, as ``propagate_labels``.

    Each is one step from the one before, at half of the usual size: a first look that takes a fraction of the time.
    """
    chosen = sorted({*keys, *np.linspace(first, last, min(count, last - first + 1)).round().astype(int).tolist()})
    own = {chosen.index(n): labels for n, labels in keys.items()}
    made = propagate_labels(
        lambda place: image(chosen[place]), own, 0, len(chosen) - 1, (), lambda place: hand(chosen[place]),
        SPARSE_WORKING_SIZE_PX,
    )  # fmt: skip
    yield from (each._replace(frame=chosen[each.frame]) for each in made)


def _propagate_span(
    image: Images, keys: Mapping[int, UInt8[ndarray, "H W"]], span: KeyframeSpan, hand: Hands, working_size_px: float
) -> Iterator[PropagatedLabels]:
    if any((labels == HAND_LABEL).any() for labels in keys.values()):
        hand = no_hand_mask
    keys = {n: _add_hand_label(labels, hand(n)) for n, labels in keys.items()}
    first, last, (before, after) = span.first, span.last, (min(keys), max(keys))
    if first in keys:
        yield PropagatedLabels(first, keys[first], 1.0)
        return
    size = _working_size(keys, working_size_px)
    frames = SmallFrames(image, size)
    colours = keyframe_histograms(frames, keys)
    streams = [track_mask(frames, key, keys[key], to, colours, hand) for key, to in ((before, last), (after, first))]
    there = _mark_lost(streams[0], keys[before], frames) if before < first else None
    back = _reversed_by_disk(_mark_lost(streams[1], keys[after], frames), frames.disk) if after > last else None
    if there is None or back is None:
        made = ((each, each.trust) for each in there or back or ())
    else:
        shares = ((n - before) / (after - before) for n in range(first, last + 1))
        both = zip(there, back, shares, strict=True)
        made = (merge_masks(one, other, share, frames[one.frame], colours) for one, other, share in both)
    apart = any(_detached_parts(labels).any() for labels in keys.values())
    for each, confidence in made:
        labels = _upscale_labels(each, keys[before].shape, frames)
        if not apart:
            labels = np.where(_detached_parts(labels), np.uint8(0), labels)
        yield PropagatedLabels(each.frame, labels, confidence)


def _reversed_by_disk(some: Iterable[TrackedMask], disk: ArrayFile) -> Iterator[TrackedMask]:
    """Make all masks, and return them in reverse order; until then they wait on ``disk``."""
    stored = [(each.frame, each.corner, each.trust, disk.put(each.inside, each.known, each.unlike)) for each in some]

    def read() -> Iterator[TrackedMask]:
        for frame, corner, trust, arrays in reversed(stored):
            inside, known, unlike = disk.get(arrays)
            yield TrackedMask(frame, corner, inside, known, trust, unlike)

    return read()


def _mark_lost(
    carried: Iterable[TrackedMask], key: UInt8[ndarray, "H W"], frames: SmallFrames
) -> Iterator[TrackedMask]:
    """Yield the masks propagated from a key frame, with a trust of 0 from the frame on in which the object is lost.

    The object is lost where its mask vanishes away from the image's edge, from the shrinking's start on: hidden parts
    are remembered, so only a wrong border shrinks to nothing.
    """
    area, lost, at_edge = np.count_nonzero(key == OBJECT_LABEL) * np.prod(frames.size) / key.size, False, False
    shrinking: list[TrackedMask] = []
    for each in carried:
        inside = each.inside[0] > 0.0
        share = np.count_nonzero(inside) / area if area else 1.0
        lost = lost or bool(share < VANISHED_AREA_FRACTION and not at_edge)
        if share > SHRUNK_AREA_FRACTION or len(shrinking) >= MAX_SHRINKING_FRAMES or at_edge or lost:
            yield from (one._replace(trust=0.0) if lost else one for one in shrinking)
            shrinking = []
        if share > SHRUNK_AREA_FRACTION:
            at_edge = _touches_image_border(each, inside, frames.size)
        if lost or share > SHRUNK_AREA_FRACTION or at_edge:
            yield each._replace(trust=0.0) if lost else each
        else:
            shrinking.append(each)
    yield from shrinking


def _touches_image_border(each: TrackedMask, inside: Bool[ndarray, "h w"], size: tuple[int, int]) -> bool:
    """Return whether the object reaches an edge of the image."""
    if not inside.any():
        return False
    low = np.argwhere(inside).min(axis=0)[::-1] + each.corner
    high = np.argwhere(inside).max(axis=0)[::-1] + each.corner
    return bool((low <= 0).any() or (high >= np.array(size) - 1).any())


def no_hand_mask(_: int) -> None:
    """Return the visible hand of a clip without known hands: None in every frame."""


def _add_hand_label(labels: UInt8[ndarray, "H W"], hand: Bool[ndarray, "h w"] | None) -> UInt8[ndarray, "H W"]:
    """Add the hand to a key frame's label map, where nothing is drawn."""
    import cv2

    if hand is None:
        return labels
    seen = cv2.resize(hand.astype(np.float32), labels.shape[::-1], interpolation=cv2.INTER_LINEAR) > 0.5
    return np.where(seen & (labels == 0), np.uint8(HAND_LABEL), labels)


def _check_keyframes(keys: Mapping[int, UInt8[ndarray, "H W"]], first: int, last: int) -> None:
    if not any((labels == OBJECT_LABEL).any() for labels in keys.values()):
        raise UsageError("missing polygons: one frame at least needs one around the object")
    outside = [n for n in keys if not first <= n <= last]
    if outside:
        raise UsageError(f"polygons must be on frames {first} to {last} (got some on frame {outside[0]})")
    if len({labels.shape for labels in keys.values()}) > 1:
        raise UsageError("polygons must be masks of one size (got masks of different sizes)")


def _working_size(keys: Mapping[int, UInt8[ndarray, "H W"]], working_size_px: float) -> tuple[int, int]:
    """Return width and height at which the object's longer side, a mean over the keys, is ``working_size_px``.

    Only small masks are enlarged. If no key frame shows the object, its occluders count instead.
    """
    boxes = {
        kind: [np.ptp(np.nonzero(labels == kind), axis=1) for labels in keys.values() if kind in labels]
        for kind in TRACKED_LABELS
    }
    sides = [float(box.max()) for box in boxes[OBJECT_LABEL] or boxes[OCCLUDER_LABEL]]
    height, width = next(iter(keys.values())).shape
    side = max(1.0, float(np.mean(sides or [1.0])))
    zoom = min(working_size_px / side, max(1.0, float(np.sqrt(MAX_UPSCALED_PIXELS / (width * height)))))
    return max(16, round(zoom * width)), max(16, round(zoom * height))


def _upscale_labels(each: TrackedMask, shape: tuple[int, ...], frames: SmallFrames) -> UInt8[ndarray, "H W"]:
    """Return the label map of a mask at a shape (height, width), its border redrawn at the image's full size."""
    import cv2

    height, width = shape
    inside, _ = place_in_window(each, (0, 0), frames.size)
    labels = np.zeros((height, width), np.uint8)
    for kind, distances in zip(TRACKED_LABELS[1:], inside[1:], strict=True):  # the last label is in front
        if (distances > 0).any():
            labels[cv2.resize(distances, (width, height), interpolation=cv2.INTER_LINEAR) > 0] = kind
    whole = frames[each.frame].whole
    visible = cv2.resize(np.minimum(inside[0], -inside[1:].max(axis=0)), whole.shape[1::-1])
    found = refine_full_resolution(whole, visible, whole.shape[1] / frames.size[0]).astype(np.float32)
    labels[cv2.resize(found, (width, height), interpolation=cv2.INTER_LINEAR) > 0.5] = OBJECT_LABEL
    return labels


def _detached_parts(labels: UInt8[ndarray, "H W"]) -> Bool[ndarray, "H W"]:
    """Return small components of the object that no occluder separates from the rest: other things of its colours."""
    import cv2

    square = np.ones((ADJACENCY_KERNEL_PX, ADJACENCY_KERNEL_PX), np.uint8)
    covered = cv2.dilate((labels > OBJECT_LABEL).astype(np.uint8), square) > 0
    count, parts, stats, _ = cv2.connectedComponentsWithStats((labels == OBJECT_LABEL).astype(np.uint8))
    areas = np.where(np.arange(count) > 0, stats[:, cv2.CC_STAT_AREA], 0)
    largest, edge = areas.argmax(), np.ones(labels.shape, bool)
    edge[1:-1, 1:-1] = False
    if (parts[edge] == largest).any() and areas[largest]:  # components may be joined beyond the image
        covered |= edge
    beside = np.bincount(parts[covered], minlength=count) > 0
    return ((areas > 0) & (areas < MIN_COMPONENT_AREA_RATIO * areas[largest]) & ~beside)[parts]


def merge_masks(
    one: TrackedMask, other: TrackedMask, share: float, frame: SmallFrame, colours: Sequence[ColourHistogram]
) -> tuple[TrackedMask, float]:
    """Merge two masks of a ``frame`` into one; also return its confidence, from their intersection over union.

    ``share`` is the frame's position between the key frames of both, 0 to 1; ``colours`` are the key frames'.
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
    """Return the fraction of the merged mask that is expected to be right.

    A mask from beyond a cut has no trust and does not count: the other one's trust does.
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
    """Return the pixels of both masks, and those of one mask that signed distances ``sides`` and colours support."""
    agreed = np.where(one, -AGREED_PIXEL_COST, AGREED_PIXEL_COST)
    cost = np.where(one ^ other, -(likely + SIDE_PRIOR_WEIGHT * sides), agreed)
    return minimal_cut(cost.astype(np.float32), edge_cost(image), np.add(one, other, dtype=np.float32) / 2.0)


def _merge_ground_evidence(
    some: Sequence[TrackedMask], corner: tuple[int, int], size: tuple[int, int]
) -> Float32[ndarray, "h w"]:
    """Return ``TrackedMask.unlike`` of the background that fits a pixel best, if one does."""
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
    """Redraw a border by the key frames' colours and the nearby ones of this image; return signed distances [px]."""
    inside = signed_distance(found)
    x, y = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in found.shape[::-1]))
    here = colour_log_ratio(at, colours, LocalColourHistogram.of(at, found, ~hidden & (np.abs(inside) > 1.0)), (x, y))
    limited = np.clip(here, -MAX_COLOUR_LOG_RATIO, MAX_COLOUR_LOG_RATIO)
    return refine_border(image, inside, certain, limited + likely, hidden)


def refine_full_resolution(
    image: UInt8[ndarray, "H W 3"], inside: Float32[ndarray, "H W"], zoom: float
) -> Bool[ndarray, "H W"]:
    """Redraw a border near the one of signed distances ``inside`` [px of the reduced size].

    Pixels near the border go to the side with the more similar colours nearby: one step of localised region-based
    segmentation (Lankton, Tannenbaum, "Localizing Region-Based Active Contours", IEEE TIP 2008). ``zoom``: size of the
    image relative to the reduced one.
    """
    import cv2

    near = np.abs(inside) < BORDER_SEARCH_PX
    if not near.any():
        return np.asarray(inside > 0.0)
    margin = round((BORDER_SEARCH_PX + COLOUR_WINDOW_RADIUS_PX) * zoom)
    rows, columns = (slice(max(0, int(i.min()) - margin), int(i.max()) + margin) for i in np.nonzero(near))
    part = rows, columns
    colours = cv2.cvtColor(np.ascontiguousarray(image[part]), cv2.COLOR_RGB2LAB).astype(np.float32)
    square = (2 * round(COLOUR_WINDOW_RADIUS_PX * zoom) + 1,) * 2
    apart = []
    for side in (inside[part] > SIDE_INTERIOR_PX, inside[part] < -SIDE_INTERIOR_PX):
        weight = side.astype(np.float32)
        total = cv2.boxFilter(weight, -1, square) + 1e-4
        mean = cv2.boxFilter(colours * weight[..., None], -1, square) / total[..., None]
        off = colours - mean
        apart.append(np.einsum("hwc,hwc->hw", off, off) + SIDE_COLOUR_SIGMA**2)
    score = inside[part] / BORDER_SEARCH_PX + (apart[1] - apart[0]) / (apart[1] + apart[0])
    found = inside > 0.0
    smooth = cv2.GaussianBlur(score, (0, 0), BORDER_SMOOTHING_PX * zoom)
    found[part] = np.where(near[part], smooth > 0.0, found[part])
    return np.asarray(found)
