"""The cheapest division, against all divisions there are."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise, product

import numpy as np
import pytest

from getagrip.timelines.detect.semi_markov import cheapest_division, division_margins

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
