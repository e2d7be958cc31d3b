"""The border between object and background, from colours and a prior.

It minimises the sum of ``cost`` u + ``edge`` |grad u| over 0 <= u <= 1, a continuous minimal cut (Chan, Esedoglu,
Nikolova, SIAM J. Appl. Math. 2006), by the primal-dual steps of Chambolle and Pock (JMIV 2011). The colours of both
sides are histograms: of the key frames, over the whole image, and of the frame before, near the same place.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Int, Int32, UInt8
from numpy import ndarray

BINS = 12
"""Bins of lightness and of each of Lab's colours."""
GREY, COLOURED = 8.0, 50.0
"""Bins of Lab's two colours are even up to about the first, beside grey, then wider; the last ends at the second."""
CELLS = 8
"""Cells in each direction of the image, by which the places of colours are counted."""
BLUR = 0.7
"""Blur of histograms [bins, cells]."""
SHARED = 8.0
"""Weight of the key frames' colours, in pixels of a cell."""
RARE = 0.05
"""Pixels of each colour that are added to both sides, since a colour may be there without having been seen."""
SMOOTH = 3.0
"""Cost of a border of one pixel where the image is smooth; ``SHARP`` of it where it has a strong edge."""
SHARP = 0.15
ROUNDS = 50
NO_HAND = 0.5
"""Pixels of the hand that was found are not the hand's where colours of the object are likelier by e to this; at its
border, where they are likelier at all."""
LEFT = 0.3
"""If less than this share is left of a found hand, colours do not tell it from the object: light has changed, say."""
UNSEEN = 1e-3
"""Probability of a colour that neither of the two has."""

Image = UInt8[ndarray, "h w 3"]
Mask = Bool[ndarray, "h w"]


