"""From polygons on a few frames to masks of every frame: dense optical flow, GrabCut along the border.

Each mask is carried as a signed distance from its border, frame by frame: from the key before forwards, from the key
after backwards (``carried_masks``); it depends on these two keys alone. The two are merged (``merged_masks``): where
they differ the keys' colours decide, the ground that keys show, and the nearer key; what has come into the image since
one key is known from the other only. At last the border is drawn at the image's own size (``fine_border``).

The confidence of a frame is the share that is expected to be right: of two, a pixel is lost if both are wrong, and
hardly near to a key; it is 1 on keys. Of one only, before the first key, after the last and up to a cut, it is its
trust: the share of the border for which flow there and back agrees, all steps since the key multiplied. It is 0 from
where the object is lost.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Mapping
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, UInt8
from numpy import ndarray

from getagrip.annotate.carried_masks import (
    TRACKED_LABELS,
    Hands,
    Images,
    TrackedMask,
    keyframe_histograms,
    place_in_window,
    track_mask,
)
from getagrip.annotate.fine_border import refine_full_resolution
from getagrip.annotate.labels import HAND_LABEL, OBJECT_LABEL, OCCLUDER_LABEL
from getagrip.annotate.merged_masks import merge_masks
from getagrip.annotate.shared_flow import SmallFrames
from getagrip.errors import UsageError

OBJECT_WORKING_SIZE_PX = 200.0
"""Masks are carried at a size at which the object's longer side is about so long [px]."""
MAX_UPSCALED_PIXELS = 1e6
"""Pixels up to which small images are enlarged for that."""
MIN_COMPONENT_AREA_RATIO = 0.25
"""Share of the object's largest part below which another may be something else."""
VANISHED_AREA_FRACTION, SHRUNK_AREA_FRACTION, MAX_SHRINKING_FRAMES = 0.05, 0.4, 60
"""An object of less than the first share of its key's pixels is lost, from where it has less than the second, at most
this number of frames before."""
ADJACENCY_KERNEL_PX = 9
"""Side of a square about a pixel that is beside what it touches [px]."""


class PropagatedLabels(NamedTuple):
    """A mask of a frame."""

    frame: int
    labels: UInt8[ndarray, "H W"]
    """0, ``OBJECT_LABEL``, ``OCCLUDER_LABEL`` or ``HAND_LABEL``."""
    confidence: float
    """From 0, lost: nothing is known of the object, to 1, as drawn."""


class KeyframeSpan(NamedTuple):
    """Frames in a row whose masks come from the same keys."""

    first: int
    last: int
    keys: tuple[int, ...]
    """The frame itself where it is one; else the keys before and after, as far as there are."""


def keyframe_spans(keys: Iterable[int], first: int, last: int) -> Iterator[KeyframeSpan]:
    """Yield the frames ``first`` to ``last``, both included and in order, by the keys that their masks come from."""
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
) -> Iterator[PropagatedLabels]:
    """Yield the masks of the frames ``first`` to ``last``, both included, in order.

    Those of keys are as they are given.

    ``hand`` is where the hand is visible, if that is known; a key on which the hand is drawn replaces it up to the next
    keys. Pixels of a key that show the hand say nothing of what is behind.

    Stretches of which all frames are ``known`` are left out. Images are asked for from one key to the next and back
    again. Raises ``UsageError`` where no key shows the object, keys are outside the interval or of different sizes.
    """
    _check_keyframes(keys, first, last)
    for stretch in keyframe_spans(keys, first, last):
        if not all(n in known for n in range(stretch.first, stretch.last + 1)):
            yield from _propagate_span(image, {n: keys[n] for n in stretch.keys}, stretch, hand)


def _propagate_span(
    image: Images, keys: Mapping[int, UInt8[ndarray, "H W"]], stretch: KeyframeSpan, hand: Hands
) -> Iterator[PropagatedLabels]:
    """Return the masks of a stretch from its own keys."""
    if any((labels == HAND_LABEL).any() for labels in keys.values()):
        hand = _unknown_hand_mask
    keys = {n: _add_hand_label(labels, hand(n)) for n, labels in keys.items()}
    first, last, (before, after) = stretch.first, stretch.last, (min(keys), max(keys))
    if first in keys:
        yield PropagatedLabels(first, keys[first], 1.0)
        return
    size = _working_size(keys)
    frames = SmallFrames(image, size)
    colours = keyframe_histograms(frames, keys)
    streams = [track_mask(frames, key, keys[key], to, colours, hand) for key, to in ((before, last), (after, first))]
    there = _mark_lost(streams[0], keys[before], frames) if before < first else None
    back = list(_mark_lost(streams[1], keys[after], frames))[::-1] if after > last else None
    if there is None or back is None:
        made = ((each, each.trust) for each in there or back or ())
    else:
        shares = ((n - before) / (after - before) for n in range(first, last + 1))
        both = zip(there, back, shares, strict=True)
        made = (merge_masks(one, other, share, frames[one.frame], colours) for one, other, share in both)
    apart = any(_detached_parts(labels).any() for labels in keys.values())
    for each, confidence in made:
        found = _upscale_labels(each, confidence, keys, frames)
        yield (
            found
            if apart
            else found._replace(labels=np.where(_detached_parts(found.labels), np.uint8(0), found.labels))
        )


