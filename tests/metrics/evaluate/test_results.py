"""Results against clips: the laws of all metrics together, and clear errors."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from getagrip.clip import Clip, Masks, input_sha256, write_clip
from getagrip.errors import InputError
from getagrip.geometry import mesh as meshes
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files import write_mesh
from getagrip.io import files
from getagrip.metrics import evaluate as ev
from getagrip.metrics.contact import CONTACT_DEFINITIONS, CONTACT_SIDES, ContactDefinition
from getagrip.metrics.evaluate import evaluate
from getagrip.metrics.evaluate.metric import ADD_MM, IOU, METRICS, SCA
from getagrip.report.pictures.result_view import View
from getagrip.result import SegmentResult, write_result
from getagrip.synthetic import objects
from helpers.scenes import FRAMES, by_other_hand, perfect, same, timeline, written

CAM = {"add_success": "add_cam_success", "add_sym_mm": "add_sym_cam_mm", "add_sym_success": "add_sym_cam_success"}
"""Metrics of the object in the hand, and the same in the camera."""
IN_BOTH = [metric for metric in METRICS.values() if metric.name in {*CAM, *CAM.values()}]


@pytest.mark.slow
def test_a_perfect_result(scene: tuple[Clip, Masks]) -> None:
    out = ev.evaluate(perfect(scene[0]), *scene)
    metrics = out.metrics
    assert metrics["iou_full"] == 1.0
    assert metrics["iou"] > 0.96
    assert metrics["add_mm"] == pytest.approx(0.0, abs=1e-9)
    assert metrics["add_success"] == metrics["add_sym_success"] == metrics["add_frame_success"] == 1.0
    for side in CONTACT_SIDES:
        for mm in (0, 5, 10):
            key = f"{side}_{mm}mm"
            assert 0.0 < metrics[f"sca_{key}"] < 1.0
            for other in ("truth_sca", "sca_add", "sca_add_sym", "sca_iou_80", "sca_iou_60"):
                assert metrics[f"{other}_{key}"] == pytest.approx(metrics[f"sca_{key}"], abs=1e-12)
            assert metrics[f"sca_diagonal_{key}"] > metrics[f"sca_{key}"]
    assert metrics["truth_penetration_hand_mm"] == metrics["penetration_hand_mm"] > 0.0
    assert out.symmetry == "none"
    assert all(len(values) == FRAMES for values in out.per_frame.values())


def test_means_are_means_of_the_frames(scene: tuple[Clip, Masks]) -> None:
    result = perfect(scene[0])
    off = se3.rigid(t=np.linspace(0.0, 0.03, FRAMES)[:, None] * [1.0, 0.0, 0.0])
    out = ev.evaluate(replace(result, T_hand_obj=off @ result.T_hand_obj), *scene)
    for key in ("iou", "iou_full", "iou_soft", "add_mm", "rotation_deg", "translation_mm", "penetration_object_mm"):
        assert out.metrics[key] == pytest.approx(np.mean(out.per_frame[key]))
    assert out.metrics["add_mm"] == pytest.approx(15.0)
    assert out.metrics["add_success"] == 0.0
    assert out.metrics["add_frame_success"] == pytest.approx(2 / 5)
    assert out.metrics["sca_add_object_5mm"] == 0.0


def test_only_what_is_wanted_is_computed(scene: tuple[Clip, Masks]) -> None:
    clip, masks = scene
    every = ev.evaluate(perfect(clip), clip, masks)
    some = ev.evaluate(perfect(clip), clip, masks, wanted=[IOU, ADD_MM])
    for part in ("metrics", "per_frame"):
        assert getattr(some, part) == {key: getattr(every, part)[key] for key in ("iou", "add_mm")}


@pytest.mark.slow
def test_very_large_meshes_are_measured_with_fewer_faces(
    scene: tuple[Clip, Masks], monkeypatch: pytest.MonkeyPatch
) -> None:
    clip, masks = scene
    faces = len(clip.mesh.faces)
    monkeypatch.setattr(meshes, "MAX_MESH_FACES", faces)
    assert not ev.evaluate(perfect(clip), clip, masks, wanted=[]).notes
    monkeypatch.setattr(meshes, "MAX_MESH_FACES", faces // 2)
    heavy = replace(clip, mesh=Mesh(clip.mesh.vertices, clip.mesh.faces))
    out = ev.evaluate(perfect(clip), heavy, masks, wanted=[IOU, ADD_MM])
    (note,) = out.notes
    assert note == f"the mesh of {faces} faces was measured with {len(heavy.mesh.light.faces)}"
    assert len(heavy.mesh.light.faces) < faces
    assert View.of(perfect(clip), heavy, masks).clip.mesh is heavy.mesh.light
    assert out.metrics["add_mm"] == pytest.approx(0.0, abs=1e-9)
    assert out.metrics["iou"] > 0.85


def test_nothing_but_masks_depends_on_where_the_camera_stands(scene: tuple[Clip, Masks]) -> None:
    clip, _ = scene
    G = se3.rigid(se3.exp_so3(np.array([0.3, -1.0, 2.0])), np.array([0.1, 0.2, 0.3]))
    hand = replace(clip.hand, T_cam_hand=G @ clip.hand.T_cam_hand)
    truth = replace(clip.truth, T_cam_hand=G @ clip.truth.T_cam_hand, T_cam_obj=G @ clip.truth.T_cam_obj)
    off = replace(perfect(clip), T_hand_obj=perfect(clip).T_hand_obj @ se3.rigid(t=np.array([0.0, 0.01, 0.0])))
    here, there = ev.evaluate(off, clip, None), ev.evaluate(off, replace(clip, hand=hand, truth=truth), None)
    for name in ("mspd_cam_recall", "ar_of_two_cam"):  # of pixels, as masks
        assert here.metrics.pop(name) < 1.0
        del there.metrics[name]
    same(here.metrics, there.metrics)
    assert "iou" not in here.metrics


def test_the_hand_that_was_given_and_the_true_one_are_kept_apart(scene: tuple[Clip, Masks]) -> None:
    """The object is judged in the frame of the hand that was given, the truth in that of the true hand."""
    clip, _ = scene
    off = replace(clip.hand, T_cam_hand=clip.hand.T_cam_hand @ se3.rigid(t=np.array([0.01, 0.0, 0.0])))
    in_hand = [metric for metric in METRICS.values() if "_cam" not in metric.name]
    metrics = ev.evaluate(perfect(clip), replace(clip, hand=off), None, wanted=in_hand).metrics
    same(metrics, ev.evaluate(perfect(clip), clip, None, wanted=in_hand).metrics)


def test_the_object_in_the_camera_is_judged_apart_from_the_hand(scene: tuple[Clip, Masks]) -> None:
    """A hand that is off does not make an object wrong that is right in the camera; nor the other way round."""
    clip, _ = scene
    off = se3.rigid(se3.exp_so3(np.array([0.2, 0.0, 0.1])), np.array([0.02, 0.0, 0.03]))
    hand = clip.hand.T_cam_hand @ off
    found = replace(perfect(clip), T_hand_obj=se3.inverse(off) @ perfect(clip).T_hand_obj)
    for result, given in (
        (found, replace(clip, hand=replace(clip.hand, T_cam_hand=hand))),
        (replace(found, T_cam_hand=hand), clip),
    ):
        metrics = ev.evaluate(result, given, None, wanted=IN_BOTH).metrics
        assert metrics["add_cam_success"] == metrics["add_sym_cam_success"] == 1.0
        assert metrics["add_sym_cam_mm"] == pytest.approx(0.0, abs=1e-9)
        assert metrics["add_success"] == metrics["add_sym_success"] == 0.0
    metrics = ev.evaluate(replace(perfect(clip), T_cam_hand=hand), clip, None, wanted=IN_BOTH).metrics
    assert metrics["add_success"] == 1.0
    assert metrics["add_sym_cam_mm"] > 20.0


def test_with_the_true_hand_hand_and_camera_agree(scene: tuple[Clip, Masks]) -> None:
    """Exactly, as nothing is computed twice; and up to rounding, where the hand is the true one only nearly."""
    clip, _ = scene
    off = replace(
        perfect(clip), T_hand_obj=perfect(clip).T_hand_obj @ se3.rigid(se3.exp_so3(np.array([0.0, 0.1, 0.4])))
    )
    nearly = se3.rigid(t=np.array([0.0, 0.0, 1e-12]))
    for result in (off, replace(off, T_cam_hand=clip.hand.T_cam_hand @ nearly)):
        metrics = ev.evaluate(result, clip, None, wanted=IN_BOTH).metrics
        assert metrics["add_sym_mm"] > 1.0
        for key in ("add_success", "add_sym_mm", "add_sym_success"):
            assert metrics[key] == pytest.approx(metrics[CAM[key]], abs=1e-6)


def test_scale_is_judged_where_it_is_free(scene: tuple[Clip, Masks]) -> None:
    clip, masks = scene
    assert "scale_error" not in ev.evaluate(perfect(clip), clip, masks).metrics
    large = replace(perfect(clip), scale=1.1)
    metrics = ev.evaluate(large, replace(clip, scale="free"), masks).metrics
    assert metrics["scale_error"] == pytest.approx(0.1)
    assert metrics["iou_full"] < 0.95


@pytest.mark.slow
def test_folders_give_what_memory_gives(scene: tuple[Clip, Masks], tmp_path: Path) -> None:
    clip, result = written(scene, tmp_path)
    expected = ev.evaluate(perfect(scene[0]), *scene).metrics
    for clips in (None, clip, clip.parent):
        same(ev.evaluate_result(result, clips).metrics, expected, 1e-4)


@pytest.mark.slow
def test_a_moved_clip_is_found_beside_its_result(scene: tuple[Clip, Masks], tmp_path: Path) -> None:
    clip, result = written(scene, tmp_path)
    clip.rename(tmp_path / "elsewhere")
    with pytest.raises(InputError, match="--clips"):
        ev.evaluate_result(result)
    assert ev.evaluate_result(result, tmp_path / "elsewhere").metrics["iou_full"] == 1.0
    result = result.rename(tmp_path / "result")
    (tmp_path / "elsewhere").rename(tmp_path / scene[0].name)
    assert ev.evaluate_result(result).metrics["iou_full"] == 1.0


def test_some_frames_of_a_clip(scene: tuple[Clip, Masks], tmp_path: Path) -> None:
    clip = write_clip(*scene, tmp_path / scene[0].name)
    some = perfect(scene[0].take(np.array([1, 3])))
    folder = write_result(some, tmp_path / "result", input_sha256(clip))
    out = ev.evaluate_result(folder)
    assert out.frames == ["000001", "000003"]
    assert out.metrics["iou_full"] == 1.0
    assert out.metrics["add_mm"] == pytest.approx(0.0, abs=1e-3)
    one = write_result(perfect(scene[0].take(np.array([2]))), tmp_path / "one", input_sha256(clip))
    assert np.isnan(ev.evaluate_result(one).metrics["sca_object_0mm"])


def test_the_fitted_frames_of_a_result_score_as_by_themselves(scene: tuple[Clip, Masks]) -> None:
    result, fitted = perfect(scene[0]), np.array([0, 1, 3])
    kinds = ["sampled" if n in fitted else "interpolated" for n in range(FRAMES)]
    off = se3.rigid(t=np.linspace(0.0, 0.01, FRAMES)[:, None] * [1.0, 0.0, 0.0])
    result = replace(result, T_hand_obj=off @ result.T_hand_obj, frame_kind=tuple(kinds))
    alone = replace(
        result, T_hand_obj=result.T_hand_obj[fitted], frames=tuple(result.frames[n] for n in fitted),
        frame_kind=("sampled",) * len(fitted), iou=result.iou[fitted],
    )  # fmt: skip
    found, expected = ev.evaluate(result, *scene).metrics_of_fitted, ev.evaluate(alone, *scene).metrics
    assert found.keys() == expected.keys()
    for key, value in expected.items():
        assert found[key] == pytest.approx(value, nan_ok=True), key


@pytest.mark.slow
def test_without_truth_or_masks(scene: tuple[Clip, Masks], tmp_path: Path) -> None:
    clip, masks = scene
    bare = write_clip(replace(clip, truth=None), masks, tmp_path / clip.name)
    result = write_result(perfect(clip), tmp_path / "result", input_sha256(bare))
    metrics = ev.evaluate_result(result).metrics
    assert {"iou", "iou_full", "sca_object_0mm", "sca_iou_80_hand_5mm"} <= metrics.keys()
    assert not any("add" in key or "truth" in key for key in metrics)
    unseen = write_clip(clip, None, tmp_path / "unseen" / clip.name)
    result = write_result(perfect(clip), tmp_path / "unseen" / "result", input_sha256(unseen))
    metrics = ev.evaluate_result(result).metrics
    assert {"add_mm", "truth_sca_object_0mm"} <= metrics.keys()
    assert not any("iou" in key for key in metrics)


def test_errors_name_what_does_not_fit(scene: tuple[Clip, Masks], tmp_path: Path) -> None:
    clip, result = written(scene, tmp_path)
    with pytest.raises(InputError, match="no such folder"):
        ev.evaluate_result(tmp_path / "nothing")
    unknown = replace(perfect(scene[0]), frames=(*scene[0].frames[:-1], "000099"))
    folder = write_result(unknown, tmp_path / "unknown", input_sha256(clip), clip_folder=clip)
    with pytest.raises(InputError, match=r"frames must be frames of the clip.*got the frame '000099'"):
        ev.evaluate_result(folder)
    folder = write_result(perfect(scene[0], "other"), tmp_path / "other", input_sha256(clip), clip_folder=clip)
    with pytest.raises(InputError, match=r"name must be 'other'.*got 'egg-and-mug'"):
        ev.evaluate_result(folder)
    write_mesh(objects.cup(), clip / "object.obj")
    with pytest.raises(InputError, match=r"input_sha256 must be .*reconstruct it again"):
        ev.evaluate_result(result)


def test_summary_means_over_the_clips_that_have_a_number() -> None:
    metrics = [{"iou": 0.5, "add_mm": 3.0}, {"iou": 1.0}, {"iou": np.nan}]
    evaluations = [
        ev.Evaluation(clip="c", category="mug", method=m, frames=[], symmetry=None, metrics=k, per_frame={})
        for m, k in zip(("a", "b", "a"), metrics, strict=True)
    ]
    out = ev.summary(evaluations)
    assert out["mean"] == {"iou": 0.75, "add_mm": 3.0}
    assert out["clips"] == {"iou": 2, "add_mm": 1}
    assert out["samples"] == [evaluation.fields() for evaluation in evaluations]
    assert out["methods"]["a"] == {"mean": {"iou": 0.5, "add_mm": 3.0}, "clips": {"iou": 1, "add_mm": 1}}


def test_tables_fit_a_terminal_and_json_holds_what_they_show(scene: tuple[Clip, Masks], tmp_path: Path) -> None:
    from rich.console import Console

    clip, masks = scene
    samples = [ev.evaluate(perfect(clip), clip, masks), ev.evaluate(perfect(clip), replace(clip, truth=None), masks)]
    console = Console(width=80, record=True, file=io.StringIO())
    for table in (ev.results_table(samples), *ev.contact_tables(samples)):
        console.print(table)
    text = console.export_text()
    assert "mean of 2" in text
    assert "sym, rot: errors up to symmetries" in " ".join(text.split())
    assert "scale:" not in text
    assert "…" not in text
    assert f"{100 * samples[0].metrics['sca_object_10mm']:.1f}" in text
    files.write_json(tmp_path / "out.json", ev.summary(samples))
    assert json.loads((tmp_path / "out.json").read_text())["samples"][0]["metrics"]["iou_full"] == 1.0


def test_every_number_stands_in_the_table_once(scene: tuple[Clip, Masks]) -> None:
    keys = [
        metric.key(d) for metric in METRICS.values() for d in CONTACT_DEFINITIONS[: None if metric.by_contact else 1]
    ]
    assert len(set(keys)) == len(keys)
    out = ev.evaluate(perfect(scene[0]), *scene)
    assert {*out.metrics, *out.per_frame} <= {*keys}


@pytest.mark.slow
def test_the_table_says_which_numbers_need_ground_truth(scene: tuple[Clip, Masks]) -> None:
    clip, masks = scene
    known, blind = (
        {key for numbers in (made.metrics, made.per_frame) for key in numbers}
        for made in (ev.evaluate(perfect(clip), of, masks) for of in (clip, replace(clip, truth=None)))
    )
    needing = {metric.key(d) for metric in METRICS.values() for d in CONTACT_DEFINITIONS if metric.needs_truth}
    assert known - blind == known & needing
    assert blind == known - needing


ANY = SegmentResult(state="grasp", first="0", last="1")
CONTACT = ContactDefinition("object", 0.010)


def test_a_grasp_in_a_timeline_counts_as_by_itself() -> None:
    clip, _ = timeline()
    result = replace(perfect(clip), segments=(ANY,))
    rows = clip.segments[2].rows
    whole = evaluate(result, clip, None, [CONTACT], [SCA])
    alone = evaluate(replace(result.take(rows), segments=()), clip, None, [CONTACT], [SCA])
    assert whole.metrics_of_grasps == pytest.approx(alone.metrics)
    assert whole.metrics[SCA.key(CONTACT)] < 0.5 * alone.metrics[SCA.key(CONTACT)]


def test_a_grasp_of_the_other_hand_is_measured_with_it() -> None:
    (own, _), (other, _) = timeline(), by_other_hand()
    known = own.segments[2].rows[other.hand_known("right")[own.segments[2].rows]]
    expected = evaluate(replace(perfect(own).take(known), segments=()), own, None, [CONTACT], [SCA]).metrics
    whole = evaluate(replace(perfect(other), segments=(ANY,)), other, None, [CONTACT], [SCA])
    assert whole.metrics_of_grasps == pytest.approx(expected) != whole.metrics
