"""Laws of the standard deviation that the energy leaves of a pose."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from getagrip.clip import with_masks
from getagrip.fitting.methods import METHODS
from getagrip.fitting.options import Options
from getagrip.fitting.problem import MethodResult, Problem, prepare_problem
from getagrip.fitting.stages.confidence import pose_spread
from helpers.scenes import scene


@cache
def solved() -> tuple[Problem, MethodResult]:
    problem = prepare_problem(with_masks(*scene("mug", 2)), Options(inits=5))
    return problem, METHODS["soft-hinge"].fit(problem, lambda _: None)


def of_frames(index: list[int]) -> float:
    """The spread if these were all the frames, with the same motion in them and as much noise in each."""
    problem, found = solved()
    some, share = np.array(index), len(index) / len(problem.clip)
    assert found.motion is not None
    motion = found.motion.resampled(np.arange(len(problem.clip)), some)
    terms = found.terms | {"mask": found.terms["mask"] * share}
    poses = replace(found.poses, R=found.poses.R[:, some], centre=found.poses.centre[:, some])
    part = problem.at(problem.clip.take(some))
    return pose_spread(part, replace(found, motion=motion, terms=terms, poses=poses))


@pytest.mark.slow
def test_fewer_frames_leave_more() -> None:
    problem, found = solved()
    every = pose_spread(problem, found)
    assert every == pytest.approx(of_frames(list(range(len(problem.clip)))))
    assert 0.0 < every < min(of_frames([0, 2, 4, 6]), of_frames([1, 3, 5, 7]))


@pytest.mark.slow
def test_masks_that_are_met_badly_leave_more() -> None:
    problem, found = solved()
    worse = replace(found, terms=found.terms | {"mask": 4.0 * found.terms["mask"]})
    assert pose_spread(problem, worse) == pytest.approx(2.0 * pose_spread(problem, found))


def test_it_is_not_known_without_a_motion() -> None:
    problem, found = solved()
    assert np.isnan(pose_spread(problem, replace(found, motion=None)))
