"""Several cameras: what one leaves open another shows; a wrong one is named and left out."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy import ndarray

from getagrip.bench.inputs.added_views import AddedViews
from getagrip.bench.inputs.perturbations import UNCHANGED, EstimatedHands
from getagrip.checks import RESULT_CHECKS, Evidence, run_checks
from getagrip.clip import Clip, Masks, Segment, read_clip, with_masks, write_clip
from getagrip.clip.views import View, from_best_view, views_of, with_views
from getagrip.fitting.evidence.epipolar import contradicting_views
from getagrip.fitting.evidence.views import FurtherViews
from getagrip.fitting.hand.refine_hand import refine_hand
from getagrip.fitting.options import Options
from getagrip.fitting.problem import MethodResult, Problem
from getagrip.fitting.stages import view_agreement
from getagrip.fitting.stages.confidence import probability_right, uncalibrated_reason
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.reconstruct import reconstruct
from getagrip.result import Reconstruction
from getagrip.synthetic.noise import NOISE_PRESETS
from getagrip.synthetic.scene_options import SceneOptions
from helpers.scenes import DEFAULT, SMALL, scene, scores

ESTIMATED = EstimatedHands(replace(NOISE_PRESETS["estimated"], mask_ragged_px=0.0))


def estimated(views: int, kind: str = "kettle") -> tuple[Clip, Masks]:
    return AddedViews(views, ESTIMATED)(*scene(kind, 1), 0)


def error_in_camera(result: Reconstruction, clip: Clip) -> float:
    """Mean distance of the posed object from the truth [m]."""
    assert clip.truth is not None
    assert result.T_cam_hand is not None
    posed = se3.transform(result.T_cam_hand @ result.T_hand_obj, result.scale * clip.mesh.vertices)
    true = se3.transform(clip.truth.T_cam_obj, clip.truth.scale * clip.mesh.vertices)
    return float(np.linalg.norm(posed - true, axis=-1).mean())


def hand_error(clip: Clip, T_cam_hand: ndarray) -> float:
    assert clip.truth is not None
    found, true = (se3.transform(T, clip.hand.vertices) for T in (T_cam_hand, clip.truth.T_cam_hand))
    return float(np.linalg.norm(found - true, axis=-1).mean())


@pytest.mark.slow
def test_a_second_view_shows_the_distance() -> None:
    errors = [error_in_camera(reconstruct(*clip, DEFAULT), clip[0]) for clip in map(estimated, (1, 2))]
    assert errors[1] < 0.002
    assert errors[1] < 0.4 * errors[0]


def test_two_views_bring_an_estimated_hand_home() -> None:
    """A single silhouette says little about the hand's distance."""
    errors = []
    for views in (1, 2):
        clip, masks = estimated(views)
        refined = refine_hand(clip, masks)[0]
        assert refined is not None
        errors.append(hand_error(clip, refined.T_cam_hand))
    assert errors[1] < 0.5 * errors[0]


@pytest.mark.slow
def test_the_order_of_views_does_not_matter() -> None:
    clip, masks = AddedViews(3, UNCHANGED)(*scene("spoon", 1), 0)
    turned = with_views(clip, views_of(clip)[::-1])
    one, other = (reconstruct(each, masks, DEFAULT) for each in (clip, turned))
    np.testing.assert_allclose(one.T_hand_obj, other.T_hand_obj, atol=2e-4)


@pytest.mark.slow
def test_views_from_files_are_those_in_memory(tmp_path: Path) -> None:
    clip, masks = AddedViews(2, UNCHANGED)(*scene("kettle", 1), 0)
    write_clip(clip, masks, tmp_path / "clip")
    one, other = reconstruct(clip, masks, DEFAULT), reconstruct(read_clip(tmp_path / "clip"), None, DEFAULT)
    np.testing.assert_allclose(one.T_hand_obj, other.T_hand_obj, atol=0.01)  # files of meshes round


def test_the_probability_knows_the_number_of_views() -> None:
    found = reconstruct(*AddedViews(2, UNCHANGED)(*scene("spoon", 1), 0), Options(every_frame=False))
    assert found.signs["views"] == 2.0
    assert found.probability_right is not None
    alone = {name: value for name, value in found.signs.items() if name != "views"}
    single = probability_right(Options(), alone, found.findings)
    assert single is not None
    assert single.value < found.probability_right.value < 1.0


