"""Segment the object from a box on one frame: GrabCut (Rother, Kolmogorov, Blake, SIGGRAPH 2004), and motion.

A box is also tracked over frames, by the pattern and the colours in it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, UInt8
from numpy import ndarray

from getagrip.errors import UsageError
from getagrip.studio.masks.graph_cut import (
    UNSEEN_COLOUR_PROBABILITY,
    ColourHistogram,
    colour_bins,
    colour_log_ratio,
    remove_object_colours,
)
from getagrip.studio.masks.propagate_frame import Image, Images
from getagrip.studio.masks.stroke_prompt import (
    MOVING_LOG_RATIO_THRESHOLD,
    STATIC_LOG_RATIO_THRESHOLD,
    bounding_slices,
    click_motion_log_ratio,
    resize_mask,
    segment_region,
)
from getagrip.studio.store.labels import HAND_LABEL, OBJECT_LABEL

Box = tuple[float, float, float, float]
"""Left, top, width and height [px]."""
MIN_BOX_SIDE_PX = 4.0
"""Least width and height of a box [px]."""
BOX_SEARCH_RADIUS = 0.5
"""Longest step of a box's content from one frame to the next, in longer sides of the box."""
BOX_DISTANCE_PENALTY = 1e-4
"""Correlation that outweighs one pixel of a box's step: on a uniform image the box stays."""
COLOUR_DISTANCE_SCALE = 64.0
"""Distance of an object's colours in RGB [of 442] (root mean square) that outweighs a correlation of 1."""
MIN_BOX_CORRELATION = 0.5
"""Correlation of a box with the first frame below which the box may be lost."""
MAX_TRACKED_BOX_PX = 128
"""Largest side of a box in the reduced images in which it is tracked [px]."""
MIN_HAND_OUTSIDE_FRACTION = 0.2
"""Fraction of the detected hand outside the object's box from which on the hand's colours there decide which pixels in
the box may be the object's: a label in front of the palm, say."""
THIN_OBJECT_FRACTION = 0.35
"""Fraction of the pixels found in a box with colours likelier beside the box, above which the object is thin and most
of the box is background: then only pixels of the other colours are the object."""
MIN_LIKELY_COLOUR_FRACTION = 0.5
"""Fraction of the pixels of the other colours that must be found for a thin object."""
BOX_EROSION_PX = 9
"""Side of the square by which the found mask is eroded before its motion is measured [px]."""
MAX_STATIC_FRACTION = 0.2
"""Largest fraction of the found mask that is removed because it does not move with the object."""
MIN_OUTSTANDING_AREA_RATIO = 0.25
"""Area of a part that differs from the background, as a fraction of the found object's, above which it is the object's,
too: an overexposed face. Smaller ones may be shadows."""
MAX_BORDER_ON_BOX_FRACTION, MAX_OUTSTANDING_FRACTION = 0.05, 0.05
"""Fraction of the mask's border on the box, and of its area what else differs from the background in the box, above
which a part of the object may be missing: 45 of 56 masks of rendered training videos with an IOU below 0.85, from boxes
that were moved or too small, and one of 25 above 0.9."""
MAX_EMPTY_STRIP_FRACTION = 0.15
"""Widest empty strip beside object and hand in the object's box, as a fraction of the box's width or height."""


def box_to_slices(box: Box, size: tuple[int, int]) -> tuple[slice, slice]:
    """Return the rows and columns of a box in an image of ``size`` (width, height) [px].

    Raises ``UsageError`` for a tiny box, or one with more than a tenth outside the image.
    """
    x, y, w, h = box
    left, top, right, bottom = max(0.0, x), max(0.0, y), min(x + w, size[0]), min(y + h, size[1])
    if not (min(w, h) >= MIN_BOX_SIDE_PX and max(0.0, right - left) * max(0.0, bottom - top) >= 0.9 * w * h):
        got = ",".join(f"{value:g}" for value in box)
        within = f"the upright image, {size[0]} x {size[1]}, {MIN_BOX_SIDE_PX:g} pixels or more on either side"
        raise UsageError(f"--object-box must be X,Y,W,H within {within} (got {got})")
    return slice(round(top), round(bottom)), slice(round(left), round(right))


