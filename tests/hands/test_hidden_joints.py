"""Joints that are not seen are kept off the background: laws of the cost, and fingers that it moves."""

from __future__ import annotations

import numpy as np
import pytest

from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.hands import generic
from getagrip.hands.fit_joints import Chains, PosePrior, joints_and_jacobian
from getagrip.hands.from_2d.landmarks import hands_from_landmarks
from getagrip.hands.from_2d.rigid_pnp import OcclusionDistances

K = np.array([[500.0, 0.0, 160.0], [0.0, 500.0, 160.0], [0.0, 0.0, 1.0]])
SIZE = 320


def disc(x: float, y: float, radius: float) -> np.ndarray:
    """Pixels within a circle."""
    v, u = np.mgrid[:SIZE, :SIZE] + 0.5
    return np.asarray((u - x) ** 2 + (v - y) ** 2 < radius**2)


def test_the_distance_is_that_to_the_nearest_pixel_that_may_hide() -> None:
    hiding = OcclusionDistances.of(disc(100.0, 160.0, 40.0)[None], 1.0)
    value, slope = hiding.at(np.array([[[100.0, 160.0], [200.0, 160.0], [100.0, 260.0], [-50.0, 10.0], [1e9, np.nan]]]))
    np.testing.assert_allclose(value, [[0.0, 60.0, 60.0, 0.0, 0.0]], atol=1.5)
    np.testing.assert_allclose(slope[0, 1:3], [[1.0, 0.0], [0.0, 1.0]], atol=0.1)
    assert not slope[0, [0, 3, 4]].any()


def test_reduced_images_measure_in_pixels_of_the_whole() -> None:
    small = disc(100.0, 160.0, 40.0)[1::2, 1::2]
    value, slope = OcclusionDistances.of(small[None], 0.5).at(np.array([[[200.0, 160.0]]]))
    assert value[0, 0] == pytest.approx(60.0, abs=4.0)
    np.testing.assert_allclose(slope[0, 0], [1.0, 0.0], atol=0.1)


def test_a_frame_about_which_nothing_is_known_costs_nothing() -> None:
    hiding = OcclusionDistances.of(np.zeros((1, SIZE, SIZE), bool), 1.0)
    value, slope = hiding.at(np.array([[[10.0, 300.0]]]))
    assert not value.any()
    assert not slope.any()


def test_some_frames_are_no_copy_of_the_distances() -> None:
    """Those of hundreds of frames are most of what a server takes while it lifts a hand again."""
    every = OcclusionDistances.of(np.stack([disc(100.0, 160.0, r) for r in (20.0, 40.0, 60.0)]), 1.0)
    some = every.take(np.array([2, 0])).take(np.array([0]))
    assert np.shares_memory(some.distance, every.distance)
    point = np.array([[[200.0, 160.0]]])
    np.testing.assert_array_equal(some.at(point)[0], every.at(np.tile(point, (3, 1, 1)))[0][2:])


def test_derivatives_of_the_cost() -> None:
    model = generic.load("right")
    chains, prior = Chains.of(model), PosePrior.of(model)
    q, shape = np.tile(prior.mean, (1, 1, 1, 1)), np.zeros(len(model.shape_names))
    X, J = joints_and_jacobian(chains, q, shape)
    T = se3.rigid(np.eye(3), np.array([0.0, 0.0, 0.4]))[None]
    hiding, noise = OcclusionDistances.of(disc(120.0, 150.0, 30.0)[None], 1.0), np.full((1, 21), 4.0)
    costs, H, g = hiding.equations(K, noise, T, X, J)
    assert costs[0] > 1.0
    assert (np.linalg.eigvalsh(H) > -1e-6 * np.abs(H).max()).all()
    h = 1e-6
    for k in range(45):
        step = np.zeros(45)
        step[k] = h
        up, down = (
            hiding.equations(K, noise, T, *joints_and_jacobian(chains, q + s * step.reshape(q.shape), shape))[0]
            for s in (1.0, -1.0)
        )
        assert g[0, 6 + k] == pytest.approx((up[0] - down[0]) / (4.0 * h), abs=2e-3 * np.abs(g).max())


@pytest.mark.slow
def test_a_finger_drawn_before_the_background_is_bent_away() -> None:
    """Landmarks of an open hand; the masks say that nothing is seen where two fingers are drawn."""
    model = generic.load("left")
    chains, prior = Chains.of(model), PosePrior.of(model)
    T, wrong = 6, [14, 15, 16, 18, 19, 20]
    X, _ = joints_and_jacobian(chains, np.tile(prior.mean, (T, 1, 1, 1)), np.zeros(len(model.shape_names)))
    R = se3.exp_so3(np.array([-0.5 * np.pi, 0.0, 0.0]))
    points = project(K, se3.transform(se3.rigid(R, np.array([0.0, 0.0, 0.35])), X))
    possible = np.zeros((SIZE, SIZE), bool)
    for k in set(range(21)) - set(wrong):
        possible |= disc(*points[0, k], 10.0)
    hiding = OcclusionDistances.of(np.tile(possible, (T, 1, 1)), 1.0)
    assert (hiding.at(points)[0][:, wrong] > 10.0).any()
    sure = np.ones((T, 21))
    off = {}
    for name, known in (("free", None), ("masks", hiding)):
        found = hands_from_landmarks(points, sure, K, "left", None, known).hand
        assert found.joints is not None
        off[name] = hiding.at(project(K, se3.transform(found.T_cam_hand, found.joints)))[0]
    assert off["masks"][:, wrong].mean() < 0.5 * off["free"][:, wrong].mean()
    assert off["masks"].max() < off["free"].max()
