"""Numbers of in-hand motion: what a hinge leaves, how fast it varies, what does not depend on where the hand is."""

from __future__ import annotations

import numpy as np
import pytest

from getagrip.geometry import se3
from getagrip.stable_grasps.axis import LOGNORMAL_MEASURES, N_SPECTRUM_MODES, measure_motion, parabola_share, spectrum
from helpers.measures import correlation_time

FPS, FRAMES = 30.0, 30
TIME = np.linspace(-1.0, 1.0, FRAMES)
CENTRE, SIZE = np.array([0.0, 0.04, 0.0]), 0.04
TOUCHED = np.array([[0.0, 0.0, 0.01], [0.01, 0.0, 0.01]])


def turning(deg: float) -> np.ndarray:
    """A hinge about the z axis through the origin of hand and object."""
    return se3.rotation_about_line(np.zeros(3), np.array([0.0, 0.0, 1.0]), np.radians(deg / 2.0) * TIME)


def wandering(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    w = np.cumsum(rng.normal(0.0, 0.01, (FRAMES, 3)), axis=0)
    return turning(25.0) @ se3.rigid(se3.exp_so3(w), 0.1 * w[:, ::-1])


def test_of_a_hinge_nothing_is_left() -> None:
    values, residual = measure_motion(turning(30.0), CENTRE, SIZE, TOUCHED, FPS)
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
    (a, _), (b, _) = (measure_motion(poses, CENTRE, SIZE, TOUCHED, FPS) for poses in (T, moved @ T))
    assert set(a) == set(LOGNORMAL_MEASURES)
    for name, value in a.items():
        assert b[name] == pytest.approx(value, rel=0.02, abs=1e-5), name


def test_an_axis_that_turns_round_has_drifted() -> None:
    half = np.radians(20.0) * np.linspace(0.0, 1.0, FRAMES // 2)
    first = se3.rotation_about_line(np.zeros(3), np.array([1.0, 0.0, 0.0]), half)
    second = se3.rotation_about_line(np.zeros(3), np.array([0.0, 1.0, 0.0]), half) @ first[-1]
    values, residual = measure_motion(np.concatenate([first, second]), CENTRE, SIZE, TOUCHED[:0], FPS)
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