def track_box(images: Images, box: Box, first: int, to: int) -> Iterator[tuple[Box, float]]:
    """Track the content of a box from the frame ``first`` to ``to``; yield box [px] and correlation of each frame.

    The box moves to the place most like the box in the first frame and in the frame before, in pattern and in the
    object's colours; the correlation is with the first frame. Raises ``UsageError`` as ``box_to_slices`` does, after
    the first box.
    """
    import cv2

    yield box, 1.0
    if to <= first:
        return
    scale = min(1.0, MAX_TRACKED_BOX_PX / max(box[2:]))
    image = downscale_image(images(first), scale)
    size = np.array(image.shape[1::-1])
    start = corner = np.clip(np.round(scale * np.array(box[:2])).astype(int), 0, size - 1)
    w, h = np.clip(np.round(scale * np.add(box[:2], box[2:])).astype(int), start + 1, size) - start
    near = round(BOX_SEARCH_RADIUS * max(w, h))
    found = (segment_box(images(first), box) == OBJECT_LABEL).astype(np.uint8)
    counts = cv2.resize(found, size.tolist(), interpolation=cv2.INTER_AREA)[corner[1] :, corner[0] :][:h, :w]
    counts = counts if counts.any() else np.ones((h, w), np.uint8)
    templates = [image[corner[1] :, corner[0] :][:h, :w]] * 2
    for n in range(first + 1, to + 1):
        image = downscale_image(images(n), scale)
        low = np.maximum(corner - near, 0)
        nearby = image[low[1] : corner[1] + h + near, low[0] : corner[0] + w + near]
        squares = [cv2.matchTemplate(nearby, each, cv2.TM_SQDIFF, mask=counts) for each in templates]
        unlike = [np.sqrt(np.maximum(each, 0.0) / counts.sum()) / COLOUR_DISTANCE_SCALE for each in squares]
        alike = [cv2.matchTemplate(nearby, each, cv2.TM_CCOEFF_NORMED) for each in templates]
        y, x = np.indices(alike[0].shape, dtype=np.float32)
        far = np.hypot(x - (corner - low)[0], y - (corner - low)[1])
        column, row = cv2.minMaxLoc(np.sum(alike, axis=0) - np.sum(unlike, axis=0) - BOX_DISTANCE_PENALTY * far)[3]
        corner = low + np.array([column, row])
        templates[1] = image[corner[1] :, corner[0] :][:h, :w]
        left, top = (np.array(box[:2]) + (corner - start) / scale).tolist()
        yield (left, top, *box[2:]), float(alike[0][row, column])


def downscale_image(image: UInt8[ndarray, "H W 3"], scale: float) -> UInt8[ndarray, "h w 3"]:
    """Reduce an image's width and height by a factor."""
    import cv2

    return np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)


def segment_box_by_motion(
    images: Images,
    n: int,
    interval: tuple[int, int],
    box: Box,
    hand: Bool[ndarray, "h w"] | None = None,
    fingers: Bool[ndarray, "H W"] | None = None,
) -> UInt8[ndarray, "H W"]:
    """Return the label map of ``segment_box``, without pixels that stay with the background while the object moves.

    Only frames of the ``interval``, ends included, are used. Where many pixels would be removed, none is: the object
    lies still while the hand moves, or is transparent.
    """
    import cv2

    labels = segment_box(images(n), box, hand, fingers)
    found, seen = labels == OBJECT_LABEL, labels == HAND_LABEL
    inner = cv2.erode(found.astype(np.uint8), np.ones((BOX_EROSION_PX, BOX_EROSION_PX), np.uint8)) > 0
    motion = click_motion_log_ratio(images, n, interval, inner, seen) if inner.any() else None
    if motion is None or not (motion[found] < STATIC_LOG_RATIO_THRESHOLD).any():
        return labels
    surely, ground = found & (motion > MOVING_LOG_RATIO_THRESHOLD), motion < STATIC_LOG_RATIO_THRESHOLD
    less = segment_box(images(n), box, hand, fingers, surely, ground)
    return less if np.mean(less[found] == OBJECT_LABEL) > 1.0 - MAX_STATIC_FRACTION else labels


