"""Laws of the hand's depth: along the ray, nothing at the truth, a hand too far away found, silence elsewhere."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from getagrip.fitting import hand_depth as hd
from getagrip.fitting.hand_depth import at_hand_depth, deeper, hand_depth, least
from getagrip.fitting.methods import METHODS
from getagrip.fitting.options import Options
from getagrip.fitting.problem import MethodResult, Problem, prepare
from getagrip.fitting.solve import minimise
from getagrip.geometry import se3
from helpers.scenes import SMALL, scene

DEPTHS = hd.STEP * np.arange(-hd.STEPS, hd.STEPS + 1)


@cache
def solved(away_mm: float) -> tuple[Problem, MethodResult]:
    """A grasp found with the hand so much too far from the camera."""
    clip, masks = scene("mug", 2, SMALL)
    middle = se3.transform(clip.hand.T_cam_hand, clip.hand.vertices.mean(axis=(0, 1))[None])[:, 0]
    ray = middle / np.linalg.norm(middle, axis=1, keepdims=True)
    clip = clip.with_hand_at(se3.rigid(None, 1e-3 * away_mm * ray) @ clip.hand.T_cam_hand)
    problem = prepare(clip, masks, Options(inits=25))
    return problem, METHODS["soft-hinge"].fit(problem, lambda _: None)


def too_far(problem: Problem) -> float:
    """How much too far from the camera the hand's middle is, on average [m]."""
    truth = problem.clip.truth
    assert truth is not None
    middle = truth.hand_vertices.mean(axis=(0, 1))[None]
    there, here = (se3.transform(T, middle)[:, 0] for T in (truth.T_cam_hand, problem.clip.hand.T_cam_hand))
    return float(np.mean(np.linalg.norm(here, axis=1) - np.linalg.norm(there, axis=1)))


# The least cost


@given(st.floats(-0.03, 0.03), st.floats(0.1, 10.0), st.floats(1.0, 1e6))
def test_a_quadratic_energy_has_the_depth_where_its_slope_balances_the_prior(
    at: float, bend: float, size: float
) -> None:
    energy = size * (1.0 + 0.5 * bend * ((DEPTHS - at) / hd.SPREAD) ** 2)
    stiff = bend / (hd.SHARE * (1.0 + 0.5 * bend * (at / hd.SPREAD) ** 2))
    assert least(energy) == pytest.approx(at * stiff / (stiff + 1.0), abs=1e-9)


def test_the_prior_alone_leaves_the_hand() -> None:
    assert least(np.ones(7)) == 0.0


@pytest.mark.parametrize("energy", [[1.0, np.inf, 1.0], [1.0, np.nan, 0.5], [0.0, 0.0, 0.0]])
def test_where_energies_say_nothing_the_hand_stays(energy: list[float]) -> None:
    assert least(np.array(energy)) == 0.0


# The hand, moved


def test_a_deeper_hand_is_farther_away_and_seen_at_the_same_place() -> None:
    problem = prepare(*scene("mug", 2, SMALL), Options())
    middle = problem.clip.hand.vertices.mean(axis=(0, 1))[None]
    there = deeper(problem, 0.02)
    before, after = (se3.transform(p.clip.hand.T_cam_hand, middle)[:, 0] for p in (problem, there))
    np.testing.assert_allclose(np.linalg.norm(after, axis=1) - np.linalg.norm(before, axis=1), 0.02, atol=1e-12)
    np.testing.assert_allclose(after[:, :2] / after[:, 2:], before[:, :2] / before[:, 2:], atol=1e-12)
    np.testing.assert_allclose(deeper(there, -0.02).clip.hand.T_cam_hand, problem.clip.hand.T_cam_hand, atol=1e-12)


@pytest.mark.slow
def test_a_true_hand_stays() -> None:
    problem, found = prepare(*scene("mug", 2, SMALL), Options()), solved(30.0)[1]
    assert not problem.hand_corrected
    assert hand_depth(problem, found) == 0.0
    there, again = at_hand_depth(problem, found, lambda _: None)
    assert there is problem
    assert again is found


@pytest.mark.parametrize("away_mm", [30.0, -30.0])
@pytest.mark.slow
def test_a_hand_at_a_wrong_depth_is_brought_to_the_true_one(away_mm: float) -> None:
    problem, found = solved(away_mm)
    assert problem.hand_corrected
    there, again = at_hand_depth(problem, found, lambda _: None)
    assert np.sign(too_far(problem)) == np.sign(away_mm)
    assert abs(too_far(there)) < 0.25 * abs(too_far(problem))
    assert again.energy[0] < found.energy[0]
    assert there.notes[:-1] == problem.notes
    assert ("nearer to" if away_mm > 0.0 else "farther from") in there.notes[-1]
    # The solutions are those of the hand where it is now: converged there, best first.
    assert (np.diff(again.energy) >= 0.0).all()
    assert sum(again.terms.values()) == pytest.approx(again.energy[0])
    assert again.motion is not None
    assert again.energy_of is not None
    terms = again.energy_of(there)(256, np.arange(len(there.clip)))
    start = minimise(again.motion.take(np.zeros(1, int)), terms, there.clip.hand.T_cam_hand, 0)
    assert start.energy[0] == pytest.approx(again.energy[0], rel=0.01)


@pytest.mark.slow
def test_where_nothing_tells_the_depth_the_hand_stays() -> None:
    problem, found = solved(30.0)
    free = replace(problem, clip=replace(problem.clip, scale="free"))
    assert hand_depth(free, found) == 0.0
    assert hand_depth(replace(problem, hand_corrected=False), found) == 0.0
    assert hand_depth(problem, replace(found, axis=None)) == 0.0
    assert hand_depth(problem, replace(found, motion=None)) == 0.0
