"""From the sampled frames to every frame: sampled poses stay, other frames follow, and each pose states its kind."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from getagrip.clip import Clip, Masks, read_clip, read_masks, write_clip
from getagrip.fitting.energy import Energy
from getagrip.fitting.energy.homan_terms import ReprojectionTerm
from getagrip.fitting.methods import METHODS, Method, OnStage
from getagrip.fitting.methods.all_frames import soft_hinge
from getagrip.fitting.motion import PosesInHand, interpolate_object_poses
from getagrip.fitting.options import Options
from getagrip.fitting.problem import MethodResult, Problem
from getagrip.fitting.stages import remaining_frames
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.metrics.evaluate import evaluate
from getagrip.metrics.evaluate.metric import ADD_MM
from getagrip.reconstruct import reconstruct
from getagrip.result import Reconstruction, read_result, write_result
from helpers.scenes import SMALL, scene

HIDDEN = (5, 6)
ASIDE = 8.0
"""[px]"""
QUICK = Options(inits=6, frames=5)
LONGER = replace(SMALL, frames=13)


@cache
def made() -> tuple[Clip, Masks]:
    """A clip whose object is hidden in two frames."""
    clip, masks = scene("mug", 2, LONGER)
    seen = masks.object.copy()
    seen[list(HIDDEN)] = False
    return clip, replace(masks, object=seen)


@cache
def found(method: str, all_of_it: bool = True) -> Reconstruction:
    return reconstruct(*made(), replace(QUICK, method=method, every_frame=all_of_it))


@pytest.mark.parametrize("method", ["soft-hinge", "one-dof", "static", "dynamic"])
@pytest.mark.slow
def test_the_frames_that_were_fitted_together_stay_as_they_were(method: str) -> None:
    some, whole = found(method, all_of_it=False), found(method)
    index = whole.frames_of("sampled")
    assert [whole.frames[n] for n in index] == list(some.frames)
    np.testing.assert_array_equal(whole.T_hand_obj[index], some.T_hand_obj)
    np.testing.assert_array_equal(whole.candidates.T_hand_obj[:, index], some.candidates.T_hand_obj)
    np.testing.assert_array_equal(whole.iou[index], some.iou)
    if some.axis is not None:
        assert whole.axis is not None
        np.testing.assert_array_equal(whole.axis.angle[index], some.axis.angle)


@pytest.mark.parametrize("method", ["soft-hinge", "one-dof", "dynamic"])
@pytest.mark.slow
def test_the_other_frames_are_as_good(method: str) -> None:
    clip, masks = made()
    whole = found(method)
    assert whole.frames == clip.frames
    assert [n for n, kind in enumerate(whole.frame_kind) if kind == "interpolated"] == list(HIDDEN)
    assert np.flatnonzero(np.isnan(whole.iou)).tolist() == list(HIDDEN)
    sampled, fitted = whole.frames_of("sampled"), whole.frames_of("fitted")
    assert len(sampled) == 5
    assert whole.iou[fitted].mean() > whole.iou[sampled].mean() - 0.01
    evaluation = evaluate(whole, clip, masks, wanted=[ADD_MM])
    add = np.array(evaluation.per_frame["add_mm"])
    assert add[fitted].max() < add[sampled].max() + 3.0
    assert add[list(HIDDEN)].max() < add[sampled].max() + 3.0
    both = np.concatenate([sampled, fitted])
    assert evaluation.metrics_of_fitted["add_mm"] == pytest.approx(add[both].mean())
    assert evaluation.frame_kind == whole.frame_kind


@pytest.mark.slow
def test_a_hinge_is_the_same_in_every_frame() -> None:
    """Eq. 3, where masks show the object: frame by frame the rotation about the axis by the angle."""
    whole = found("one-dof")
    assert whole.axis is not None
    shown = whole.frames_of("sampled", "fitted")
    angle = whole.axis.angle[shown]
    turn = se3.rotation_about_line(whole.axis.point[None], whole.axis.direction[None], angle - angle[0])
    np.testing.assert_allclose(turn @ whole.T_hand_obj[0], whole.T_hand_obj[shown], atol=1e-9)


@pytest.mark.slow
def test_it_does_not_matter_where_the_masks_are_nor_how_many_are_read_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clip = read_clip(write_clip(*made(), tmp_path / "clip"))
    again = reconstruct(clip, None, replace(QUICK, method="one-dof"))
    in_memory = reconstruct(clip, read_masks(clip), replace(QUICK, method="one-dof"))
    np.testing.assert_array_equal(again.T_hand_obj, in_memory.T_hand_obj)
    monkeypatch.setattr(remaining_frames, "FIT_CHUNK_FRAMES", 2)
    few = reconstruct(clip, None, replace(QUICK, method="one-dof"))
    apart = se3.transform(few.T_hand_obj, clip.mesh.vertices) - se3.transform(again.T_hand_obj, clip.mesh.vertices)
    assert np.linalg.norm(apart, axis=-1).max() < 0.003
    assert few.frame_kind == again.frame_kind


@pytest.mark.slow
def test_results_say_how_each_pose_was_found_and_older_ones_are_read(tmp_path: Path) -> None:
    whole = found("one-dof")
    folder = write_result(whole, tmp_path / "result")
    back, _ = read_result(folder)
    assert back.frame_kind == whole.frame_kind
    np.testing.assert_array_equal(back.iou, whole.iou)
    content = dict(np.load(folder / "result.npz"))
    del content["frame_kind"]
    content["iou"] = np.nan_to_num(content["iou"])
    np.savez(folder / "result.npz", **content)
    assert {*read_result(folder)[0].frame_kind} == {"sampled"}


def test_between_two_poses_lies_the_shortest_way_and_beyond_the_ends_nothing_moves() -> None:
    R = se3.exp_so3(np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 0.8]]]))
    poses = PosesInHand(R, np.array([[[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]]), np.ones(1))
    between = interpolate_object_poses(poses, np.array([2, 6]), np.array([0, 2, 3, 6, 9]))
    np.testing.assert_allclose(se3.log_so3(between.R[0])[:, 2], [0.0, 0.0, 0.2, 0.8, 0.8], atol=1e-12)
    np.testing.assert_allclose(between.centre[0, :, 0], [0.0, 0.0, 0.025, 0.1, 0.1], atol=1e-12)


@pytest.mark.slow
def test_a_corrected_hand_is_corrected_in_every_frame() -> None:
    """A constant error of the hand: what is found of it in the sampled frames holds in the others, too."""
    clip, masks = scene("mug", 2, LONGER)
    error = se3.rigid(se3.exp_so3(np.array([0.0, 0.06, 0.06])), np.array([0.006, 0.0, 0.0]))
    turned = clip.with_hand_at(clip.hand.T_cam_hand @ error)
    result = reconstruct(turned, masks, QUICK)
    assert result.T_cam_hand is not None
    assert len(result.T_cam_hand) == len(clip)
    off = se3.angle_between(result.T_cam_hand[:, :3, :3], clip.hand.T_cam_hand[:, :3, :3])
    given = np.linalg.norm([0.0, 0.06, 0.06])
    assert off.max() < 0.8 * given
    assert off[result.frames_of("fitted")].max() < off[result.frames_of("sampled")].max() + 0.02
    assert result.iou.min() > 0.9


@pytest.mark.slow
def test_a_users_terms_count_in_every_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    """They draw the object's centre a few pixels aside, in the frames that were sampled and in the others."""
    clip, masks = made()
    assert clip.truth is not None
    true = project(clip.K, se3.transform(clip.truth.T_cam_obj, clip.mesh.centre[None]))

    def aside(problem: Problem) -> Energy:
        crops, at = problem.observation.crops, clip.index_of(problem.clip.frames)
        target = (true[at] + np.array([ASIDE, 0.0]) - crops.corner[:, None]) * crops.zoom
        points, K = np.zeros_like(problem.clip.hand.vertices[:, :1]), problem.observation.K
        return lambda level, index: [ReprojectionTerm(points[index], K[index], target[index], 50.0)]

    def fit(problem: Problem, on_stage: OnStage) -> MethodResult:
        return soft_hinge(problem, on_stage, more=aside)

    monkeypatch.setitem(METHODS, "aside", Method("aside", fit))
    result = reconstruct(clip, masks, replace(QUICK, method="aside"))
    T_cam_obj = clip.with_hand_at(result.T_cam_hand).hand.T_cam_hand @ result.T_hand_obj
    moved = project(clip.K, se3.transform(T_cam_obj, result.scale * clip.mesh.centre[None])) - true
    fitted = [n for n, kind in enumerate(result.frame_kind) if kind == "fitted"]
    assert len(fitted) == len(clip) - len(HIDDEN) - QUICK.frames
    assert moved[fitted, 0, 0].min() > 0.7 * ASIDE


@pytest.mark.slow
def test_where_the_mesh_does_not_meet_the_masks_the_other_frames_follow_their_neighbours(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A cup in place of the mug: each mask alone would tell a pose of its own."""
    clip, masks = scene("mug", 2, LONGER)
    wrong = replace(clip, mesh=scene("glass", 2, LONGER)[0].mesh)
    options = replace(QUICK, mesh="as-given")

    def bent() -> tuple[float, Reconstruction]:
        result = reconstruct(wrong, masks, options)
        R = result.T_hand_obj[:, :3, :3]
        turns = R[1:] @ np.swapaxes(R[:-1], 1, 2)
        return float(se3.angle_between(turns[1:], turns[:-1]).mean()), result

    smooth, followed = bent()
    monkeypatch.setattr(remaining_frames, "BENDING_WEIGHT", 0.0)
    rough, alone = bent()
    sampled = alone.frames_of("sampled")
    np.testing.assert_array_equal(followed.T_hand_obj[sampled], alone.T_hand_obj[sampled])
    assert smooth < 0.9 * rough
    assert followed.iou.mean() > alone.iou.mean() - 0.02
