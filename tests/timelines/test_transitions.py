"""Motion between segments and the depth of grasps: frames of reference, time and order do not matter."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from getagrip.clip import Segment, with_masks
from getagrip.fitting.motion import transform_poses
from getagrip.fitting.options import Options
from getagrip.fitting.pipeline import repair_input
from getagrip.geometry import se3
from getagrip.timelines.observations import Hypotheses, TimelineInputs
from getagrip.timelines.transitions import TimelineMotion, _blend_motions, correct_depth, depth_jitter, split_at_gaps
from helpers.random_motions import N, random_hypotheses, random_motions
from helpers.scenes import timeline


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


def test_depth_is_mended_and_contact_stays() -> None:
    clip, masks = timeline()
    footage = TimelineInputs.of(repair_input(with_masks(clip, masks), Options(inits=20)))
    rows = np.arange(7)  # the object lies still
    true = clip.truth.T_cam_obj[rows]
    middle = se3.transform(true, clip.mesh.centre[None])[:, 0]
    ray = middle / np.linalg.norm(middle, axis=1, keepdims=True)
    deeper = se3.rigid(None, 0.015 * np.where(rows % 2, 1.0, -1.0)[:, None] * ray)
    motion = TimelineMotion.of(footage.clip, footage.shown)
    motion.T_cam_obj[rows], motion.T_cam_hand[rows] = deeper @ true, deeper @ clip.hand.T_cam_hand[rows]
    correct_depth(motion, footage.problem(rows), rows, footage.clip.side, depth_jitter(motion.places(rows)))
    for found, right in ((motion.T_cam_obj, true), (motion.T_cam_hand, clip.hand.T_cam_hand[rows])):
        off = np.abs(np.sum((found[rows, :3, 3] - right[:, :3, 3]) * ray, axis=1))
        assert off.mean() < 0.007
    aside = np.cross(motion.T_cam_hand[rows, :3, 3] - clip.hand.T_cam_hand[rows, :3, 3], ray)
    np.testing.assert_allclose(aside, 0.0, atol=1e-9)


def test_motion_is_no_jitter() -> None:
    rng = np.random.default_rng(0)
    places = np.array([0.0, 0.0, 0.6]) + np.cumsum(rng.normal(0.0, 0.01, (400, 3)), axis=0) * [1.0, 1.0, 0.9]
    assert depth_jitter(places) < 0.003
    still = np.tile([0.05, 0.0, 0.6], (400, 1))
    assert depth_jitter(still) == 0.0
    still[:, 2] += rng.normal(0.0, 0.005, 400)
    assert 0.009 < depth_jitter(still) < 0.016  # second differences of white noise are sqrt(6) times as large


@given(st.integers(0, 99))
def test_jitter_knows_no_frame_no_direction_of_time_and_no_unit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    places = np.array([0.05, 0.0, 0.6]) + rng.normal(0.0, 1e-3, (50, 3))
    places *= 1.0 + rng.normal(0.0, 0.01, (50, 1))
    jitter, R = depth_jitter(places), se3.exp_so3(rng.normal(size=3))
    assert jitter > 0.0
    np.testing.assert_allclose(depth_jitter(places @ R.T), jitter, rtol=1e-9)
    np.testing.assert_allclose(depth_jitter(0.5 * places), 0.5 * jitter, rtol=1e-9)
    np.testing.assert_allclose(depth_jitter(places[::-1]), jitter, rtol=0.2)  # rays differ by what jitters
