"""VSD: known answers, and the plain definition pixel by pixel."""

from __future__ import annotations

import numpy as np
import pytest

from getagrip.metrics.pose import VSD_TOLERANCES, VSD_VISIBILITY_TOLERANCE_M, discrepancy, ray_lengths, vsd_recall

TOLERANCES = VSD_TOLERANCES * 0.1


def plain(predicted: np.ndarray, true: np.ndarray, scene: np.ndarray, tolerance: float) -> float:
    """BOP's definition, one pixel after the other."""
    cost = count = 0
    for p, t, s in zip(predicted.flat, true.flat, scene.flat, strict=True):
        visible_true = t > 0 and (s == 0 or t - s <= VSD_VISIBILITY_TOLERANCE_M)
        visible = p > 0 and (s == 0 or p - s <= VSD_VISIBILITY_TOLERANCE_M or visible_true)
        count += visible or visible_true
        cost += (visible or visible_true) and not (visible and visible_true and abs(p - t) < tolerance)
    return cost / count if count else 1.0


@pytest.mark.parametrize("seed", range(5))
def test_it_is_the_plain_definition(seed: int) -> None:
    rng = np.random.default_rng(seed)
    true = 0.5 + 0.01 * rng.normal(size=(6, 8))
    predicted, scene = true + 0.03 * rng.normal(size=true.shape), true + 0.02 * rng.normal(size=true.shape)
    for image in (true, predicted, scene):
        image[rng.random(true.shape) < 0.3] = 0.0
    expected = [plain(predicted, true, scene, tolerance) for tolerance in TOLERANCES]
    np.testing.assert_allclose(discrepancy(predicted, true, scene, TOLERANCES), expected)


def test_the_true_pose_has_none_and_one_elsewhere_is_all_wrong() -> None:
    true, elsewhere, scene = np.zeros((3, 4, 6))
    true[:, :2], elsewhere[:, 4:] = 0.5, 0.5
    assert vsd_recall(discrepancy(true, true, scene, TOLERANCES)) == 1.0
    assert vsd_recall(discrepancy(elsewhere, true, scene, TOLERANCES)) == 0.0
    np.testing.assert_array_equal(discrepancy(np.zeros((4, 6)), np.zeros((4, 6)), scene, TOLERANCES), 1.0)


def test_what_is_behind_the_scene_does_not_count() -> None:
    true, predicted, scene = np.full((2, 2), 0.5), np.full((2, 2), 0.5), np.zeros((2, 2))
    predicted[0], scene[0] = 0.6, 0.3  # wrong, behind a hand
    assert discrepancy(predicted, true, scene, TOLERANCES).max() == 0.0


def test_rays_are_as_long_as_points_of_depth_one_are_far() -> None:
    K = np.array([[50.0, 0.0, 3.0], [0.0, 60.0, 2.5], [0.0, 0.0, 1.0]])
    u, v = np.meshgrid(np.arange(4) + 0.5, np.arange(5) + 0.5)
    points = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(K).T
    np.testing.assert_allclose(ray_lengths(K, (4, 5)), np.linalg.norm(points, axis=-1))


def test_recall_is_over_bops_tolerances_and_thresholds() -> None:
    np.testing.assert_allclose(VSD_TOLERANCES, np.linspace(0.05, 0.5, 10))
    assert vsd_recall(np.array([0.0, 0.12, 0.47, 0.5])) == pytest.approx((1.0 + 0.8 + 0.1) / 4)
