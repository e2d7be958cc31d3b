"""Means and their intervals: known laws, and none where clips are few or alike."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from getagrip.experiments.statistics import estimate, resamples


@given(st.lists(st.floats(0.0, 1.0), min_size=5, max_size=20), st.integers(0, 5))
def test_an_interval_holds_its_mean_and_stays_among_the_values(values: list[float], seed: int) -> None:
    x = np.array(values)
    found = estimate(x, resamples([str(n) for n in range(len(x))], seed))
    assert found.mean == pytest.approx(x.mean())
    assert found.clips == len(x)
    if np.ptp(x) > 0.0:
        assert x.min() - 1e-12 <= found.low <= found.high <= x.max() + 1e-12


def test_the_interval_is_that_of_the_normal_law() -> None:
    x = np.random.default_rng(0).normal(size=400)
    found = estimate(x, resamples([str(n) for n in range(400)]))
    wide = 1.96 * x.std() / np.sqrt(400)
    np.testing.assert_allclose([found.low, found.high], [x.mean() - wide, x.mean() + wide], atol=0.015)


def test_clips_of_a_subject_are_drawn_together() -> None:
    weights = resamples([name for name in "abcdef" for _ in range(2)])
    np.testing.assert_array_equal(weights[:, ::2], weights[:, 1::2])
    np.testing.assert_array_equal(weights.sum(axis=1), 12)
    # Each clip twice says no more than each once.
    x = np.repeat([0.0, 1.0, 0.0, 0.5, 0.2, 0.9], 2)
    assert estimate(x, weights).high == estimate(x[::2], weights[:, ::2]).high


def test_no_interval_where_clips_are_few_alike_or_drawn_together() -> None:
    assert np.isnan(estimate(np.ones(5), resamples(list("abcde"))).low)
    assert np.isnan(estimate(np.arange(4.0), resamples(list("abcd"))).low)
    assert np.isnan(estimate(np.arange(6.0), resamples(list("aaaaaa"))).low)
    nothing = estimate(np.full(3, np.nan), resamples(list("abc")))
    assert np.isnan(nothing.mean)
    assert nothing.clips == 0
