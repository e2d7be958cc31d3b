"""Errors of trackers and masks: of the given size, alike in frames that follow, never in the truth."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from getagrip.clip import Clip, Masks
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.hands import generic
from getagrip.hands.bending import bend_fingers, finger_hinge_axes, finger_weights
from getagrip.hands.model import KNUCKLES
from getagrip.synthetic.noise import (
    ESTIMATED_HANDS_FILE,
    NOISE_PRESETS,
    Noise,
    draw_hand_errors,
    noisy_hand,
    perturb_mask_boundary,
    perturbed,
)
from getagrip.synthetic.scene import synthesise
from getagrip.synthetic.scene_options import SceneOptions
from helpers.measures import ERROR_MEASURES, ErrorCurves, measure


@pytest.fixture(scope="module")
def made() -> tuple[Clip, Masks]:
    return synthesise("can", 0, SceneOptions(frames=120, size=(160, 120), focal=150.0))


def displaced(clip: Clip, noise: Noise, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Turn [deg], shift [mm] and shift along the ray [mm] of the hand's middle in every frame."""
    moved = replace(clip, hand=noisy_hand(clip, noise, np.random.default_rng(seed)))
    turn = np.degrees(se3.angle_between(clip.hand.T_cam_hand[:, :3, :3], moved.hand.T_cam_hand[:, :3, :3]))
    middle = clip.hand.vertices.mean(axis=(0, 1))[None]
    before, after = (se3.transform(c.hand.T_cam_hand, middle)[:, 0] for c in (clip, moved))
    ray = before / np.linalg.norm(before, axis=1, keepdims=True)
    return turn, 1e3 * (after - before), 1e3 * np.sum((after - before) * ray, axis=1)


@pytest.mark.slow
def test_no_noise_changes_nothing(made: tuple[Clip, Masks]) -> None:
    clip, masks = perturbed(*made, NOISE_PRESETS["none"], 3)
    np.testing.assert_allclose(clip.hand.T_cam_hand, made[0].hand.T_cam_hand, atol=1e-12)
    assert clip.hand.vertices is made[0].hand.vertices
    assert masks is made[1]


@pytest.mark.slow
def test_the_truth_keeps_the_true_hand(made: tuple[Clip, Masks]) -> None:
    clip, _ = perturbed(*made, NOISE_PRESETS["strong"], 3)
    assert clip.truth is made[0].truth
    assert not np.allclose(clip.hand.vertices, made[0].hand.vertices, atol=1e-3)
    assert clip.provenance["noise"]["hand_bias_deg"] == NOISE_PRESETS["strong"].hand_bias_deg


@given(deg=st.floats(0.1, 10.0), mm=st.floats(0.1, 20.0), seed=st.integers(0, 2**31))
@settings(max_examples=20, deadline=None)
@pytest.mark.slow
def test_a_bias_has_its_size_in_every_frame(made: tuple[Clip, Masks], deg: float, mm: float, seed: int) -> None:
    turn, shift, _ = displaced(made[0], Noise(hand_bias_deg=deg, hand_bias_mm=mm), seed)
    np.testing.assert_allclose(turn, deg, rtol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(shift, axis=1), mm, rtol=1e-6)


def test_depth_lies_along_the_ray(made: tuple[Clip, Masks]) -> None:
    turn, shift, depth = displaced(made[0], Noise(hand_bias_depth_mm=8.0, hand_jitter_depth_mm=2.0))
    np.testing.assert_allclose(np.linalg.norm(shift, axis=1), np.abs(depth), rtol=1e-6)
    np.testing.assert_allclose(turn, 0.0, atol=1e-4)
    assert abs(abs(depth.mean()) - 8.0) < 1.5
    assert depth.std() == pytest.approx(2.0, rel=0.3)


