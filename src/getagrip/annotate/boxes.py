"""Segment the object from a box on one frame: GrabCut (Rother, Kolmogorov, Blake, SIGGRAPH 2004), and motion."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, UInt8
from numpy import ndarray

from getagrip.annotate.carried_masks import Image, Images
from getagrip.annotate.click_motion import MOVES, STILL, moves_with_click
from getagrip.annotate.colour_cut import UNSEEN, Colours, bins, coloured_hand, likelier
from getagrip.annotate.labels import HAND, OBJECT
from getagrip.annotate.strokes import around, cut_out, resized
from getagrip.errors import UsageError

Box = tuple[float, float, float, float]
"""Left, top, width and height [px]."""
SMALLEST = 4.0
"""Least width and height of a box [px]."""
REACH = 0.5
"""Longest step of what a box shows from one frame to the next, in longer sides of the box."""
STAYS = 1e-4
"""Correlation that outweighs a pixel of a box's step: where all looks alike it stays."""
UNLIKE = 64.0
"""Distance of an object's colours in RGB [of 442] (root mean square) that outweighs a correlation of 1."""
LOST = 0.5
"""Correlation of a box with the first frame below which it may be elsewhere."""
LARGEST = 128
"""Largest side of a box in the images in which it is followed [px]."""
OUTSIDE = 0.2
"""If more than this share of a found hand is outside the object's box, its colours there tell which pixels in the box
may be the object's: a label before the palm, say."""
THIN = 0.35
"""If more than this share of what is found in a box has colours that are likelier beside it, the object is so thin that
most of the box is background: what has the other colours is the object."""
ENOUGH = 0.5
"""That counts if more than this share of the pixels of those colours is found."""
BORDER = 9
"""Side of the square by which what is found in a box is made narrower before its motion is measured [px]."""
MUCH = 0.2
"""Share of what is found in a box that is not left out for its motion."""
EMPTY = 0.15
"""Object and hand reach all sides of the object's box, within this share of the box's width or height."""


def window(box: Box, size: tuple[int, int]) -> tuple[slice, slice]:
    """Return the rows and columns of a box in an image of ``size`` (width, height) [px].

    Raises ``UsageError`` for a box that is tiny, or more than a tenth of which is out of the image.
    """
    x, y, w, h = box
    left, top, right, bottom = max(0.0, x), max(0.0, y), min(x + w, size[0]), min(y + h, size[1])
    if not (min(w, h) >= SMALLEST and max(0.0, right - left) * max(0.0, bottom - top) >= 0.9 * w * h):
        got = ",".join(f"{value:g}" for value in box)
        within = f"the upright image, {size[0]} x {size[1]}, {SMALLEST:g} pixels or more on either side"
        raise UsageError(f"--object-box must be X,Y,W,H within {within} (got {got})")
    return slice(round(top), round(bottom)), slice(round(left), round(right))


def followed_boxes(images: Images, box: Box, first: int, to: int) -> Iterator[tuple[Box, float]]:
    """Follow what is seen in a box from a frame to a later one; yield it in each of them, the first included.

    It moves to where the image is most like the box in the first frame and in the frame before, in pattern and in the
    object's colours. With each box comes its correlation with the first frame. Raises ``UsageError`` after the first as
    ``window`` does.
    """
    import cv2

    yield box, 1.0
    if to <= first:
        return
    scale = min(1.0, LARGEST / max(box[2:]))
    image = reduced(images(first), scale)
    size = np.array(image.shape[1::-1])
    start = corner = np.clip(np.round(scale * np.array(box[:2])).astype(int), 0, size - 1)
    w, h = np.clip(np.round(scale * np.add(box[:2], box[2:])).astype(int), start + 1, size) - start
    near = round(REACH * max(w, h))
    found = (boxed(images(first), box) == OBJECT).astype(np.uint8)
    counts = cv2.resize(found, size.tolist(), interpolation=cv2.INTER_AREA)[corner[1] :, corner[0] :][:h, :w]
    counts = counts if counts.any() else np.ones((h, w), np.uint8)
    templates = [image[corner[1] :, corner[0] :][:h, :w]] * 2
    for n in range(first + 1, to + 1):
        image = reduced(images(n), scale)
        low = np.maximum(corner - near, 0)
        nearby = image[low[1] : corner[1] + h + near, low[0] : corner[0] + w + near]
        squares = [cv2.matchTemplate(nearby, each, cv2.TM_SQDIFF, mask=counts) for each in templates]
        unlike = [np.sqrt(np.maximum(each, 0.0) / counts.sum()) / UNLIKE for each in squares]
        alike = [cv2.matchTemplate(nearby, each, cv2.TM_CCOEFF_NORMED) for each in templates]
        y, x = np.indices(alike[0].shape, dtype=np.float32)
        far = np.hypot(x - (corner - low)[0], y - (corner - low)[1])
        column, row = cv2.minMaxLoc(np.sum(alike, axis=0) - np.sum(unlike, axis=0) - STAYS * far)[3]
        corner = low + np.array([column, row])
        templates[1] = image[corner[1] :, corner[0] :][:h, :w]
        left, top = (np.array(box[:2]) + (corner - start) / scale).tolist()
        yield (left, top, *box[2:]), float(alike[0][row, column])


