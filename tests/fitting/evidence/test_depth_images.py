"""Depth as evidence: wrong depth is reported, and a real sensor's errors are as assumed."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest

from getagrip.bench.inputs.simulated_evidence import DEPTH_ERROR_LEVELS, SimulatedDepth
from getagrip.checks import Evidence
from getagrip.clip import Clip, Masks, with_masks
from getagrip.clip.depth import ASSUMED_DEPTH_ERROR, DEPTH_KEY, Depth
from getagrip.fitting.evidence import depth_images as modality
from getagrip.fitting.evidence.depth_images import MAX_DEPTH_MISFIT, DepthImages
from getagrip.fitting.options import Options
from getagrip.fitting.problem import Problem, prepare_problem
from getagrip.geometry import se3
from getagrip.geometry.mesh_files import read_mesh
from getagrip.geometry.rasterize import depth_and_face
from helpers.environment import DATA, needs
from helpers.scenes import SHORT, scene


@cache
def with_depth(level: str) -> tuple[Clip, Masks, Depth]:
    clip, masks = SimulatedDepth(level)(*scene("mug", 1, SHORT), 0)
    return clip, masks, clip.evidence[DEPTH_KEY]


def evidence(depth: Depth, level: str = "realsense") -> Evidence:
    """A clip with some depth, and the truth for a result."""
    clip, masks, _ = with_depth(level)
    assert clip.truth is not None
    T = se3.inverse(clip.hand.T_cam_hand) @ clip.truth.T_cam_obj
    return Evidence(replace(clip, evidence={DEPTH_KEY: depth}), masks, T_hand_obj=T, scale=clip.truth.scale)


def findings(it: Evidence) -> set[str]:
    checks = (*DepthImages.input_checks, *DepthImages.result_checks)
    return {check.name for check in checks if check.finding(check.measure(it), it) is not None}


def problem(depth: Depth) -> Problem:
    clip, masks, _ = with_depth("realsense")
    return prepare_problem(with_masks(replace(clip, evidence={DEPTH_KEY: depth}), masks), Options(frames=4, inits=2))


@pytest.mark.parametrize("level", ["realsense", "mono"])
def test_errors_as_they_are_assumed_are_no_finding(level: str) -> None:
    depth = with_depth(level)[2]
    assert not findings(evidence(depth, level))


def test_a_clip_without_depth_has_no_term_and_no_value() -> None:
    clip, masks, _ = with_depth("realsense")
    it = Evidence(replace(clip, evidence={}), masks)
    assert all(np.isnan(check.measure(it)) for check in (*DepthImages.input_checks, *DepthImages.result_checks))
    assert (
        DepthImages().terms(prepare_problem(with_masks(replace(clip, evidence={}), masks), Options(frames=4, inits=2)))
        is None
    )


def test_depth_of_another_unit_is_found_and_not_used() -> None:
    depth = with_depth("realsense")[2]
    for factor in (0.3048, 3.28):  # feet for metres, and the other way round
        wrong = replace(depth, z=factor * depth.z)
        assert findings(evidence(wrong)) == {"depth-unit"}, "what is not used does not count little"
        assert DepthImages().terms(problem(wrong)) is None
        free = replace(wrong, source=replace(wrong.source, scale="clip"))
        assert DepthImages().terms(problem(free)) is not None
    assert DepthImages().terms(problem(depth)) is not None


def test_depth_shifted_by_another_camera_is_found() -> None:
    depth = with_depth("realsense")[2]
    shifted = replace(depth, z=np.roll(depth.z, 14, axis=2))
    assert findings(evidence(shifted)) & {"depth-elsewhere", "depth-misfit"}


def test_warped_depth_is_found() -> None:
    depth = with_depth("realsense")[2]
    ramp = np.linspace(0.7, 1.3, depth.z.shape[2])
    it = evidence(replace(depth, z=depth.z * ramp))
    assert {"depth-misfit", "depth-warped"} <= findings(it)
    assert modality.depth_misfit(evidence(depth))[0] < MAX_DEPTH_MISFIT


def test_mostly_holes_is_found() -> None:
    depth = with_depth("realsense")[2]
    holes = np.random.default_rng(0).random(depth.z.shape) < 0.97
    assert "depth-missing" in findings(evidence(replace(depth, z=np.where(holes, 0.0, depth.z))))


@pytest.mark.parametrize("level", DEPTH_ERROR_LEVELS)
def test_simulated_depth_errs_as_its_level_says(level: str) -> None:
    clip, masks, depth = with_depth(level)
    assert depth.source.source == DEPTH_ERROR_LEVELS[level].source
    share = np.mean((depth.z == 0.0)[depth.of_masks(masks.object, clip.size)])
    assert share == pytest.approx(DEPTH_ERROR_LEVELS[level].holes, abs=0.15)
    again = SimulatedDepth(level)(*scene("mug", 1, SHORT), 0)[0].evidence[DEPTH_KEY]
    assert again == depth


@needs(DATA / "frame")
@needs(DATA / "ycb")
def test_a_real_sensor_errs_as_is_assumed() -> None:
    label, image = np.load(DATA / "frame" / "labels.npz"), cv2.imread(str(DATA / "frame" / "depth.png"), -1)
    mesh, pose = read_mesh(DATA / "ycb" / "006_mustard_bottle.obj"), label["pose_y"][0]
    K = np.array([[616.641, 0.0, 308.548], [0.0, 616.258, 248.523], [0.0, 0.0, 1.0]])
    z = depth_and_face(mesh.vertices @ pose[:, :3].T + pose[:, 3], mesh.faces, K, (640, 480))[0]
    bottle = 5
    shown = cv2.erode(((label["seg"] == bottle) & np.isfinite(z)).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    known = shown & (image > 0) & (image < 65535)
    off = np.log(0.001 * image[known]) - np.log(z[known])
    assert abs(np.median(off)) < 0.004
    assert np.median(np.abs(off - np.median(off))) / 0.6745 == pytest.approx(ASSUMED_DEPTH_ERROR["sensor"], rel=0.3)
    assert known.sum() > 0.9 * shown.sum()
