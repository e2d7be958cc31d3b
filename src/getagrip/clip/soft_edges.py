"""Masks with soft edges, as resizing, smoothing and lossy compression leave them: half of the maximum and more counts.

An image of labels has areas of each label; in a soft mask, only the background and the maximum have. What is between
them are steps from the one to the other.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Int
from numpy import ndarray

from getagrip.clip.sampling import frame_indices
from getagrip.errors import InputError

SOFT_EDGES_NOTE = "edges are soft: values of half of the maximum and more were used, in images"
N_SAMPLED_IMAGES = 9
"""Images."""
MIN_SOFT_MAXIMUM = 64
"""Below it, values are labels."""
MIN_EDGE_VALUES, MULTI_MASK_EDGE_VALUES = 3, 8
"""Values that are edges only: of a soft mask, and of several of them in one image."""
MIN_INTERIOR_FRACTION = 0.25
"""Share of the pixels of a value that are like all four neighbours, from which on the value is an area's."""


Load = Callable[[int], tuple[Path, Int[ndarray, "H W"]]]
"""The file of a frame's image, and its labels."""


def binarise_soft_masks(
    load: Load, frames: Collection[int], notes: Counter[str], named: Sequence[int] = (), others: bool = False
) -> Load:
    """Load masks with soft edges as one label, where some of the images show that they are such masks.

    ``named`` are the labels of the object, as far as they are; ``others`` whether others are named as well. ``notes``
    counts the images with soft edges.
    """
    looked = (soft_maximum(*load(n), named, others) for n in sample_frames(frames))
    maximum = next((one for one in looked if one is not None), None)
    notes.clear()  # of what is read again
    if maximum is None:
        return load

    def half(n: int) -> tuple[Path, Int[ndarray, "H W"]]:
        path, labels = load(n)
        notes[SOFT_EDGES_NOTE] += 1
        return path, np.where(2 * np.max(_colour_channels(labels), axis=0) >= maximum, named[0] if named else 255, 0)

    return half


def sample_frames(frames: Collection[int]) -> list[int]:
    """Return some of the frames, spread over them, that stand for all."""
    every = sorted(frames)
    return [every[i] for i in frame_indices(len(every), N_SAMPLED_IMAGES)]


def soft_maximum(path: Path, labels: Int[ndarray, "H W"], named: Sequence[int], others: bool) -> int | None:
    """Return the largest value of a mask with soft edges; None for an image of labels, and for a sharp one.

    Raises ``InputError`` for several masks with soft edges in one image, and where a label is named that is an edge's.
    """
    channels = [channel for channel in _colour_channels(labels) if channel.any()]
    if not channels or not all(np.array_equal(channel, channels[0]) for channel in channels):
        return None
    values = channels[0]
    maximum = int(values.max())
    if maximum < MIN_SOFT_MAXIMUM:
        return None
    inside = _interior_pixels(values)
    count, count_inside = np.bincount(values.ravel()), np.bincount(values[inside], minlength=maximum + 1)
    value = np.flatnonzero(count)
    area = count_inside[value] >= MIN_INTERIOR_FRACTION * count[value]
    steps = int(np.count_nonzero(~area[(value > 0) & (value < maximum)]))
    several = value[area & (4 * value > maximum) & (4 * value < 3 * maximum)]
    if several.size and steps >= MULTI_MASK_EDGE_VALUES:
        some = ", ".join(map(str, [*several[:6], maximum]))
        raise InputError(path, "labels", f"soft edges between several, {some}", "sharp ones, or a mask of each thing")
    if several.size or steps < MIN_EDGE_VALUES:
        return None
    edge = next((one for one in named if 2 * max(one >> 16, one >> 8 & 255, one & 255) < min(maximum, 255)), None)
    if edge is not None or others:
        got = "a mask with soft edges, the only thing in the image"
        raise InputError(path, "labels", got, "--object for its maximum or for nothing, no --ignore and --hand")
    return maximum


def area_values(labels: Int[ndarray, "H W"]) -> list[int]:
    """Return the values that are no background's and have areas of their own, not only edges."""
    values, at, count = np.unique(labels, return_inverse=True, return_counts=True)
    if len(values) < 3:
        return [value for value in values.tolist() if value]
    within = np.bincount(at.ravel()[_interior_pixels(labels).ravel()], minlength=len(values))
    return [int(value) for value in values[(within >= MIN_INTERIOR_FRACTION * count) & (within > 0)] if value]


def _interior_pixels(values: Int[ndarray, "H W"]) -> Bool[ndarray, "H W"]:
    """Return which pixels have the value of all of their neighbours."""
    inside = np.ones(values.shape, dtype=bool)
    for axis in (0, 1):
        same = np.diff(values, axis=axis) == 0
        first, last = ((slice(None),) * axis + (cut,) for cut in (slice(1, None), slice(None, -1)))
        inside[first] &= same
        inside[last] &= same
    return inside


def _colour_channels(labels: Int[ndarray, "H W"]) -> list[Int[ndarray, "H W"]]:
    """Red, green and blue of colours, else the values."""
    return [labels] if labels.max(initial=0) < 2**16 else [labels >> 16, labels >> 8 & 255, labels & 255]
