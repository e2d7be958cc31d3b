"""A mask carried from its key frame through the images, and two such masks blended.

Where a pixel of the new frame was in the old one is found by dense inverse search (DIS; Kroeger, Timofte, Dai, Van
Gool, "Fast Optical Flow using Dense Inverse Search", ECCV 2016). After each step GrabCut (Rother, Kolmogorov, Blake,
SIGGRAPH 2004) draws the border anew in a narrow band, so that errors do not grow. Lengths are in
pixels of the size at which masks are carried (``propagated_masks.SIDE``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, UInt8
from numpy import ndarray

from getagrip.annotate.labels import FRONT, OBJECT

Image = UInt8[ndarray, "H W 3"]
Images = Callable[[int], Image]
"""RGB by frame, from 0; of any one size that has the shape of the masks'."""

MARGIN = 120
"""Largest motion between frames [px]; what moves farther is lost."""
FAR = 16
"""Signed distances end here [px]."""
BAND, UNSURE_BAND = 3.0, 10.0
"""GrabCut moves the border by less than this, the second where flow there and back disagrees [px]."""
ROUNDS = 2
"""Rounds of GrabCut."""
BACK = 1.5
"""Flow there and back agrees if it ends so near to where it began [px]."""

KINDS = (OBJECT, FRONT)


class Carried(NamedTuple):
    """The mask of a frame on its way; small, since those of all frames between two keys are kept."""

    frame: int
    corner: tuple[int, int]
    """Left and top of the part of the image that holds all of it [px]."""
    inside: Float32[ndarray, "2 h w"]
    """Signed distances from the borders of ``KINDS``, above 0 inside, -FAR to FAR [px]."""
    known: Float32[ndarray, "h w"]
    """1 where that comes from the key, 0 where it was not in the image."""
    trust: float


def carry(
    image: Images, keys: Mapping[int, UInt8[ndarray, "H W"]], key: int, to: int, size: tuple[int, int]
) -> Iterator[Carried]:
    """Carry the mask of a key to the frames after it until ``to``, or before it."""
    if key == to:
        return
    now, before = _of_key(key, keys[key], size), _resized(image(key), size)
    towards = 1 if to > key else -1
    for frame in range(key + towards, to + towards, towards):
        after = _resized(image(frame), size)
        now = _step(now, before, after, frame)
        yield now
        before = after


def _of_key(frame: int, labels: UInt8[ndarray, "H W"], size: tuple[int, int]) -> Carried:
    import cv2

    masks = [cv2.resize((labels == kind).astype(np.float32), size, interpolation=cv2.INTER_AREA) for kind in KINDS]
    inside = np.stack([_signed_distance(mask > 0.5) for mask in masks])
    return _cut(frame, (0, 0), inside, np.ones(inside.shape[1:], np.float32), 1.0)


def _resized(image: Image, size: tuple[int, int]) -> UInt8[ndarray, "h w 3"]:
    import cv2

    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def _step(now: Carried, before: Image, after: Image, frame: int) -> Carried:
    """Carry a mask to the next frame."""
    import cv2

    if not now.inside.size:  # it is not visible
        return now._replace(frame=frame)
    height, width = before.shape[:2]
    (left, top), (h, w) = now.corner, now.inside.shape[1:]
    rows = slice(max(0, top - MARGIN), min(height, top + h + MARGIN))
    columns = slice(max(0, left - MARGIN), min(width, left + w + MARGIN))
    a, b = before[rows, columns], after[rows, columns]
    back, there = _flow(b, a), _flow(a, b)
    x, y = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in b.shape[1::-1]))
    came = x + back[..., 0], y + back[..., 1]
    off = np.linalg.norm(back + cv2.remap(there, *came, cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE), axis=-1)
    u, v = came[0] + columns.start, came[1] + rows.start
    known = ((u >= 0) & (u <= width - 1) & (v >= 0) & (v <= height - 1)).astype(np.float32)
    old = np.clip(u, 0, width - 1) - left, np.clip(v, 0, height - 1) - top
    inside = np.stack([_moved(kind, old, -float(FAR)) for kind in now.inside])
    border = np.abs(inside[0]) < 2.0
    trust = now.trust * (float(np.mean(off[border] < BACK)) if border.any() else 1.0)
    refined = np.stack([_refined(b, kind, off < BACK) for kind in inside])
    return _cut(frame, (columns.start, rows.start), refined, known * _moved(now.known, old, 1.0), trust)


def _moved(
    values: Float32[ndarray, "h w"], old: tuple[Float32[ndarray, "H W"], Float32[ndarray, "H W"]], outside: float
) -> Float32[ndarray, "H W"]:
    """Values at where pixels were."""
    import cv2

    return np.asarray(cv2.remap(values, *old, cv2.INTER_LINEAR, None, cv2.BORDER_CONSTANT, outside), np.float32)


