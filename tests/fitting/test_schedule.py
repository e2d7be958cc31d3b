"""The longer search: what it starts from is the same, what it finds is no worse."""

from __future__ import annotations

from itertools import pairwise

import pytest

from getagrip.fitting.options import Options
from getagrip.fitting.solver.search import DEFAULT_SCHEDULE, THOROUGH_SCHEDULE
from getagrip.reconstruct import reconstruct
from helpers.scenes import SHORT, scene


@pytest.mark.slow
def test_the_longer_search_finds_no_worse_and_says_what_it_was() -> None:
    usual, longer = (
        reconstruct(*scene("mug", 2, SHORT), Options(inits=12, thorough=thorough)) for thorough in (False, True)
    )
    assert longer.energy["total"] < 1.01 * usual.energy["total"]
    assert (usual.options["thorough"], longer.options["thorough"]) == (False, True)


def test_the_longer_search_goes_through_the_same_stages_and_keeps_more() -> None:
    short, long = ([*schedule.coarse, *schedule.fine] for schedule in (DEFAULT_SCHEDULE, THOROUGH_SCHEDULE))
    for usual, longer in zip(short, long, strict=True):
        assert (usual.name, usual.level, usual.frames) == (longer.name, longer.level, longer.frames)
        assert longer.keep >= usual.keep
        assert longer.within >= usual.within
    assert sum(s.rounds * s.parents for s in long) > sum(s.rounds * s.parents for s in short)
    assert all(a.keep >= b.keep for a, b in pairwise(long))
