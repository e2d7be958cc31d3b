"""A hand whose depth jitters: the object it holds goes back to its masks, and the hand with it."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from getagrip.clip import with_masks
from getagrip.fitting.options import Options
from getagrip.fitting.pipeline import repair_input
from getagrip.geometry import se3
from getagrip.timelines.observations import TimelineInputs
from getagrip.timelines.transitions import TimelineMotion, correct_depth, depth_jitter
from helpers.scenes import timeline


def test_depth_is_mended_and_contact_stays() -> None:
    clip, masks = timeline()
    assert clip.truth is not None
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
