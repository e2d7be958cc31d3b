"""Regions of an image as COCO writes them: polygons and run lengths, to pixels.

A pixel belongs to a polygon where its centre is inside, and along the border within half a pixel (``cv2.fillPoly``, to
1/256 px). Run lengths go down the columns, beginning with pixels that are outside; compressed ones are COCO's texts.
Not pycocotools (2.0.11): runs that end early leave stray memory in its masks, and a random text can abort the process.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.io import arrays, files
from getagrip.io.images import decode_image

MAX_REGION_CORNERS = 100_000
"""Most corners of the polygons of one region."""
MAX_NESTED_POLYGONS = 1000
"""Polygons of one region beyond which none is looked at as a hole."""
N_INSIDE_TEST_CORNERS = 16
"""Corners of a polygon by which it is inside another one."""
NESTED_POLYGONS_NOTE = "polygons inside others of their region were filled (holes are wound the other way)"
MAX_DRAWN_PIXELS = 2**30
"""Pixels that are gone through for the regions of one kind in a frame, or for the polygons of one region."""


def fill_polygons(
    path: Path, key: str, value: object, size: tuple[int, int], notes: Counter[str] | None = None
) -> Bool[ndarray, "H W"]:
    """Fill polygons [[x, y, x, y, ...], ...], clipped to the image.

    Raises ``InputError``.

    Corners may leave the image by its own size, no further. A polygon inside another one that is wound the other way
    is a hole in it; ``notes`` count those that are wound the same way, and are filled.
    """

    width, height = size
    if not isinstance(value, list) or not all(isinstance(corners, list) for corners in value):
        raise InputError(path, key, files.shorten_value(value), "polygons, [[x, y, x, y, ...], ...]")
    if sum(map(len, value)) > 2 * MAX_REGION_CORNERS:
        raise InputError(path, key, f"{sum(map(len, value)) // 2} corners", f"at most {MAX_REGION_CORNERS}")
    found, drawn = list[Float[ndarray, "n 2"]](), 0
    for corners in value:
        points = arrays.from_lists(corners)
        if points is None or points.dtype.kind not in "fi" or points.ndim != 1 or len(points) < 6 or len(points) % 2:
            raise InputError(path, key, files.shorten_value(corners), "at least three corners x, y, x, y, x, y")
        points = points.reshape(-1, 2).astype(float)
        if not np.all((points >= -np.array(size)) & (points <= 2 * np.array(size))):  # false for NaN, too
            bad = f"corners from {points.min():g} to {points.max():g}"
            raise InputError(path, key, bad, f"corners in or about the {width} x {height} image")
        drawn += int(np.prod(np.clip(np.ptp(points, axis=0), 1, size)))
        if drawn > MAX_DRAWN_PIXELS:
            raise InputError(path, key, "polygons of more pixels", f"at most {MAX_DRAWN_PIXELS} pixels in all")
        found.append(points)
    return _draw_polygons(found, size, Counter() if notes is None else notes)


def _draw_polygons(
    found: list[Float[ndarray, "n 2"]], size: tuple[int, int], notes: Counter[str]
) -> Bool[ndarray, "H W"]:
    """Draw polygons, the largest first: a hole is inside one that was drawn and wound the other way."""
    import cv2

    out = np.zeros(size[::-1], np.uint8)
    areas = [_signed_area(points) for points in found]
    outer = list[int]()
    for k in sorted(range(len(found)), key=lambda k: -abs(areas[k])):
        corners = [np.round(256.0 * (found[k] - 0.5)).astype(np.int32)]
        around = [n for n in outer if len(outer) <= MAX_NESTED_POLYGONS and _is_inside(found[k], found[n])]
        if not around or areas[k] * areas[around[-1]] > 0.0:
            notes.update([NESTED_POLYGONS_NOTE] * bool(around))
            cv2.fillPoly(out, corners, 1, shift=8)
        else:
            hole = np.zeros_like(out)
            cv2.fillPoly(hole, corners, 1, shift=8)
            cv2.polylines(hole, corners, True, 0, shift=8)  # the border is the region's
            out[hole > 0] = 0
        outer.append(k)
    return out.astype(bool)


def _signed_area(points: Float[ndarray, "n 2"]) -> float:
    """Compute the area of a polygon, below 0 if it is wound the other way."""
    x, y = (points - points[0]).T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2.0


def _is_inside(points: Float[ndarray, "n 2"], outer: Float[ndarray, "m 2"]) -> bool:
    """Return whether some corners of a polygon, and the middle of these, are all in another one."""
    import cv2

    if (points.min(axis=0) < outer.min(axis=0)).any() or (points.max(axis=0) > outer.max(axis=0)).any():
        return False
    border = outer.astype(np.float32)
    some = points[np.linspace(0, len(points) - 1, min(len(points), N_INSIDE_TEST_CORNERS)).astype(int)]
    return all(cv2.pointPolygonTest(border, (float(x), float(y)), False) >= 0.0 for x, y in some)


def decode_run_lengths(path: Path, key: str, value: object, size: tuple[int, int]) -> Bool[ndarray, "H W"]:
    """Decode ``{"size": [height, width], "counts": [...] or "..."}``. Raises ``InputError``."""
    width, height = size
    if not isinstance(value, dict) or value.get("size") != [height, width]:
        shape = value.get("size") if isinstance(value, dict) else value
        raise InputError(
            path, f"{key}.size", files.shorten_value(shape), f"[{height}, {width}], the size of the images"
        )
    counts = value.get("counts")
    if isinstance(counts, str):
        counts = _decode_coco_counts(path, key, counts, width * height)
    whole = isinstance(counts, list) and all(type(n) is int and n >= 0 for n in counts)
    if not whole or not isinstance(counts, list) or sum(counts) != width * height:
        input_words = (
            f"runs of {sum(counts)} pixels" if whole and isinstance(counts, list) else files.shorten_value(counts)
        )
        raise InputError(path, f"{key}.counts", input_words, f"runs of {width * height} pixels in all")
    inside = np.arange(len(counts)) % 2 == 1
    return np.repeat(inside, counts).reshape(width, height).T


def _decode_coco_counts(path: Path, key: str, text: str, pixels: int) -> list[int]:
    """COCO's text: numbers in groups of five bits, from the lowest, 32 for "more", the highest bit for the sign.

    From the fourth on they are differences from the last but one (``rleFrString`` of the COCO API).
    """
    counts: list[int] = []
    value = bits = 0
    for letter in text:
        group = ord(letter) - 48
        if not 0 <= group < 64 or bits > 30:
            raise InputError(path, f"{key}.counts", files.shorten_value(text), "COCO's compressed run lengths")
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


@dataclass(frozen=True)
class PngRegion:
    """A region as a PNG of its own box, as LabelMe has it.

    Attributes:
        content: the PNG's file.
        corner: column and row of its first pixel in the image.
    """

    content: bytes
    corner: tuple[int, int]

    def pixels(self, path: Path, key: str, size: tuple[int, int]) -> Bool[ndarray, "H W"]:
        """Decode the region. Raises ``InputError`` where it is damaged or leaves the image."""
        inside = decode_image(path, key, self.content, max(size)).any(axis=2)
        (x, y), (height, width) = self.corner, inside.shape
        if min(x, y) < 0 or x + width > size[0] or y + height > size[1]:
            got = f"{width} x {height} pixels from ({x}, {y}) on"
            raise InputError(path, key, got, f"a mask inside the {size[0]} x {size[1]} image")
        out = np.zeros(size[::-1], dtype=bool)
        out[y : y + height, x : x + width] = inside
        return out


def decode_region(
    path: Path, key: str, value: object, size: tuple[int, int], notes: Counter[str] | None = None
) -> Bool[ndarray, "H W"]:
    """Decode a COCO ``segmentation`` of either kind, or a ``PngRegion``. Raises ``InputError``."""
    if isinstance(value, PngRegion):
        return value.pixels(path, key, size)
    return (
        decode_run_lengths(path, key, value, size)
        if isinstance(value, dict)
        else fill_polygons(path, key, value, size, notes)
    )


def run_length_size(value: object) -> tuple[int, int] | None:
    """Return the width and height that run lengths state; None for other regions, and where they are malformed."""
    stated = value.get("size") if isinstance(value, dict) else None
    if not isinstance(stated, list) or len(stated) != 2 or not all(type(side) is int for side in stated):
        return None
    return stated[1], stated[0]


def drop_flat_polygons(value: object) -> object:
    """Drop polygons of fewer than three corners or without area from a ``segmentation``; others stay as they are."""
    if not isinstance(value, list) or sum(len(one) for one in value if isinstance(one, list)) > 2 * MAX_REGION_CORNERS:
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


def check_region_count(path: Path, key: str, count: int, size: tuple[int, int]) -> None:
    """Raise ``InputError`` for more regions of one kind in a frame than can be drawn in a few seconds."""
    most = max(1, MAX_DRAWN_PIXELS // (size[0] * size[1]))
    if count > most:
        raise InputError(path, key, f"{count} regions in one frame", f"at most {most} at {size[0]} x {size[1]}")


def union(regions: Iterable[Bool[ndarray, "H W"]], size: tuple[int, int]) -> Bool[ndarray, "H W"]:
    """Return the pixels in any of some regions."""
    out = np.zeros(size[::-1], dtype=bool)
    for pixels in regions:
        out |= pixels
    return out
