"""Means over clips, their bootstrap intervals, and paired differences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

RESAMPLES = 2000
LEVEL = 0.95
FEWEST = 5
"""Fewest clips with an interval: that of two would just span both values."""


@dataclass(frozen=True)
class Estimate:
    """A mean over clips with its interval; NaN where there is nothing to average."""

    mean: float
    low: float
    high: float
    clips: int


def resamples(groups: Sequence[str], seed: int = 0) -> Float[ndarray, "B n"]:
    """How often each clip is drawn in each bootstrap resample.

    Clips of the same group (subject) are drawn together, as many groups as there are: they are no independent
    evidence. With a group for each clip this is the plain bootstrap.
    """
    names, member = np.unique(np.asarray(groups), return_inverse=True)
    rng = np.random.default_rng(seed)
    drawn = rng.multinomial(len(names), np.full(len(names), 1.0 / len(names)), size=RESAMPLES)
    return drawn[:, member].astype(float)


def estimate(values: Float[ndarray, "n"], weights: Float[ndarray, "B n"]) -> Estimate:
    """The mean of the values that are there (not NaN), with the percentile interval of its resamples.

    There is no interval for fewer than ``FEWEST`` values, where all are equal (100 % of ten clips is no certainty), nor
    where all are drawn together.
    """
    known = ~np.isnan(values)
    if not known.any():
        return Estimate(float("nan"), float("nan"), float("nan"), 0)
    mean = float(values[known].mean())
    drawn = weights[:, known]
    total = drawn.sum(axis=1)
    # A resample may hold none of these clips.
    means = (drawn @ values[known])[total > 0] / total[total > 0]
    if known.sum() < FEWEST or not np.ptp(values[known]) or not np.ptp(drawn, axis=1).any():
        return Estimate(mean, float("nan"), float("nan"), int(known.sum()))
    low, high = np.quantile(means, [(1.0 - LEVEL) / 2.0, (1.0 + LEVEL) / 2.0])
    return Estimate(mean, float(low), float(high), int(known.sum()))
