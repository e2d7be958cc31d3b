"""The cheapest division against all divisions; windows cost what their frames leave unexplained."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise, product

import numpy as np
import pytest

from getagrip.timelines.detect.grasp_evidence import HingeFit, split_runs
from getagrip.timelines.detect.image_motion import ImageMotion
from getagrip.timelines.detect.semi_markov import (
    MOTION_STATES,
    STATIC_CONTOUR_SIGMA_PX,
    best_fit_in_window,
    cheapest_division,
    division_margins,
    window_costs,
)

Segments = tuple[tuple[int, int, int], ...]
"""First frame, last frame, state of each."""


def every_division(frames: int, states: int) -> Iterator[Segments]:
    for cuts in product([False, True], repeat=frames - 1):
        starts = [0, *(n + 1 for n, cut in enumerate(cuts) if cut)]
        ends = [*(n - 1 for n in starts[1:]), frames - 1]
        for chosen in product(range(states), repeat=len(starts)):
            yield tuple(zip(starts, ends, chosen, strict=True))


def drawn(seed: int, frames: int = 6, states: int = 2) -> np.ndarray:
    rng = np.random.default_rng(seed)
    cost = rng.normal(size=(states, frames, frames)) * 3.0
    cost[rng.random(cost.shape) < 0.3] = np.inf
    return cost


def total(cost: np.ndarray, segments: Segments) -> float:
    return float(sum(cost[state, first, last] for first, last, state in segments))


@pytest.mark.parametrize("seed", range(12))
def test_no_division_is_cheaper(seed: int) -> None:
    cost = drawn(seed)
    least = min(every_division(6, 2), key=lambda segments: total(cost, segments))
    found = cheapest_division(cost)
    assert found.cost == pytest.approx(total(cost, least))
    if np.isfinite(found.cost):
        spans = [(int(a), int(b), int(s)) for (a, b), s in zip(found.spans, found.states, strict=True)]
        assert total(cost, tuple(spans)) == pytest.approx(found.cost)
        assert spans[0][0] == 0
        assert spans[-1][1] == 5
        assert all(after[0] == before[1] + 1 for before, after in pairwise(spans))


@pytest.mark.parametrize("seed", range(6))
def test_margins_are_those_of_the_best_division_without_the_state_there(seed: int) -> None:
    cost = np.where(np.isfinite(drawn(seed)), drawn(seed), 5.0)
    found = cheapest_division(cost)
    divisions = list(every_division(6, 2))
    for (first, last), state, margin in zip(found.spans, found.states, division_margins(cost, found), strict=True):
        edge = (last + 1 - first) // 4
        core = range(first + edge, last - edge + 1)
        others = [d for d in divisions if not any(s == state and a <= n <= b for a, b, s in d for n in core)]
        assert margin == pytest.approx(min(total(cost, d) for d in others) - found.cost)
        assert margin >= 0.0


def test_what_is_impossible_is_not_found() -> None:
    found = cheapest_division(np.full((2, 4, 4), np.inf))
    assert found.cost == np.inf
    assert len(found.spans) == len(found.states) == 0


T, ONSET = 40, 18
STATIC, HELD, FREE = (MOTION_STATES.index(name) for name in ("static", "held", "free"))


def moved(lags: int = 4, speed: float = 2.0) -> ImageMotion:
    """Nothing moves before ``ONSET``, and from then on each frame does."""
    at = np.maximum(np.arange(T) - ONSET + 1, 0) * speed
    displaced = np.full((lags, T), np.nan)
    for lag in range(1, lags + 1):
        displaced[lag - 1, lag:] = at[lag:] - at[:-lag]
    return ImageMotion(displaced, np.zeros((lags, T)))


def fit(first: int, last: int, right: slice, frames: np.ndarray | None = None) -> HingeFit:
    """A fit that is right in some frames, and wrong elsewhere."""
    frames = np.arange(first, last + 1) if frames is None else frames
    misfit = np.full(T, 30.0)
    misfit[right] = 0.8
    eye = np.tile(np.eye(4), (len(frames), 1, 1))
    return HingeFit(frames, eye, eye, misfit[frames], np.ones(len(frames)), 1.0, "right")


def states(held: list[HingeFit], motion: ImageMotion | None = None) -> list[tuple[int, int, int]]:
    found = cheapest_division(window_costs(motion or moved(), held))
    return [(int(a), int(b), int(s)) for (a, b), s in zip(found.spans, found.states, strict=True)]


def test_what_moves_without_an_explanation_is_free() -> None:
    assert states([]) == [(0, ONSET - 1, STATIC), (ONSET, T - 1, FREE)]


def test_what_a_fit_explains_is_held() -> None:
    assert states([fit(0, T - 1, slice(ONSET, None))]) == [(0, ONSET - 1, STATIC), (ONSET, T - 1, HELD)]


def test_a_pause_in_the_air_does_not_end_a_hold() -> None:
    motion = moved()
    motion.moved[:, 26:34] = 0.0
    assert states([fit(0, T - 1, slice(ONSET, None))], motion)[1:] == [(ONSET, T - 1, HELD)]


def test_two_ways_to_hold_are_two_segments() -> None:
    fits = [fit(0, T - 1, slice(ONSET, 29)), fit(0, T - 1, slice(29, None))]
    assert states(fits)[1:] == [(ONSET, 28, HELD), (29, T - 1, HELD)]
    assert best_fit_in_window(fits, ONSET, 28, 0.0) is fits[0]
    assert best_fit_in_window(fits, 29, T - 1, 0.0) is fits[1]


def test_a_fit_says_nothing_where_it_was_not_tried() -> None:
    assert states([fit(0, T - 1, slice(ONSET, None), np.arange(ONSET, 31))])[1:] == [
        (ONSET, 30, HELD),
        (31, T - 1, FREE),
    ]


def test_frames_that_nobody_knows_cost_nothing() -> None:
    motion = moved()
    motion.moved[:] = np.nan
    cost = window_costs(motion, [])
    assert cost[STATIC, 0, T - 1] < cost[STATIC, 0, T // 2] + cost[STATIC, T // 2 + 1, T - 1]
    assert states([], motion) == [(0, T - 1, STATIC)]


@pytest.mark.parametrize("jitter", [0.5 * STATIC_CONTOUR_SIGMA_PX, STATIC_CONTOUR_SIGMA_PX])
def test_jitter_of_masks_is_no_motion(jitter: float) -> None:
    motion = ImageMotion(np.full((4, T), jitter), np.zeros((4, T)))
    assert states([], motion) == [(0, T - 1, STATIC)]


def test_windows_end_after_they_start() -> None:
    cost = window_costs(moved(), [fit(0, T - 1, slice(ONSET, None))])
    below = np.tril(np.ones((T, T), dtype=bool), -1)
    assert np.isinf(cost[:, below]).all()
    assert not np.isnan(cost).any()


def test_runs_are_cut_into_equal_pieces() -> None:
    parts = list(split_runs([(3, 5), (10, 29), (40, 139)], longest=60, shortest=6))
    assert [(part[0], part[-1]) for part in parts] == [(10, 29), (40, 89), (90, 139)]
