"""Statistics of a LeRobot dataset's features."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from jaxtyping import Shaped, UInt8
from numpy import ndarray

QUANTILES = (0.01, 0.10, 0.50, 0.90, 0.99)
MOST_PIXELS = 200_000
"""Of an image that are looked at, as many as a small one has."""


def statistics(values: Shaped[ndarray, "T ..."]) -> dict[str, Shaped[ndarray, "..."]]:
    """Of numbers over all frames, a number for each entry."""
    rows = values.reshape(len(values), -1).astype(float)
    low, high, mean, std = rows.min(axis=0), rows.max(axis=0), rows.mean(axis=0), rows.std(axis=0)
    quantiles = {f"q{round(100 * q):02d}": np.quantile(rows, q, axis=0) for q in QUANTILES}
    return {"min": low, "max": high, "mean": mean, "std": std, "count": np.array([len(rows)]), **quantiles}


def image_stats(images: Iterable[UInt8[ndarray, "H W 3"]]) -> dict[str, Shaped[ndarray, "..."]]:
    """Of the three channels over all images, from 0 to 1, as arrays (3, 1, 1)."""
    histogram, count = np.zeros((3, 256)), 0
    for image in images:
        step = max(1, int(np.sqrt(image.shape[0] * image.shape[1] / MOST_PIXELS)))
        histogram += [np.bincount(image[::step, ::step, k].ravel(), minlength=256) for k in range(3)]
        count += 1
    levels = np.arange(256) / 255.0
    share = histogram / histogram.sum(axis=1, keepdims=True)
    mean = share @ levels
    there = [np.flatnonzero(of) for of in histogram]
    total = np.cumsum(share, axis=1)
    out = {
        "min": levels[[of[0] for of in there]],
        "max": levels[[of[-1] for of in there]],
        "mean": mean,
        "std": np.sqrt(np.maximum(share @ levels**2 - mean**2, 0.0)),
        **{f"q{round(100 * q):02d}": levels[np.argmax(total >= q, axis=1)] for q in QUANTILES},
    }
    return {key: value.reshape(3, 1, 1) for key, value in out.items()} | {"count": np.array([count])}
