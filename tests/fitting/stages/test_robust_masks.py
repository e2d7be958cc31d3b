"""Outlier masks are left out, in frames that were fitted together and in all others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy import ndarray

from getagrip.bench.inputs.perturbations import displace_mask
from getagrip.clip import with_masks
from getagrip.fitting.energy.mask import SilhouetteMesh
from getagrip.fitting.methods import METHODS
from getagrip.fitting.methods.all_frames import refit_hinge
from getagrip.fitting.motion import PosesInHand
from getagrip.fitting.options import Options
from getagrip.fitting.problem import MethodResult, Problem, prepare_problem
from getagrip.fitting.stages.robust_masks import (
    OUTLIER_AREA_FRACTION,
    OUTLIER_MEDIAN_FACTOR,
    MaskOverlap,
    fit_without_outliers,
    mask_overlap,
    medoid_poses,
    outlier_threshold,
)
from getagrip.geometry import se3
from getagrip.geometry.kernels.silhouette import silhouettes, unpack
from getagrip.reconstruct import reconstruct
from helpers.scenes import SMALL, scene, scores

WRONG = [4, 7]
"""Of 9 frames, 5 of which are fitted together: one that is among them, and one that is not."""


@pytest.mark.parametrize("method", ["soft-hinge", "one-dof"])
@pytest.mark.slow
def test_wrong_masks_are_left_out_and_named(method: str) -> None:
    clip, masks = scene("mug", 2, replace(SMALL, frames=9))
    wrong = masks.object.copy()
    for n in WRONG:
        wrong[n] = displace_mask(masks.object[n], np.array([0.6, -0.8]))
    spoilt = replace(masks, object=wrong)
    options = Options(method=method, inits=4, frames=5)
    result = reconstruct(clip, spoilt, options)
    assert [clip.frames[n] for n in WRONG] == [clip.frames[n] for n in np.flatnonzero(np.isnan(result.iou))]
    assert {result.frame_kind[n] for n in WRONG} == {"interpolated"}
    (message,) = (finding.message for finding in result.findings if finding.check == "outlier-masks")
    names = f"frames {clip.frames[4]}, {clip.frames[7]}"
    assert message == f"2 of 9 masks contradict the others and were left out: {names}; --given-masks uses all"
    assert not any("contradict" in note for note in result.notes)
    assert result.checks["outlier-masks"] == pytest.approx(2 / 9)
    off = scores(result, clip, masks)["add_sym_mm"]
    believing = reconstruct(clip, spoilt, replace(options, masks="as-given"))
    assert not np.isnan(believing.iou).any()
    assert scores(believing, clip, masks)["add_sym_mm"] > 2.0 * off


@pytest.mark.parametrize(("wrong", "again"), [([5], "refit"), ([2, 5, 8], "fit")])
def test_a_fit_without_few_masks_begins_at_the_fit_before(wrong: list[int], again: str) -> None:
    """More outliers may have led the fit astray."""
    clip, masks = scene("bottle", 1, replace(SMALL, frames=12))
    spoilt = masks.object.copy()
    for n in wrong:
        spoilt[n] = displace_mask(masks.object[n], np.array([0.6, -0.8]))
    options = Options(inits=4, mesh="as-given")
    problem = prepare_problem(with_masks(clip, replace(masks, object=spoilt)), options)
    method, calls = METHODS[options.method], list[str]()

    def fit(some: Problem) -> MethodResult:
        calls.append("fit")
        return method.fit(some, lambda stage: None)

    def refit(some: Problem, found: MethodResult, frames: ndarray) -> MethodResult:
        calls.append("refit")
        assert len(frames) == len(some.clip)
        return refit_hinge(some, found, frames, lambda stage: None)

    left, found = fit_without_outliers(problem, fit, refit)
    assert calls[:2] == ["fit", again]
    assert {*left.trust.outliers} >= {clip.frames[n] for n in wrong}
    assert found.poses.R.shape[1] == len(left.clip)


@pytest.mark.parametrize("times", [1.0, 3.0])
def test_a_mask_is_an_outlier_by_the_objects_size_and_by_the_other_masks(times: float) -> None:
    size, usual = 1000.0, np.array([10.0, 12.0, 14.0])
    met = MaskOverlap(np.full(3, 800.0), 800.0 + times * usual, np.full(3, size))
    assert outlier_threshold(met) == max(OUTLIER_AREA_FRACTION * size, OUTLIER_MEDIAN_FACTOR * times * 12.0)
    poor = met._replace(either=met.either + size)  # all are missed: none contradicts the others
    assert poor.differing.max() < outlier_threshold(poor)


@pytest.mark.parametrize("shift", [0.0, 0.12, -0.12, 3.0])
def test_masks_are_compared_by_the_part_of_the_image_around_the_object(shift: float) -> None:
    clip, masks = scene("mug", 2, replace(SMALL, frames=9))
    T = se3.inverse(clip.hand.T_cam_hand) @ clip.truth.T_cam_obj
    T_cam_hand = clip.hand.T_cam_hand.copy()
    T_cam_hand[:, 0, 3] += shift  # in the image, across a border on either side, or out of it
    T_cam_hand[3, 2, 3] = -1.0  # behind the camera nothing is drawn
    clip = clip.with_hand_at(T_cam_hand)
    met = mask_overlap(clip, masks, T, 1.1)

    width, height = clip.size
    T_cam_obj = T_cam_hand @ T
    R, t = np.ascontiguousarray(T_cam_obj[:, :3, :3]), np.ascontiguousarray(T_cam_obj[:, :3, 3])
    K = np.stack([clip.K[:, 0, 0], clip.K[:, 1, 1], clip.K[:, 0, 2], clip.K[:, 1, 2]], axis=1)
    bits = np.empty((9, height, -(-width // 64)), np.uint64)
    silhouettes(R, t, np.full(9, 1.1), *SilhouetteMesh.of(clip.mesh, np.zeros(3)).tables, K, bits)
    drawn = unpack(bits, width)
    counted = drawn & (masks.object | ~masks.ignore)
    for found, expected in zip(met, (counted & masks.object, counted | masks.object, drawn), strict=True):
        np.testing.assert_array_equal(found, expected.sum(axis=(1, 2)))
    assert bool(met.silhouette.any()) == (shift < 1.0)


def test_the_typical_pose_is_no_outlier() -> None:
    R, centre = np.tile(np.eye(3), (1, 9, 1, 1)), np.zeros((1, 9, 3))
    centre[0, :, 0] = 1e-4 * np.arange(9)
    centre[0, 4] = 0.1
    poses = PosesInHand(R, centre, np.ones(1))
    points = np.random.default_rng(0).normal(size=(20, 3))
    assert np.abs(medoid_poses(poses, points).centre - centre)[0, np.arange(9) != 4].max() < 1e-3
    assert np.linalg.norm(medoid_poses(poses, points).centre[0, 4]) < 1e-3
