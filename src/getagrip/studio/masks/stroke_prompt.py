"""Segment the object from strokes or clicks on one frame; every stroke is obeyed.

Strokes are completed by GrabCut, clicks by what moves with them (``click_motion``).

Rother, Kolmogorov, Blake, SIGGRAPH 2004. A stroke lies on the object ("on") or on what is not the object ("off"). If
polygons are drawn on the frame as well, strokes correct them nearby, and they are kept elsewhere.

The border of a mask at the image's own size: pixels near to it go to the side with the more similar colours nearby.

Localised region-based segmentation (Lankton, Tannenbaum, "Localizing Region-Based Active Contours", IEEE TIP 2008), one
step of it from the border that was found at a smaller size.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8
from numpy import ndarray

from getagrip.studio.masks.click_prompt import click_motion_log_ratio, segment_by_click_motion
from getagrip.studio.masks.graph_cut import ColourHistogram, colour_bins, colour_log_ratio, overlapping_components
from getagrip.studio.masks.propagate_frame import Hands, Image, Images
from getagrip.studio.store.labels import OBJECT_LABEL, FrameLabels, Labels

BORDER_SEARCH_PX = 2.5
"""The border moves by less than this [px of the smaller size]."""
SIDE_INTERIOR_PX = 0.8
"""Pixels farther from it than this count for their side's colours [px of the smaller size]."""
COLOUR_WINDOW_RADIUS_PX = 4.0
"""Half side of the squares in which colours are averaged: small, but from wherever the border may be they reach both
sides [px of the smaller size]."""
BORDER_SMOOTHING_PX = 0.5
"""Standard deviation of the Gaussian that smooths the border [px of the smaller size]."""
SIDE_COLOUR_SIGMA = 4.0
"""Standard deviation of a side's colours [of 255]."""


def refine_full_resolution(
    image: UInt8[ndarray, "H W 3"], inside: Float32[ndarray, "H W"], zoom: float
) -> Bool[ndarray, "H W"]:
    """Draw the border anew, near the one that signed distances give [px of the smaller size].

    ``zoom``: how many times larger the image is.
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


MAX_GRABCUT_SIDE_PX = 480
"""Largest side of the image part that GrabCut runs on [px]."""
STROKE_WIDTH_FRACTION = 0.008
"""Width of a stroke, as a share of the image's shorter side."""
MIN_OBJECT_REACH, MAX_OBJECT_REACH = 0.25, 0.45
"""The object reaches no farther from the strokes than their extent, limited to these shares of the image's shorter
side; from a single click, no farther than the larger one."""
MAX_CLICK_EXTENT = 0.05
"""Strokes of an extent less than this share are a click."""
CORRECTION_RADIUS_FRACTION = 0.12
"""Polygons are corrected within this share of the image's shorter side from a stroke."""
STROKE_GRABCUT_ITERATIONS = 5
"""Rounds of GrabCut."""


def keyframe_label_maps(
    labels: Labels, image: Images, hand: Hands = lambda _: None
) -> dict[int, UInt8[ndarray, "H W"]]:
    """Return ``labels.label_maps``, those with strokes completed by what the image shows."""
    maps = labels.label_maps()
    for n in maps:
        frame = labels.frames[n]
        if frame.on or frame.off:
            maps[n] = apply_strokes(image(n), maps[n], frame, hand(n), _click_motion(labels, n, image, hand(n)))
    return maps


def _click_motion(
    labels: Labels, n: int, image: Images, hand: Bool[ndarray, "h w"] | None
) -> Float32[ndarray, "H W"] | None:
    """Return what moves with the clicks on a frame; None where polygons or longer strokes say more."""
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
    """Return a frame's label map, ``drawn`` so far by polygons, after its strokes; ``motion``: see ``click_motion``."""
    import cv2

    shape = drawn.shape
    on, off = (_rasterize_strokes(strokes, shape) for strokes in (frame.on or (), frame.off or ()))
    seen = np.zeros(shape, bool) if hand is None else resize_mask(hand, shape)
    no_object = off | ((drawn != 0) & (drawn != OBJECT_LABEL)) | (seen & (drawn != OBJECT_LABEL))
    start = None
    if (drawn == OBJECT_LABEL).any():
        near = cv2.distanceTransform((~(on | off)).astype(np.uint8), cv2.DIST_L2, 3) < CORRECTION_RADIUS_FRACTION * min(
            shape
        )
        start = np.where(drawn == OBJECT_LABEL, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
        start[~near & (drawn == OBJECT_LABEL)], start[~near & (drawn != OBJECT_LABEL)] = cv2.GC_FGD, cv2.GC_BGD
    found = segment_region(
        image, on, no_object & ~on, start, bounding_slices(on | (drawn == OBJECT_LABEL), shape), motion
    )
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
    import cv2

    return np.asarray(cv2.resize(mask.astype(np.float32), shape[1::-1], interpolation=cv2.INTER_LINEAR) > 0.5)


def bounding_slices(
    mask: Bool[ndarray, "H W"], shape: tuple[int, ...], margin: float | None = None
) -> tuple[slice, slice]:
    """Return rows and columns around the marked pixels; all if none is marked."""
    if not mask.any():
        return slice(0, shape[0]), slice(0, shape[1])
    short, marked = min(shape[:2]), np.nonzero(mask)
    if margin is None:
        extent = max(float(np.ptp(i)) for i in marked)
        margin = (
            MAX_OBJECT_REACH * short
            if extent < MAX_CLICK_EXTENT * short
            else min(max(extent, MIN_OBJECT_REACH * short), MAX_OBJECT_REACH * short)
        )
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
    """Return what is found in a part of the image: by motion, if that is known, else by GrabCut.

    GrabCut begins with its labels or, without any, with the strokes' colours. Parts count as one across the ``hand``.
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
        found = segment_by_click_motion(
            small, cv2.resize(motion[part], size, interpolation=cv2.INTER_AREA), sure, never
        )
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
    """Return what GrabCut finds; without labels it begins with the colours of what is sure."""
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
    """Return the largest part of a mask; pieces that only the hand separates are one."""
    import cv2

    if not mask.any():
        return mask
    between = cv2.dilate(hand, np.ones((3, 3), np.uint8)) > 0
    _, parts = cv2.connectedComponents((mask | between).astype(np.uint8))
    return np.asarray(mask & (parts == np.bincount(parts[mask]).argmax()))
