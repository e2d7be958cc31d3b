"""Segment the object from strokes or clicks on one frame; every stroke is obeyed.

A stroke lies on the object ("on") or on something else ("off"). GrabCut (Rother, Kolmogorov, Blake, SIGGRAPH 2004)
completes strokes; if polygons are drawn on the frame as well, strokes correct them nearby, and distant parts stay as
drawn. A click is completed by motion: the object is the pixels that move with the click, in frames before and after it,
and not with the surroundings, i.e. pixels far from click and hand. The object moves as the pixels at the click and at
the hand do, or independently: a pixel far from both motions is no evidence beyond ``INDEPENDENT_MOTION_LOG_RATIO``.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8
from numpy import ndarray

from getagrip.studio.masks.graph_cut import (
    ColourHistogram,
    colour_bins,
    colour_log_ratio,
    edge_cost,
    minimal_cut,
    overlapping_components,
)
from getagrip.studio.masks.optical_flow import FLOW_SIGMA_PX, fit_object_motion, optical_flow, squared_flow_error
from getagrip.studio.masks.propagate_frame import FLOW_CONSISTENCY_PX, Hands, Image, Images
from getagrip.studio.store.labels import OBJECT_LABEL, FrameLabels, Labels

MAX_GRABCUT_SIDE_PX = 480
"""Largest side of the image crop that GrabCut runs on [px]."""
STROKE_WIDTH_FRACTION = 0.008
"""Width of a stroke, as a fraction of the image's shorter side."""
MIN_OBJECT_REACH, MAX_OBJECT_REACH = 0.25, 0.45
"""Limits of the object's reach beyond its strokes, as fractions of the image's shorter side: in between, the reach is
the strokes' extent; from a single click, it is the larger limit."""
MAX_CLICK_EXTENT = 0.05
"""Extent of strokes, as a fraction of the image's shorter side, below which they are a click."""
CORRECTION_RADIUS_FRACTION = 0.12
"""Distance from a stroke within which polygons are corrected, as a fraction of the image's shorter side."""
STROKE_GRABCUT_ITERATIONS = 5
CLICK_MOTION_IMAGE_PX = 320
"""Longer side of the images in which motion is measured [px]."""
COMPARED_FRAME_OFFSETS = (-36, -24, -16, -8, -4, 4, 8, 16, 24, 36)
"""Frames in which motion is measured, relative to the click's frame."""
CLICK_RADIUS_FRACTION, MIN_SURROUNDINGS_DISTANCE = 0.05, 0.3
"""Distances from the click, in shorter sides of the image: nearer pixels are the object's, and beyond the second number
they are the surroundings'."""
CLICK_HAND_DILATION_PX = 9
"""Side of the square by which the hand is dilated: its flow reaches beyond its border [px]."""
INDEPENDENT_MOTION_LOG_RATIO = 2.0
"""Log ratio by which a pixel moves independently rather than as the object."""
MIN_CLICK_EVIDENCE = 1.0
"""Evidence at the click below which nothing has moved."""
MOVING_LOG_RATIO_THRESHOLD, STATIC_LOG_RATIO_THRESHOLD = 0.5, -1.5
"""Log ratios of motion: pixels above the first number show the object's colours, below the second the background's."""
MOTION_DEAD_ZONE, MOTION_EVIDENCE_RANGE = 0.3, (-2.0, 0.75)
"""Log ratio of motion that is no evidence, and limits of the evidence, which is 1 at three times the dead zone."""
CLICK_COLOUR_WEIGHT, MAX_CLICK_LOG_RATIO = 1.5, 6.0
"""Weight of the log ratio of colours, and its largest absolute value."""
N_CLICK_ITERATIONS = 3


def keyframe_label_maps(
    labels: Labels, image: Images, hand: Hands = lambda _: None
) -> dict[int, UInt8[ndarray, "H W"]]:
    """Return the label maps of key frames, ``labels.label_maps`` with strokes and clicks completed from the images."""
    maps = labels.label_maps()
    for n in maps:
        frame = labels.frames[n]
        if frame.on or frame.off:
            maps[n] = apply_strokes(image(n), maps[n], frame, hand(n), _click_motion(labels, n, image, hand(n)))
    return maps


