"""Columns: candidates in a result's place, and clips without any result."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from getagrip.geometry import se3
from getagrip.view.live.column import TRUTH, Column, hinge, named
from helpers.two_candidates import column, two_candidates


@pytest.mark.slow
def test_a_candidate_takes_the_results_place() -> None:
    it = column()
    other = it.candidate(1)
    assert it.candidate(0) is it
    assert np.array_equal(other.view.result.T_hand_obj, it.candidates.T_hand_obj[1])
    assert np.isnan(other.view.result.iou).all()  # that of the result is not its own
    assert (other.name, other.rank) == (it.name, 1)


def test_the_axis_of_poses_that_turn_about_a_line_is_that_line() -> None:
    point, direction = np.array([0.02, -0.01, 0.03]), np.array([0.6, 0.0, 0.8])
    angle = np.linspace(0.0, 4.0, 9)  # beyond half a turn
    start = se3.rigid(se3.exp_so3(np.array([0.1, 0.2, -0.3])), np.array([0.05, 0.0, 0.02]))
    T = se3.rotation_about_line(point, direction, angle) @ start
    found = hinge(T, two_candidates()[1].mesh.vertices)
    assert found is not None
    sign = np.sign(found.direction @ direction)
    assert np.allclose(found.direction, sign * direction, atol=1e-6)
    assert np.allclose(found.angle, sign * angle, atol=1e-6)
    assert np.allclose(np.cross(found.point - point, direction), 0.0, atol=1e-6)
    assert hinge(T[:1], two_candidates()[1].mesh.vertices) is None


def test_a_clip_shows_its_ground_truth_or_the_hand_alone() -> None:
    _, clip, masks = two_candidates()
    assert clip.truth is not None
    true, alone = Column.of_clip(clip, masks), Column.of_clip(replace(clip, truth=None), None)
    assert (true.name, true.posed, true.is_result, true.truth) == (TRUTH, True, False, None)
    assert np.allclose(true.T_cam_obj, clip.truth.T_cam_obj)
    assert (alone.name, alone.posed, alone.is_result) == (clip.name, False, False)


def test_columns_of_one_method_are_told_apart_by_their_folders() -> None:
    it = column().view
    static = replace(it, result=replace(it.result, method="static"))
    names = [made.name for made in named([("a", it), ("b", it), ("c", static)])]
    assert len(set(names)) == 3
    assert names[0].endswith("(a)")
    assert "(c)" not in names[2]