@pytest.mark.parametrize("memory", [0.0, 0.1])
@pytest.mark.slow
def test_jitter_lasts_as_long_as_its_memory(made: tuple[Clip, Masks], memory: float) -> None:
    clip = made[0]
    noise = Noise(hand_jitter_mm=2.0, jitter_memory_s=memory)
    shifts = np.stack([displaced(clip, noise, seed)[1] for seed in range(20)])
    in_hand = np.einsum("nij,sni->snj", clip.hand.T_cam_hand[:, :3, :3], shifts)
    expected = np.exp(-1.0 / (clip.fps * memory)) if memory else 0.0
    correlation = np.mean(in_hand[:, 1:] * in_hand[:, :-1]) / np.mean(in_hand**2)
    assert correlation == pytest.approx(expected, abs=0.05)
    assert np.sqrt(np.mean(np.sum(in_hand**2, axis=-1))) == pytest.approx(2.0, rel=0.1)


def test_more_noise_is_the_same_noise_larger(made: tuple[Clip, Masks]) -> None:
    small, large = (displaced(made[0], Noise(hand_bias_mm=mm, hand_jitter_mm=mm), 5)[1] for mm in (1.0, 3.0))
    np.testing.assert_allclose(large, 3.0 * small, rtol=1e-6, atol=1e-9)


@pytest.mark.slow
def test_depth_and_fingers_leave_the_other_errors_as_they_are(made: tuple[Clip, Masks]) -> None:
    plain = Noise(hand_bias_deg=2.0, hand_jitter_mm=1.0, mask_ragged_px=1.0)
    more = replace(plain, hand_bias_depth_mm=5.0, finger_bias_deg=10.0)
    (a, masks_a), (b, masks_b) = (perturbed(*made, noise, 7) for noise in (plain, more))
    np.testing.assert_array_equal(masks_a.object, masks_b.object)
    np.testing.assert_allclose(a.hand.T_cam_hand[:, :3, :3], b.hand.T_cam_hand[:, :3, :3], atol=1e-12)


@pytest.mark.compiles
def test_fingers_bend_about_their_joints_and_keep_their_lengths(made: tuple[Clip, Masks]) -> None:
    hand = made[0].hand
    moved = noisy_hand(made[0], Noise(finger_bias_deg=10.0), np.random.default_rng(1))
    bones = [np.linalg.norm(np.diff(j.reshape(-1, 21, 3)[:, 1:].reshape(-1, 5, 4, 3), axis=2), axis=-1)
             for j in (hand.joints, moved.joints)]  # fmt: skip
    np.testing.assert_allclose(bones[0], bones[1], atol=1e-9)
    np.testing.assert_array_equal(hand.joints[:, [0, 1, 5, 9, 13, 17]], moved.joints[:, [0, 1, 5, 9, 13, 17]])
    palm = generic.load("right").weights[:, 0] > 0.99
    assert np.linalg.norm(moved.vertices - hand.vertices, axis=-1)[:, palm].mean() < 2e-4
    assert not np.allclose(moved.vertices, hand.vertices, atol=2e-3)


def test_weights_found_from_joints_agree_with_the_skin(made: tuple[Clip, Masks]) -> None:
    weights = finger_weights(made[0].hand)
    assert weights.min() >= 0.0
    assert weights.sum(axis=(1, 2)).max() <= 1.0 + 1e-9
    skin = generic.load("right").weights
    finger = np.stack([skin[:, k : k + 3].sum(axis=1) for k in KNUCKLES], axis=1)
    sure = finger.max(axis=1) > 0.95
    assert np.mean(np.argmax(weights.sum(axis=2)[sure], axis=1) == np.argmax(finger[sure], axis=1)) > 0.98