def reduced(image: UInt8[ndarray, "H W 3"], scale: float) -> UInt8[ndarray, "h w 3"]:
    """Reduce an image's width and height by a factor."""
    import cv2

    return np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)


def moving_in_box(
    images: Images, n: int, interval: tuple[int, int], box: Box, hand: Bool[ndarray, "h w"] | None = None
) -> UInt8[ndarray, "H W"]:
    """Return what ``boxed`` does, without what stays with the ground while the object moves.

    Frames beyond the ``interval``, whose ends are included, are not looked at. Where much would be left out, nothing
    is: the object lies still while the hand moves, or the ground is seen through it.
    """
    import cv2

    labels = boxed(images(n), box, hand)
    found, seen = labels == OBJECT, labels == HAND
    inner = cv2.erode(found.astype(np.uint8), np.ones((BORDER, BORDER), np.uint8)) > 0
    motion = moves_with_click(images, n, interval, inner, seen) if inner.any() else None
    if motion is None or not (motion[found] < STILL).any():
        return labels
    less = boxed(images(n), box, hand, found & (motion > MOVES), motion < STILL)
    return less if np.mean(less[found] == OBJECT) > 1.0 - MUCH else labels


def boxed(
    image: Image,
    box: Box,
    hand: Bool[ndarray, "h w"] | None = None,
    surely: Bool[ndarray, "H W"] | None = None,
    ground: Bool[ndarray, "H W"] | None = None,
) -> UInt8[ndarray, "H W"]:
    """Return the label map of a frame on which the object fills a box, ``HAND`` where the hand is seen.

    Args:
        image: RGB.
        box: the object's [px].
        hand: visible pixels of the hand that was found, of any size; None: not known.
        surely: pixels that are known to be the object's, unless they are the hand's, or apart from its largest part.
        ground: pixels that are known not to be the object's.

    Raises:
        UsageError: as ``window`` does.
    """
    import cv2

    shape = image.shape[:2]
    inside = np.zeros(shape, bool)
    inside[window(box, (shape[1], shape[0]))] = True
    possible = inside if ground is None else inside & ~ground
    w, h = box[2:]
    seen = np.zeros(shape, bool) if hand is None else resized(hand, shape)
    part = around(inside, shape, 0.15 * max(w, h))
    beside = np.zeros(shape, bool)
    beside[part] = True
    beside &= ~inside & ~seen
    at = bins(image)

    def cut(hand: Bool[ndarray, "H W"], sure: Bool[ndarray, "H W"]) -> Bool[ndarray, "H W"]:
        free = possible & ~hand

        def begun_with(some: Bool[ndarray, "H W"]) -> Bool[ndarray, "H W"]:
            start = np.where(some, cv2.GC_PR_FGD, np.where(free, cv2.GC_PR_BGD, cv2.GC_BGD)).astype(np.uint8)
            return cut_out(image, sure, ~free, start, part, hand=hand)

        likely = free & (likelier(at, Colours.of(image, free, free | beside)) > 0.0)
        found = begun_with(free)
        if np.count_nonzero(found & ~likely) > THIN * np.count_nonzero(found):
            again = begun_with(likely)
            if np.count_nonzero(again) > ENOUGH * np.count_nonzero(likely):
                return again
        return found

    outside = seen & ~inside
    known = np.count_nonzero(outside) > OUTSIDE * np.count_nonzero(seen)
    skin = Colours.of(image, outside, outside)
    unlike = inside & known & (skin.counts[0][at] < UNSEEN)
    surely = np.zeros(shape, bool) if surely is None else surely
    found = cut(seen & ~unlike, surely)
    if known and found.any():
        reached = seen
        seen = coloured_hand(reached, at, Colours.of(image, found, found), skin)
        found = cut(seen, surely | (reached & ~seen & inside))
    out = np.where(seen, HAND, 0).astype(np.uint8)
    out[found] = OBJECT
    return out


def empty_side(labels: UInt8[ndarray, "H W"], box: Box) -> tuple[str, float] | None:
    """Return the side of a box with the widest empty strip, and the strip's share of the box's width or height.

    None up to a share of ``EMPTY``, and where nothing is labelled. Raises ``UsageError`` as ``window`` does.
    """
    inside = labels[window(box, (labels.shape[1], labels.shape[0]))] != 0
    if not inside.any():
        return None
    (top, bottom), (left, right) = (
        (int(filled.argmax()) / len(filled), int(filled[::-1].argmax()) / len(filled))
        for filled in (inside.any(axis=1), inside.any(axis=0))
    )
    share, side = max((left, "left"), (top, "top"), (right, "right"), (bottom, "bottom"))
    return (side, share) if share > EMPTY else None
