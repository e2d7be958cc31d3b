"""Lens distortion: what OpenCV puts into an image is taken out again, and coefficients of no lens are refused."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from getagrip.errors import UsageError
from getagrip.geometry.lens import Distortion

SIZE = (320, 240)
K = np.array([[250.0, 0.0, 163.0], [0.0, 252.0, 118.0], [0.0, 0.0, 1.0]])
LENSES = {
    "usual": Distortion((-0.25, 0.06, 0.002, -0.001, 0.01)),
    "four": Distortion((-0.2, 0.05, 0.0, 0.0)),
    "fisheye": Distortion((0.05, -0.01, 0.002, 0.001), fisheye=True),
}


def pattern(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """A smooth picture, by the place in it [px], pixel centres at halves."""
    return np.stack([128.0 + 90.0 * np.sin(u / 17.0), 128.0 + 90.0 * np.cos(v / 13.0), 128.0 + 0.0 * u], axis=-1)


@pytest.mark.parametrize("lens", LENSES)
def test_a_distorted_picture_is_as_a_pinhole_sees_it(lens: str) -> None:
    it = LENSES[lens]
    u, v = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    seen = np.stack([u, v], axis=-1).reshape(-1, 1, 2)
    maps = cv2.fisheye if it.fisheye else cv2
    through = maps.undistortPoints(seen, K, np.array(it.distortion), P=K).reshape(SIZE[1], SIZE[0], 2)
    distorted = pattern(through[..., 0], through[..., 1]).astype(np.uint8)
    straight = it.removal(K, SIZE)(distorted)
    inner = (slice(40, -40), slice(50, -50))
    off = np.abs(straight.astype(float) - pattern(u, v))[inner]
    assert off.max() < 4.0
    assert np.abs(distorted.astype(float) - pattern(u, v))[inner].max() > 20.0


def test_no_distortion_changes_nothing() -> None:
    image = np.random.default_rng(0).integers(0, 255, (SIZE[1], SIZE[0], 3), dtype=np.uint8)
    np.testing.assert_array_equal(Distortion((0.0,) * 5).removal(K, SIZE)(image), image)
    assert Distortion().words == ""
    assert "fisheye model, 0.05" in LENSES["fisheye"].words


def test_coefficients_of_no_lens_are_refused() -> None:
    for wrong, words in (
        (Distortion((0.1, 0.2, 0.3)), "4 or 5 or 8 or 12 or 14 [(]got 3"),
        (Distortion((0.1,) * 5, fisheye=True), "must be 4 [(]got 5"),
        (Distortion((90.0, 80.0, 0.0, 0.0)), "this lens's"),
    ):
        with pytest.raises(UsageError, match=words):
            wrong.removal(K, SIZE)
