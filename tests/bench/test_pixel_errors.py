"""A result equal to the truth has no errors; a shift along the ray is a shift along it, and none across."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from getagrip.bench.pixels.pixel_errors import PixelErrors, PixelTruth, hand_errors, measure
from getagrip.clip import Clip, Masks
from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.result import Candidates, Reconstruction
from getagrip.result.findings import Finding, Probability
from getagrip.synthetic.scene import ground_truth_masks, make_scene
from getagrip.synthetic.scene_options import SceneOptions


@pytest.fixture(scope="module")
def shown() -> tuple[Clip, Masks, PixelTruth, Reconstruction]:
    """A mug in a hand, its truth, and a result that is equal to it."""
    scene = make_scene("mug", 3, SceneOptions(frames=4, size=(160, 120), focal=150.0))
    clip, masks = scene.clip, ground_truth_masks(scene)
    assert clip.truth is not None
    assert clip.hand.joints is not None
    joints = se3.transform(clip.hand.T_cam_hand, clip.hand.joints)
    truth = PixelTruth(clip.frames, clip.mesh, clip.truth.T_cam_obj, joints, np.asarray(masks.object))
    T = se3.inverse(clip.hand.T_cam_hand) @ clip.truth.T_cam_obj
    result = replace(Reconstruction.external(clip.name, "truth", clip.frames, T), T_cam_hand=clip.hand.T_cam_hand)
    return clip, masks, truth, result


def moved(result: Reconstruction, clip: Clip, shift: np.ndarray) -> Reconstruction:
    """The result with its object shifted in the camera [m], by frame."""
    T = result.T_cam_obj.copy()
    T[:, :3, 3] += shift
    T_hand_obj = se3.inverse(clip.hand.T_cam_hand) @ T
    return replace(result, T_hand_obj=T_hand_obj, candidates=replace(result.candidates, T_hand_obj=T_hand_obj[None]))


def rays(clip: Clip) -> np.ndarray:
    """Unit rays to the object's centre."""
    assert clip.truth is not None
    centre = se3.transform(clip.truth.T_cam_obj, clip.mesh.centre[None])[:, 0]
    return np.asarray(centre / np.linalg.norm(centre, axis=1, keepdims=True))


def test_the_truth_has_no_errors(shown: Any) -> None:
    clip, masks, truth, result = shown
    errors = measure(truth, clip, result, masks)
    assert isinstance(errors, PixelErrors)
    assert errors.object.right
    assert errors.right_among_candidates
    assert errors.mask_iou == 1.0
    assert errors.true_pose_iou is not None
    assert errors.true_pose_iou > 0.99
    assert errors.frames == 4
    for each in (errors.object, errors.nearest_candidate):
        found = (each.add_mm, each.add_percent, each.along_mm, each.across_mm, each.rotation_deg)
        assert np.allclose(found, 0.0, atol=1e-6)
    for hand in (errors.hand_found, errors.hand_solved):
        assert hand is not None
        assert np.allclose((hand.joints_mm, hand.along_mm, hand.palm_deg, hand.tilt_deg), 0.0, atol=1e-4)


def test_masks_that_contradict_the_truth_are_told_from_a_wrong_pose(shown: Any) -> None:
    clip, masks, truth, result = shown
    half = np.asarray(masks.object).copy()
    half[:, :, half.any(axis=(0, 1)).nonzero()[0].mean().astype(int) :] = False
    blamed = measure(truth, clip, result, Masks(half, np.asarray(masks.ignore))).true_pose_iou
    assert blamed is not None
    assert 0.2 < blamed < 0.8


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_shift_along_the_ray_is_along_it(shown: Any, sign: float) -> None:
    clip, _, truth, result = shown
    errors = measure(truth, clip, moved(result, clip, sign * 0.010 * rays(clip))).object
    assert errors.along_mm == pytest.approx(sign * 10.0)
    assert errors.add_mm == pytest.approx(10.0)
    assert (errors.across_mm, errors.rotation_deg) == pytest.approx((0.0, 0.0), abs=1e-6)


