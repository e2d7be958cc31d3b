"""Tracker glitches are repaired and real motion is left alone; hands are refined against their own pixels."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from numpy import ndarray

from getagrip.checks.evidence import Glitches
from getagrip.clip import Clip, HandTrack, Masks, with_masks
from getagrip.fitting.hand.hand_error_model import HandErrors
from getagrip.fitting.hand.hand_silhouette import HAND_CROP_SIZE_PX, HandMask, HandSilhouette
from getagrip.fitting.hand.refine_hand import frames_without_glitch, refine_hand, repair_hand
from getagrip.fitting.options import Options
from getagrip.fitting.problem import prepare_problem
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.geometry.kernels.silhouette import unpack
from getagrip.geometry.rasterize import render_coverage
from getagrip.hands.bending import bend_fingers, finger_weights
from getagrip.provenance import assumed, estimated
from getagrip.reconstruct import reconstruct
from getagrip.synthetic.noise import Noise, noisy_hand
from getagrip.synthetic.scene import synthesise
from getagrip.synthetic.scene_options import SceneOptions
from helpers.scenes import SHORT, scene

FRAMES = 40


def along(motion: ndarray) -> Clip:
    """A hand that moves by ``motion`` (T, 6): shift [m] and turn [rad] in the camera's frame."""
    clip, _ = scene("can", 0, SHORT)
    one = clip.take(np.zeros(len(motion), int))
    T = se3.rigid(se3.exp_so3(motion[:, 3:]), motion[:, :3]) @ one.hand.T_cam_hand
    names = tuple(f"{n:06d}" for n in range(len(motion)))
    return replace(one, frames=names, hand=replace(one.hand, T_cam_hand=T), truth=None)


def smooth() -> Clip:
    """A hand that turns about the camera and goes 20 cm aside, and back, in 40 frames."""
    t = np.linspace(0.0, np.pi, FRAMES)[:, None]
    return along(np.sin(t) * [0.2, 0.05, 0.05, 0.2, 0.3, 0.1])


def flipped(clip: Clip, frames: list[int], angle: float = np.pi) -> Clip:
    """Turn the hand about one of its axes after the other, by half a turn unless ``angle`` [rad] says otherwise."""
    T, middle = clip.hand.T_cam_hand.copy(), clip.hand.vertices.mean(axis=(0, 1))
    R = se3.exp_so3(angle * np.eye(3)[np.arange(1, len(frames) + 1) % 3])
    T[frames] = T[frames] @ se3.rigid(R, middle - R @ middle)
    return clip.with_hand_at(T)


def glitches_of(clip: Clip) -> tuple[str, ...]:
    glitches = repair_hand(clip, Options())[1]
    assert glitches is not None
    return glitches.frames


def test_a_hand_that_moves_is_left_as_it_is() -> None:
    clip = smooth()
    assert repair_hand(clip, Options()) == (clip, Glitches((), FRAMES))