def test_no_bend_is_no_change(made: tuple[Clip, Masks]) -> None:
    hand = made[0].hand
    vertices, joints = bend_fingers(hand.vertices, hand.joints, finger_weights(hand), np.zeros((len(made[0]), 5, 3)))
    np.testing.assert_allclose(vertices, hand.vertices, atol=1e-12)
    np.testing.assert_allclose(joints, hand.joints, atol=1e-12)
    still = np.zeros((len(made[0]), 5, 3)), np.zeros((len(made[0]), 5))
    sideways = bend_fingers(hand.vertices, hand.joints, finger_weights(hand), *still)
    np.testing.assert_array_equal(sideways[0], vertices)


def test_fingers_turn_sideways_as_a_whole_at_right_angles_to_their_bends(made: tuple[Clip, Masks]) -> None:
    hand = made[0].hand
    still, angle = np.zeros((len(made[0]), 5, 3)), np.full((len(made[0]), 5), 0.3)
    joints = bend_fingers(hand.vertices, hand.joints, finger_weights(hand), still, angle)[1]
    first, moved = (j[:, 1:].reshape(-1, 5, 4, 3) for j in (hand.joints, joints))
    np.testing.assert_array_equal(first[:, :, 0], moved[:, :, 0])
    shape = [np.linalg.norm(one[:, :, :, None] - one[:, :, None], axis=-1) for one in (first, moved)]
    np.testing.assert_allclose(shape[0], shape[1], atol=1e-9)
    a, b = (one[:, :, 1] - one[:, :, 0] for one in (first, moved))
    cosine = np.sum(a * b, axis=-1) / np.linalg.norm(a, axis=-1) ** 2
    np.testing.assert_allclose(cosine, np.cos(0.3), atol=1e-9)
    out_of_plane = np.sum((b - a * cosine[..., None]) * finger_hinge_axes(hand.joints), axis=-1)
    # The thumb's hinge is that of its first two bones.
    np.testing.assert_allclose(np.abs(out_of_plane) / np.linalg.norm(a, axis=-1), np.sin(0.3), atol=1e-3)


def test_fingers_without_joints_are_refused(made: tuple[Clip, Masks]) -> None:
    bare = replace(made[0], hand=replace(made[0].hand, joints=None))
    with pytest.raises(InputError, match="joints"):
        perturbed(bare, made[1], NOISE_PRESETS["moderate"], 0)
    perturbed(bare, made[1], Noise(hand_bias_mm=3.0), 0)


def test_ragged_masks_keep_to_the_object_and_an_empty_one_stays_empty(made: tuple[Clip, Masks]) -> None:
    _, masks = perturbed(*made, Noise(mask_ragged_px=1.0), 0)
    assert not (masks.object & masks.ignore).any()
    union, both = masks.object | made[1].object, masks.object & made[1].object
    assert 0.8 < both.sum() / union.sum() < 1.0
    empty = np.zeros((20, 30), dtype=bool)
    assert not perturb_mask_boundary(empty, 2.0, np.random.default_rng(0)).any()


@pytest.mark.slow
def test_clips_differ_in_how_far_they_are_off_and_the_usual_one_is_off_by_the_bias(made: tuple[Clip, Masks]) -> None:
    noise = Noise(hand_bias_deg=10.0, spread=0.6)
    short = made[0].take(np.arange(4))
    turns = np.array([displaced(short, noise, seed)[0] for seed in range(200)])
    np.testing.assert_allclose(turns, turns[:, :1].repeat(turns.shape[1], axis=1), rtol=1e-6)
    logs = np.log(turns[:, 0] / 10.0)
    assert abs(np.median(logs)) < 0.15
    assert logs.std() == pytest.approx(0.6, rel=0.2)