def segment_box(
    image: Image,
    box: Box,
    hand: Bool[ndarray, "h w"] | None = None,
    fingers: Bool[ndarray, "H W"] | None = None,
    surely: Bool[ndarray, "H W"] | None = None,
    ground: Bool[ndarray, "H W"] | None = None,
) -> UInt8[ndarray, "H W"]:
    """Return the label map of a frame on which the object fills a box, ``HAND_LABEL`` where the hand is visible.

    Args:
        image: RGB.
        box: the object's [px].
        hand: visible pixels of the detected hand, of any size; None: not known.
        fingers: pixels at which a finger may be (``finger_pixels``). Where known, a large part of the box that differs
            from the background, beside the object and away from fingers, is the object's, whatever its colours.
        surely: pixels known to be the object's, unless they are the hand's, or apart from the object's largest part.
        ground: pixels known not to be the object's.

    Raises:
        UsageError: as ``box_to_slices`` does.
    """
    import cv2

    shape = image.shape[:2]
    inside = np.zeros(shape, bool)
    inside[box_to_slices(box, (shape[1], shape[0]))] = True
    possible = inside if ground is None else inside & ~ground
    w, h = box[2:]
    seen = np.zeros(shape, bool) if hand is None else resize_mask(hand, shape)
    part = bounding_slices(inside, shape, 0.15 * max(w, h))
    beside = np.zeros(shape, bool)
    beside[part] = True
    beside &= ~inside & ~seen
    at = colour_bins(image)

    def cut(hand: Bool[ndarray, "H W"], sure: Bool[ndarray, "H W"]) -> Bool[ndarray, "H W"]:
        free = possible & ~hand

        def begun_with(some: Bool[ndarray, "H W"]) -> Bool[ndarray, "H W"]:
            start = np.where(some, cv2.GC_PR_FGD, np.where(free, cv2.GC_PR_BGD, cv2.GC_BGD)).astype(np.uint8)
            return segment_region(image, sure, ~free, start, part, hand=hand)

        likely = free & (colour_log_ratio(at, ColourHistogram.of(image, free, free | beside)) > 0.0)
        found = begun_with(free)
        if np.count_nonzero(found & ~likely) > THIN_OBJECT_FRACTION * np.count_nonzero(found):
            again = begun_with(likely)
            if np.count_nonzero(again) > MIN_LIKELY_COLOUR_FRACTION * np.count_nonzero(likely):
                return again
        return found

    outside = seen & ~inside
    known = np.count_nonzero(outside) > MIN_HAND_OUTSIDE_FRACTION * np.count_nonzero(seen)
    skin = ColourHistogram.of(image, outside, outside)
    unlike = inside & known & (skin.counts[0][at] < UNSEEN_COLOUR_PROBABILITY)
    surely = np.zeros(shape, bool) if surely is None else surely
    found = cut(seen & ~unlike, surely)
    if known and found.any():
        reached = seen
        seen = remove_object_colours(reached, at, ColourHistogram.of(image, found, found), skin)
        found = cut(seen, surely | (reached & ~seen & inside))
    if fingers is not None:
        unlike = _unlike_background(image, beside & ~fingers) & possible & ~fingers
        found |= _large_parts(unlike & ~found & ~seen, found)
    out = np.where(seen, HAND_LABEL, 0).astype(np.uint8)
    out[found] = OBJECT_LABEL
    return out