def test_a_shift_across_the_ray_is_across_it(shown: Any) -> None:
    clip, _, truth, result = shown
    across = np.cross(rays(clip), [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    errors = measure(truth, clip, moved(result, clip, 0.010 * across)).object
    assert (errors.along_mm, errors.across_mm) == pytest.approx((0.0, 10.0), abs=1e-6)


def test_errors_are_up_to_symmetries() -> None:
    scene = make_scene("mug", 3, SceneOptions(frames=2, size=(160, 120), focal=150.0))
    clip, side = scene.clip, 0.03
    corners = np.array([[x, y, z] for x in (-side, side) for y in (-side, side) for z in (-2 * side, 2 * side)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    block = Mesh(corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]))
    assert clip.truth is not None
    truth = PixelTruth(clip.frames, block, clip.truth.T_cam_obj)
    half = np.diag([-1.0, -1.0, 1.0, 1.0])
    T = se3.inverse(clip.hand.T_cam_hand) @ clip.truth.T_cam_obj @ half
    result = replace(Reconstruction.external("block", "turned", clip.frames, T), T_cam_hand=clip.hand.T_cam_hand)
    errors = measure(truth, replace(clip, mesh=block), result)
    assert (errors.object.add_mm, errors.object.rotation_deg) == pytest.approx((0.0, 0.0), abs=0.1)
    assert errors.hand_found is None
    assert errors.mask_iou is None
    assert errors.true_pose_iou is None


def test_the_size_that_a_draft_gave_the_mesh_is_undone(shown: Any) -> None:
    clip, _, truth, result = shown
    larger = replace(clip, mesh=Mesh(10.0 * clip.mesh.vertices, clip.mesh.faces))
    tenth = replace(result, scale=0.1, candidates=replace(result.candidates, scale=np.array([0.1])))
    assert measure(truth, larger, tenth).object.add_mm == pytest.approx(0.0, abs=1e-6)


def test_the_right_candidate_is_found_behind_a_wrong_result(shown: Any) -> None:
    clip, _, truth, result = shown
    wrong = moved(result, clip, 0.05 * rays(clip))
    both = np.concatenate([wrong.candidates.T_hand_obj, result.candidates.T_hand_obj])
    errors = measure(truth, clip, replace(wrong, candidates=Candidates(both, np.ones(2), np.zeros(2))))
    assert not errors.object.right
    assert errors.right_among_candidates
    assert errors.nearest_candidate.add_mm == pytest.approx(0.0, abs=1e-6)


def test_hands_are_measured_where_they_are_known(shown: Any) -> None:
    _, _, truth, _ = shown
    true = truth.joints
    centre = true[:, :12].mean(axis=1)
    ray = centre / np.linalg.norm(centre, axis=1, keepdims=True)
    known = true.copy()
    known[:, 12:] = np.nan
    known[0] = np.nan
    errors = hand_errors(true + 0.020 * ray[:, None], known)
    assert errors is not None
    assert (errors.joints_mm, errors.along_mm) == pytest.approx((20.0, 20.0), abs=1e-6)
    assert (errors.palm_deg, errors.tilt_deg) == pytest.approx((0.0, 0.0), abs=1e-4)
    assert hand_errors(true, np.full_like(true, np.nan)) is None


def test_a_palm_that_turns_about_its_normal_does_not_tilt(shown: Any) -> None:
    _, _, truth, _ = shown
    true = truth.joints
    palm = true[:, [0, 5, 17]]
    normal = np.cross(palm[:, 1] - palm[:, 0], palm[:, 2] - palm[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    only = np.full_like(true, np.nan)
    only[:, [0, 5, 17]] = palm
    turned = se3.transform(se3.rotation_about_line(palm[:, 0], normal, np.full(len(true), np.radians(12.0))), true)
    errors = hand_errors(turned, only)
    assert errors is not None
    assert (errors.palm_deg, errors.tilt_deg) == pytest.approx((12.0, 0.0), abs=1e-3)


def test_what_a_result_says_is_kept(shown: Any) -> None:
    clip, _, truth, result = shown
    findings = (Finding("other-size", True, 1.0, 0.5, "no"), Finding("near-image-edge", False, 1.0, 0.5, "so"))
    said = measure(
        truth, clip, replace(result, findings=findings, probability_right=Probability(0.4, "right", ("pose-spread",)))
    ).said
    assert (said.in_hand, said.in_camera, said.extrapolated) == (0.4, None, ("pose-spread",))
    assert (said.refused, said.serious, said.notes) == (True, ("other-size",), ("near-image-edge",))
    assert not measure(truth, clip, result).said.refused


def test_a_frame_without_truth_is_named(shown: Any) -> None:
    clip, _, truth, result = shown
    with pytest.raises(UsageError, match="frame 000003 has no truth: known are 000000 to 000002"):
        measure(
            replace(
                truth,
                frames=truth.frames[:3],
                T_cam_obj=truth.T_cam_obj[:3],
                joints=truth.joints[:3],
                masks=truth.masks[:3],
            ),
            clip,
            result,
        )
