"""Hypotheses, motions and what lies between: frames of reference, time and order do not matter."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from getagrip.clip import Segment, read_masks, with_masks
from getagrip.fitting.energy.homan_terms import vertex_moments
from getagrip.fitting.motion import PosesInHand, transform_poses
from getagrip.fitting.options import Options
from getagrip.fitting.pipeline import repair_input
from getagrip.geometry import se3
from getagrip.timelines.observations import GraspClip, Hypotheses, TimelineInputs
from getagrip.timelines.tracking import _pose_embedding, hand_motions
from getagrip.timelines.transitions import TimelineMotion, _blend_motions, split_at_gaps
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


@given(st.integers(0, 99))
def test_spots_are_as_far_apart_as_surfaces(seed: int) -> None:
    """The distance of two poses' points is the root mean square distance of their vertices."""
    rng = np.random.default_rng(seed)
    found = random_hypotheses(rng, 1)
    about = VERTICES - VERTICES.mean(axis=0)
    spots = _pose_embedding(vertex_moments(about), PosesInHand(found.R, found.centre, found.scale))
    posed = found.scale[:, None, None] * about @ np.swapaxes(found.R[:, 0], -1, -2) + found.centre
    for k in range(1, K):
        rms = np.sqrt(np.mean(np.sum((posed[k] - posed[0]) ** 2, axis=-1)))
        assert np.linalg.norm(spots[k] - spots[0]) == pytest.approx(rms)


@given(st.integers(0, 99))
def test_a_blend_is_the_same_backwards_and_in_any_frame(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ahead, behind = (random_hypotheses(rng).take(np.zeros(1, int)) for _ in range(2))
    back, T = np.arange(N)[::-1], random_motions(rng, 1).repeat(N, axis=0)
    blend = _blend_motions(ahead, behind)
    for other in (
        _blend_motions(behind.at(back), ahead.at(back)).at(back),
        transform_poses(_blend_motions(*(_in(T, one) for one in (ahead, behind))), se3.inverse(T)),
    ):
        np.testing.assert_allclose(other.R, blend.R, atol=1e-9)
        np.testing.assert_allclose(other.centre, blend.centre, atol=1e-9)
    np.testing.assert_allclose(_blend_motions(ahead, ahead).R, ahead.R, atol=1e-12)


def _in(T: np.ndarray, found: Hypotheses) -> Hypotheses:
    poses = transform_poses(found, T)
    return Hypotheses(poses.R, poses.centre, poses.scale, found.energy)


@given(st.sets(st.integers(3, 20), min_size=1))
def test_parts_without_gaps_are_all_of_the_frames(known: set[int]) -> None:
    rows = np.array(sorted(known))
    parts = split_at_gaps(Segment("grasp", 3, 20, "left"), rows)
    assert np.concatenate([part.rows for part in parts]).tolist() == rows.tolist()
    assert all(after.first > before.last + 1 for before, after in pairwise(parts))
    assert {(part.state, part.side) for part in parts} == {("grasp", "left")}


def test_what_is_put_in_a_frame_is_there(footage: TimelineInputs) -> None:
    motion, rows = TimelineMotion.of(footage.clip, footage.shown), np.arange(2, 5)
    T = random_motions(np.random.default_rng(0), 1)[0]
    found = Hypotheses.of_pose(T, footage.clip.mesh.centre).at(np.zeros(3, int))
    motion.put(rows, found, "fitted")
    assert [kind == "fitted" for kind in motion.kind] == [n in rows for n in range(len(footage))]
    np.testing.assert_array_equal(np.isnan(motion.T_cam_obj[:, 0, 0]), ~np.isin(np.arange(len(footage)), rows))
    for row in rows:
        np.testing.assert_allclose(motion.at(int(row)).T_world_obj(footage.clip.mesh.centre)[0, 0], T, atol=1e-12)


def test_what_a_hand_carries_comes_back(footage: TimelineInputs) -> None:
    (there,), (back,), (on,), (whole,) = (
        hand_motions(footage.clip, *ends) for ends in ((1, 6), (6, 1), (6, 9), (1, 9))
    )
    np.testing.assert_allclose(there @ back, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(on @ there, whole, atol=1e-12)


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
