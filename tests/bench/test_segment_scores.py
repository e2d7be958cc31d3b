"""Scores of intervals: known values, bounds, and one partner for each."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from getagrip.bench.segments import Span, match_segments, span_iou, summarise_segments

SPANS = st.tuples(st.integers(0, 40), st.integers(0, 40)).map(lambda ends: (min(ends), max(ends)))


@given(SPANS, SPANS)
def test_overlap_is_that_of_sets_of_frames(a: Span, b: Span) -> None:
    in_a, in_b = set(range(a[0], a[1] + 1)), set(range(b[0], b[1] + 1))
    assert span_iou(a, b) == pytest.approx(len(in_a & in_b) / len(in_a | in_b))


@given(st.lists(SPANS, max_size=4), st.lists(SPANS, max_size=4))
def test_scores_stay_within_bounds_and_nothing_is_matched_twice(true: list[Span], found: list[Span]) -> None:
    one = match_segments(true, found)
    assert len(one.matches) == len(true)
    assert sum(match.start is not None for match in one.matches) <= min(len(true), len(found))
    all_ = summarise_segments([one])
    if true or found:
        assert 0.0 <= all_.f1[1] <= all_.f1[0] <= 1.0
    assert all_.false == (int(bool(found) and not true), int(not true))


def test_what_is_found_exactly_is_perfect() -> None:
    true = [(3, 20), (30, 40)]
    exact = summarise_segments([match_segments(true, true), match_segments([], [])])
    assert (exact.tiou, exact.f1, exact.start, exact.end, exact.missed) == (1.0, (1.0, 1.0), 0.0, 0.0, 0)
    assert exact.false == (0, 1)


def test_errors_are_of_what_overlaps_and_misses_count_as_none() -> None:
    late = summarise_segments([match_segments([(10, 29), (50, 60)], [(14, 31)]), match_segments([], [(1, 5)])])
    assert late.tiou == pytest.approx((16 / 22 + 0.0) / 2)
    assert (late.start, late.end, late.missed) == (4.0, 2.0, 1)
    assert late.f1 == pytest.approx((2 * 1 / 4, 2 * 1 / 4))
    assert late.false == (1, 1)


def test_of_two_finds_in_one_grasp_the_larger_counts_and_the_other_is_false() -> None:
    one = match_segments([(0, 29)], [(0, 9), (12, 29)])
    assert one.matches[0].tiou == pytest.approx(18 / 30)
    assert summarise_segments([one]).f1[0] == pytest.approx(2 / 3)


def test_nothing_has_no_mean() -> None:
    assert math.isnan(summarise_segments([]).tiou)
    assert math.isnan(summarise_segments([]).f1[0])