def _unlike_background(image: Image, beside: Bool[ndarray, "H W"]) -> Bool[ndarray, "H W"]:
    """Return the pixels of colours that pixels ``beside`` the box lack, without specks."""
    import cv2

    unlike = ColourHistogram.of(image, beside, beside).counts[0][colour_bins(image)] < UNSEEN_COLOUR_PROBABILITY
    return np.asarray(cv2.morphologyEx(unlike.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)) > 0)


def _large_parts(unlike: Bool[ndarray, "H W"], found: Bool[ndarray, "H W"]) -> Bool[ndarray, "H W"]:
    """Return the parts ``unlike`` the background that touch the ``found`` object and are not small beside it."""
    import cv2

    opened = cv2.morphologyEx(unlike.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    count, parts, stats, _ = cv2.connectedComponentsWithStats(opened, connectivity=4)
    touched = np.bincount(parts[cv2.dilate(found.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0], minlength=count) > 0
    large = stats[:, cv2.CC_STAT_AREA] > MIN_OUTSTANDING_AREA_RATIO * np.count_nonzero(found)
    return np.asarray((touched & large & (np.arange(count) > 0))[parts])


def first_mask_finding(
    image: Image, labels: UInt8[ndarray, "H W"], box: Box, fingers: Bool[ndarray, "H W"] | None = None
) -> str:
    """Return in words why a label map of ``segment_box`` lacks a part of the object; empty where nothing says so.

    Either much of the mask's border lies on the box, or what differs from the background stands beside the mask in the
    box, away from ``fingers``. Raises ``UsageError`` as ``box_to_slices`` does.
    """
    import cv2

    found, shape = labels == OBJECT_LABEL, labels.shape
    if not found.any():
        return ""
    rows, columns = box_to_slices(box, (shape[1], shape[0]))
    inside, inner = np.zeros(shape, bool), np.zeros(shape, bool)
    inside[rows, columns] = inner[rows.start + 2 : rows.stop - 2, columns.start + 2 : columns.stop - 2] = True
    border = found & (cv2.erode(found.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=1) == 0)
    share = float((border & ~inner).sum()) / max(1.0, float(border.sum()))
    if share > MAX_BORDER_ON_BOX_FRACTION:
        return f"{100 * share:.0f} % of the mask's border lie on the box: does the object reach beyond it?"
    part = bounding_slices(inside, shape, 0.15 * max(box[2:]))
    away = ~inside & (labels != HAND_LABEL)
    beside = np.zeros(shape, bool)
    beside[part] = away[part]
    free = inside & (labels == 0)
    if fingers is not None:
        beside, free = beside & ~fingers, free & ~fingers
    missing = float((free & _unlike_background(image, beside)).sum()) / float(found.sum())
    if missing > MAX_OUTSTANDING_FRACTION:
        return (
            f"{100 * missing:.0f} % as much as its mask differ from the background, too: are they a part of the object?"
        )
    return ""


def empty_side(labels: UInt8[ndarray, "H W"], box: Box) -> tuple[str, float] | None:
    """Return the side of a box with the widest empty strip, and the strip as a fraction of the box's width or height.

    None for a fraction up to ``MAX_EMPTY_STRIP_FRACTION``, and without labels. Raises ``UsageError`` as
    ``box_to_slices`` does.
    """
    inside = labels[box_to_slices(box, (labels.shape[1], labels.shape[0]))] != 0
    if not inside.any():
        return None
    (top, bottom), (left, right) = (
        (int(filled.argmax()) / len(filled), int(filled[::-1].argmax()) / len(filled))
        for filled in (inside.any(axis=1), inside.any(axis=0))
    )
    share, side = max((left, "left"), (top, "top"), (right, "right"), (bottom, "bottom"))
    return (side, share) if share > MAX_EMPTY_STRIP_FRACTION else None
