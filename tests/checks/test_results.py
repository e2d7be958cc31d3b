"""Checks of results: masks that agree with each other against rough ones, frames that fit less, regrasps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from jaxtyping import Float
from numpy import ndarray

from getagrip.batch.clips import _Tally
from getagrip.batch.job import Outcome
from getagrip.batch.scheduling import BatchOptions, KeepOptions
from getagrip.checks import RESULT_CHECKS, Evidence, run_checks
from getagrip.checks.results import MIN_REGRASP_FRAMES, describe_largest_step, object_steps, regrasp_jump
from getagrip.clip import Clip, Masks
from getagrip.errors import UsageError
from getagrip.fitting.stages.robust_masks import image_iou
from getagrip.geometry import se3
from getagrip.provenance import assumed
from getagrip.result.findings import Finding, Probability
from getagrip.synthetic.noise import Noise, perturbed
from helpers.scenes import SMALL, scene

SERIOUS = {"large-mask-misfit", "poor-mask-fit"}


def found(clip: Clip, masks: Masks, away: float = 0.0, misfit: float = np.nan) -> dict[str, Finding]:
    """Of the true poses, moved sideways by ``away`` [m]."""
    T_cam_obj = clip.truth.T_cam_obj.copy()
    T_cam_obj[:, 0, 3] += away
    T = se3.inverse(clip.hand.T_cam_hand) @ T_cam_obj
    iou = image_iou(clip, masks, T, clip.truth.scale)
    result = Evidence(clip, masks, T, clip.truth.scale, iou, misfit=misfit)
    checks = [check for check in RESULT_CHECKS.values() if "mask-" in check.name]
    return {finding.check: finding for finding in run_checks(checks, result)[1]}


@pytest.mark.parametrize("category", ["mug", "bottle", "can"])
def test_right_results_are_not_serious_whatever_the_noise_of_masks(category: str) -> None:
    clip, masks = scene(category, 2, SMALL)
    assert found(clip, masks, misfit=0.7) == {}
    for px in (1.0, 2.0, 4.0):
        rough = perturbed(clip, masks, Noise(mask_ragged_px=px), 1)[1]
        assert not SERIOUS & {*found(clip, rough, misfit=8.0)}


@pytest.mark.parametrize("category", ["mug", "bottle", "can"])
def test_contours_off_masks_that_agree_are_serious_and_the_hand_is_named(category: str) -> None:
    clip, masks = scene(category, 2, SMALL)
    findings = found(clip, masks, away=0.008, misfit=8.0)
    assert findings.keys() == SERIOUS
    for finding in findings.values():
        assert finding.serious
        assert "the hand's pose" in finding.message
    assert "the hand's pose" in found(clip, masks, misfit=4.0)["mask-misfit"].message


def test_a_built_in_shape_may_be_farther_off() -> None:
    """It is hardly the object's own, so contours say nothing of the pose; a low IOU does."""
    clip, masks = scene("mug", 2, SMALL)
    built_in = replace(clip, provenance={"mesh": assumed("a built-in shape")})
    for away, misfit, own, its in ((0.005, 8.0, SERIOUS, set()), (0.008, 10.0, SERIOUS, {"poor-mask-fit"})):
        assert own <= {*found(clip, masks, away, misfit)}
        assert its == SERIOUS & {*found(built_in, masks, away, misfit)}
    limits = [found(each, masks, 0.008, 10.0)["poor-mask-fit"] for each in (clip, built_in)]
    assert [one.limit for one in limits] == [0.9, 0.85]
    assert "(usual: at least 0.85)" in limits[1].message


def test_a_low_overlap_with_near_contours_is_that_of_a_small_object() -> None:
    clip, masks = scene("mug", 2, SMALL)
    assert found(clip, masks, away=0.008, misfit=1.0) == {}


