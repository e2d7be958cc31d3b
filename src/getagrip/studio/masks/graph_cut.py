"""The border between object and background, from colours and a prior.

The border minimises the sum of ``cost`` u + ``edge`` |grad u| over 0 <= u <= 1, a continuous minimal cut (Chan,
Esedoglu, Nikolova, SIAM J. Appl. Math. 2006), by the primal-dual steps of Chambolle and Pock (JMIV 2011). The colours
of both sides are histograms: of the key frames, over the whole image, and of the frame before, near the same place.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Int, Int32, UInt8
from numpy import ndarray

from getagrip.compiling import kernel


@kernel("s2 s2 s2 i")
def cut_steps(cost: ndarray, edge: ndarray, u: ndarray, rounds: int) -> None:
    """Minimise the sum of cost u + edge |grad u| over 0 <= u <= 1, from ``u`` (h, w) and into it."""
    height, width = u.shape
    step = np.float32(1.0 / np.sqrt(8.0))
    bar = u.copy()
    px, py = np.zeros_like(u), np.zeros_like(u)
    for _ in range(rounds):
        for i in range(height):
            for j in range(width):
                x, y = px[i, j], py[i, j]
                if j + 1 < width:
                    x += step * (bar[i, j + 1] - bar[i, j])
                if i + 1 < height:
                    y += step * (bar[i + 1, j] - bar[i, j])
                length = np.sqrt(x * x + y * y) / edge[i, j]
                if length > 1.0:
                    x, y = x / length, y / length
                px[i, j], py[i, j] = x, y
        for i in range(height):
            for j in range(width):
                spread = px[i, j] + py[i, j]
                if j > 0:
                    spread -= px[i, j - 1]
                if i > 0:
                    spread -= py[i - 1, j]
                new = min(max(u[i, j] + step * (spread - cost[i, j]), np.float32(0.0)), np.float32(1.0))
                bar[i, j], u[i, j] = np.float32(2.0) * new - u[i, j], new


N_COLOUR_BINS = 12
"""Bins of lightness and of each of Lab's colours."""
GREY_BIN_SCALE, MAX_BINNED_CHROMA = 8.0, 50.0
"""Distance from grey of Lab's two colours up to which their bins are even, then wider; and the last bin's end."""
N_IMAGE_CELLS = 8
"""Cells in each direction of the image, in each of which colours are counted."""
HISTOGRAM_BLUR_SIGMA = 0.7
"""Blur of histograms [bins, cells]."""
KEYFRAME_COLOUR_WEIGHT = 8.0
"""Weight of the key frames' colours, in pixels of a cell."""
COLOUR_PSEUDO_COUNT = 0.05
"""Pixels of each colour added to both sides, since either side may have colours that were not seen."""
BORDER_COST = 3.0
"""Cost of a border of one pixel on a smooth image; on a strong edge, ``STRONG_EDGE_FACTOR`` times as much."""
STRONG_EDGE_FACTOR = 0.15
N_PRIMAL_DUAL_STEPS = 50
HAND_COLOUR_LOG_RATIO = 0.5
"""Log ratio of the object's colours to the hand's above which a pixel of the detected hand is not the hand's; at the
hand's border the limit is 0."""
MIN_REMAINING_HAND_FRACTION = 0.3
"""Fraction of the detected hand that must remain: else colours cannot separate it from the object (changed light)."""
UNSEEN_COLOUR_PROBABILITY = 1e-3
"""Probability of a colour that neither hand nor object has."""

Image = UInt8[ndarray, "h w 3"]
Mask = Bool[ndarray, "h w"]