def test_a_hand_that_is_shaken_is_left_as_it_is() -> None:
    """By 10 cm, 3 times a second, at 30 frames a second."""
    t = np.arange(FRAMES)[:, None] / 30.0
    clip = along(0.05 * np.sin(2.0 * np.pi * 3.0 * t) * [1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert glitches_of(clip) == ()


def test_a_hand_that_moves_and_stays_does_not_jump() -> None:
    clip = along(np.where(np.arange(FRAMES)[:, None] < 20, 0.0, 0.3) * [1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert glitches_of(clip) == ()


def test_a_hand_that_comes_in_fast_and_slows_down_keeps_its_frames() -> None:
    """Steps as of a hand that reaches for an object in DexYCB [mm]."""
    steps = [69, 115, 63, 61, 52, 52, 29, 28, 12, 12, 4, 5, 2, 5, 3, 1, 2, 2, 4, 4, 4, 4, 5, 7, 8, 16, 7, 5, 6, 7]
    way = 1e-3 * np.cumsum([0, *steps])[:, None] * [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    for motion in (way, way[::-1]):
        assert glitches_of(along(motion)) == ()


@pytest.mark.parametrize("frames", [[7], [7, 20], [10, 11, 12], [0], [39], [3, 9, 15, 16, 22, 30, 36]])
def test_jumps_are_found_and_put_right(frames: list[int]) -> None:
    clip = smooth()
    steady, glitches = repair_hand(flipped(clip, frames, angle=2.0), Options())
    assert glitches is not None
    assert glitches.frames == tuple(clip.frames[n] for n in frames)
    assert steady.hand.vertices is clip.hand.vertices
    kept = np.setdiff1d(np.arange(FRAMES), frames)
    assert np.array_equal(steady.hand.T_cam_hand[kept], clip.hand.T_cam_hand[kept])
    off = se3.transform(steady.hand.T_cam_hand, clip.hand.vertices) - se3.transform(
        clip.hand.T_cam_hand, clip.hand.vertices
    )
    assert np.abs(off).max() < (0.005 if {0, 39}.isdisjoint(frames) else 0.03)


@pytest.mark.parametrize("frames", [[0], [39], [7, 20], [10, 11, 12], [n for n in range(FRAMES) if n % 5 > 1]])
def test_flips_are_undone(frames: list[int]) -> None:
    """In three frames of five, too: each axis has fewer of them than there are hands as they should be."""
    clip = smooth()
    steady, glitches = repair_hand(flipped(clip, frames), Options())
    assert glitches == Glitches(tuple(clip.frames[n] for n in frames), FRAMES)
    assert np.allclose(steady.hand.T_cam_hand, clip.hand.T_cam_hand, atol=1e-12)


def test_jumps_are_the_same_from_any_camera_and_in_reverse() -> None:
    clip = flipped(flipped(smooth(), [5, 17, 18]), [8, 30], angle=2.0)
    kept = np.array(frames_without_glitch(clip.hand))
    rng = np.random.default_rng(0)
    elsewhere = se3.rigid(se3.exp_so3(rng.normal(size=3)), rng.normal(size=3)) @ clip.hand.T_cam_hand
    assert np.array_equal(frames_without_glitch(replace(clip.hand, T_cam_hand=elsewhere)), kept)
    reverse = np.arange(FRAMES)[::-1]
    frames, flip = frames_without_glitch(clip.hand.take(reverse))
    assert np.array_equal([reverse[frames][::-1], flip[::-1]], kept)


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_few_frames_have_no_known_jumps(frames: int) -> None:
    clip = smooth().take(np.arange(frames))
    assert glitches_of(clip) == ()


def test_hands_are_believed_where_asked_to_and_by_the_method_to_the_letter() -> None:
    clip = flipped(smooth(), [5])
    for options in (Options(hands="as-given"), Options(method="paper")):
        assert repair_hand(clip, options) == (clip, None)


def test_a_result_says_where_the_hand_jumps_and_has_it_put_right() -> None:
    clip, masks = scene("can", 0)
    bad = flipped(clip, [3])
    options = Options(inits=6, every_frame=False)
    result, right = (reconstruct(one, masks, options) for one in (bad, clip))
    assert result.T_cam_hand is not None
    middle = clip.hand.vertices.mean(axis=(0, 1))[None]
    off = se3.transform(result.T_cam_hand, middle) - se3.transform(clip.hand.T_cam_hand, middle)
    assert np.linalg.norm(off, axis=-1).max() < 0.02
    assert {"tracker-glitches"} == {f.check for f in result.findings} - {f.check for f in right.findings}
    assert clip.frames[3] in next(f for f in result.findings if f.check == "tracker-glitches").message


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


def test_at_the_truth_hardly_a_pixel_differs(made: tuple[Clip, Masks]) -> None:
    clip, masks = made
    seen = HandSilhouette.of(clip, masks).with_field.with_fingers()
    value, g, H = seen(np.zeros((len(clip), seen.errors.size)))
    assert value.sum() < 0.03 * seen.mask.pixels  # resampled pixels, no more
    assert g.shape == (6, 22)
    assert H.shape == (6, 22, 22)
    drawn = render_coverage(
        se3.transform(clip.hand.T_cam_hand, clip.hand.vertices)[0], clip.hand.faces, clip.K[0], clip.size
    )
    assert unpack(seen.mask.observed, HAND_CROP_SIZE_PX)[0].any() == (masks.ignore[0] & drawn).any()


@pytest.mark.slow
def test_a_true_hand_is_left_alone(made: tuple[Clip, Masks]) -> None:
    assert refine_hand(*made)[0] is None
    problem = prepare_problem(with_masks(*made), Options())
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


def test_grown_masks_are_as_large_as_the_silhouettes_and_no_smaller_than_the_input(made: tuple[Clip, Masks]) -> None:
    clip, masks = made
    true = HandMask.of(clip, masks)
    small = HandMask.of(clip, smaller(masks, 3))
    seen = unpack(true.observed, HAND_CROP_SIZE_PX) & unpack(small.valid, HAND_CROP_SIZE_PX)
    grown = small.grown_to(true.observed)
    assert small.pixels < 0.75 * seen.sum()
    assert grown.pixels == pytest.approx(seen.sum(), rel=0.05)
    assert not (unpack(small.observed, HAND_CROP_SIZE_PX) & ~unpack(grown.observed, HAND_CROP_SIZE_PX)).any()
    assert not (unpack(grown.observed, HAND_CROP_SIZE_PX) & ~unpack(small.valid, HAND_CROP_SIZE_PX)).any()
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
def test_the_option_as_given_changes_nothing(made: tuple[Clip, Masks]) -> None:
    clip = off(made[0], CONSTANT)
    assert prepare_problem(with_masks(clip, made[1]), Options()).trust.hand_refined
    for options in (Options(hands="as-given"), Options(method="paper")):
        problem = prepare_problem(with_masks(clip, made[1]), options)
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


SPREAD = np.array([0.3, -0.25, -0.1, 0.15, 0.3])


def other_fingers(made: tuple[Clip, Masks]) -> Clip:
    """A hand turned by 12 degrees, 6 % too large, with fingers that are sideways; its true joints were seen."""
    clip = made[0]
    hand, joints = clip.hand, clip.hand.joints
    assert joints is not None
    seen = project(clip.K, se3.transform(hand.T_cam_hand, joints))
    vertices, joints = bend_fingers(
        hand.vertices, joints, finger_weights(hand), np.zeros((len(clip), 5, 3)), np.tile(SPREAD, (len(clip), 1))
    )
    wrong = replace(
        off(clip, Noise(hand_bias_deg=12.0)).hand, vertices=1.06 * vertices, joints=1.06 * joints, joints_2d=seen,
        joints_2d_confidence=np.ones(seen.shape[:2]),
    )  # fmt: skip
    return replace(clip, hand=wrong, provenance=clip.provenance | {"hands": estimated("by a network")})


@pytest.mark.slow
def test_beside_joints_wrong_fingers_do_not_keep_the_palm_from_turning(made: tuple[Clip, Masks]) -> None:
    clip = other_fingers(made)
    found, _ = refine_hand(clip, made[1])
    lifted, _ = refine_hand(replace(clip, provenance=clip.provenance | {"hands_scale": assumed("")}), made[1])
    assert found is not None
    assert lifted is not None
    turned = [apart(clip, one.T_cam_hand)[0] for one in (found, lifted)]
    assert turned[0] < 0.4 * apart(clip, clip.hand.T_cam_hand)[0]
    assert turned[0] < 0.7 * turned[1], "a hand that was lifted from joints has the fingers that it has"


@pytest.mark.slow
def test_contact_counts_with_the_fingers_as_refined_in_every_frame(made: tuple[Clip, Masks]) -> None:
    clip, true = other_fingers(made), made[0].hand.joints
    found, _ = refine_hand(clip, made[1])
    assert found is not None
    assert true is not None
    every, given = np.arange(len(clip)), clip.hand.joints
    refined = found.with_fingers(clip.hand, every)
    assert refined.joints is not None
    np.testing.assert_array_equal(refined.T_cam_hand, clip.hand.T_cam_hand)
    prepared = prepare_problem(with_masks(clip, made[1]), Options()).clip.hand
    np.testing.assert_array_equal(prepared.vertices, refined.vertices)

    def off_sideways(joints: ndarray) -> float:
        bones = [np.diff(one[:, 1:].reshape(-1, 5, 4, 3)[:, :, :2], axis=2) for one in (joints, true)]
        a, b = (one / np.linalg.norm(one, axis=-1, keepdims=True) for one in bones)
        return float(np.linalg.norm(a - b, axis=-1).mean())

    assert given is not None
    assert off_sideways(refined.joints) < 0.7 * off_sideways(given)
    some = found.take(every[::2]).with_fingers(clip.hand, every[::2])
    assert some.joints is not None
    np.testing.assert_allclose(some.joints[::2], refined.joints[::2], atol=1e-12)
    np.testing.assert_allclose(some.joints[1], refined.joints[1], atol=0.01)


def test_landmarks_of_the_images_stay_with_their_frames(made: tuple[Clip, Masks]) -> None:
    points = np.random.default_rng(0).uniform(0.0, 200.0, (6, 21, 2))
    hand = replace(made[0].hand, joints_2d=points, joints_2d_confidence=np.ones((6, 21)))
    taken = HandErrors.of(hand).take(np.array([4, 1])).tracked
    assert taken.joints_2d is not None
    np.testing.assert_array_equal(taken.joints_2d, points[[4, 1]])
