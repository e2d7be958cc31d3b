"""Fit probabilities that results are right, and score them.

A probability is calibrated if a share p of the results with probability p is right. Its expected calibration error
(ECE) is the mean distance between the two over bins of p, weighted by the number of results. For few results, even
perfect probabilities have an error above zero (``least_error``).
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
"""Number of bins, of equal width."""
RIDGE = 3.0
"""Ridge penalty of weights of standardised features, in negative log-likelihood: half of it times the square."""
OUTER = 0.01
"""Fraction of a feature's values, at each end, that are clipped."""


@dataclass(frozen=True)
class Bin:
    """Results of similar probability."""

    probability: float
    """Mean probability."""
    right: float
    """Share of right results."""
    count: int


def fit_weights(
    signs: Float[ndarray, "n S"], right: Bool[ndarray, "n"], directions: Sequence[int], ridge: float = RIDGE
) -> tuple[list[FeatureWeight], float]:
    """Fit a logistic regression of right results on features, with a ridge; return weights and bias.

    A direction of 1 excludes negative weights, -1 positive ones. ``signs`` must not be NaN.
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
    """Compute the share of pairs of a right and a wrong result in which the right one is more probable; ties count 0.5.

    NaN without right or without wrong results.
    """
    rights, wrongs = probability[right], np.sort(probability[~right])
    if not len(rights) or not len(wrongs):
        return float("nan")
    below = [np.searchsorted(wrongs, rights, side=side) for side in ("left", "right")]
    return float(np.mean(below) / len(wrongs))


def auroc_interval(
    probability: Float[ndarray, "n"], right: Bool[ndarray, "n"], weights: Float[ndarray, "B n"]
) -> tuple[float, float]:
    """Compute the interval of ``auroc`` over bootstrap resamples ``weights``, at the level ``CONFIDENCE_LEVEL``."""
    ahead = probability[right, None] - probability[~right]
    won = weights[:, right] @ np.heaviside(ahead, 0.5)
    pairs = weights[:, right].sum(axis=1) * weights[:, ~right].sum(axis=1)
    drawn = np.sum(won * weights[:, ~right], axis=1)[pairs > 0] / pairs[pairs > 0]
    low, high = np.quantile(drawn, [(1.0 - CONFIDENCE_LEVEL) / 2.0, (1.0 + CONFIDENCE_LEVEL) / 2.0])
    return float(low), float(high)


def bins(probability: Float[ndarray, "n"], right: Bool[ndarray, "n"], count: int = BINS) -> list[Bin]:
    """Group the results by probability into bins of equal width; empty bins are left out."""
    number = np.minimum((probability * count).astype(int), count - 1)
    of_bin = [number == k for k in range(count)]
    return [Bin(float(probability[b].mean()), float(right[b].mean()), int(b.sum())) for b in of_bin if b.any()]


def calibration_error(probability: Float[ndarray, "n"], right: Bool[ndarray, "n"]) -> float:
    """Compute the expected calibration error."""
    return sum(b.count * abs(b.probability - b.right) for b in bins(probability, right)) / len(right)


def least_error(probability: Float[ndarray, "n"], draws: int = 500) -> float:
    """Compute the mean calibration error of perfect probabilities: right results are drawn by them."""
    rng = np.random.default_rng(0)
    drawn = rng.random((draws, len(probability))) < probability
    return float(np.mean([calibration_error(probability, right) for right in drawn]))