def _flow(a: Image, b: Image) -> Float32[ndarray, "H W 2"]:
    """Return the place in b of each pixel of a, less its place in a [px]."""
    import cv2

    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    a, b = (cv2.cvtColor(np.ascontiguousarray(each), cv2.COLOR_RGB2GRAY) for each in (a, b))
    return np.asarray(search.calc(a, b, np.zeros((*a.shape, 2), np.float32)), np.float32)


def _refined(image: Image, inside: Float32[ndarray, "h w"], sure: Bool[ndarray, "h w"]) -> Float32[ndarray, "h w"]:
    """Signed distances from the border that GrabCut finds near to the given one, and less near where flow is unsure."""
    import cv2

    near = inside > -FAR
    band = np.where(sure, BAND, UNSURE_BAND)
    if not (inside > band).any() or near.all():
        return inside
    labels = np.where(inside > 0, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[inside > band], labels[inside < -band] = cv2.GC_FGD, cv2.GC_BGD
    rows, columns = (slice(int(i.min()), int(i.max()) + 1) for i in np.nonzero(near))
    part = np.ascontiguousarray(labels[rows, columns])
    colours = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.setRNGSeed(0)  # GrabCut begins with k-means from random centres
    image = np.ascontiguousarray(image[rows, columns])
    labels[rows, columns] = cv2.grabCut(image, part, (0, 0, 0, 0), *colours, ROUNDS, cv2.GC_INIT_WITH_MASK)[0]
    found = _signed_distance((labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD))
    return np.asarray(cv2.GaussianBlur(found, (0, 0), 1.0), np.float32)


def _signed_distance(mask: Bool[ndarray, "h w"]) -> Float32[ndarray, "h w"]:
    """Distance from the border between pixels, above 0 inside, up to ``FAR`` [px]."""
    import cv2

    distances = []
    for each in (mask, ~mask):
        seen = each.astype(np.uint8)
        if seen.all():
            distances.append(np.full(mask.shape, float(FAR), np.float32))
        else:
            distances.append(np.maximum(cv2.distanceTransform(seen, cv2.DIST_L2, 5) - 0.5, 0.0))
    return np.clip(distances[0] - distances[1], -FAR, FAR).astype(np.float32)


def _cut(
    frame: int,
    corner: tuple[int, int],
    inside: Float32[ndarray, "2 h w"],
    known: Float32[ndarray, "h w"],
    trust: float,
) -> Carried:
    """Only the part that holds what is inside, and what is near to it."""
    near = (inside > -FAR).any(axis=0)
    if not near.any():
        return Carried(frame, corner, inside[:, :0, :0], known[:0, :0], trust)
    rows, columns = (slice(int(i.min()), int(i.max()) + 1) for i in np.nonzero(near))
    corner = corner[0] + columns.start, corner[1] + rows.start
    return Carried(frame, corner, inside[:, rows, columns].copy(), known[rows, columns].copy(), trust)


def blended(one: Carried, other: Carried, share: float) -> tuple[Carried, float]:
    """Blend two masks of a frame by the other's ``share``, 0 to 1; also return their agreement.

    They agree or not where both are known.
    """
    left, top = np.minimum(one.corner, other.corner).tolist()
    ends = [np.add(each.corner, each.inside.shape[:0:-1]) for each in (one, other)]
    width, height = (np.maximum(*ends) - (left, top)).tolist()
    (a, known_a), (b, known_b) = (placed(each, (left, top), (width, height)) for each in (one, other))
    weight_a, weight_b = (1.0 - share) * one.trust * known_a + 1e-6, share * other.trust * known_b + 1e-6
    inside = (weight_a * a + weight_b * b) / (weight_a + weight_b)
    both = (known_a > 0.5) & (known_b > 0.5)
    union = np.count_nonzero(both & ((a[0] > 0) | (b[0] > 0)))
    agreement = np.count_nonzero(both & (a[0] > 0) & (b[0] > 0)) / union if union else 1.0
    known = np.maximum(known_a, known_b)
    return one._replace(corner=(left, top), inside=inside.astype(np.float32), known=known), float(agreement)


def placed(
    each: Carried, corner: tuple[int, int], size: tuple[int, int]
) -> tuple[Float32[ndarray, "2 h w"], Float32[ndarray, "h w"]]:
    """Place signed distances, and what is known, in another part of the image, which holds theirs."""
    inside, known = np.full((2, *size[::-1]), -float(FAR), np.float32), np.ones(size[::-1], np.float32)
    (left, top), (h, w) = np.subtract(each.corner, corner).tolist(), each.inside.shape[1:]
    inside[:, top : top + h, left : left + w] = each.inside
    known[top : top + h, left : left + w] = each.known
    return inside, known