@pytest.mark.parametrize(
    ("right", "least", "passes"),
    [(0.4, 0.5, False), (0.6, 0.5, True), (0.6, 0.7, False), (0.0, 0.0, True), (None, 1.0, True)],
)
def test_strict_asks_for_a_probability_where_there_is_one(right: float | None, least: float, passes: bool) -> None:
    tally = _Tally()
    tally.add(
        Outcome("a", "done", "", probability_right=None if right is None else Probability(right, "right")),
        KeepOptions(),
    )
    assert tally.passes(least) == passes


@pytest.mark.parametrize("least", [-0.1, 1.1, float("nan")])
def test_a_least_probability_is_a_probability(least: float) -> None:
    with pytest.raises(UsageError, match="--min-probability"):
        BatchOptions(min_probability=least)


def test_frames_in_a_row_that_are_met_less_than_the_others_are_named() -> None:
    clip, masks = scene("mug", 2, SMALL)
    usual = np.full(len(clip), 0.95)

    def findings(iou: Float[ndarray, "n"], frames: tuple[str, ...] | None = None) -> tuple[Finding, ...]:
        return run_checks([RESULT_CHECKS["uneven-mask-fit"]], Evidence(clip, masks, iou=iou, iou_frames=frames))[1]

    alone, some, unseen = usual.copy(), usual.copy(), usual.copy()
    alone[[0, 3, -1]], some[2:5], unseen[:4] = 0.5, (0.8, 0.7, 0.8), np.nan
    for even in (usual, 0.5 * usual, alone, unseen, np.full(len(clip), np.nan)):
        assert findings(even) == ()
    for uneven in (some, 0.5 * some):
        (one,) = findings(uneven)
        assert f"from frame {clip.frames[2]} to {clip.frames[4]} " in one.message
        assert one.value == pytest.approx(0.8 / 0.95)
        assert not one.serious
    (one,) = findings(np.repeat(some, 2), tuple(f"every-{n}" for n in range(2 * len(clip))))
    assert "from frame every-4 to every-9 " in one.message  # of more frames than those that were fitted together


CHECK = [check for check in RESULT_CHECKS.values() if check.name == "regrasp"]


def in_hand(T_hand_obj: ndarray) -> Evidence:
    clip, masks = scene("mug", 0)
    index = np.arange(len(T_hand_obj)) % len(clip)
    return Evidence(clip.take(index), masks.take(index), T_hand_obj)


def turning(by: ndarray) -> ndarray:
    """Turned by so many degrees."""
    return se3.rigid(se3.exp_so3(np.radians(by)[:, None] * [0.0, 0.0, 1.0]), np.zeros(3))


def test_an_object_that_is_held_still_does_not_move() -> None:
    it = in_hand(turning(np.zeros(20)))
    assert np.allclose(object_steps(it), 0.0)
    assert regrasp_jump(it) == 0.0


@pytest.mark.parametrize("degrees", [30.0, 200.0])
def test_an_object_that_turns_evenly_does_not_jump(degrees: float) -> None:
    assert regrasp_jump(in_hand(turning(np.linspace(0.0, degrees, 20)))) == 0.0


def test_an_object_that_turns_to_and_fro_does_not_jump() -> None:
    assert regrasp_jump(in_hand(turning(30.0 * np.sin(np.linspace(0.0, 9.0, 30))))) == 0.0


def test_a_regrasp_is_found_where_it_is_and_named() -> None:
    it = in_hand(turning(np.linspace(0.0, 20.0, 8) + np.where(np.arange(8) < 5, 0.0, 60.0)))
    assert int(np.argmax(object_steps(it))) == 4
    (finding,) = run_checks(CHECK, it)[1]
    assert not finding.serious
    assert describe_largest_step(it) == f"from frame {it.clip.frames[4]} to {it.clip.frames[5]}"
    assert describe_largest_step(it) in finding.message


def test_its_size_counts_in_diameters() -> None:
    T = turning(np.zeros(10))
    T[5:, 0, 3] = 0.3 * in_hand(T).clip.mesh.diameter
    assert regrasp_jump(in_hand(T)) == pytest.approx(0.3)


def test_few_frames_tell_nothing() -> None:
    assert np.isnan(regrasp_jump(in_hand(turning(np.zeros(MIN_REGRASP_FRAMES - 1)))))
