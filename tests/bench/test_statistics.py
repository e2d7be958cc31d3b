"""Means and their intervals: known laws, and none where clips are few or alike."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from getagrip.bench.comparison import bootstrap_resamples, estimate_mean


@given(st.lists(st.floats(0.0, 1.0), min_size=5, max_size=20))
def test_an_interval_holds_its_mean(values: list[float]) -> None:
    x = np.array(values)
    found = estimate_mean(x, [str(n) for n in range(len(x))])
    assert found.mean == pytest.approx(x.mean())
    assert found.clips == len(x)
    if np.ptp(x) > 0.0:
        assert found.low <= found.mean <= found.high


def test_the_interval_is_that_of_the_normal_law() -> None:
    x = np.random.default_rng(0).normal(size=400)
    found = estimate_mean(x, [str(n) for n in range(400)])
    wide = 1.966 * x.std(ddof=1) / np.sqrt(400)
    np.testing.assert_allclose([found.low, found.high], [x.mean() - wide, x.mean() + wide], atol=1e-4)


def test_intervals_of_six_subjects_cover_the_mean() -> None:
    rng, subjects = np.random.default_rng(0), [name for name in "abcdef" for _ in range(8)]
    draws = [np.repeat(rng.normal(size=6), 8) + rng.normal(size=48) for _ in range(2000)]
    found = [estimate_mean(x, subjects) for x in draws]
    assert 0.935 < np.mean([e.low <= 0.0 <= e.high for e in found]) < 0.965


def test_clips_of_a_subject_are_drawn_together() -> None:
    subjects = [name for name in "abcdef" for _ in range(2)]
    weights = bootstrap_resamples(subjects)
    np.testing.assert_array_equal(weights[:, ::2], weights[:, 1::2])
    np.testing.assert_array_equal(weights.sum(axis=1), 12)
    # Each clip twice says no more than each once.
    x = np.repeat([0.0, 1.0, 0.0, 0.5, 0.2, 0.9], 2)
    assert estimate_mean(x, subjects).high == pytest.approx(estimate_mean(x[::2], subjects[::2]).high)


def test_no_interval_where_clips_are_few_alike_or_of_one_subject() -> None:
    assert np.isnan(estimate_mean(np.ones(5), list("abcde")).low)
    assert np.isnan(estimate_mean(np.arange(4.0), list("abcd")).low)
    assert np.isnan(estimate_mean(np.arange(6.0), list("aaaaaa")).low)
    nothing = estimate_mean(np.full(3, np.nan), list("abc"))
    assert np.isnan(nothing.mean)
    assert nothing.clips == 0
