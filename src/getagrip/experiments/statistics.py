"""Means over clips with intervals by Student's t over groups of clips, and bootstrap resamples for other statistics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.special import stdtrit

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
    """Draw how often each clip is in each bootstrap resample.

    Clips of the same group (subject) are drawn together, as many groups as there are: they are no independent
    evidence. With a group for each clip this is the plain bootstrap.
    """
    names, member = np.unique(np.asarray(groups), return_inverse=True)
    rng = np.random.default_rng(seed)
    drawn = rng.multinomial(len(names), np.full(len(names), 1.0 / len(names)), size=RESAMPLES)
    return drawn[:, member].astype(float)


def estimate(values: Float[ndarray, "n"], groups: Sequence[str]) -> Estimate:
    """Estimate the mean of the values that are not NaN, with an interval that holds for few groups.

    Clips of a group (subject) are no independent evidence: the interval is Student's t with one degree of freedom less
    than there are groups, and the standard error that of a ratio, from the groups' sums of deviations from the mean.

    There is no interval for fewer than ``FEWEST`` values, where all are equal (100 % of ten clips is no certainty), nor
    where all are of one group.
    """
    known = ~np.isnan(values)
    n = int(known.sum())
    if not n:
        return Estimate(float("nan"), float("nan"), float("nan"), 0)
    x = values[known]
    mean = float(x.mean())
    names, member = np.unique(np.asarray(groups)[known], return_inverse=True)
    G = len(names)
    if n < FEWEST or not np.ptp(x) or G < 2:
        return Estimate(mean, float("nan"), float("nan"), n)
    deviations = np.bincount(member, x - mean)
    error = float(np.sqrt(G / (G - 1) * np.sum(deviations**2))) / n
    wide = float(stdtrit(G - 1, (1.0 + LEVEL) / 2.0)) * error
    return Estimate(mean, mean - wide, mean + wide, n)
