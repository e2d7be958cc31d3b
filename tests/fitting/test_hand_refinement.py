"""Laws of the hand's correction: derivatives, nothing at the truth, known errors found, the prior without pixels."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy import ndarray

from getagrip.clip import Clip, HandTrack, Masks, with_masks
from getagrip.datasets.synthetic.noise import Noise, noisy_hand
from getagrip.datasets.synthetic.scene import synthesise
from getagrip.datasets.synthetic.scene_options import SceneOptions
from getagrip.fitting.hand_errors import HandErrors
from getagrip.fitting.hand_refinement import refine_hand
from getagrip.fitting.hand_silhouette import SIZE, HandMask, HandSilhouette
from getagrip.fitting.options import Options
from getagrip.fitting.problem import prepare
from getagrip.geometry import se3
from getagrip.geometry.depth import covered
from getagrip.kernels.silhouette import unpack
from getagrip.provenance import estimated

CONSTANT = Noise(hand_bias_deg=8.0, hand_bias_mm=10.0)


@pytest.fixture(scope="module")
def made() -> tuple[Clip, Masks]:
    return synthesise("can", 0, SceneOptions(frames=6, size=(320, 240), focal=300.0))


def off(clip: Clip, noise: Noise) -> Clip:
    return replace(clip, hand=noisy_hand(clip, noise, np.random.default_rng(3)))


def apart(clip: Clip, T_cam_hand: ndarray) -> tuple[float, float]:
    """Mean angle [degrees] to the true hand, and mean distance of its middle across the line of sight [mm]."""
    assert clip.truth is not None
    true, middle = clip.truth.T_cam_hand, clip.truth.hand_vertices.mean(axis=(0, 1))[None]
    there = se3.transform(true, middle)[:, 0]
    d = se3.transform(T_cam_hand, middle)[:, 0] - there
    ray = there / np.linalg.norm(there, axis=1, keepdims=True)
    across = np.linalg.norm(d - np.sum(d * ray, axis=1, keepdims=True) * ray, axis=1)
    return np.degrees(se3.angle_between(T_cam_hand[:, :3, :3], true[:, :3, :3])).mean(), 1e3 * across.mean()


@pytest.mark.parametrize("number", range(27))
@pytest.mark.slow
def test_points_move_as_the_jacobian_says(made: tuple[Clip, Masks], number: int) -> None:
    errors = HandErrors.of(made[0].hand).with_fingers(sideways=True).take(np.arange(2))
    rng = np.random.default_rng(number)
    x = 0.02 * rng.standard_normal((2, errors.size))
    nearest = rng.integers(errors.tracked.vertices.shape[1], size=(2, 40))
    along = rng.standard_normal((2, 40, 3))

    def place(x: ndarray) -> ndarray:
        moved = se3.transform(errors.T_cam_hand(x), errors.surface(x)[0])
        return np.sum(np.take_along_axis(moved, nearest[..., None], axis=1) * along, axis=-1)

    step = 1e-5 * np.eye(errors.size)[number]
    J = errors.jacobian(x, *errors.surface(x), nearest, along)[..., number]
    # Bends: blended vertices move nearly, not exactly, about the finger's axis.
    tolerance = 1e-6 if number < 7 else 2e-3
    np.testing.assert_allclose((place(x + step) - place(x - step)) / 2e-5, J, atol=tolerance)


def test_at_the_truth_hardly_a_pixel_differs(
    made: tuple[Clip, Masks],
) -> None:
    clip, masks = made
    seen = HandSilhouette.of(clip, masks).with_field.with_fingers()
    value, g, H = seen(np.zeros((len(clip), seen.errors.size)))
    assert value.sum() < 0.03 * seen.mask.pixels  # resampled pixels, no more
    assert g.shape == (6, 22)
    assert H.shape == (6, 22, 22)
    drawn = covered(se3.transform(clip.hand.T_cam_hand, clip.hand.vertices)[0], clip.hand.faces, clip.K[0], clip.size)
    assert unpack(seen.mask.observed, SIZE)[0].any() == (masks.ignore[0] & drawn).any()


@pytest.mark.slow
def test_a_true_hand_is_left_alone(made: tuple[Clip, Masks]) -> None:
    assert refine_hand(*made)[0] is None
    problem = prepare(with_masks(*made), Options())
    assert not problem.trust.hand_refined
    np.testing.assert_array_equal(problem.clip.hand.T_cam_hand, made[0].hand.T_cam_hand)


@pytest.mark.slow
def test_a_constant_error_is_found(made: tuple[Clip, Masks]) -> None:
    clip = off(made[0], CONSTANT)
    found = refine_hand(clip, made[1])[0]
    assert found is not None
    assert found.after < 0.3 * found.before
    before, after = apart(clip, clip.hand.T_cam_hand), apart(clip, found.T_cam_hand)
    assert after[0] < 0.5 * before[0]
    assert after[1] < 0.3 * before[1]
    assert f"{100 * found.before:.0f} %" in str(found)


def smaller(masks: Masks, by: int) -> Masks:
    """Masks of the hand that keep away from everything by some pixels."""
    assert masks.hand is not None
    kernel = np.ones((2 * by + 1, 2 * by + 1), np.uint8)
    hand = np.stack([cv2.erode(m.view(np.uint8), kernel, borderValue=0) for m in masks.hand]).view(bool)
    return Masks(masks.object, hand, hand)


@pytest.mark.parametrize(("degrees", "kind"), [(2.0, "measured"), (8.0, "estimated")])
def test_a_measured_hand_that_its_pixels_turn_far_is_refined_as_an_estimate(
    made: tuple[Clip, Masks], degrees: float, kind: str
) -> None:
    clip, masks = off(made[0], Noise(hand_bias_deg=degrees)), made[1]
    refined, _ = refine_hand(clip, masks)
    assert refined is not None
    assert refined.kind == kind
    source = {"hands": estimated("by a network")}
    as_estimate, _ = refine_hand(replace(clip, provenance=clip.provenance | source), masks)
    assert as_estimate is not None
    same = np.array_equal(as_estimate.T_cam_hand, refined.T_cam_hand)
    assert same == (kind == "estimated")


@pytest.mark.parametrize("by", [2, 3])
@pytest.mark.slow
def test_masks_that_are_too_small_all_round_do_not_turn_the_hand(made: tuple[Clip, Masks], by: int) -> None:
    clip, masks = made
    found = refine_hand(clip, smaller(masks, by), have_gaps=True)[0]
    turned, moved = (0.0, 0.0) if found is None else apart(clip, found.T_cam_hand)
    assert turned < 1.0
    assert moved < 1.0


@pytest.mark.slow
def test_nor_do_they_hide_its_error(made: tuple[Clip, Masks]) -> None:
    clip = off(made[0], CONSTANT)
    found = refine_hand(clip, smaller(made[1], 3), have_gaps=True)[0]
    assert found is not None
    assert f"grown by {found.grown:.1f} px" in str(found)
    assert apart(clip, found.T_cam_hand)[1] < 0.4 * apart(clip, clip.hand.T_cam_hand)[1]


def test_grown_masks_are_as_large_as_the_silhouettes_and_no_smaller_than_given(made: tuple[Clip, Masks]) -> None:
    clip, masks = made
    true = HandMask.of(clip, masks)
    small = HandMask.of(clip, smaller(masks, 3))
    seen = unpack(true.observed, SIZE) & unpack(small.valid, SIZE)
    grown = small.grown_to(true.observed)
    assert small.pixels < 0.75 * seen.sum()
    assert grown.pixels == pytest.approx(seen.sum(), rel=0.05)
    assert not (unpack(small.observed, SIZE) & ~unpack(grown.observed, SIZE)).any()
    assert not (unpack(grown.observed, SIZE) & ~unpack(small.valid, SIZE)).any()
    np.testing.assert_array_equal(true.grown_to(small.observed).observed, true.observed)
    np.testing.assert_array_equal(small.grown_to(np.full_like(small.observed, 2**64 - 1)).observed, small.observed)


def test_without_joints_the_hand_is_corrected_as_a_rigid_one(made: tuple[Clip, Masks]) -> None:
    clip = off(made[0], CONSTANT)
    clip = replace(clip, hand=replace(clip.hand, joints=None))
    found = refine_hand(clip, made[1])[0]
    assert found is not None
    assert apart(clip, found.T_cam_hand)[1] < 0.3 * apart(clip, clip.hand.T_cam_hand)[1]


def test_without_pixels_the_prior_decides(made: tuple[Clip, Masks]) -> None:
    clip = off(made[0], CONSTANT)
    assert refine_hand(clip, Masks(made[1].object, np.zeros_like(made[1].ignore)))[0] is None


def test_of_a_hand_that_goes_behind_the_camera_all_pixels_differ(made: tuple[Clip, Masks]) -> None:
    clip, masks = made
    behind = clip.hand.T_cam_hand.copy()
    behind[0, 2, 3] = -0.1
    through = replace(clip, hand=replace(clip.hand, T_cam_hand=behind))
    assert refine_hand(through, Masks(masks.object, masks.ignore, masks.ignore)) == (None, 1.0)


@pytest.mark.slow
def test_pixels_that_are_not_the_hand_move_nothing(made: tuple[Clip, Masks]) -> None:
    clip, masks = made
    everything = Masks(masks.object, ~masks.object)
    assert refine_hand(clip, everything)[0] is None
    far = np.zeros_like(masks.ignore)
    far[:, :20, :20] = True
    assert HandMask.of(clip, Masks(masks.object, masks.ignore | far)).pixels == HandMask.of(clip, masks).pixels


def test_the_arm_says_nothing(made: tuple[Clip, Masks]) -> None:
    clip, masks = made
    hand: HandTrack = clip.hand
    assert hand.joints is not None
    wrist = se3.transform(hand.T_cam_hand, hand.joints[:, [0, 9]])
    arm = Masks(masks.object, masks.ignore.copy())
    for n, K in enumerate(clip.K):
        (u0, v0), (u1, v1) = (wrist[n] @ K.T)[:, :2] / wrist[n][:, 2:]
        for t in np.linspace(0.3, 2.0, 60):
            u, v = int(u0 + t * (u0 - u1)), int(v0 + t * (v0 - v1))
            arm.ignore[n, max(v - 3, 0) : v + 3, max(u - 3, 0) : u + 3] = True
    assert (arm.ignore & ~masks.ignore).any()
    assert refine_hand(clip, arm)[0] is None


@pytest.mark.slow
def test_as_given_leaves_everything_as_it_is(made: tuple[Clip, Masks]) -> None:
    clip = off(made[0], CONSTANT)
    assert prepare(with_masks(clip, made[1]), Options()).trust.hand_refined
    for options in (Options(hands="as-given"), Options(method="paper")):
        problem = prepare(with_masks(clip, made[1]), options)
        assert not problem.trust.hand_refined
        np.testing.assert_array_equal(problem.clip.hand.T_cam_hand, clip.hand.T_cam_hand)


@pytest.mark.slow
def test_where_the_hand_is_known_alone_another_one_does_not_count(made: tuple[Clip, Masks]) -> None:
    clip, masks = off(made[0], CONSTANT), made[1]
    beside = masks.ignore | (np.roll(masks.ignore, 25, axis=2) & ~masks.object)
    alone, _ = refine_hand(clip, Masks(masks.object, masks.ignore, masks.ignore))
    both, _ = refine_hand(clip, Masks(masks.object, beside, masks.ignore))
    assert alone is not None
    assert both is not None
    assert apart(clip, both.T_cam_hand)[1] < 0.4 * apart(clip, clip.hand.T_cam_hand)[1]
    assert apart(clip, alone.T_cam_hand)[1] < 0.3 * apart(clip, clip.hand.T_cam_hand)[1]


def test_frames_in_which_nobody_labelled_the_hand_say_nothing(made: tuple[Clip, Masks]) -> None:
    clip, masks = made
    assert masks.hand is not None
    hand = masks.hand.copy()
    hand[[1, 3]] = False
    seen = HandSilhouette.of(clip, Masks(masks.object, masks.ignore, hand)).with_field.with_fingers()
    everywhere = HandSilhouette.of(off(clip, CONSTANT), Masks(masks.object, masks.ignore, hand))
    everywhere = everywhere.with_field.with_fingers()
    x = np.zeros((len(clip), seen.errors.size))
    for values in (*seen(x), *everywhere(x)):
        assert not values[[1, 3]].any()
        assert values[[0, 2]].any()


def test_landmarks_of_the_images_stay_with_their_frames(made: tuple[Clip, Masks]) -> None:
    points = np.random.default_rng(0).uniform(0.0, 200.0, (6, 21, 2))
    hand = replace(made[0].hand, joints_2d=points, joints_2d_confidence=np.ones((6, 21)))
    taken = HandErrors.of(hand).take(np.array([4, 1])).tracked
    assert taken.joints_2d is not None
    np.testing.assert_array_equal(taken.joints_2d, points[[4, 1]])