def bins(image: Image) -> Int32[ndarray, "h w"]:
    """Return the bin of each pixel's colour."""
    import cv2

    levels = np.arange(256)
    apart = np.arcsinh((levels - 127.5) / GREY) / np.arcsinh(COLOURED / GREY)
    grey = np.clip(BINS * (1.0 + apart) / 2.0, 0, BINS - 1)
    table = np.stack([levels * BINS // 256, grey, grey], axis=-1).astype(np.uint8)[:, None]
    lab = cv2.LUT(cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2LAB), table).astype(np.int32)
    return np.asarray((lab[..., 0] * BINS + lab[..., 1]) * BINS + lab[..., 2])


class Colours(NamedTuple):
    """Shares of pixels that have a colour, inside and outside."""

    counts: Float32[ndarray, "2 bins"]

    @staticmethod
    def of(image: Image, inside: Mask, counted: Mask) -> Colours:
        """Count one image; shares of its pixels."""
        at, sides = bins(image), []
        for side in (inside & counted, ~inside & counted):
            cube = np.bincount(at[side], minlength=BINS**3).astype(np.float32).reshape(BINS, BINS, BINS)
            sides.append(_blurred(cube).ravel() / max(1, np.count_nonzero(side)))
        return Colours(np.stack(sides).astype(np.float32))

    @staticmethod
    def mean(some: list[Colours]) -> Colours:
        """Return the mean of several images."""
        return Colours(np.mean([each.counts for each in some], axis=0).astype(np.float32))


class Places(NamedTuple):
    """Counts of pixels by cell of the image."""

    size: tuple[int, int]
    counts: Float32[ndarray, "2 cells"]

    @staticmethod
    def of(at: Int32[ndarray, "h w"], inside: Mask, counted: Mask) -> Places:
        """Count one image, given by the bins of its pixels."""
        height, width = inside.shape
        y, x = np.mgrid[:height, :width]
        at = (y * CELLS // max(height, CELLS) * CELLS + x * CELLS // max(width, CELLS)) * BINS**3 + at
        shape = CELLS, CELLS, BINS, BINS, BINS
        sides = [
            _blurred(np.bincount(at[side], minlength=int(np.prod(shape))).astype(np.float32).reshape(shape)).ravel()
            for side in (inside & counted, ~inside & counted)
        ]
        return Places((width, height), np.stack(sides))


def _cells(
    size: tuple[int, int], x: Float32[ndarray, "h w"], y: Float32[ndarray, "h w"]
) -> Iterator[tuple[Int[ndarray, "h w"], Float32[ndarray, "h w"]]]:
    """Yield the four cells about each place, and their shares in it."""
    (u, column), (v, row) = (
        np.modf(np.clip((each + 0.5) * CELLS / max(length, CELLS) - 0.5, 0.0, CELLS - 1.001).astype(np.float32))
        for each, length in zip((x, y), size, strict=True)
    )
    for i, across in enumerate((1 - u, u)):
        for j, down in enumerate((1 - v, v)):
            yield ((row + j) * CELLS + column + i).astype(np.int64), across * down


def _blurred(counts: Float32[ndarray, "..."]) -> Float32[ndarray, "..."]:
    from scipy.ndimage import gaussian_filter

    return np.asarray(gaussian_filter(counts, BLUR, mode="constant", truncate=2.0), np.float32)


def likelier(
    at: Int32[ndarray, "h w"],
    keys: Colours,
    before: Places | None = None,
    came: tuple[Float32[ndarray, "h w"], Float32[ndarray, "h w"]] | None = None,
) -> Float32[ndarray, "h w"]:
    """Return the logarithm of the ratio of each pixel's colour probability inside to that outside, from its bin.

    ``came`` has the pixels' places in the frame ``before``, whose colours there count as well.
    """
    sides = SHARED * keys.counts[:, at] + RARE * SHARED / BINS
    if before is not None and came is not None:
        for cell, share in _cells(before.size, *came):
            sides = sides + share * before.counts[:, cell * BINS**3 + at]
    return np.asarray(np.log(sides[0] / sides[1]), np.float32)


def coloured_hand(hand: Mask, at: Int32[ndarray, "h w"], own: Colours, skin: Colours) -> Mask:
    """Return a hand that was found without those pixels that have the object's ``own`` colours; all of it if most have.

    ``at``: the bins of the image's pixels.
    """
    import cv2

    shares = (each.counts[0][at] + UNSEEN for each in (own, skin))
    unlike = cv2.GaussianBlur(np.log(np.divide(*shares)), (0, 0), 1.0)
    found = ~(touching(~hand | (unlike > 0.0), ~hand) | (unlike > NO_HAND))
    return np.asarray(found if np.count_nonzero(found) > LEFT * np.count_nonzero(hand) else hand)


def touching(mask: Mask, before: Mask) -> Mask:
    """Return the parts of a mask that overlap with what it was."""
    import cv2

    _, parts = cv2.connectedComponents(mask.astype(np.uint8))
    return np.asarray(mask & np.isin(parts, np.unique(parts[before])))


def edges(image: Image) -> Float32[ndarray, "h w"]:
    """Return the cost of a border per pixel [1/px]."""
    values = image.astype(np.float32)
    change = np.zeros(image.shape[:2], np.float32)
    right, down = values[:, 1:] - values[:, :-1], values[1:] - values[:-1]
    change[:, :-1] += np.einsum("hwc,hwc->hw", right, right)
    change[:-1] += np.einsum("hwc,hwc->hw", down, down)
    return np.asarray(SMOOTH * (SHARP + (1.0 - SHARP) * np.exp(-change / (2.0 * change.mean() + 1e-6))), np.float32)


def cut(cost: Float32[ndarray, "h w"], edge: Float32[ndarray, "h w"], start: Float32[ndarray, "h w"]) -> Mask:
    """Return where u is above one half, from a ``start`` near to it."""
    from getagrip.kernels.cut import cut_steps

    u = start.copy()
    cut_steps(cost, edge, u, ROUNDS)
    return np.asarray(u > 0.5)
