"""Mask IOU: known answers and laws."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from getagrip.clip import Masks
from getagrip.geometry import se3
from getagrip.geometry.rasterize import render_coverage
from getagrip.metrics.mask import iou, iou_of_poses
from getagrip.synthetic import objects

MUG = objects.mug()
SIZE = (320, 240)
K = np.array([[400.0, 0.0, 160.0], [0.0, 400.0, 120.0], [0.0, 0.0, 1.0]])
images = arrays(bool, (6, 7))


def poses(frames: int = 3) -> np.ndarray:
    rng = np.random.default_rng(3)
    return se3.rigid(se3.exp_so3(rng.normal(size=(frames, 3))), rng.normal([0.0, 0.0, 0.5], 0.01, (frames, 3)))


def seen(T: np.ndarray, ignore: np.ndarray | None = None) -> Masks:
    drawn = np.stack([render_coverage(se3.transform(T_cam_obj, MUG.vertices), MUG.faces, K, SIZE) for T_cam_obj in T])
    return Masks(drawn, np.zeros_like(drawn) if ignore is None else ignore)


@given(images, images, images)
def test_iou_is_what_python_sets_say(a: np.ndarray, b: np.ndarray, ignore: np.ndarray) -> None:
    A, B = (set(np.flatnonzero(mask & ~ignore)) for mask in (a, b))
    found = float(iou(a, b, ignore))
    assert np.isnan(found) if not A | B else found == pytest.approx(len(A & B) / len(A | B))


@given(images, st.integers(0, 5))
def test_iou_of_a_mask_with_itself_is_one(mask: np.ndarray, row: int) -> None:
    mask = mask.copy()
    mask[row, 0] = True
    assert iou(mask, mask, np.zeros_like(mask)) == 1.0
    assert iou(mask, ~mask, np.zeros_like(mask)) == 0.0


def test_the_truth_fits_its_own_masks() -> None:
    T = poses()
    found = iou_of_poses(MUG, 1.0, T, np.stack([K] * 3), seen(T))
    np.testing.assert_array_equal(found.full, 1.0)
    assert found.crop.min() > 0.96  # the crop draws finer than the mask is
    assert found.soft.min() > 0.96


def test_soft_and_hard_iou_agree_but_for_border_pixels() -> None:
    T = poses()
    off = se3.rigid(t=np.array([0.01, 0.0, 0.0])) @ T
    found = iou_of_poses(MUG, 1.0, off, np.stack([K] * 3), seen(T))
    np.testing.assert_allclose(found.soft, found.crop, atol=0.01)
    np.testing.assert_allclose(found.full, found.crop, atol=0.02)
    assert found.full.max() < 0.95


def test_ignored_pixels_do_not_count() -> None:
    """With the right half ignored, what lies there makes no difference, seen or drawn."""
    T = poses()
    half = np.zeros((3, SIZE[1], SIZE[0]), dtype=bool)
    half[:, :, 160:] = True
    masks = seen(T, half)
    hidden = Masks(masks.object & ~half, half)
    whole = iou_of_poses(MUG, 1.0, T, np.stack([K] * 3), masks)
    np.testing.assert_array_equal(whole.full, 1.0)
    np.testing.assert_array_equal(iou_of_poses(MUG, 1.0, T, np.stack([K] * 3), hidden).full, 1.0)


@pytest.mark.parametrize("border", [(0.0, 120.0), (320.0, 120.0), (160.0, 0.0), (160.0, 240.0)])
def test_pixels_beyond_the_image_do_not_count(border: tuple[float, float]) -> None:
    """An object that the border cuts fits its own mask in the crop, of which a part lies beyond, as in the image."""
    T = poses()
    T[:, :3, 3] += 0.5 * np.linalg.inv(K) @ [*border, 1.0] - se3.transform(T, MUG.centre[None])[:, 0]
    found = iou_of_poses(MUG, 1.0, T, np.stack([K] * 3), seen(T))
    assert min(found.crop.min(), found.soft.min()) > 0.95
    np.testing.assert_array_equal(found.full, 1.0)


def test_a_prediction_outside_the_crop_scores_zero() -> None:
    T = poses()
    far = se3.rigid(t=np.array([10.0, 0.0, 0.0])) @ T
    found = iou_of_poses(MUG, 1.0, far, np.stack([K] * 3), seen(T))
    for values in (found.full, found.crop, found.soft):
        np.testing.assert_array_equal(values, 0.0)


def test_frames_in_which_the_object_is_not_observed_are_left_out() -> None:
    T = poses()
    masks = seen(T)
    masks.object[1] = False
    masks.ignore[2] = masks.object[2]
    found = iou_of_poses(MUG, 1.0, T, np.stack([K] * 3), masks)
    np.testing.assert_array_equal(np.isnan(found.full), [False, True, True])
    nothing = iou_of_poses(MUG, 1.0, T, np.stack([K] * 3), Masks(masks.object & False, masks.ignore))
    assert np.isnan(nothing.crop).all()


@given(st.floats(0.5, 2.0), st.floats(0.5, 2.0))
def test_one_view_does_not_distinguish_scale_from_depth(scale: float, focal: float) -> None:
    T = poses(1)[0]
    camera = np.diag([focal, focal, 1.0]) @ K
    far = T.copy()
    far[:3, 3] *= scale
    posed = (se3.transform(pose, s * MUG.vertices) for s, pose in ((1.0, T), (scale, far)))
    near, away = (render_coverage(vertices, MUG.faces, camera, SIZE) for vertices in posed)
    assert np.count_nonzero(near ^ away) <= 2