def colour_bins(image: Image) -> Int32[ndarray, "h w"]:
    """Return the bin of each pixel's colour."""
    import cv2

    levels = np.arange(256)
    apart = np.arcsinh((levels - 127.5) / GREY_BIN_SCALE) / np.arcsinh(MAX_BINNED_CHROMA / GREY_BIN_SCALE)
    grey = np.clip(N_COLOUR_BINS * (1.0 + apart) / 2.0, 0, N_COLOUR_BINS - 1)
    table = np.stack([levels * N_COLOUR_BINS // 256, grey, grey], axis=-1).astype(np.uint8)[:, None]
    lab = cv2.LUT(cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2LAB), table).astype(np.int32)
    return np.asarray((lab[..., 0] * N_COLOUR_BINS + lab[..., 1]) * N_COLOUR_BINS + lab[..., 2])


class ColourHistogram(NamedTuple):
    """Probabilities of colours inside and outside a mask."""

    counts: Float32[ndarray, "2 bins"]

    @staticmethod
    def of(image: Image, inside: Mask, counted: Mask) -> ColourHistogram:
        """Count the colours of the ``counted`` pixels of an image."""
        at = colour_bins(image)
        sides = [
            _count_bins(at[side], (N_COLOUR_BINS,) * 3) / max(1, np.count_nonzero(side))
            for side in (inside & counted, ~inside & counted)
        ]
        return ColourHistogram(np.stack(sides).astype(np.float32))

    @staticmethod
    def mean(some: list[ColourHistogram]) -> ColourHistogram:
        """Return the mean of the histograms of several images."""
        return ColourHistogram(np.mean([each.counts for each in some], axis=0).astype(np.float32))


class LocalColourHistogram(NamedTuple):
    """Counts of colours in each cell of the image, inside and outside a mask."""

    size: tuple[int, int]
    counts: Float32[ndarray, "2 cells"]

    @staticmethod
    def of(at: Int32[ndarray, "h w"], inside: Mask, counted: Mask) -> LocalColourHistogram:
        """Count the ``counted`` pixels of an image, from the bins of their colours."""
        height, width = inside.shape
        y, x = np.mgrid[:height, :width]
        row, column = y * N_IMAGE_CELLS // max(height, N_IMAGE_CELLS), x * N_IMAGE_CELLS // max(width, N_IMAGE_CELLS)
        at = (row * N_IMAGE_CELLS + column) * N_COLOUR_BINS**3 + at
        shape = (N_IMAGE_CELLS,) * 2 + (N_COLOUR_BINS,) * 3
        sides = [_count_bins(at[side], shape) for side in (inside & counted, ~inside & counted)]
        return LocalColourHistogram((width, height), np.stack(sides))


def _bilinear_cells(
    size: tuple[int, int], x: Float32[ndarray, "h w"], y: Float32[ndarray, "h w"]
) -> Iterator[tuple[Int[ndarray, "h w"], Float32[ndarray, "h w"]]]:
    """Yield the four cells around each place, and their bilinear weights."""
    cells = (
        np.clip((each + 0.5) * N_IMAGE_CELLS / max(length, N_IMAGE_CELLS) - 0.5, 0.0, N_IMAGE_CELLS - 1.001)
        for each, length in zip((x, y), size, strict=True)
    )
    (u, column), (v, row) = (np.modf(each.astype(np.float32)) for each in cells)
    for i, across in enumerate((1 - u, u)):
        for j, down in enumerate((1 - v, v)):
            yield ((row + j) * N_IMAGE_CELLS + column + i).astype(np.int64), across * down


def _count_bins(at: Int[ndarray, "n"], shape: tuple[int, ...]) -> Float32[ndarray, "m"]:
    """Count the pixels in each bin of a histogram of a ``shape``, and blur it."""
    from scipy.ndimage import gaussian_filter

    counts = np.bincount(at, minlength=int(np.prod(shape))).astype(np.float32).reshape(shape)
    blurred = gaussian_filter(counts, HISTOGRAM_BLUR_SIGMA, mode="constant", truncate=2.0)
    return np.asarray(blurred, np.float32).ravel()


def colour_log_ratio(
    at: Int32[ndarray, "h w"],
    keys: ColourHistogram,
    before: LocalColourHistogram | None = None,
    came: tuple[Float32[ndarray, "h w"], Float32[ndarray, "h w"]] | None = None,
) -> Float32[ndarray, "h w"]:
    """Return the log ratio of each pixel's colour probabilities inside and outside, from the bin of its colour.

    ``came`` are the pixels' places in the frame ``before``, whose colours at these places count as well.
    """
    sides = KEYFRAME_COLOUR_WEIGHT * keys.counts[:, at] + COLOUR_PSEUDO_COUNT * KEYFRAME_COLOUR_WEIGHT / N_COLOUR_BINS
    if before is not None and came is not None:
        for cell, share in _bilinear_cells(before.size, *came):
            sides = sides + share * before.counts[:, cell * N_COLOUR_BINS**3 + at]
    return np.asarray(np.log(sides[0] / sides[1]), np.float32)


def remove_object_colours(hand: Mask, at: Int32[ndarray, "h w"], own: ColourHistogram, skin: ColourHistogram) -> Mask:
    """Return a detected hand without pixels of the object's ``own`` colours; unchanged if most have such colours.

    ``at`` are the bins of the image's colours, ``skin`` the hand's colours.
    """
    import cv2

    shares = (each.counts[0][at] + UNSEEN_COLOUR_PROBABILITY for each in (own, skin))
    unlike = cv2.GaussianBlur(np.log(np.divide(*shares)), (0, 0), 1.0)
    found = ~(overlapping_components(~hand | (unlike > 0.0), ~hand) | (unlike > HAND_COLOUR_LOG_RATIO))
    return np.asarray(found if np.count_nonzero(found) > MIN_REMAINING_HAND_FRACTION * np.count_nonzero(hand) else hand)


def overlapping_components(mask: Mask, before: Mask) -> Mask:
    """Return the components of a mask that overlap with a mask ``before``."""
    import cv2

    _, parts = cv2.connectedComponents(mask.astype(np.uint8))
    return np.asarray(mask & np.isin(parts, np.unique(parts[before])))


def edge_cost(image: Image) -> Float32[ndarray, "h w"]:
    """Return the cost of a border per pixel [1/px]."""
    values = image.astype(np.float32)
    change = np.zeros(image.shape[:2], np.float32)
    right, down = values[:, 1:] - values[:, :-1], values[1:] - values[:-1]
    change[:, :-1] += np.einsum("hwc,hwc->hw", right, right)
    change[:-1] += np.einsum("hwc,hwc->hw", down, down)
    smooth = np.exp(-change / (2.0 * change.mean() + 1e-6))
    return np.asarray(BORDER_COST * (STRONG_EDGE_FACTOR + (1.0 - STRONG_EDGE_FACTOR) * smooth), np.float32)


def minimal_cut(cost: Float32[ndarray, "h w"], edge: Float32[ndarray, "h w"], start: Float32[ndarray, "h w"]) -> Mask:
    """Return the pixels whose u is above one half, from a ``start`` near the minimum."""
    u = start.copy()
    cut_steps(cost, edge, u, N_PRIMAL_DUAL_STEPS)
    return np.asarray(u > 0.5)
