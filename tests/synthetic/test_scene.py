"""Synthetic clips: deterministic, true to their options, mirror images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from getagrip.clip import Clip, read_clip, read_masks, write_clip
from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.warp import align_similarity
from getagrip.synthetic.categories import SYNTHETIC_CATEGORIES, clips_of_split
from getagrip.synthetic.noise import perturb_mask_boundary
from getagrip.synthetic.scene import clip_name, make_scene, render_pictures, synthesise
from getagrip.synthetic.scene_options import SYNTHETIC_PRESETS, SceneOptions
from helpers.scenes import SHORT, scene

FEW = SHORT


def in_hand(clip: Clip) -> np.ndarray:
    return se3.inverse(clip.truth.T_cam_hand) @ clip.truth.T_cam_obj


@pytest.mark.slow
def test_the_same_seed_gives_the_same_clip() -> None:
    options = replace(FEW, hand_jitter_deg=2.0, hand_jitter_mm=3.0, mask_ragged_px=1.5)
    (a, masks_a), (b, masks_b) = (synthesise("bowl", 5, options) for _ in range(2))
    assert np.array_equal(a.hand.T_cam_hand, b.hand.T_cam_hand)
    assert np.array_equal(masks_a.object, masks_b.object)
    other, _ = synthesise("bowl", 6, options)
    assert not np.allclose(a.hand.T_cam_hand, other.hand.T_cam_hand)


@pytest.mark.slow
def test_left_clips_are_mirror_images() -> None:
    right, masks_right = synthesise("mug", 3, replace(FEW, other_hand=True))
    left, masks_left = synthesise("mug", 3, replace(FEW, other_hand=True, side="left"))
    assert left.side == "left"
    assert np.array_equal(masks_left.object, masks_right.object[:, :, ::-1])
    assert np.array_equal(masks_left.ignore, masks_right.ignore[:, :, ::-1])
    assert np.array_equal(masks_left.hand, masks_right.hand[:, :, ::-1])
    assert not (masks_right.hand & ~masks_right.ignore).any()
    assert se3.is_rigid(left.truth.T_cam_obj).all()
    assert left.mesh.volume == pytest.approx(right.mesh.volume)
    # The thumb's tip lies on the other side, the palm looks the same way.
    np.testing.assert_allclose(left.hand.joints, right.hand.joints * [-1, 1, 1])
    # In a mirrored world whose up is the same.
    assert se3.is_rigid(left.world.T_world_cam).all()
    up_left, up_right = (
        np.einsum("nji,j->ni", world.T_world_cam[:, :3, :3], world.up) for world in (left.world, right.world)
    )
    np.testing.assert_allclose(up_left, up_right * [-1, 1, 1], atol=1e-12)
    np.testing.assert_allclose(np.diff(right.times), 1.0 / right.fps)


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.slow
def test_the_object_turns_about_the_axis_alone_without_a_residual(side: str) -> None:
    scene = make_scene("glass", 1, replace(FEW, side=side, residual_deg=0.0, residual_mm=0.0))
    T = in_hand(scene.clip)
    line = se3.rotation_about_line(scene.axis.point, scene.axis.direction, scene.axis.angle - scene.axis.angle[0])
    np.testing.assert_allclose(T, line @ T[0], atol=1e-9)


@pytest.mark.slow
def test_the_residual_and_the_turn_keep_to_their_limits() -> None:
    options = replace(FEW, frames=8, residual_deg=1.0, residual_mm=1.0, turn_deg=(15.0, 40.0))
    for category, seed in [("bowl", 0), ("spoon", 1)]:
        scene = make_scene(category, seed, options)
        exact = make_scene(category, seed, replace(options, residual_deg=0.0, residual_mm=0.0))
        assert np.radians(14.9) < np.ptp(scene.axis.angle) < np.radians(40.1)
        off = in_hand(scene.clip) @ se3.inverse(in_hand(exact.clip))
        turn = np.linalg.norm(se3.log_so3(off[:, :3, :3]), axis=1)
        at = se3.transform(off, scene.axis.point[None])[:, 0] - scene.axis.point
        assert turn.max() <= np.radians(1.0) * np.sqrt(3.0)
        assert np.linalg.norm(at, axis=1).max() <= 1e-3 * np.sqrt(3.0)


@pytest.mark.slow
def test_noise_leaves_the_truth_alone() -> None:
    noisy = replace(FEW, hand_bias_deg=3.0, hand_bias_mm=6.0)
    (clean, _), (other, _) = scene("cup", 0, FEW), synthesise("cup", 0, noisy)
    np.testing.assert_array_equal(clean.truth.T_cam_obj, other.truth.T_cam_obj)
    np.testing.assert_array_equal(clean.truth.T_cam_hand, other.truth.T_cam_hand)
    off = se3.inverse(other.truth.T_cam_hand) @ other.hand.T_cam_hand
    np.testing.assert_allclose(np.linalg.norm(se3.log_so3(off[:, :3, :3]), axis=1), np.radians(3.0), rtol=1e-6)
    middle = other.hand.vertices.mean(axis=(0, 1))
    moved = se3.transform(off, middle[None])[:, 0] - middle
    np.testing.assert_allclose(np.linalg.norm(moved, axis=1), 6e-3, rtol=1e-6)


@pytest.mark.slow
def test_jitter_has_the_given_size() -> None:
    clip, _ = synthesise("spoon", 0, SceneOptions(frames=200, size=(64, 48), focal=60.0, hand_jitter_deg=2.0))
    off = se3.inverse(clip.truth.T_cam_hand) @ clip.hand.T_cam_hand
    rms = np.sqrt(np.mean(np.sum(se3.log_so3(off[:, :3, :3]) ** 2, axis=1)))
    assert np.degrees(rms) == pytest.approx(2.0, rel=0.15)


@pytest.mark.slow
def test_a_free_scale_hides_the_size_and_nothing_else() -> None:
    (known, masks_known), (free, masks_free) = scene("bowl", 0, FEW), synthesise("bowl", 0, replace(FEW, scale="free"))
    assert free.truth.scale != 1.0
    np.testing.assert_allclose(free.truth.scale * free.mesh.vertices, known.mesh.vertices, atol=1e-12)
    assert (masks_known.object != masks_free.object).mean() < 1e-4


def test_ragged_masks_move_by_the_given_distance() -> None:
    mask = np.zeros((200, 400), dtype=bool)
    mask[100:] = True
    moved = perturb_mask_boundary(mask, 2.0, np.random.default_rng(0))
    height = moved.sum(axis=0) - 100
    assert np.sqrt(np.mean(height**2.0)) == pytest.approx(2.0, abs=0.7)
    assert abs(np.mean(height)) < 0.7


@pytest.mark.slow
def test_a_mean_cad_is_aligned_with_the_object_it_stands_for() -> None:
    options = replace(FEW, cad="mean", vary=0.15, scale="free")
    scene = make_scene("mug", 3, options)
    exact = make_scene("mug", 3, replace(options, cad="exact"))
    truth = scene.clip.truth
    np.testing.assert_allclose(  # the same object is seen
        se3.transform(truth.T_cam_obj, scene.object.vertices),
        se3.transform(exact.clip.truth.T_cam_obj, exact.object.vertices),
        atol=1e-9,
    )
    cad = Mesh(truth.scale * scene.clip.mesh.vertices, scene.clip.mesh.faces)
    T, size = align_similarity(cad, scene.object, resize=True)  # nothing is left to align
    np.testing.assert_allclose(T, np.eye(4), atol=1e-9)
    assert size == pytest.approx(1.0)
    off = np.linalg.norm(cad.vertices - scene.object.vertices, axis=1).mean()
    assert 0.003 < off / scene.object.diameter < 0.08


@given(seed=st.integers(0, 2**31), size=st.floats(0.5, 2.0), w=st.lists(st.floats(-1.5, 1.5), min_size=3, max_size=3))
@settings(max_examples=20, deadline=None)
def test_alignment_undoes_any_similarity(seed: int, size: float, w: list[float]) -> None:
    rng = np.random.default_rng(seed)
    cad = SYNTHETIC_CATEGORIES["cup"]()
    T = se3.rigid(se3.exp_so3(np.array(w)), rng.normal(size=3))
    held = Mesh(se3.transform(T, size * cad.vertices), cad.faces)
    found, factor = align_similarity(cad, held, resize=True)
    np.testing.assert_allclose(found, T, atol=1e-6)
    assert factor == pytest.approx(size)


@pytest.mark.parametrize("preset", SYNTHETIC_PRESETS)
def test_splits_are_disjoint_and_hold_every_category_and_both_hands(preset: str) -> None:
    train, test = clips_of_split("train", preset), clips_of_split("validation", preset)
    assert not {(category, seed) for category, seed, _ in train} & {(category, seed) for category, seed, _ in test}
    for clips in (train, test):
        assert {category for category, _, _ in clips} == set(SYNTHETIC_CATEGORIES)
        for category in SYNTHETIC_CATEGORIES:
            assert {o.side for c, _, o in clips if c == category} == {"left", "right"}
        assert 0.15 < np.mean([o.other_hand for _, _, o in clips]) < 0.45
        assert len({clip_name(*clip) for clip in clips}) == len(clips)
    assert len(test) > 190
    assert len(train) > 90
    assert clips_of_split("validation", preset) == test


@pytest.mark.slow
def test_presets_share_their_truth() -> None:
    (category, seed, clean), (_, _, noisy) = (
        clips_of_split("validation", preset)[4] for preset in ("clean", "moderate")
    )
    few = {"frames": 3, "size": (160, 120), "focal": 150.0}
    (a, _), (b, _) = (synthesise(category, seed, replace(o, **few)) for o in (clean, noisy))
    np.testing.assert_array_equal(a.truth.T_cam_obj, b.truth.T_cam_obj)
    assert not np.allclose(a.hand.T_cam_hand, b.hand.T_cam_hand)
    for wrong, what in ((("validation", "dirty"), "--preset 'dirty'"), (("test", "clean"), "split 'test'")):
        with pytest.raises(UsageError, match=f"unknown {what}"):
            clips_of_split(*wrong)


@pytest.mark.slow
def test_clips_survive_their_folder(tmp_path) -> None:
    clip, masks = scene("pan", 0, FEW)
    images = render_pictures(make_scene("pan", 0, FEW))
    back = read_clip(write_clip(clip, masks, tmp_path / "pan", images))
    assert back.name == clip.name
    np.testing.assert_allclose(back.hand.T_cam_hand, clip.hand.T_cam_hand, atol=1e-6)
    assert np.array_equal(read_masks(back).object, masks.object)
    assert images[0].shape == (240, 320, 3)


def test_impossible_scenes_are_refused_by_name() -> None:
    with pytest.raises(UsageError, match="bottle"):
        synthesise("teapot", 0)
    with pytest.raises(UsageError, match=r"frames must be .*got 1"):
        synthesise("can", 0, SceneOptions(frames=1))
    with pytest.raises(UsageError, match=r"seed must be 0 or more.*got -1"):
        synthesise("can", -1)
