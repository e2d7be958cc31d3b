"""How far contours move: in pixels, without what is hidden, and without the camera's own motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from getagrip.clip import Clip, Masks, World
from getagrip.geometry import camera, se3
from getagrip.timelines.detect.image_motion import ImageMotion, image_motion, visible_contour
from helpers.clips import small_clip

FRAMES = 6


def clip_of(size: tuple[int, int] = (160, 120)) -> Clip:
    clip, _ = small_clip(FRAMES)
    K = np.tile([[150.0, 0.0, 80.0], [0.0, 150.0, 60.0], [0.0, 0.0, 1.0]], (FRAMES, 1, 1))
    return replace(clip, size=size, K=K)


def squares(lefts: np.ndarray, side: int = 40) -> Masks:
    object_ = np.zeros((FRAMES, 120, 160), dtype=bool)
    for mask, left in zip(object_, lefts, strict=True):
        mask[30 : 30 + side, left : left + side] = True
    return Masks(object_, np.zeros_like(object_))


def test_what_stays_has_not_moved() -> None:
    moved = image_motion(clip_of(), squares(np.full(FRAMES, 50)), 3).moved
    assert np.isnan(moved[2, :3]).all()
    assert np.isnan(moved[0, 0])
    np.testing.assert_array_equal(moved[~np.isnan(moved)], 0.0)


def test_a_shift_is_in_pixels_and_adds_up_over_frames() -> None:
    moved = image_motion(clip_of(), squares(50 + np.arange(FRAMES)), 3).moved
    # Half the contour of a square moves, the other half slides along itself.
    expected = 2 * 40 / (4 * 40 * np.pi / 4)
    np.testing.assert_allclose(moved[0, 1:], expected)
    np.testing.assert_allclose(moved[2, 3:], 3 * expected)


def test_what_is_hidden_moves_nothing() -> None:
    masks = squares(np.full(FRAMES, 50))
    object_, ignore = masks.object.copy(), masks.ignore.copy()
    for n in range(FRAMES):  # something passes before the object
        object_[n, :, 40 + 8 * n : 48 + 8 * n] = False
        ignore[n, :, 40 + 8 * n : 48 + 8 * n] = True
    moved = image_motion(clip_of(), Masks(object_, ignore), 2).moved
    np.testing.assert_array_equal(moved[~np.isnan(moved)], 0.0)


def test_an_object_that_is_all_hidden_says_nothing() -> None:
    masks = squares(np.full(FRAMES, 50))
    moved = image_motion(clip_of(), Masks(masks.object, ~masks.object), 2).moved
    assert np.isnan(moved).all()


def test_the_contour_of_a_disc_is_as_long_as_it_is() -> None:
    rows, cols = np.mgrid[:200, :200]
    disc = (rows - 100) ** 2 + (cols - 100) ** 2 < 60**2
    assert visible_contour(disc, np.zeros_like(disc)) == pytest.approx(2 * np.pi * 60, rel=0.02)
    assert visible_contour(np.zeros_like(disc), np.zeros_like(disc)) == 0.0


def test_a_moving_camera_does_not_move_what_lies_still() -> None:
    clip = clip_of()
    n = np.arange(FRAMES)[:, None]
    R = se3.exp_so3(n * [0.01, -0.02, 0.03])
    world = World(se3.rigid(R, n * [0.004, -0.006, 0.003]))
    T_cam_world = se3.inverse(world.T_world_cam)
    corners = np.array([[-0.06, -0.05, 0.4], [0.06, -0.05, 0.4], [0.06, 0.05, 0.4], [-0.06, 0.05, 0.4]])
    masks = drawn(clip, T_cam_world, corners)
    still = image_motion(replace(clip, world=world), masks, 4)
    shaken = image_motion(clip, masks, 4)
    assert np.nanmax(still.moved) < 0.05 * np.nanmax(shaken.moved)
    assert np.nanmin(shaken.moved[3]) > 4.0
    assert still.by_camera[3, 5] > 4.0
    assert np.all(shaken.by_camera == 0.0)


def test_jitter_is_told_from_motion() -> None:
    t = np.arange(80)
    rng = np.random.default_rng(0)
    speed = np.where(t < 30, 0.0, 1.5)

    def moved(jitter: float) -> ImageMotion:
        at, out = np.cumsum(speed), np.full((4, len(t)), np.nan)
        for lag in range(1, 5):
            shift = at[lag:] - at[:-lag]
            out[lag - 1, lag:] = np.hypot(shift, jitter * rng.uniform(0.9, 1.1, len(shift)))
        return ImageMotion(out, np.zeros_like(out))

    assert moved(0.0).jitter == pytest.approx(0.0, abs=1e-6)
    assert moved(0.8).jitter == pytest.approx(0.8, abs=0.15)
    assert ImageMotion(np.full((4, 5), np.nan), np.zeros((4, 5))).jitter == 0.0


def drawn(clip: Clip, T_cam_world: np.ndarray, corners: np.ndarray) -> Masks:
    """Masks of a flat thing [m, in the world]."""
    import cv2

    object_ = np.zeros((FRAMES, 120, 160), dtype=np.uint8)
    for mask, K, T in zip(object_, clip.K, T_cam_world, strict=True):
        uv = camera.project(K, se3.transform(T, corners))
        cv2.fillPoly(mask, [np.round(256.0 * (uv - 0.5)).astype(np.int32)], 1, shift=8)
    return Masks(object_.astype(bool), np.zeros((FRAMES, 120, 160), dtype=bool))
