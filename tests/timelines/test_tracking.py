"""Hypotheses in any frame of reference, and their tracking: distinct paths, the cheapest kept, true poses stay true."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from getagrip.clip import read_masks, with_masks
from getagrip.fitting.energy.homan_terms import vertex_moments
from getagrip.fitting.motion import PosesInHand, transform_poses
from getagrip.fitting.options import Options
from getagrip.fitting.pipeline import repair_input
from getagrip.geometry import se3
from getagrip.timelines.observations import GraspClip, Hypotheses, TimelineInputs
from getagrip.timelines.tracking import (
    N_PATHS,
    _pose_embedding,
    _select_distinct_paths,
    hand_motions,
    track_hypotheses,
)
from helpers.clips import box
from helpers.random_motions import K, random_hypotheses, random_motions
from helpers.scenes import by_other_hand, timeline

VERTICES = box(0.1, 0.06, 0.04).vertices + np.array([0.01, -0.02, 0.03])


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
    grasp = clip.segments[2]
    found = GraspClip.of(with_masks(clip, masks), grasp)
    assert found is not None
    of_hand, seen, rows = found.clip, read_masks(found.clip), found.rows
    assert rows.tolist() == [n for n in grasp.rows if clip.other_hand.known[n]]
    assert (of_hand.side, of_hand.frames) == (grasp.side, tuple(clip.frames[n] for n in rows))
    np.testing.assert_array_equal(of_hand.hand.T_cam_hand, clip.other_hand.track.T_cam_hand[rows])
    np.testing.assert_array_equal(seen.object, masks.take(rows).object)


def test_the_cheapest_distinct_paths_of_each_start_are_kept() -> None:
    rng = np.random.default_rng(0)
    spots, cost, start = rng.uniform(size=(60, 12)), rng.uniform(size=60), rng.integers(3, size=60)
    spots[1], start[1], cost[1] = spots[0] + 1e-4, start[0], cost[0] + 1.0  # a copy
    kept = _select_distinct_paths(spots, cost, start, 5, 0.5)
    assert np.all(np.diff(cost[kept]) > 0.0)
    assert 1 not in kept
    for one in range(3):
        mine, every = kept[start[kept] == one], np.flatnonzero(start == one)
        assert mine[0] == every[np.argmin(cost[every])]
        apart = np.linalg.norm(spots[mine][:, None] - spots[mine], axis=-1)
        assert apart[~np.eye(len(mine), dtype=bool)].min() > 0.5
        assert len(mine) <= 5


@pytest.mark.slow
@pytest.mark.parametrize("back", [False, True])
def test_the_best_path_is_the_true_one(back: bool) -> None:
    clip, masks = timeline()
    footage = TimelineInputs.of(repair_input(with_masks(clip, masks), Options(inits=20)))
    T = footage.T_world_cam @ clip.truth.T_cam_obj
    begin, rows = (7, np.arange(6, 2, -1)) if back else (4, np.arange(5, 10))
    centre = se3.transform(T[begin], clip.mesh.centre[None])
    away = centre + 0.4 * clip.mesh.diameter  # another start, which is wrong
    start = Hypotheses(
        T[[begin, begin], None, :3, :3], np.stack([centre, away]), np.ones(2), np.array([0.0, 1.0])
    )  # fmt: skip
    paths = track_hypotheses(footage, begin, rows, start)
    assert paths.start[0] == 0
    assert {*paths.start} == {0, 1}
    assert np.bincount(paths.start).max() <= N_PATHS
    off = se3.transform(paths.found.T_world_obj(clip.mesh.centre)[0], clip.mesh.vertices[None])
    off = off - se3.transform(T[rows], clip.mesh.vertices[None])
    assert np.linalg.norm(off, axis=-1).mean(axis=1).max() < 0.07 * clip.mesh.diameter


@pytest.mark.slow
def test_poses_are_followed_independently() -> None:
    """Each start goes where it goes alone, and where the hand is does not matter to frames that it does not change."""
    clip, masks = timeline()
    footage = TimelineInputs.of(repair_input(with_masks(clip, masks), Options(inits=20)))
    T = footage.T_world_cam[4] @ clip.truth.T_cam_obj[4]
    true = Hypotheses.of_pose(T, clip.mesh.centre)
    away = replace(true, centre=true.centre + 0.3 * clip.mesh.diameter, energy=true.energy + 1.0)
    rows = np.arange(5, 8)
    both = track_hypotheses(footage, 4, rows, true.concatenate(away))
    for k, start in enumerate((true, away)):
        alone, of = track_hypotheses(footage, 4, rows, start).found, both.found.take(both.start == k)
        np.testing.assert_array_equal(alone.R, of.R)
        np.testing.assert_array_equal(alone.centre, of.centre)
        np.testing.assert_array_equal(alone.energy, of.energy)


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


def test_what_a_hand_carries_comes_back(footage: TimelineInputs) -> None:
    (there,), (back,), (on,), (whole,) = (
        hand_motions(footage.clip, *ends) for ends in ((1, 6), (6, 1), (6, 9), (1, 9))
    )
    np.testing.assert_allclose(there @ back, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(on @ there, whole, atol=1e-12)
