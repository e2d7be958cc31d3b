"""What does not matter to whole timelines: the world's frame, a mirror, the direction of time, where a grasp is cut."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy import ndarray

from getagrip.clip import Clip, HandTrack, Masks, Segment, World, with_masks
from getagrip.fitting.options import Options
from getagrip.fitting.pipeline import repair_input
from getagrip.fitting.problem import prepare_problem
from getagrip.geometry import se3
from getagrip.reconstruct import reconstruct
from getagrip.result import Reconstruction
from getagrip.timelines.observations import GraspClip, Hypotheses, TimelineInputs
from getagrip.timelines.segments import fit_in_all_frames, solve_grasp
from getagrip.timelines.tracking import track_hypotheses
from helpers.scenes import SMALL, timeline

FEW = Options(inits=20)


@cache
def usual() -> Reconstruction:
    return reconstruct(*timeline(), FEW)


def before_camera(result: Reconstruction, clip: Clip) -> ndarray:
    """Vertices (T, V, 3) as they were found."""
    T_cam_hand = clip.hand.T_cam_hand if result.T_cam_hand is None else result.T_cam_hand
    return se3.transform(T_cam_hand @ result.T_hand_obj, clip.mesh.vertices)


def apart(a: ndarray, b: ndarray) -> float:
    """Mean distance of vertices in the worst frame, in the mug's diameter."""
    return float(np.linalg.norm(a - b, axis=-1).mean(axis=-1).max()) / timeline()[0].mesh.diameter


@pytest.mark.slow
def test_a_grasp_of_a_timeline_is_solved_as_a_grasp_by_itself() -> None:
    """To the bit, where mesh and masks are taken as they are; then neighbours and the settling of depths come to it."""
    clip, masks = timeline()
    segment = Segment("grasp", 0, 7, clip.side)
    rows = clip.segments[2].rows
    alone, seen = replace(clip, segments=()).take(rows), masks.take(rows)
    footage = TimelineInputs.of(repair_input(with_masks(replace(alone, segments=(segment,)), seen), FEW))
    grasp = GraspClip.of(footage.clip, segment)
    assert grasp is not None
    found = fit_in_all_frames(solve_grasp(grasp, prepare_problem(grasp.clip, FEW), []), 0, [])
    expected = reconstruct(alone, seen, replace(FEW, mesh="as-given", masks="as-given"))
    np.testing.assert_array_equal(found.track.T_hand_obj[0], expected.T_hand_obj)
    assert found.axis is not None
    assert expected.axis is not None
    np.testing.assert_array_equal(found.axis.angle, expected.axis.angle)
    np.testing.assert_array_equal(found.solutions.energy[0], expected.energy["total"])
    whole = reconstruct(replace(alone, segments=(segment,)), seen, FEW)
    assert apart(before_camera(whole, alone), before_camera(expected, alone)) < 0.05
    assert whole.segments[0].signs.keys() == expected.signs.keys()


@pytest.mark.slow
def test_the_frame_of_the_world_does_not_matter() -> None:
    clip, masks = timeline()
    rng = np.random.default_rng(0)
    T = se3.rigid(se3.exp_so3(rng.normal(size=3)), rng.normal(size=3))
    world = clip.world
    assert world is not None
    assert world.up is not None
    assert world.support is not None
    up = T[:3, :3] @ world.up
    other = World(T @ world.T_world_cam, up, world.support + float(up @ T[:3, 3]))
    found = reconstruct(replace(clip, world=other, truth=None), masks, FEW)
    assert apart(before_camera(found, clip), before_camera(usual(), clip)) < 0.05
    (one, two) = (result.segments[0].T_world_obj for result in (usual(), found))
    lies, there = (se3.transform(pose, clip.mesh.vertices)[None] for pose in (T @ one, two))
    assert apart(lies, there) < 0.05


@pytest.mark.slow
def test_a_left_hand_is_a_right_hand_in_a_mirror() -> None:
    left, masks = timeline(options=replace(SMALL, side="left"))
    found = before_camera(reconstruct(left, masks, FEW), left) * [-1.0, 1.0, 1.0]
    assert apart(found, before_camera(usual(), timeline()[0])) < 0.05


def backwards(clip: Clip, masks: Masks) -> tuple[Clip, Masks]:
    """As if it had been filmed the other way."""
    T, back = len(clip), np.arange(len(clip))[::-1]
    segments = tuple(replace(s, first=T - 1 - s.last, last=T - 1 - s.first) for s in clip.segments[::-1])
    other = replace(clip, segments=(), times=None).take(back)
    return replace(other, segments=segments, frames=clip.frames, times=None), masks.take(back)


@pytest.mark.slow
def test_a_timeline_may_run_backwards() -> None:
    """The object is put down, then: the same poses."""
    clip, masks = timeline()
    other, seen = backwards(clip, masks)
    found = reconstruct(other, seen, FEW)
    assert [segment.state for segment in found.segments] == ["grasp", "contact", "static"]
    assert apart(before_camera(found, other)[::-1], before_camera(usual(), clip)) < 0.07


@pytest.mark.slow
def test_a_grasp_may_be_cut_in_two() -> None:
    clip, masks = timeline()
    static, contact, grasp = clip.segments
    parts = replace(grasp, last=grasp.first + 3), replace(grasp, first=grasp.first + 4)
    found = reconstruct(replace(clip, segments=(static, contact, *parts)), masks, FEW)
    assert apart(before_camera(found, clip), before_camera(usual(), clip)) < 0.1
    assert [segment.by_masks for segment in found.segments] == [False] * 4


@pytest.mark.slow
def test_poses_are_followed_independently() -> None:
    """Each start goes where it goes alone, and where the hand is does not matter to frames that it does not change."""
    clip, masks = timeline()
    footage = TimelineInputs.of(repair_input(with_masks(clip, masks), FEW))
    assert clip.truth is not None
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


@pytest.mark.slow
def test_an_object_that_lies_still_does_not_know_the_hand() -> None:
    """Where what hides it is marked, its pose comes from the masks alone."""
    clip, masks = timeline()
    T = clip.hand.T_cam_hand.copy()
    T[:5, :3, 3] += [0.1, 0.0, 0.1]  # before it comes near
    hand = HandTrack(clip.hand.vertices, clip.hand.faces, T, clip.hand.regions, clip.hand.joints)
    found = reconstruct(replace(clip, hand=hand, truth=None), masks, replace(FEW, hands="as-given"))
    lies, usual_pose = (
        before_camera(result, one)[:5] for result, one in ((found, replace(clip, hand=hand)), (usual(), clip))
    )
    assert apart(lies, usual_pose) < 0.02
