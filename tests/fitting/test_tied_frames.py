"""The solver, where a term ties frames to each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy import ndarray

from getagrip.fitting.energy import PosesInCamera, Quadratic, Term
from getagrip.fitting.energy.homan_terms import InteractionTerm, SmoothnessTerm, vertex_moments
from getagrip.fitting.motion import Free
from getagrip.fitting.solver.solve import minimise
from getagrip.least_squares import DampingRules
from helpers.terms import N, random_poses, some_term


class Tied:
    """A term that ties frames to each other by nothing."""

    name = "tied"

    def __init__(self, inner: Term) -> None:
        self.inner = inner

    def __call__(self, poses: PosesInCamera, bound: ndarray) -> Quadratic:
        local = self.inner(poses, bound)
        return replace(local, cross=np.zeros((*local.g.shape, *local.g.shape[1:])))


@pytest.mark.parametrize("free_scale", [False, True])
def test_tied_by_nothing_frames_are_solved_as_ever(free_scale: bool) -> None:
    rng = np.random.default_rng(8)
    poses = random_poses(rng)
    terms = [some_term("reprojection", rng), some_term("interaction", rng)]
    start = Free(poses.R, poses.centre, np.log(poses.scale), free_scale)
    T = np.tile(np.eye(4), (N, 1, 1))
    alone = minimise(start, terms, T, 4)
    tied = minimise(start, [Tied(term) for term in terms], T, 4)
    np.testing.assert_allclose(alone.energy, tied.energy, rtol=1e-6)
    np.testing.assert_allclose(alone.motion.centre, tied.motion.centre, atol=1e-6)


def test_steps_of_tied_frames_are_newton_steps() -> None:
    """The smoothness of a body that may only be shifted is quadratic, and its minimum between two images known."""
    rng = np.random.default_rng(9)
    centre = np.array([0.0, 0.0, 0.5]) + rng.normal(0.0, 0.02, (1, N, 3))
    start = Free(np.tile(np.eye(3), (1, N, 1, 1)), centre, np.zeros(1))
    smooth, fixed = SmoothnessTerm(vertex_moments(np.zeros((1, 3))), 2e5), InteractionTerm(centre[0].copy(), 1e5)
    chain = 2.0 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1)
    chain[0, 0] = chain[-1, -1] = 1.0
    expected = np.linalg.solve(1e5 * np.eye(N) + 2e5 * chain, 1e5 * centre[0])
    found = minimise(
        start, [smooth, fixed], np.tile(np.eye(4), (N, 1, 1)), 12, rules=DampingRules(tolerance=1e-12)
    ).motion.centre[0]
    np.testing.assert_allclose(found, expected, atol=1e-6)
