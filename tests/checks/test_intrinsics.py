"""Intrinsics that are not of the images."""

from dataclasses import replace

import numpy as np
import pytest

from getagrip.checks import INPUT_CHECKS, Evidence, run_checks
from getagrip.checks.intrinsics import camera_warning, compute_intrinsics
from getagrip.errors import UsageError
from getagrip.geometry.lens import Lens
from helpers.clips import small_clip


def matrices(fx: float, fy: float, cx: float, cy: float) -> np.ndarray:
    return np.array([[[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]])


@pytest.mark.parametrize(
    "K", [(600, 600, 320, 240), (614, 613, 312.4, 241.6), (900, 900, 300, 262), (5000, 5000, 320, 240)]
)
def test_cameras_of_the_images_are_not_flagged(K: tuple[float, ...]) -> None:
    assert camera_warning(matrices(*K), (640, 480)) == ""


@pytest.mark.parametrize(
    ("K", "words"),
    [
        ((800, 800, 426.6, 320), "it fits images of 853 x 640"),
        ((900, 900, 480, 360), "it fits images of 960 x 720"),
        ((1200, 1200, 640, 480), "it fits images of 1280 x 960"),
        ((300, 300, 160, 120), "it fits images of 320 x 240"),
        ((600, 600, 240, 320), "it fits images of 480 x 640"),
        ((450, 600, 320, 240), "K fits images of 853 x 480 or 640 x 360"),
        ((50, 50, 320, 240), "889 px for 50 mm"),
        ((12500, 12500, 320, 240), "an estimator's own"),
    ],
)
def test_cameras_of_other_images_are_flagged_and_the_images_named(K: tuple[float, ...], words: str) -> None:
    assert words in camera_warning(matrices(*K), (640, 480))


def test_one_frame_with_another_camera_is_enough() -> None:
    K = np.concatenate([matrices(600, 600, 320, 240)] * 5 + [matrices(900, 900, 480, 360)])
    assert "960 x 720" in camera_warning(K, (640, 480))


def test_a_focal_length_in_millimetres_is_refused() -> None:
    with pytest.raises(UsageError, match=r"--focal must be in pixels \(got 50\).* mm\? The 35-mm .* 889 px for 50 mm"):
        compute_intrinsics(Lens(focal=50.0), (640, 480))


def test_a_clip_with_such_a_camera_has_a_serious_finding() -> None:
    clip, masks = small_clip()
    _, right = run_checks(INPUT_CHECKS.values(), Evidence(clip, masks))
    K = clip.K.copy()
    K[:, :2] *= 1.5
    _, found = run_checks(INPUT_CHECKS.values(), Evidence(replace(clip, K=K), masks))
    assert not {"principal-point", "field-of-view", "pixel-stretch"} & {one.check for one in right}
    (finding,) = (one for one in found if one.check == "principal-point")
    width, height = (round(1.5 * side) for side in clip.size)
    assert finding.serious
    assert f"it fits images of {width} x {height}" in finding.message