@pytest.mark.slow
def test_outliers_have_their_share_their_duration_and_one_error_each(made: tuple[Clip, Masks]) -> None:
    noise = Noise(hand_jitter_mm=1.0, outlier_share=0.2, outlier_times=1000.0, outlier_s=0.2)
    shifts = np.stack([displaced(made[0], noise, seed)[1] for seed in range(40)])
    in_hand = np.einsum("nij,sni->snj", made[0].hand.T_cam_hand[:, :3, :3], shifts)
    out = np.linalg.norm(in_hand, axis=-1) > 30.0
    assert out.mean() == pytest.approx(0.2, abs=0.05)
    starts = out[:, 1:] & ~out[:, :-1]
    assert out.sum() / (starts.sum() + out[:, 0].sum()) == pytest.approx(0.2 * made[0].fps, rel=0.25)
    follow = out[:, 1:] & out[:, :-1]
    same = np.linalg.norm(in_hand[:, 1:] - in_hand[:, :-1], axis=-1) < 20.0  # but for jitter, and bursts that touch
    assert same[follow].mean() > 0.8


@pytest.mark.slow
def test_spread_and_outliers_leave_the_other_draws_as_they_are(made: tuple[Clip, Masks]) -> None:
    plain = Noise(hand_bias_deg=2.0, hand_jitter_mm=1.0, finger_bias_deg=5.0, mask_ragged_px=1.0)
    a, b = (perturbed(*made, noise, 7) for noise in (plain, replace(plain, outlier_share=1e-9, outlier_times=3.0)))
    np.testing.assert_array_equal(a[0].hand.T_cam_hand, b[0].hand.T_cam_hand)
    np.testing.assert_array_equal(a[0].hand.vertices, b[0].hand.vertices)
    np.testing.assert_array_equal(a[1].object, b[1].object)


@pytest.mark.slow
def test_measures_of_drawn_errors_are_those_that_were_drawn() -> None:
    rng = np.random.default_rng(0)
    noise = Noise(
        hand_bias_deg=12.0, hand_jitter_deg=3.0, hand_bias_depth_mm=20.0, hand_jitter_depth_mm=5.0, hand_jitter_mm=0.1,
        finger_bias_deg=10.0, finger_jitter_deg=4.0, jitter_memory_s=0.05,
    )  # fmt: skip
    clips = [ErrorCurves.of(draw_hand_errors(noise, 200, 30.0, rng)) for _ in range(40)]
    found = measure(clips, 30.0)
    for name, expected in (("turn_bias", 12.0), ("turn_jitter", 3.0), ("finger_bias", 10.0), ("finger_jitter", 4.0)):
        assert np.degrees(found[name]) == pytest.approx(expected, rel=0.15)
    assert found["depth_bias"] == pytest.approx(0.020, rel=0.05)
    assert found["depth_jitter"] == pytest.approx(0.005, rel=0.1)
    assert found["across_bias"] < 1e-4
    assert found["memory"] == pytest.approx(0.05, rel=0.3)
    assert found["outlier_share"] < 0.01


@pytest.mark.slow
def test_errors_drawn_as_estimated_have_the_measures_of_the_estimates() -> None:
    rng, table = np.random.default_rng(0), json.loads(ESTIMATED_HANDS_FILE.read_text())
    clips = [
        ErrorCurves.of(draw_hand_errors(NOISE_PRESETS["estimated"], int(n), 30.0, rng))
        for n in rng.choice(table["lengths"], 300)
    ]
    found = measure(clips, 30.0)
    for name in {*ERROR_MEASURES, "spread"} - {"finger_bias", "finger_jitter"}:
        assert found[name] == pytest.approx(table["measured"][name], rel=0.25), name


@pytest.mark.slow
def test_the_strong_level_displaces_hands_further_than_the_moderate_level(made: tuple[Clip, Masks]) -> None:
    def off(level: str) -> np.ndarray:
        """Distance of the vertices from the true ones, by frame [m]."""
        hand = perturbed(*made, NOISE_PRESETS[level], 5)[0].hand
        posed, true = (se3.transform(one.T_cam_hand, one.vertices) for one in (hand, made[0].hand))
        return np.linalg.norm(posed - true, axis=-1).mean(axis=1)

    assert np.all(off("strong") > 1.5 * off("moderate"))