def mirrored(view: View) -> View:
    masks = Masks(*(np.ascontiguousarray(np.asarray(m)[:, :, ::-1]) for m in (view.masks.object, view.masks.ignore)))
    return replace(view, masks=masks)


def turned(view: View) -> View:
    aside = se3.rigid(se3.exp_so3(np.radians([10.0, 0.0, 0.0])), np.zeros(3))
    return replace(view, T_cam_view=view.T_cam_view @ aside)


def zoomed(view: View) -> View:
    return replace(view, K=view.K * np.array([1.4, 1.4, 1.0])[:, None] * [1, 1, 1] + 0.0 * view.K)


def of_another_scene(view: View) -> View:
    other = AddedViews(2, UNCHANGED)(*scene("bottle", 3), 0)[0]
    masks = views_of(other)[0].masks
    away = np.roll(np.asarray(masks.object), 60, axis=1), np.roll(np.asarray(masks.ignore), 60, axis=1)
    return replace(view, masks=Masks(*away))


@pytest.mark.parametrize("wrong", [mirrored, turned, of_another_scene])
def test_masks_of_a_wrong_camera_contradict_by_geometry_alone(wrong: object) -> None:
    clip, masks = AddedViews(3, UNCHANGED)(*scene("kettle", 1), 0)
    assert contradicting_views(clip, masks) == {}
    first, second = views_of(clip)
    found = contradicting_views(with_views(clip, [wrong(first), second]), masks)  # type: ignore[operator]
    assert [*found] == [first.name]


def test_a_view_of_few_frames_is_compared_in_these() -> None:
    clip, masks = AddedViews(2, UNCHANGED)(*scene("kettle", 1, SceneOptions(frames=26)), 0)
    view = turned(views_of(clip)[0])
    rare = np.isin(np.arange(len(clip)), [3, 6])[:, None, None]
    few = replace(view, masks=Masks(np.asarray(view.masks.object) & rare, np.asarray(view.masks.ignore) | ~rare))
    assert [*contradicting_views(with_views(clip, [few]), masks)] == [view.name]


@pytest.mark.slow
def test_a_fitted_mesh_is_not_deformed_again_to_look_for_suspect_views(monkeypatch: pytest.MonkeyPatch) -> None:
    clip, masks = AddedViews(2, UNCHANGED)(*scene("mug", 0), 0)
    mesh = Mesh(clip.mesh.vertices * [1.15, 1.15, 1.0], clip.mesh.faces)
    seen = list[Mesh]()
    module = sys.modules["getagrip.reconstruct"]

    def suspect(problem: Problem, found: MethodResult) -> None:
        monkeypatch.setattr(
            view_agreement, "image_iou", lambda posed, *_: seen.append(posed.mesh) or np.ones(len(posed))
        )
        view_agreement.suspect_view(problem, found)

    monkeypatch.setattr(module, "suspect_view", suspect)
    stretched = replace(clip, mesh=mesh, truth=None)
    result = reconstruct(stretched, masks, Options(inits=6, every_frame=False))
    assert result.warp is not None
    assert len(seen) == 1
    np.testing.assert_allclose(seen[0].vertices, result.warp(mesh).vertices, atol=1e-9)


def test_a_timeline_is_fitted_from_its_own_camera() -> None:
    clip, masks = AddedViews(2, UNCHANGED)(*scene("spoon", 1, SMALL), 0)
    nothing = Masks(np.zeros_like(np.asarray(masks.object)), np.ones_like(np.asarray(masks.object)))
    hidden = with_masks(clip, nothing)
    assert from_best_view(hidden)[1] is not None
    grasp = Segment("grasp", 0, len(clip) - 1, clip.side)
    assert from_best_view(replace(hidden, segments=(grasp,)))[1] is None


def test_no_view_counts_in_the_papers_method_nor_in_the_reason_for_no_probability() -> None:
    clip, masks = AddedViews(2, UNCHANGED)(*scene("spoon", 1, SMALL), 0)
    found = reconstruct(clip, masks, Options(method="paper", inits=2, every_frame=False))
    assert not [name for name in found.energy if ":" in name]
    assert uncalibrated_reason(Options(), (), ("mask", "mask:view2")) == ""


