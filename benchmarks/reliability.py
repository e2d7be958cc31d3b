"""Probabilities of being right: fitted to what was right, and held against it.

A probability is calibrated where of the results with a probability of p a share of p is right. Its expected calibration
error (ECE) is the mean distance between the two over bins of p, weighted by how many results are in each. Of few
results it is above zero for perfect probabilities, too (``least_error``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.bench.comparison import CONFIDENCE_LEVEL
from getagrip.checks.calibration import FeatureWeight, sigmoid

BINS = 10
"""Of the same width."""
RIDGE = 3.0
"""Of weights by one standard deviation; half its square counts as much as one result's negative log-likelihood."""
OUTER = 0.01
"""Share of the values of a sign, at either end, that are held at the range's end."""


@dataclass(frozen=True)
class Bin:
    """Results of similar probability."""

    probability: float
    """Their mean."""
    right: float
    """Share of them that is right."""
    count: int


def fit_weights(
    signs: Float[ndarray, "n S"], right: Bool[ndarray, "n"], directions: Sequence[int], ridge: float = RIDGE
) -> tuple[list[FeatureWeight], float]:
    """The logistic regression of what is right on signs, and its bias: most likely, under a ridge.

    A sign whose direction is 1 gets no weight below 0, of -1 none above. Signs must be known (not NaN).
    """
    from scipy.optimize import minimize

    low, high = np.quantile(signs, [OUTER, 1.0 - OUTER], axis=0)
    held = np.clip(signs, low, high)
    middle, size = held.mean(axis=0), held.std(axis=0)
    size[size == 0.0] = 1.0
    x = (held - middle) / size

    def cost(w: Float[ndarray, "_"]) -> tuple[float, Float[ndarray, "_"]]:
        logit = w[0] + x @ w[1:]
        off = sigmoid(logit) - right
        value = np.sum(np.logaddexp(0.0, logit) - right * logit) + 0.5 * ridge * np.sum(w[1:] ** 2)
        return float(value), np.concatenate([[off.sum()], x.T @ off + ridge * w[1:]])

    bounds = [(None, None), *((0.0 if d > 0 else None, 0.0 if d < 0 else None) for d in directions)]
    w = minimize(cost, np.zeros(1 + x.shape[1]), jac=True, method="L-BFGS-B", bounds=bounds).x
    weight = w[1:] / size
    weights = [FeatureWeight(float(v), float(a), float(b)) for v, a, b in zip(weight, low, high, strict=True)]
    return weights, float(w[0] - weight @ middle)


def auroc(probability: Float[ndarray, "n"], right: Bool[ndarray, "n"]) -> float:
    """Share of pairs of a right and a wrong result in which the right one is the more probable; ties count half.

    NaN where there are none of either.
    """
    rights, wrongs = probability[right], np.sort(probability[~right])
    if not len(rights) or not len(wrongs):
        return float("nan")
    below = [np.searchsorted(wrongs, rights, side=side) for side in ("left", "right")]
    return float(np.mean(below) / len(wrongs))


def auroc_interval(
    probability: Float[ndarray, "n"], right: Bool[ndarray, "n"], weights: Float[ndarray, "B n"]
) -> tuple[float, float]:
    """The interval of ``auroc`` over bootstrap resamples (``statistics.resamples``), of the level ``CONFIDENCE_LEVEL``."""
    ahead = probability[right, None] - probability[~right]
    won = weights[:, right] @ np.heaviside(ahead, 0.5)
    pairs = weights[:, right].sum(axis=1) * weights[:, ~right].sum(axis=1)
    drawn = np.sum(won * weights[:, ~right], axis=1)[pairs > 0] / pairs[pairs > 0]
    low, high = np.quantile(drawn, [(1.0 - CONFIDENCE_LEVEL) / 2.0, (1.0 + CONFIDENCE_LEVEL) / 2.0])
    return float(low), float(high)


def bins(probability: Float[ndarray, "n"], right: Bool[ndarray, "n"]) -> list[Bin]:
    """The results by their probability, bins without any left out."""
    number = np.minimum((probability * BINS).astype(int), BINS - 1)
    of_bin = [number == k for k in range(BINS)]
    return [Bin(float(probability[b].mean()), float(right[b].mean()), int(b.sum())) for b in of_bin if b.any()]


def calibration_error(probability: Float[ndarray, "n"], right: Bool[ndarray, "n"]) -> float:
    """The expected calibration error."""
    return sum(b.count * abs(b.probability - b.right) for b in bins(probability, right)) / len(right)


def least_error(probability: Float[ndarray, "n"], draws: int = 500) -> float:
    """The mean calibration error if these probabilities were perfect: what is right is drawn by them."""
    rng = np.random.default_rng(0)
    drawn = rng.random((draws, len(probability))) < probability
    return float(np.mean([calibration_error(probability, right) for right in drawn]))