def _mark_lost(
    carried: Iterable[TrackedMask], key: UInt8[ndarray, "H W"], frames: SmallFrames
) -> Iterator[TrackedMask]:
    """Yield masks on their way from a key, with a trust of 0 from where the object is lost.

    It is lost where it vanishes while neither something in front hides it nor the image ends, and from where it began
    to: what is hidden is remembered (``carried_masks``), so that only a border that is wrong shrinks to nothing.
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


def _unknown_hand_mask(_: int) -> None:
    """Return the hand where nothing is known of it."""


def _add_hand_label(labels: UInt8[ndarray, "H W"], hand: Bool[ndarray, "h w"] | None) -> UInt8[ndarray, "H W"]:
    """Return a key's mask and the hand, where nothing is drawn."""
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


def _working_size(keys: Mapping[int, UInt8[ndarray, "H W"]]) -> tuple[int, int]:
    """Width and height at which the object's longer side, a mean over the keys, is ``OBJECT_WORKING_SIZE_PX``.

    Only small masks are enlarged for that. Where no key shows the object, what is in front of it counts.
    """
    boxes = {
        kind: [np.ptp(np.nonzero(labels == kind), axis=1) for labels in keys.values() if kind in labels]
        for kind in TRACKED_LABELS
    }
    sides = [float(box.max()) for box in boxes[OBJECT_LABEL] or boxes[OCCLUDER_LABEL]]
    height, width = next(iter(keys.values())).shape
    side = max(1.0, float(np.mean(sides or [1.0])))
    zoom = min(OBJECT_WORKING_SIZE_PX / side, max(1.0, float(np.sqrt(MAX_UPSCALED_PIXELS / (width * height)))))
    return max(16, round(zoom * width)), max(16, round(zoom * height))


def _upscale_labels(
    each: TrackedMask, confidence: float, keys: Mapping[int, UInt8[ndarray, "H W"]], frames: SmallFrames
) -> PropagatedLabels:
    """At the size of the keys' masks."""
    import cv2

    height, width = next(iter(keys.values())).shape
    inside, _ = place_in_window(each, (0, 0), frames.size)
    labels = np.zeros((height, width), np.uint8)
    for kind, distances in zip(TRACKED_LABELS[1:], inside[1:], strict=True):  # what is in front wins
        if (distances > 0).any():
            labels[cv2.resize(distances, (width, height), interpolation=cv2.INTER_LINEAR) > 0] = kind
    whole = frames[each.frame].whole
    visible = cv2.resize(np.minimum(inside[0], -inside[1:].max(axis=0)), whole.shape[1::-1])
    found = refine_full_resolution(whole, visible, whole.shape[1] / frames.size[0]).astype(np.float32)
    labels[cv2.resize(found, (width, height), interpolation=cv2.INTER_LINEAR) > 0.5] = OBJECT_LABEL
    return PropagatedLabels(each.frame, labels, confidence)


def _detached_parts(labels: UInt8[ndarray, "H W"]) -> Bool[ndarray, "H W"]:
    """Return small parts of the object that nothing in front separates from the rest: something else of its colours."""
    import cv2

    covered = (
        cv2.dilate(
            (labels > OBJECT_LABEL).astype(np.uint8), np.ones((ADJACENCY_KERNEL_PX, ADJACENCY_KERNEL_PX), np.uint8)
        )
        > 0
    )
    count, parts, stats, _ = cv2.connectedComponentsWithStats((labels == OBJECT_LABEL).astype(np.uint8))
    areas = np.where(np.arange(count) > 0, stats[:, cv2.CC_STAT_AREA], 0)
    largest, edge = areas.argmax(), np.ones(labels.shape, bool)
    edge[1:-1, 1:-1] = False
    if (parts[edge] == largest).any() and areas[largest]:  # they may be joined beyond the image
        covered |= edge
    beside = np.bincount(parts[covered], minlength=count) > 0
    return ((areas > 0) & (areas < MIN_COMPONENT_AREA_RATIO * areas[largest]) & ~beside)[parts]
