"""The border between object and background, from colours and a prior.

The border minimises the sum of ``cost`` u + ``edge`` |grad u| over 0 <= u <= 1, a continuous minimal cut (Chan,
Esedoglu, Nikolova, SIAM J. Appl. Math. 2006), by the primal-dual steps of Chambolle and Pock (JMIV 2011). The colours
of both sides are histograms: of the key frames, over the whole image, and of the frame before, near the same place.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Int, Int32, UInt8
from numpy import ndarray

from getagrip.compiling import kernel


@kernel("s2 s2 s2 i")
def cut_steps(cost: ndarray, edge: ndarray, u: ndarray, rounds: int) -> None:
    """Minimise the sum of cost u + edge |grad u| over 0 <= u <= 1, from ``u`` (h, w) and into it."""
    height, width = u.shape
    step, zero, one, two = np.float32(1.0 / np.sqrt(8.0)), np.float32(0.0), np.float32(1.0), np.float32(2.0)
    bar = u.copy()
    px, py = (
        np.zeros((height, width + 1), np.float32),
        np.zeros((height + 1, width), np.float32),
    )
    for _ in range(rounds):
        for i in range(height):  # rows without a branch are compiled to vector instructions
            now, below, limit, x, y = bar[i], bar[min(i + 1, height - 1)], edge[i], px[i, 1:], py[i + 1]
            for j in range(width - 1):
                across, down = x[j] + step * (now[j + 1] - now[j]), y[j] + step * (below[j] - now[j])
                share = limit[j] / max(limit[j], np.sqrt(across * across + down * down))
                x[j], y[j] = share * across, share * down
            j = width - 1
            y[j] = min(max(y[j] + step * (below[j] - now[j]), -limit[j]), limit[j])
        for i in range(height):
            now, value, price, x, y, above = bar[i], u[i], cost[i], px[i], py[i + 1], py[i]
            for j in range(width):
                spread = x[j + 1] - x[j] + y[j] - above[j]
                new = min(max(value[j] + step * (spread - price[j]), zero), one)
                now[j], value[j] = two * new - value[j], new


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
        row, column = (np.arange(n, dtype=np.int32) * N_IMAGE_CELLS // max(n, N_IMAGE_CELLS) for n in (height, width))
        at = (row[:, None] * N_IMAGE_CELLS + column) * N_COLOUR_BINS**3 + at
        shape = (N_IMAGE_CELLS,) * 2 + (N_COLOUR_BINS,) * 3
        sides = [_count_bins(at[side], shape) for side in (inside & counted, ~inside & counted)]
        return LocalColourHistogram((width, height), np.stack(sides))


@kernel("n2 s2 s2 s2 i i s3")
def _add_cell_counts(
    at: ndarray, counts: ndarray, x: ndarray, y: ndarray, width: int, height: int, sides: ndarray
) -> None:
    """Add to the ``sides`` (2, h, w) of pixels the counts of their colours in the four cells around (x, y), bilinearly.

    ``width`` and ``height`` are the image's, whose cells ``counts`` are (``LocalColourHistogram``).
    """
    bins = N_COLOUR_BINS**3
    last = np.float32(N_IMAGE_CELLS - 1.001)
    for i in range(at.shape[0]):
        for j in range(at.shape[1]):
            u = (x[i, j] + np.float32(0.5)) * np.float32(N_IMAGE_CELLS / max(width, N_IMAGE_CELLS)) - np.float32(0.5)
            v = (y[i, j] + np.float32(0.5)) * np.float32(N_IMAGE_CELLS / max(height, N_IMAGE_CELLS)) - np.float32(0.5)
            u, v = min(max(np.float32(0.0), u), last), min(max(np.float32(0.0), v), last)  # NaN becomes 0
            column, row = int(u), int(v)
            u, v = u - np.float32(column), v - np.float32(row)
            first = (row * N_IMAGE_CELLS + column) * bins + at[i, j]
            below = first + N_IMAGE_CELLS * bins
            for side in range(2):
                some = counts[side]
                above = some[first] + u * (some[first + bins] - some[first])
                under = some[below] + u * (some[below + bins] - some[below])
                sides[side, i, j] += above + v * (under - above)


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
        x, y = (np.ascontiguousarray(each, np.float32) for each in came)
        sides = np.ascontiguousarray(sides, np.float32)
        _add_cell_counts(np.ascontiguousarray(at), before.counts, x, y, *before.size, sides)
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

    count, parts = cv2.connectedComponents(mask.astype(np.uint8))
    return np.asarray(mask & (np.bincount(parts[before], minlength=count) > 0)[parts])


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
