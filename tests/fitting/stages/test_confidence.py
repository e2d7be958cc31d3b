"""Pose spread and scale check: what lowers confidence in a result, and what does not."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from getagrip.clip import Clip, Masks, with_masks
from getagrip.fitting.methods import METHODS
from getagrip.fitting.options import Options
from getagrip.fitting.problem import MethodResult, Problem, prepare_problem
from getagrip.fitting.stages.confidence import pose_spread, scale_check
from getagrip.geometry.mesh import Mesh
from helpers.scenes import SHORT, scene


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


def rather(clip: Clip, masks: Masks, method: str = "soft-hinge") -> tuple[float, float]:
    problem = prepare_problem(with_masks(clip, masks), Options(method=method, inits=20))
    return scale_check(problem, METHODS[method].fit(problem, lambda _: None))


def resized(clip: Clip, by: float) -> Clip:
    return replace(clip, mesh=Mesh(by * clip.mesh.vertices, clip.mesh.faces), truth=None)


@pytest.mark.parametrize("method", ["soft-hinge", "one-dof", "dynamic"])
@pytest.mark.slow
def test_the_true_size_is_the_best(method: str) -> None:
    factor, gain = rather(*scene("bottle", 1, SHORT), method)
    assert factor == pytest.approx(1.0, abs=0.02)
    assert 0.0 <= gain < 0.15


@pytest.mark.parametrize("by", [0.9, 1.1])
@pytest.mark.slow
def test_another_size_than_the_objects_is_found(by: float) -> None:
    clip, masks = scene("bottle", 1, SHORT)
    factor, gain = rather(resized(clip, by), masks)
    assert factor * by == pytest.approx(1.0, abs=0.04)
    assert gain > 0.3


def test_nothing_is_known_where_the_size_was_free_or_the_method_has_no_motion() -> None:
    clip, masks = scene("bottle", 1, SHORT)
    assert np.isnan(rather(replace(clip, scale="free"), masks)).all()
    assert np.isnan(rather(clip, masks, "single-frame")).all()