@pytest.mark.slow
def test_a_view_that_the_fit_cannot_meet_is_left_out_and_named() -> None:
    """A camera turned about its vertical axis keeps to the epipolar planes of one beside it."""
    clip, masks = AddedViews(2, UNCHANGED)(*scene("kettle", 1), 0)
    (view,) = views_of(clip)
    aside = se3.rigid(se3.exp_so3(np.radians([0.0, 4.0, 0.0])), np.zeros(3))
    wrong = with_views(clip, [replace(view, T_cam_view=view.T_cam_view @ aside)])
    assert contradicting_views(wrong, masks) == {}
    alone, found = reconstruct(*scene("kettle", 1), DEFAULT), reconstruct(wrong, masks, DEFAULT)
    assert "view-contradicts" in {finding.check for finding in found.findings}
    assert view.name in next(str(f) for f in found.findings if f.check == "view-contradicts")
    np.testing.assert_allclose(found.T_hand_obj, alone.T_hand_obj, atol=1e-6)


@pytest.mark.slow
def test_a_views_outlier_masks_are_left_out() -> None:
    clip, masks = AddedViews(2, UNCHANGED)(*scene("kettle", 1), 0)
    (view,) = views_of(clip)
    objects = np.asarray(view.masks.object).copy()
    objects[3] = np.roll(objects[3], 40, axis=1)
    bad = with_views(clip, [replace(view, masks=Masks(objects, np.asarray(view.masks.ignore)))])
    good, found = reconstruct(clip, masks, DEFAULT), reconstruct(bad, masks, DEFAULT)
    outliers = [str(f) for f in found.findings if f.check == "view-outliers"]
    assert len(outliers) == 1
    assert clip.frames[3] in outliers[0]
    assert scores(found, clip, masks)["add_sym_mm"] < scores(good, clip, masks)["add_sym_mm"] + 1.0


def test_a_view_without_a_mask_in_these_frames_is_a_note() -> None:
    clip, masks = AddedViews(2, UNCHANGED)(*scene("spoon", 1, SMALL), 0)
    (view,) = views_of(clip)
    nothing = np.zeros_like(np.asarray(view.masks.object))
    late = with_views(clip, [replace(view, masks=Masks(nothing, ~nothing))])
    assert contradicting_views(late, masks) == {}
    findings = run_checks(FurtherViews.result_checks, Evidence(late, masks))[1]
    assert [(f.check, f.serious) for f in findings] == [("view-unseen", False)]


def test_masks_of_several_views_may_be_met_less() -> None:
    clip, masks = AddedViews(2, UNCHANGED)(*scene("spoon", 1, SMALL), 0)
    (poor,) = (check for check in RESULT_CHECKS.values() if check.name == "poor-mask-fit")
    alone, beside = (Evidence(each, masks) for each in (with_views(clip, []), clip))
    assert (alone.met_less, beside.met_less) == (False, True)
    said = [str(poor.finding(0.8, it)) for it in (alone, beside)]
    assert ["at least 0.9)" in said[0], "at least 0.85)" in said[1]] == [True, True]


def test_cameras_out_of_step_are_a_note() -> None:
    clip, masks = AddedViews(2, UNCHANGED)(*scene("spoon", 1, SMALL), 0)
    (view,) = views_of(clip)
    late = with_views(clip, [replace(view, time_offset=0.4 / clip.fps)])
    findings = run_checks(FurtherViews.result_checks, Evidence(late, masks))[1]
    assert [(f.check, f.serious) for f in findings] == [("view-out-of-step", False)]
    assert "0.4 frames" in str(findings[0])


@pytest.mark.slow
def test_a_clip_whose_own_camera_sees_little_is_fitted_from_the_view_that_sees_most() -> None:
    clip, masks = AddedViews(3, UNCHANGED)(*scene("kettle", 1), 0)
    objects, ignored = np.asarray(masks.object).copy(), np.asarray(masks.ignore).copy()
    objects[1:], ignored[1:] = False, True
    found = reconstruct(clip, Masks(objects, ignored), DEFAULT)
    assert any("fitted from the view view2" in note for note in found.notes)
    assert len(found.frames) == len(clip)
    assert error_in_camera(found, clip) < 0.002