def _click_motion(
    labels: Labels, n: int, image: Images, hand: Bool[ndarray, "h w"] | None
) -> Float32[ndarray, "H W"] | None:
    """Return the log ratio of moving with the clicks on a frame; None where polygons or longer strokes are drawn."""
    frame, shape = labels.frames[n], labels.size[::-1]
    on = _rasterize_strokes(frame.on or (), shape)
    if frame.object or not on.any() or max(map(np.ptp, np.nonzero(on))) >= MAX_CLICK_EXTENT * min(shape):
        return None
    seen = np.zeros(shape, bool) if hand is None else resize_mask(hand, shape)
    return click_motion_log_ratio(image, n, (labels.first, labels.last), on, seen)


def apply_strokes(
    image: Image,
    drawn: UInt8[ndarray, "H W"],
    frame: FrameLabels,
    hand: Bool[ndarray, "h w"] | None = None,
    motion: Float32[ndarray, "H W"] | None = None,
) -> UInt8[ndarray, "H W"]:
    """Return a frame's label map, ``drawn`` by polygons, after its strokes; ``motion``: ``click_motion_log_ratio``."""
    import cv2

    shape = drawn.shape
    on, off = (_rasterize_strokes(strokes, shape) for strokes in (frame.on or (), frame.off or ()))
    seen = np.zeros(shape, bool) if hand is None else resize_mask(hand, shape)
    no_object = off | ((drawn != 0) & (drawn != OBJECT_LABEL)) | (seen & (drawn != OBJECT_LABEL))
    start = None
    if (drawn == OBJECT_LABEL).any():
        distance = cv2.distanceTransform((~(on | off)).astype(np.uint8), cv2.DIST_L2, 3)
        near = distance < CORRECTION_RADIUS_FRACTION * min(shape)
        start = np.where(drawn == OBJECT_LABEL, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
        start[~near & (drawn == OBJECT_LABEL)], start[~near & (drawn != OBJECT_LABEL)] = cv2.GC_FGD, cv2.GC_BGD
    part = bounding_slices(on | (drawn == OBJECT_LABEL), shape)
    found = segment_region(image, on, no_object & ~on, start, part, motion)
    out = np.where(drawn == OBJECT_LABEL, 0, drawn).astype(np.uint8)
    out[found] = OBJECT_LABEL
    out[off & (out == OBJECT_LABEL)], out[on] = 0, OBJECT_LABEL
    return out


def _rasterize_strokes(strokes: Sequence[Float[ndarray, "_ 2"]], shape: tuple[int, ...]) -> Bool[ndarray, "H W"]:
    import cv2

    out = np.zeros(shape[:2], np.uint8)
    width = max(2, round(STROKE_WIDTH_FRACTION * min(shape[:2])))
    for points in strokes:
        corners = np.floor(points).astype(np.int32)
        cv2.polylines(out, [corners], False, 1, width)
        cv2.circle(out, corners[0].tolist(), width // 2, 1, -1)
    return np.asarray(out > 0)


def resize_mask(mask: Bool[ndarray, "h w"], shape: tuple[int, ...]) -> Bool[ndarray, "H W"]:
    """Resize a mask to a shape (height, width), by linear interpolation."""
    import cv2

    return np.asarray(cv2.resize(mask.astype(np.float32), shape[1::-1], interpolation=cv2.INTER_LINEAR) > 0.5)


def bounding_slices(
    mask: Bool[ndarray, "H W"], shape: tuple[int, ...], margin: float | None = None
) -> tuple[slice, slice]:
    """Return rows and columns around a mask's pixels, by a ``margin`` [px] or the object's reach; all if none."""
    if not mask.any():
        return slice(0, shape[0]), slice(0, shape[1])
    short, marked = min(shape[:2]), np.nonzero(mask)
    if margin is None:
        extent, margin = max(float(np.ptp(i)) for i in marked), MAX_OBJECT_REACH * short
        if extent >= MAX_CLICK_EXTENT * short:
            margin = min(max(extent, MIN_OBJECT_REACH * short), margin)
    rows, columns = (
        slice(max(0, int(i.min() - margin)), min(length, int(i.max() + margin) + 1))
        for i, length in zip(marked, shape, strict=False)
    )
    return rows, columns


def segment_region(
    image: Image,
    on: Bool[ndarray, "H W"],
    off: Bool[ndarray, "H W"],
    start: UInt8[ndarray, "H W"] | None,
    part: tuple[slice, slice],
    motion: Float32[ndarray, "H W"] | None = None,
    hand: Bool[ndarray, "H W"] | None = None,
) -> Bool[ndarray, "H W"]:
    """Segment the object in a ``part`` of the image: by ``motion`` where it is known, else by GrabCut.

    ``on`` pixels are the object's, ``off`` pixels never. GrabCut starts from the labels ``start`` or, without, from the
    colours of ``on``. Components that only the ``hand`` separates count as one.
    """
    import cv2

    out = np.zeros(on.shape, bool)
    if start is None and not on.any():
        return out
    image = cv2.resize(image, on.shape[::-1], interpolation=cv2.INTER_AREA)[part]
    height, width = image.shape[:2]
    zoom = min(1.0, MAX_GRABCUT_SIDE_PX / max(height, width))
    size = max(8, round(zoom * width)), max(8, round(zoom * height))
    small = np.ascontiguousarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    sure, never = (
        cv2.resize(each[part].astype(np.uint8), size, interpolation=cv2.INTER_AREA) > 0 for each in (on, off)
    )
    if motion is None:
        labels = None if start is None else cv2.resize(start[part], size, interpolation=cv2.INTER_NEAREST)
        found = _grabcut(small, labels, sure, never)
    else:
        reduced = cv2.resize(motion[part], size, interpolation=cv2.INTER_AREA)
        found = segment_by_click_motion(small, reduced, sure, never)
    across = np.zeros(found.shape, np.uint8) if hand is None else cv2.resize(hand[part].astype(np.uint8), size)
    touched = hand is None and (found & sure).any()
    found = overlapping_components(found, sure) if touched else _largest_component(found, across)
    soft = cv2.GaussianBlur(found.astype(np.float32), (0, 0), 1.0)
    out[part] = cv2.resize(soft, (width, height), interpolation=cv2.INTER_LINEAR) > 0.5
    return out & ~off


def _grabcut(
    image: UInt8[ndarray, "h w 3"],
    labels: UInt8[ndarray, "h w"] | None,
    sure: Bool[ndarray, "h w"],
    never: Bool[ndarray, "h w"],
) -> Bool[ndarray, "h w"]:
    """Run GrabCut; without labels it starts from the colours of the ``sure`` pixels."""
    import cv2

    if labels is None:
        labels = np.full(sure.shape, cv2.GC_PR_BGD, np.uint8)
        labels[[0, -1]] = labels[:, [0, -1]] = cv2.GC_BGD
        labels[never], labels[sure] = cv2.GC_BGD, cv2.GC_FGD
        unknown = labels == cv2.GC_PR_BGD
        likely = colour_log_ratio(colour_bins(image), ColourHistogram.of(image, sure, ~unknown)) > 1.0
        labels[likely & unknown] = cv2.GC_PR_FGD
    else:
        labels[never], labels[sure] = cv2.GC_BGD, cv2.GC_FGD
    front, back = (np.isin(labels, sides) for sides in ((cv2.GC_FGD, cv2.GC_PR_FGD), (cv2.GC_BGD, cv2.GC_PR_BGD)))
    if not front.any() or not back.any():
        return np.zeros(sure.shape, bool)
    colours = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.setRNGSeed(0)  # GrabCut begins with k-means from random centres
    labels = cv2.grabCut(image, labels, (0, 0, 0, 0), *colours, STROKE_GRABCUT_ITERATIONS, cv2.GC_INIT_WITH_MASK)[0]
    return np.isin(labels, (cv2.GC_FGD, cv2.GC_PR_FGD))


def _largest_component(mask: Bool[ndarray, "h w"], hand: UInt8[ndarray, "h w"]) -> Bool[ndarray, "h w"]:
    """Return the largest component of a mask; pieces that only the hand separates are one."""
    import cv2

    if not mask.any():
        return mask
    between = cv2.dilate(hand, np.ones((3, 3), np.uint8)) > 0
    _, parts = cv2.connectedComponents((mask | between).astype(np.uint8))
    return np.asarray(mask & (parts == np.bincount(parts[mask]).argmax()))


def click_motion_log_ratio(
    images: Images, frame: int, interval: tuple[int, int], click: Bool[ndarray, "H W"], hand: Bool[ndarray, "H W"]
) -> Float32[ndarray, "H W"] | None:
    """Return the log ratio of the probabilities that a pixel moves with the click, or with the surroundings.

    Positive values are relative to the click's own, so that it is 1 there. None where the click has not moved in the
    frames of the ``interval``, ends included.
    """
    import cv2

    def small(image: ndarray) -> ndarray:
        return cv2.resize(image, size, interpolation=cv2.INTER_AREA)

    shape = click.shape
    size = tuple(max(16, round(length * min(1.0, CLICK_MOTION_IMAGE_PX / max(shape)))) for length in shape[::-1])
    away = cv2.distanceTransform((small(click.astype(np.float32)) == 0).astype(np.uint8), cv2.DIST_L2, 3) / min(size)
    held = small(hand.astype(np.float32)) > 0.5
    square = np.ones((CLICK_HAND_DILATION_PX, CLICK_HAND_DILATION_PX), np.uint8)
    here = away < CLICK_RADIUS_FRACTION
    surroundings = (away > MIN_SURROUNDINGS_DISTANCE) & (cv2.dilate(held.astype(np.uint8), square) == 0)
    x, y = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in size))
    now, total = small(images(frame)), np.zeros(size[::-1], np.float32)
    for other in (frame + step for step in COMPARED_FRAME_OFFSETS if interval[0] <= frame + step <= interval[1]):
        then = small(images(other))
        back = optical_flow(now, then)
        came = x + back[..., 0], y + back[..., 1]
        off = squared_flow_error(optical_flow(then, now), back, came)
        own, ground = (
            fit_object_motion(x, y, came, each & (off < FLOW_CONSISTENCY_PX**2)) for each in (here | held, surroundings)
        )
        if own is None or ground is None:
            continue
        apart, still = (np.square(came[0] - each[0]) + np.square(came[1] - each[1]) for each in (own, ground))
        noise = 1.0 + float(np.median(still[surroundings]))
        ratio = np.log1p(still / noise) - np.minimum(np.log1p(apart / FLOW_SIGMA_PX**2), INDEPENDENT_MOTION_LOG_RATIO)
        ratio = cv2.GaussianBlur((ratio / (1.0 + off / FLOW_SIGMA_PX**2)).astype(np.float32), (0, 0), 2.0)
        if np.median(ratio[here]) > 0.0:
            total += ratio
    at_click = float(np.median(total[here])) if here.any() else 0.0
    if at_click < MIN_CLICK_EVIDENCE:
        return None
    whole = cv2.resize(total, shape[::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(np.where(whole > 0.0, whole / at_click, whole), np.float32)


def segment_by_click_motion(
    image: UInt8[ndarray, "h w 3"],
    motion: Float32[ndarray, "h w"],
    sure: Bool[ndarray, "h w"],
    never: Bool[ndarray, "h w"],
) -> Bool[ndarray, "h w"]:
    """Segment the object by its motion (``click_motion_log_ratio``), and by the colours of the moving pixels.

    Motion remains evidence when colours are counted again, so a part in another colour is not lost.
    """
    at, edge = colour_bins(image), edge_cost(image)
    moved = np.clip((motion - MOTION_DEAD_ZONE) / (2.0 * MOTION_DEAD_ZONE), *MOTION_EVIDENCE_RANGE)
    found, known = ((motion > MOVING_LOG_RATIO_THRESHOLD) & ~never) | sure, np.zeros_like(sure)
    known[[0, -1]] = known[:, [0, -1]] = True
    known |= found | never | (motion < STATIC_LOG_RATIO_THRESHOLD)
    for _ in range(N_CLICK_ITERATIONS):
        colours = CLICK_COLOUR_WEIGHT * colour_log_ratio(at, ColourHistogram.of(image, found, known))
        evidence = np.clip(colours, -MAX_CLICK_LOG_RATIO, MAX_CLICK_LOG_RATIO) + moved
        evidence[never] = -MAX_CLICK_LOG_RATIO
        evidence[sure] = MAX_CLICK_LOG_RATIO
        object_ = evidence.astype(np.float32)
        found = minimal_cut(-object_, edge, (object_ > 0.0).astype(np.float32))
        known = np.ones_like(sure)
    return found
