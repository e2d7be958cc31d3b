"""Candidates in a result's place."""

from __future__ import annotations

import numpy as np
import pytest

from getagrip.geometry import se3
from getagrip.report.pictures.result_view import candidate_view, fit_hinge_axis
from helpers.results import two_candidates, view


@pytest.mark.slow
def test_a_candidate_takes_the_results_place() -> None:
    it = view()
    other = candidate_view(it, 1)
    assert candidate_view(it, 0) is it
    assert np.array_equal(other.result.T_hand_obj, it.result.candidates.T_hand_obj[1])
    assert np.isnan(other.result.iou).all()  # that of the result is not its own


def test_the_axis_of_poses_that_turn_about_a_line_is_that_line() -> None:
    point, direction = np.array([0.02, -0.01, 0.03]), np.array([0.6, 0.0, 0.8])
    angle = np.linspace(0.0, 4.0, 9)  # beyond half a turn
    start = se3.rigid(se3.exp_so3(np.array([0.1, 0.2, -0.3])), np.array([0.05, 0.0, 0.02]))
    T = se3.rotation_about_line(point, direction, angle) @ start
    found = fit_hinge_axis(T, two_candidates()[1].mesh.vertices)
    assert found is not None
    sign = np.sign(found.direction @ direction)
    assert np.allclose(found.direction, sign * direction, atol=1e-6)
    assert np.allclose(found.angle, sign * angle, atol=1e-6)
    assert np.allclose(np.cross(found.point - point, direction), 0.0, atol=1e-6)
    assert fit_hinge_axis(T[:1], two_candidates()[1].mesh.vertices) is None
