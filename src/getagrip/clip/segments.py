"""Regions of an image as COCO writes them: polygons and run lengths, to pixels.

A pixel belongs to a polygon where its centre is inside, and along the border within half a pixel (``cv2.fillPoly``, to
1/256 px). Run lengths go down the columns, beginning with pixels that are outside; compressed ones are COCO's texts.
Not pycocotools (2.0.11): runs that end early leave stray memory in its masks, and a random text can abort the process.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from jaxtyping import Bool
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.io import arrays, files

MOST_CORNERS = 100_000
"""Most corners of the polygons of one region."""
MOST_DRAWN = 2**30
"""Pixels that are gone through for the regions of one kind in a frame, or for the polygons of one region."""


def polygons(path: Path, key: str, value: object, size: tuple[int, int]) -> Bool[ndarray, "H W"]:
    """Fill polygons [[x, y, x, y, ...], ...], clipped to the image.

    Raises ``InputError``.

    Corners may leave the image by its own size, no further.
    """
    import cv2

    width, height = size
    if not isinstance(value, list) or not all(isinstance(corners, list) for corners in value):
        raise InputError(path, key, files.shown(value), "polygons, [[x, y, x, y, ...], ...]")
    if sum(map(len, value)) > 2 * MOST_CORNERS:
        raise InputError(path, key, f"{sum(map(len, value)) // 2} corners", f"at most {MOST_CORNERS}")
    out = np.zeros((height, width), np.uint8)
    drawn = 0
    for corners in value:
        points = arrays.from_lists(corners)
        if points is None or points.dtype.kind not in "fi" or points.ndim != 1 or len(points) < 6 or len(points) % 2:
            raise InputError(path, key, files.shown(corners), "at least three corners x, y, x, y, x, y")
        points = points.reshape(-1, 2).astype(float)
        if not np.all((points >= -np.array(size)) & (points <= 2 * np.array(size))):  # false for NaN, too
            bad = f"corners from {points.min():g} to {points.max():g}"
            raise InputError(path, key, bad, f"corners in or about the {width} x {height} image")
        drawn += int(np.prod(np.clip(np.ptp(points, axis=0), 1, size)))
        if drawn > MOST_DRAWN:
            raise InputError(path, key, "polygons of more pixels", f"at most {MOST_DRAWN} pixels in all")
        cv2.fillPoly(out, [np.round(256.0 * (points - 0.5)).astype(np.int32)], 1, shift=8)
    return out.astype(bool)


def run_lengths(path: Path, key: str, value: object, size: tuple[int, int]) -> Bool[ndarray, "H W"]:
    """Decode ``{"size": [height, width], "counts": [...] or "..."}``. Raises ``InputError``."""
    width, height = size
    if not isinstance(value, dict) or value.get("size") != [height, width]:
        shape = value.get("size") if isinstance(value, dict) else value
        raise InputError(path, f"{key}.size", files.shown(shape), f"[{height}, {width}], the size of the images")
    counts = value.get("counts")
    if isinstance(counts, str):
        counts = _uncompressed(path, key, counts, width * height)
    whole = isinstance(counts, list) and all(type(n) is int and n >= 0 for n in counts)
    if not whole or not isinstance(counts, list) or sum(counts) != width * height:
        input_words = f"runs of {sum(counts)} pixels" if whole and isinstance(counts, list) else files.shown(counts)
        raise InputError(path, f"{key}.counts", input_words, f"runs of {width * height} pixels in all")
    inside = np.arange(len(counts)) % 2 == 1
    return np.repeat(inside, counts).reshape(width, height).T


def _uncompressed(path: Path, key: str, text: str, pixels: int) -> list[int]:
    """COCO's text: numbers in groups of five bits, from the lowest, 32 for "more", the highest bit for the sign.

    From the fourth on they are differences from the last but one (``rleFrString`` of the COCO API).
    """
    counts: list[int] = []
    value = bits = 0
    for letter in text:
        group = ord(letter) - 48
        if not 0 <= group < 64 or bits > 30:
            raise InputError(path, f"{key}.counts", files.shown(text), "COCO's compressed run lengths")
        value |= (group & 31) << bits
        bits += 5
        if not group & 32:
            if group & 16:
                value -= 1 << bits
            counts.append(value + (counts[-2] if len(counts) > 2 else 0))
            if not 0 <= counts[-1] <= pixels:
                raise InputError(path, f"{key}.counts", f"a run of {counts[-1]} pixels", f"0 to {pixels}")
            value = bits = 0
    if bits:
        raise InputError(path, f"{key}.counts", "run lengths that are cut short", "COCO's compressed run lengths")
    return counts


def region(path: Path, key: str, value: object, size: tuple[int, int]) -> Bool[ndarray, "H W"]:
    """Decode a COCO ``segmentation``, of either kind. Raises ``InputError``."""
    return (run_lengths if isinstance(value, dict) else polygons)(path, key, value, size)


def with_area(value: object) -> object:
    """Drop polygons of fewer than three corners or without area from a ``segmentation``; others stay as they are."""
    if not isinstance(value, list) or sum(len(one) for one in value if isinstance(one, list)) > 2 * MOST_CORNERS:
        return value
    return [one for one in value if not _is_flat(one)]


def _is_flat(corners: object) -> bool:
    """Return whether corners, where they are numbers, are on a line."""
    points = arrays.from_lists(corners) if isinstance(corners, list) else None
    if points is None or points.dtype.kind not in "fi" or points.ndim != 1 or len(points) % 2:
        return isinstance(corners, list) and not corners
    if len(points) < 6:
        return True
    from_first = points.reshape(-1, 2).astype(float) - points[:2]
    far = from_first[np.argmax(np.hypot(*from_first.T))]
    across = from_first[:, 0] * far[1] - from_first[:, 1] * far[0]
    return bool(np.all(np.abs(across) <= 1e-9 * (far @ far)))


def check_count(path: Path, key: str, count: int, size: tuple[int, int]) -> None:
    """Raise ``InputError`` for more regions of one kind in a frame than can be drawn in a few seconds."""
    most = max(1, MOST_DRAWN // (size[0] * size[1]))
    if count > most:
        raise InputError(path, key, f"{count} regions in one frame", f"at most {most} at {size[0]} x {size[1]}")


def union(regions: Iterable[Bool[ndarray, "H W"]], size: tuple[int, int]) -> Bool[ndarray, "H W"]:
    """Return the pixels in any of some regions."""
    out = np.zeros(size[::-1], dtype=bool)
    for pixels in regions:
        out |= pixels
    return out
