"""A bound saves work and changes nothing: what is within it is the same, what exceeds it still does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from getagrip.clip import with_masks
from getagrip.fitting.energy import no_bound
from getagrip.fitting.methods.all_frames import add_contact_consistency, coarse_energy, make_initial_poses
from getagrip.fitting.options import Options
from getagrip.fitting.problem import prepare_problem
from getagrip.fitting.solver.solve import poses_in_camera
from helpers.scenes import SHORT, scene


@pytest.mark.parametrize("k", range(4))
@pytest.mark.slow
def test_a_bound_changes_nothing_within_it(k: int) -> None:
    problem = prepare_problem(with_masks(*scene("mug", 1, SHORT)), Options(inits=4))
    poses = poses_in_camera(make_initial_poses(problem), problem.clip.hand.T_cam_hand)
    poses = replace(poses, scale=2.0 * poses.scale)  # so large that the hand is in it
    term = add_contact_consistency(problem, coarse_energy(problem))(64, np.arange(len(problem.clip)))[k]
    free = term(poses, no_bound(poses))
    total = free.value.sum(axis=1)
    assert (total > 0.0).any(), term.name
    bound = np.array([1.001, 0.5, 0.0, 2.0]) * total - np.array([0.0, 0.0, 1.0, 0.0])
    found = term(poses, bound)
    within = total <= bound
    assert within.tolist() == [True, total[1] == 0.0, False, True]
    for name in ("value", "g", "H"):
        np.testing.assert_array_equal(getattr(found, name)[within], getattr(free, name)[within])
    over = ~within & (bound >= 0.0)
    assert np.all(found.value.sum(axis=1)[over] > bound[over])
