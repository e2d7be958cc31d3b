"""Laws of whole reconstructions, on small synthetic clips: what is recovered, what a result holds, what is refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from getagrip.clip import FrameMasks, Masks
from getagrip.errors import GetagripError, InputError, UsageError
from getagrip.fitting.options import Options
from getagrip.fitting.pipeline import AMBIGUOUS_ENERGY_RATIO
from getagrip.fitting.stages.robust_masks import image_iou
from getagrip.geometry import se3
from getagrip.reconstruct import reconstruct
from helpers.clips import small_clip
from helpers.scenes import DEFAULT, SHORT, SMALL, found, scene, scores

STILL = replace(SMALL, turn_deg=(0.0, 0.0), residual_deg=0.0, residual_mm=0.0)


# What is recovered


@pytest.mark.parametrize(("category", "seed"), [("mug", 2), ("box", 1), ("spoon", 1), ("kettle", 1)])
@pytest.mark.slow
def test_a_hinged_object_is_recovered(category: str, seed: int) -> None:
    clip, masks = scene(category, seed)
    result = found(category, seed)
    metrics = scores(result, clip, masks)
    assert metrics["add_sym_success"] == 1.0
    assert metrics["add_sym_mm"] < 0.05e3 * clip.mesh.diameter
    assert result.iou.mean() > 0.85
    assert result.scale == 1.0


@pytest.mark.parametrize(("category", "seed"), [("mug", 2), ("box", 1), ("kettle", 1)])
@pytest.mark.slow
def test_an_unknown_scale_is_recovered(category: str, seed: int) -> None:
    options = replace(SMALL, scale="free")
    metrics = scores(found(category, seed, options), *scene(category, seed, options))
    assert metrics["add_sym_success"] == 1.0
    assert abs(metrics["scale_error"]) < 0.05


@pytest.mark.parametrize(("category", "seed"), [("mug", 2), ("box", 1)])
@pytest.mark.slow
def test_the_dynamic_method_recovers_a_free_motion(category: str, seed: int) -> None:
    result = found(category, seed, SMALL, replace(DEFAULT, method="dynamic"))
    assert scores(result, *scene(category, seed))["add_sym_success"] == 1.0
    assert result.axis is None


@pytest.mark.slow
def test_the_static_method_recovers_a_still_object() -> None:
    result = found("mug", 2, STILL, replace(DEFAULT, method="static"))
    metrics = scores(result, *scene("mug", 2, STILL))
    assert metrics["add_success"] == 1.0
    assert metrics["add_mm"] < 5.0
    assert result.axis is None
    np.testing.assert_array_equal(result.T_hand_obj, np.broadcast_to(result.T_hand_obj[0], (8, 4, 4)))


@pytest.mark.slow
def test_a_still_object_is_found_still() -> None:
    result = found("mug", 2, STILL)
    assert scores(result, *scene("mug", 2, STILL))["add_success"] == 1.0
    assert np.ptp(np.degrees(se3.angle_between(result.T_hand_obj[:1, :3, :3], result.T_hand_obj[:, :3, :3]))) < 5.0


@pytest.mark.slow
def test_noise_on_hands_and_masks_is_borne() -> None:
    noisy = replace(SMALL, hand_jitter_deg=1.0, hand_jitter_mm=2.0, mask_ragged_px=0.7)
    assert scores(found("kettle", 1, noisy), *scene("kettle", 1, noisy))["add_sym_success"] == 1.0


# What a result holds


@pytest.mark.parametrize("method", ["soft-hinge", "one-dof", "static", "dynamic"])
@pytest.mark.slow
def test_what_a_result_holds(method: Any) -> None:
    clip, _ = scene("mug", 2)
    result = found("mug", 2, SMALL, replace(DEFAULT, method=method))
    assert result.clip == clip.name
    assert result.method == method
    assert result.frames == clip.frames
    assert se3.is_rigid(result.T_hand_obj).all()
    assert ((result.iou >= 0.0) & (result.iou <= 1.0)).all()
    c = result.candidates
    np.testing.assert_array_equal(c.T_hand_obj[0], result.T_hand_obj)
    assert c.scale[0] == result.scale
    assert (np.diff(c.energy) >= 0.0).all()
    assert result.energy["total"] == pytest.approx(c.energy[0])
    assert sum(v for k, v in result.energy.items() if k != "total") == pytest.approx(result.energy["total"])
    assert result.ambiguous == (len(c.energy) > 1 and bool(c.energy[1] < AMBIGUOUS_ENERGY_RATIO * c.energy[0]))
    stages = {k: v for k, v in result.seconds.items() if k != "total"}
    assert sum(stages.values()) == pytest.approx(result.seconds["total"])
    assert result.options["method"] == method
    assert result.notes == ()


@pytest.mark.slow
def test_the_axis_describes_the_motion() -> None:
    """Eq. 3: from frame to frame the object turns about the axis by the difference of the angles."""
    result = found("mug", 2, SMALL, replace(DEFAULT, method="one-dof"))
    axis = result.axis
    assert axis is not None
    assert np.linalg.norm(axis.direction) == pytest.approx(1.0)
    assert axis.angle.mean() == pytest.approx(0.0, abs=1e-9)
    turn = se3.rotation_about_line(axis.point[None], axis.direction[None], axis.angle - axis.angle[0])
    np.testing.assert_allclose(turn @ result.T_hand_obj[0], result.T_hand_obj, atol=1e-9)


@pytest.mark.slow
def test_an_axis_through_the_hand() -> None:
    axis = found("mug", 2, SMALL, replace(DEFAULT, axis="hand")).axis
    assert axis is not None
    np.testing.assert_array_equal(axis.point, np.zeros(3))


@pytest.mark.slow
def test_progress_is_reported_after_each_stage() -> None:
    calls: list[tuple[str, float]] = []
    result = reconstruct(*scene("spoon", 1), Options(inits=8), lambda stage, part: calls.append((stage, part)))
    assert [stage for stage, _ in calls] == [k for k in result.seconds if k != "total"]
    assert calls[-1][1] == pytest.approx(1.0)
    assert (np.diff([part for _, part in calls]) > 0).all()


@pytest.mark.slow
def test_frames_are_sampled_linearly() -> None:
    clip, masks = scene("spoon", 1)
    result = reconstruct(clip, masks, Options(inits=8, frames=3))
    assert result.frames_of("sampled").tolist() == [0, 4, 7]
    assert result.T_hand_obj.shape == (8, 4, 4)


@pytest.mark.slow
def test_the_truth_explains_clean_masks() -> None:
    clip, masks = scene("kettle", 1)
    assert clip.truth is not None
    T_hand_obj = se3.inverse(clip.truth.T_cam_hand) @ clip.truth.T_cam_obj
    assert image_iou(clip, masks, T_hand_obj, clip.truth.scale).min() > 0.999  # two rasterisers, one or two pixels


# What is refused


@pytest.mark.parametrize(
    "options", [{"inits": 0}, {"frames": 1}, {"push": -0.1}, {"pull": float("nan")}, {"push": float("inf")}]
)
def test_impossible_options_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(UsageError, match="must be"):
        Options(**options)


def test_no_threads_are_too_few() -> None:
    with pytest.raises(UsageError, match=r"threads must be 1 or more.*got 0"):
        reconstruct(*scene("spoon", 1, SHORT), threads=0)


def test_a_clip_without_a_visible_object_is_refused(refused: Callable[..., str]) -> None:
    clip, masks = small_clip()
    nothing = Masks(np.zeros_like(masks.object), masks.ignore)
    refused(lambda: reconstruct(clip, nothing), "0 of 3", "at least 2")


def test_one_visible_frame_is_refused(refused: Callable[..., str]) -> None:
    clip, masks = small_clip()
    seen = masks.object.copy()
    seen[1:] = False
    with pytest.raises(InputError):
        reconstruct(clip, Masks(seen, masks.ignore))
    refused(lambda: reconstruct(clip, Masks(seen, masks.ignore)), "1 of 3")


@pytest.mark.slow
def test_frames_without_a_visible_object_are_left_out_and_reported() -> None:
    clip, masks = scene("spoon", 1)
    seen = masks.object.copy()
    seen[[2, 5]] = False
    result = reconstruct(clip, Masks(seen, masks.ignore), Options(inits=8))
    assert result.frames == clip.frames
    assert result.frames_of("interpolated").tolist() == [2, 5]
    assert any("2 frames" in note and clip.frames[2] in note for note in result.notes)


@pytest.mark.parametrize("ignored", [True, False])
def test_frames_without_a_mask_are_interpolated(ignored: bool) -> None:
    """They are no evidence that the object is not there, and change nothing in the others."""
    clip, masks = scene("spoon", 1)
    given = masks if ignored else replace(masks, ignore=np.zeros_like(masks.ignore))
    size, gone = clip.size, [2, 5]
    of_frames = [FrameMasks(*each) for each in zip(given.object, given.ignore, strict=True)]
    sparse = Masks.of(FrameMasks.unknown(size) if n in gone else one for n, one in enumerate(of_frames))
    seen = given.object.copy()
    seen[gone] = False
    result, empty = (reconstruct(clip, m, Options(inits=8)) for m in (sparse, Masks(seen, given.ignore)))
    assert result.frames_of("interpolated").tolist() == gone
    np.testing.assert_array_equal(result.T_hand_obj, empty.T_hand_obj)
    assert np.flatnonzero(np.isnan(result.iou)).tolist() == gone
    metrics = scores(result, clip, sparse)
    assert metrics["iou"] == pytest.approx(scores(result, clip, Masks(seen, given.ignore))["iou"])
    assert {finding.check for finding in result.findings} == {finding.check for finding in empty.findings}


def test_an_object_behind_the_camera_is_reported() -> None:
    clip, masks = scene("spoon", 1)
    behind = clip.hand.T_cam_hand.copy()
    behind[:, 2, 3] -= 10.0
    with pytest.raises(GetagripError, match="behind the camera"):
        reconstruct(replace(clip, hand=replace(clip.hand, T_cam_hand=behind)), masks, Options(inits=8))


@pytest.mark.parametrize("inits", [1, 2])
@pytest.mark.slow
def test_few_starts_and_two_frames_will_do(inits: int) -> None:
    clip, masks = scene("spoon", 1)
    index = np.array([0, 7])
    result = reconstruct(clip.take(index), Masks(masks.object[index], masks.ignore[index]), Options(inits=inits))
    assert np.isfinite(result.T_hand_obj).all()
    assert len(result.candidates.energy) >= 1


def test_a_single_visible_pixel_will_do() -> None:
    clip, masks = small_clip()
    seen = np.zeros_like(masks.object)
    seen[:, 12, 16] = True
    result = reconstruct(clip, Masks(seen, np.zeros_like(seen)), Options(inits=4))
    assert np.isfinite(result.T_hand_obj).all()


@pytest.mark.slow
def test_hidden_pixels_may_be_counted_for_an_ablation() -> None:
    with_ignore = found("kettle", 1)
    without = found("kettle", 1, SMALL, replace(DEFAULT, occlusion=False))
    assert without.options["occlusion"] is False
    assert without.energy["mask"] > with_ignore.energy["mask"]


# What it asks of the machine


@pytest.mark.slow
def test_blas_runs_on_one_thread_and_has_its_own_again_after_that() -> None:
    def threads() -> set[int]:
        return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}

    during = set[int]()
    clip, masks = scene("box", 1)
    with threadpool_limits(2, user_api="blas"):
        reconstruct(clip, masks, Options(inits=1), lambda *_: during.update(threads()))
        assert threads() == {2}
    assert during == {1}
