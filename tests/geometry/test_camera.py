"""Cameras: projecting, and crops that see what the image sees."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from getagrip.geometry.camera import Crops, backproject, bounding_boxes, crops_around, project

K = np.array([[600.0, 0.0, 321.0], [0.0, 610.0, 239.0], [0.0, 0.0, 1.0]])
pixels = arrays(float, (4, 2), elements=st.floats(-100.0, 800.0))


@given(uv=pixels, depth=st.floats(0.1, 10.0))
def test_what_is_backprojected_projects_back(uv: np.ndarray, depth: float) -> None:
    np.testing.assert_allclose(project(K, depth * backproject(K, uv)), uv, atol=1e-8)
    np.testing.assert_allclose(backproject(K, uv)[:, 2], 1.0)


def test_the_axis_goes_through_the_principal_point() -> None:
    np.testing.assert_array_equal(project(K, np.array([[0.0, 0.0, 2.0]])), [[321.0, 239.0]])
    # x to the right, y down
    u, v = project(K, np.array([[0.1, 0.2, 1.0]]))[0]
    assert (u, v) == (381.0, 361.0)


@given(uv=pixels, corner=arrays(float, (1, 2), elements=st.floats(-50.0, 300.0)), side=st.floats(50.0, 500.0))
def test_crops_move_and_zoom_the_image(uv: np.ndarray, corner: np.ndarray, side: float) -> None:
    crops = Crops(corner, side, size=64)
    X = backproject(K, uv)
    np.testing.assert_allclose(project(crops.intrinsics(K[None])[0], X), (uv - corner) * 64 / side, atol=1e-6)


def test_resampling_agrees_with_projecting() -> None:
    """A pixel of the crop holds the image pixel through whose square the same ray goes."""
    rng = np.random.default_rng(0)
    image = rng.integers(1, 255, (1, 48, 64)).astype(np.uint8)
    crops = Crops(np.array([[7.3, -4.6]]), side=57.7, size=40)
    crop = crops.resample(image, outside=0)[0]
    K_crop = crops.intrinsics(K[None])[0]
    rows, cols = np.mgrid[:40, :40]
    centres = np.stack([cols + 0.5, rows + 0.5], axis=-1).reshape(-1, 2)
    u, v = np.floor(project(K, backproject(K_crop, centres))).astype(int).T
    inside = (u >= 0) & (u < 64) & (v >= 0) & (v < 48)
    expected = np.where(inside, image[0][np.clip(v, 0, 47), np.clip(u, 0, 63)], 0)
    np.testing.assert_array_equal(crop.ravel(), expected)


def test_a_crop_of_the_whole_image_is_the_image() -> None:
    image = np.random.default_rng(0).integers(0, 255, (2, 32, 32)).astype(np.uint8)
    np.testing.assert_array_equal(Crops(np.zeros((2, 2)), 32.0, 32).resample(image, outside=0), image)


@given(masks=arrays(bool, (3, 9, 12)))
def test_bounding_boxes_hold_all_and_no_more(masks: np.ndarray) -> None:
    for mask, (u0, v0, u1, v1) in zip(masks, bounding_boxes(masks), strict=True):
        assert mask.sum() == mask[v0:v1, u0:u1].sum()
        if mask.any():
            inside = mask[v0:v1, u0:u1]
            assert inside[0].any()
            assert inside[-1].any()
            assert inside[:, 0].any()
            assert inside[:, -1].any()
        else:
            assert (u0, v0, u1, v1) == (0, 0, 0, 0)


def test_crops_are_centred_and_as_large_as_asked() -> None:
    masks = np.zeros((2, 100, 200), dtype=bool)
    masks[0, 10:30, 50:90] = True
    masks[1, 60:70, 150:160] = True
    crops = crops_around(masks, expand=1.5, size=32)
    assert crops.side == 1.5 * 40
    np.testing.assert_array_equal(crops.corner + crops.side / 2, [[70.0, 20.0], [155.0, 65.0]])
