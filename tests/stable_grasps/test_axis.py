"""The best hinge: no pose and no other hinge is nearer, its gradient is right; measures of the residual."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from getagrip.geometry import se3
from getagrip.stable_grasps.axis import (
    LOGNORMAL_MEASURES,
    N_SPECTRUM_MODES,
    AxisRotation,
    _HingeTangents,
    _minimise_hinge,
    mean_rotation,
    measure_motion,
    parabola_share,
    pose_hinge,
    rotation_hinge,
    spectrum,
)
from helpers.measures import correlation_time
from helpers.scenes import unit

PosesInCamera = tuple[np.ndarray, np.ndarray]
SIZE = 0.05
AT_HAND = np.zeros(3)
seeds = st.integers(0, 10_000)


def exact(
    rng: np.random.Generator, through: np.ndarray | None = None, frames: int = 20
) -> tuple[AxisRotation, PosesInCamera]:
    """A random hinge and poses on it, less than a full turn apart."""
    point = 0.1 * rng.normal(size=3) if through is None else through
    hinge = AxisRotation(se3.exp_so3(2.0 * rng.normal(size=3)), unit(rng), point, 0.1 * rng.normal(size=3), SIZE)
    return hinge, hinge.at(rng.uniform(-1.2, 1.2, frames))


def noisy(rng: np.random.Generator, noise: float) -> PosesInCamera:
    R, c = exact(rng)[1]
    return se3.exp_so3(noise * rng.normal(size=(len(R), 3))) @ R, c + noise * SIZE * rng.normal(size=c.shape)


def static_energy(R: np.ndarray, c: np.ndarray, size: float = SIZE) -> float:
    return float(np.sum((R - mean_rotation(R)) ** 2) + np.sum((c - c.mean(axis=0)) ** 2) / size**2)


def each_energy(found: PosesInCamera, true: PosesInCamera, size: float) -> np.ndarray:
    """E of each frame."""
    return np.asarray(
        np.sum((found[0] - true[0]) ** 2, axis=(1, 2)) + np.sum((found[1] - true[1]) ** 2, axis=1) / size**2
    )


@settings(max_examples=6)
@given(seeds)
@pytest.mark.slow
def test_angles_are_the_best_of_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    R, c = noisy(rng, 0.5)
    for size in (SIZE, np.inf):
        hinge = replace(exact(rng)[0], size=size)
        least = each_energy(hinge.nearest(R, c), (R, c), size)
        assert hinge.energy(R, c) == pytest.approx(least.sum())
        for angle in np.linspace(-np.pi, np.pi, 181):
            assert np.all(least <= each_energy(hinge.at(np.full(len(R), angle)), (R, c), size) + 1e-9)


@settings(max_examples=4)
@given(seeds)
@pytest.mark.slow
def test_an_exact_hinge_is_found_exactly(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for through in (None, AT_HAND):
        true, (R, c) = exact(rng, through)
        for found in (rotation_hinge(R, c), pose_hinge(R, c, SIZE, through)):
            assert np.linalg.norm(np.cross(found.direction, true.direction)) < 1e-5
            np.testing.assert_allclose(found.nearest(R, c)[0], R, atol=1e-6)
            if found.size == SIZE or through is None:
                np.testing.assert_allclose(found.nearest(R, c)[1], c, atol=1e-6)
        across = found.point - true.point
        assert np.linalg.norm(np.cross(across, true.direction)) < 1e-4


@settings(max_examples=3)
@given(seeds, st.sampled_from([0.0, 0.03, 0.3, 3.0]))
@pytest.mark.slow
def test_a_hinge_is_never_worse_than_one_pose(seed: int, noise: float) -> None:
    rng = np.random.default_rng(seed)
    R, c = noisy(rng, noise)
    static = static_energy(R, c)
    assert rotation_hinge(R, c).energy(R, c) <= static_energy(R, c, np.inf) + 1e-9
    free = pose_hinge(R, c, SIZE).energy(R, c)
    at_hand = pose_hinge(R, c, SIZE, AT_HAND).energy(R, c)
    assert free <= at_hand + 1e-6 * static + 1e-9  # one that passes anywhere may pass there
    assert at_hand <= static + 1e-9


@settings(max_examples=10)
@given(seeds, st.sampled_from([0.03, 0.3, 3.0]))
@pytest.mark.slow
def test_no_hinge_fits_rotations_better(seed: int, noise: float) -> None:
    rng = np.random.default_rng(seed)
    R, c = noisy(rng, noise)
    best = rotation_hinge(R, c)
    for _ in range(50):
        other = replace(best, R=se3.exp_so3(rng.normal(size=3)) @ best.R, direction=unit(rng))
        near = replace(
            best,
            R=se3.exp_so3(0.02 * rng.normal(size=3)) @ best.R,
            direction=se3.exp_so3(0.02 * rng.normal(size=3)) @ best.direction,
        )
        for hinge in (other, near):
            assert best.energy(R, c) <= hinge.energy(R, c) + 1e-9


@pytest.mark.parametrize("free", [True, False])
def test_the_gradient_is_that_of_finite_differences(free: bool) -> None:
    rng = np.random.default_rng(3)
    R, c = noisy(rng, 0.3)
    moves = _HingeTangents.of(exact(rng)[0], free)
    x = 0.3 * rng.normal(size=11 if free else 8)

    def energy(x: np.ndarray) -> float:
        return moves.hinge(x).energy(R, c)

    hinge = moves.hinge(x)
    angles = hinge.angles(R, c)
    R_found, c_found = hinge.at(angles)
    off = np.concatenate([(R_found - R).reshape(-1, 9), (c_found - c) / SIZE], axis=1).ravel()
    steps = 1e-6 * np.eye(len(x))
    differences = [(energy(x + step) - energy(x - step)) / 2e-6 for step in steps]
    np.testing.assert_allclose(
        2.0 * moves.jacobian(x, angles).T @ off, differences, atol=1e-6 * np.abs(differences).max()
    )


@pytest.mark.parametrize("noise", [0.05, 0.5])
@pytest.mark.parametrize("through", [None, AT_HAND], ids=["anywhere", "at the hand"])
@pytest.mark.slow
def test_random_restarts_find_no_better_hinge(noise: float, through: np.ndarray | None) -> None:
    rng = np.random.default_rng(int(100 * noise))
    R, c = noisy(rng, noise)
    best = pose_hinge(R, c, SIZE, through).energy(R, c)
    for _ in range(5):
        start = replace(exact(rng, through)[0], R=se3.exp_so3(2.0 * rng.normal(size=3)))
        assert best <= _minimise_hinge(start, R, c, through, 60).energy(R, c) * (1.0 + 1e-6)


@pytest.mark.slow
def test_the_hand_frame_does_not_matter_for_an_axis_anywhere() -> None:
    rng = np.random.default_rng(0)
    R, c = noisy(rng, 0.2)
    Q, t = se3.exp_so3(rng.normal(size=3)), rng.normal(size=3)
    one, other = pose_hinge(R, c, SIZE), pose_hinge(Q @ R, c @ Q.T + t, SIZE)
    assert one.energy(R, c) == pytest.approx(other.energy(Q @ R, c @ Q.T + t), rel=1e-6)
    assert np.linalg.norm(np.cross(Q @ one.direction, other.direction)) < 1e-3


def test_poses_that_do_not_move_have_no_error() -> None:
    rng = np.random.default_rng(1)
    R, c = np.tile(se3.exp_so3(rng.normal(size=3)), (5, 1, 1)), np.tile(rng.normal(size=3), (5, 1))
    for hinge in (rotation_hinge(R, c), pose_hinge(R, c, SIZE), pose_hinge(R, c, SIZE, AT_HAND)):
        np.testing.assert_allclose(hinge.nearest(R, c)[0], R, atol=1e-6)
        np.testing.assert_allclose(hinge.nearest(R, c)[1], c, atol=1e-6)


FPS, FRAMES = 30.0, 30
TIME = np.linspace(-1.0, 1.0, FRAMES)
CENTRE, OBJECT_SIZE = np.array([0.0, 0.04, 0.0]), 0.04
TOUCHED = np.array([[0.0, 0.0, 0.01], [0.01, 0.0, 0.01]])


def turning(deg: float) -> np.ndarray:
    """A hinge about the z axis through the origin of hand and object."""
    return se3.rotation_about_line(np.zeros(3), np.array([0.0, 0.0, 1.0]), np.radians(deg / 2.0) * TIME)


def wandering(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    w = np.cumsum(rng.normal(0.0, 0.01, (FRAMES, 3)), axis=0)
    return turning(25.0) @ se3.rigid(se3.exp_so3(w), 0.1 * w[:, ::-1])


def test_of_a_hinge_nothing_is_left() -> None:
    values, residual = measure_motion(turning(30.0), CENTRE, OBJECT_SIZE, TOUCHED, FPS)
    assert values["turn"] == pytest.approx(np.radians(30.0), rel=1e-4)
    assert values["rotation"] < 1e-6
    assert values["place"] < 1e-7
    assert values["drift"] < 1e-3
    assert values["duration"] == 1.0
    assert values["pivot"] == pytest.approx(0.005, rel=0.02)  # the middle of the two points, from the z axis
    ends = np.mean(TIME[-6:])  # the first fifth and the last
    assert values["slip"] == pytest.approx(0.005 * 2.0 * np.sin(np.radians(15.0) * ends), rel=0.01)
    np.testing.assert_allclose(np.abs(residual.hinge.direction), [0.0, 0.0, 1.0], atol=1e-4)


@pytest.mark.slow
def test_numbers_do_not_depend_on_the_frame_of_the_hand() -> None:
    T = wandering(0)
    moved = se3.rigid(se3.exp_so3(np.array([0.4, -1.0, 0.7])), np.array([0.1, 0.2, -0.3]))
    (a, _), (b, _) = (measure_motion(poses, CENTRE, OBJECT_SIZE, TOUCHED, FPS) for poses in (T, moved @ T))
    assert set(a) == set(LOGNORMAL_MEASURES)
    for name, value in a.items():
        assert b[name] == pytest.approx(value, rel=0.02, abs=1e-5), name


def test_an_axis_that_turns_round_has_drifted() -> None:
    half = np.radians(20.0) * np.linspace(0.0, 1.0, FRAMES // 2)
    first = se3.rotation_about_line(np.zeros(3), np.array([1.0, 0.0, 0.0]), half)
    second = se3.rotation_about_line(np.zeros(3), np.array([0.0, 1.0, 0.0]), half) @ first[-1]
    values, residual = measure_motion(np.concatenate([first, second]), CENTRE, OBJECT_SIZE, TOUCHED[:0], FPS)
    assert np.degrees(values["drift"]) == pytest.approx(90.0, abs=1.0)
    assert parabola_share(residual) > 0.8
    assert np.isnan(values["slip"])


@pytest.mark.slow
def test_the_correlation_time_of_a_slow_curve_is_longer() -> None:
    rng = np.random.default_rng(0)
    white = rng.normal(size=(3000, 3))
    assert correlation_time(white, FPS) < 1.0 / FPS
    slow = np.stack([np.convolve(x, np.exp(-np.arange(150) / 15.0)) for x in white.T], axis=-1)
    assert correlation_time(slow, FPS) == pytest.approx(0.5, rel=0.15)
    assert np.isnan(correlation_time(np.zeros((30, 3)), FPS))


@pytest.mark.parametrize("mode", [1, 3, N_SPECTRUM_MODES - 1, N_SPECTRUM_MODES, 20])
def test_a_cosine_is_one_line_of_the_spectrum_and_the_last_has_what_is_faster(mode: int) -> None:
    curve = np.cos(np.pi * mode * (np.arange(FRAMES) + 0.5) / FRAMES)
    shares = spectrum(curve[:, None] + 5.0)
    assert shares[min(mode, N_SPECTRUM_MODES) - 1] == pytest.approx(1.0)
