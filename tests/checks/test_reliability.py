"""Fitting probabilities, and measuring them."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.reliability import auroc, auroc_interval, bins, calibration_error, fit_weights, least_error
from getagrip.bench.comparison import bootstrap_resamples
from getagrip.checks.calibration import sigmoid


def test_the_fit_finds_what_drew_the_labels() -> None:
    rng = np.random.default_rng(0)
    x = rng.normal(size=(4000, 3))
    right = rng.random(4000) < sigmoid(0.5 + x @ np.array([2.0, -1.0, 0.0]))
    weights, bias = fit_weights(x, right, (1, -1, 0))
    assert [w.weight for w in weights] == pytest.approx([2.0, -1.0, 0.0], abs=0.2)
    assert bias == pytest.approx(0.5, abs=0.15)


def test_a_sign_of_the_wrong_direction_counts_nothing() -> None:
    rng = np.random.default_rng(1)
    x = rng.normal(size=(500, 2))
    right = rng.random(500) < sigmoid(x[:, 0] + x[:, 1])
    weights, _ = fit_weights(x, right, (1, -1))
    assert weights[0].weight > 0.5
    assert weights[1].weight == 0.0


def test_a_constant_sign_counts_nothing() -> None:
    rng = np.random.default_rng(2)
    weights, bias = fit_weights(np.ones((200, 1)), rng.random(200) < 0.7, (1,))
    assert weights[0].weight == 0.0
    assert sigmoid(np.array(bias)) == pytest.approx(0.7, abs=0.1)


def test_the_interval_of_auroc_is_that_of_its_resamples() -> None:
    rng = np.random.default_rng(4)
    p, right = rng.integers(0, 9, 80) / 9.0, rng.random(80) < 0.6
    weights = bootstrap_resamples([str(n // 2) for n in range(80)])
    repeated = [np.repeat(np.arange(80), w.astype(int)) for w in weights[:200]]
    drawn = [auroc(p[index], right[index]) for index in repeated]
    assert auroc_interval(p, right, weights[:200]) == pytest.approx(tuple(np.quantile(drawn, [0.025, 0.975])))


def test_auroc_is_the_share_of_pairs_in_order() -> None:
    rng = np.random.default_rng(3)
    p, right = rng.integers(0, 6, 60) / 6.0, rng.random(60) < 0.5
    pairs = [(a > b) + 0.5 * (a == b) for a in p[right] for b in p[~right]]
    assert auroc(p, right) == pytest.approx(np.mean(pairs))
    assert auroc(-p, right) == pytest.approx(1.0 - np.mean(pairs))
    assert np.isnan(auroc(p, np.ones(60, dtype=bool)))


def test_calibration_error() -> None:
    right = np.array([True, True, False, False])
    assert calibration_error(right.astype(float), right) == 0.0
    assert calibration_error(np.full(4, 0.5), right) == 0.0
    assert calibration_error(np.full(4, 0.9), right) == pytest.approx(0.4)
    assert sum(b.count for b in bins(np.array([0.0, 0.3, 0.99, 1.0]), right)) == 4


def test_perfect_probabilities_have_little_error_where_results_are_many() -> None:
    p = np.random.default_rng(4).random(5000)
    assert least_error(p, draws=20) < 0.02 < least_error(p[:50], draws=100)
