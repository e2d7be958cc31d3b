"""Hypotheses in other frames of reference, and grasps as clips of their own."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from getagrip.clip import read_masks, with_masks
from getagrip.fitting.motion import transform_poses
from getagrip.fitting.options import Options
from getagrip.fitting.pipeline import repair_input
from getagrip.geometry import se3
from getagrip.timelines.observations import GraspClip, Hypotheses, TimelineInputs
from helpers.clips import box
from helpers.scenes import by_other_hand, timeline

VERTICES = box(0.1, 0.06, 0.04).vertices + np.array([0.01, -0.02, 0.03])
K, N = 3, 5


def random_motions(rng: np.random.Generator, count: int = N) -> np.ndarray:
    return se3.rigid(se3.exp_so3(rng.normal(size=(count, 3))), rng.normal(0.0, 0.3, (count, 3)))


def random_hypotheses(rng: np.random.Generator, frames: int = N) -> Hypotheses:
    R, centre = se3.exp_so3(rng.normal(size=(K, frames, 3))), rng.normal(0.0, 0.2, (K, frames, 3))
    return Hypotheses(R, centre, rng.uniform(0.8, 1.2, K), np.sort(rng.uniform(size=K)))


@pytest.fixture(scope="module")
def footage() -> TimelineInputs:
    return TimelineInputs.of(repair_input(with_masks(*timeline()), Options(inits=4)))


@given(st.integers(0, 99))
def test_poses_go_to_another_frame_and_back(seed: int) -> None:
    rng = np.random.default_rng(seed)
    found, T = random_hypotheses(rng), random_motions(rng)
    back = transform_poses(transform_poses(found, T), se3.inverse(T))
    np.testing.assert_allclose(back.R, found.R, atol=1e-12)
    np.testing.assert_allclose(back.centre, found.centre, atol=1e-12)


@given(st.integers(0, 99))
def test_the_mesh_goes_where_its_centre_is(seed: int) -> None:
    """``X_world = R (scale (X - c)) + centre`` is ``T_world_obj (scale X)``."""
    rng = np.random.default_rng(seed)
    found, c = random_hypotheses(rng), rng.normal(0.0, 0.1, 3)
    expected = (found.scale[:, None, None, None] * (VERTICES - c)) @ np.swapaxes(found.R, -1, -2)
    placed = se3.transform(found.T_world_obj(c), found.scale[:, None, None, None] * VERTICES)
    np.testing.assert_allclose(placed, expected + found.centre[:, :, None], atol=1e-12)


def test_one_pose_is_its_own_hypothesis() -> None:
    T = random_motions(np.random.default_rng(3), 1)[0]
    centre = np.array([0.02, 0.0, -0.01])
    np.testing.assert_allclose(Hypotheses.of_pose(T, centre).T_world_obj(centre)[0, 0], T, atol=1e-12)


def test_a_grasp_is_a_clip_of_the_frames_in_which_its_hand_is_known() -> None:
    clip, masks = by_other_hand()
    assert clip.other_hand is not None
    grasp = clip.segments[2]
    found = GraspClip.of(with_masks(clip, masks), grasp)
    assert found is not None
    of_hand, seen, rows = found.clip, read_masks(found.clip), found.rows
    assert rows.tolist() == [n for n in grasp.rows if clip.other_hand.known[n]]
    assert (of_hand.side, of_hand.frames) == (grasp.side, tuple(clip.frames[n] for n in rows))
    np.testing.assert_array_equal(of_hand.hand.T_cam_hand, clip.other_hand.track.T_cam_hand[rows])
    np.testing.assert_array_equal(seen.object, masks.take(rows).object)
