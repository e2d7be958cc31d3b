"""ARCTIC's metrics of motion: known answers, and the plain double loop."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from getagrip.geometry import se3
from getagrip.metrics.motion import (
    ARCTIC_CONTACT_DISTANCE_M,
    ContactPairs,
    acceleration_error,
    contact_deviation,
    motion_deviation,
    root_error,
    vertex_success,
)

T = 20
TIME = np.arange(T) / 30.0


def held(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A body, and the vertices of a hand that touches it in a few of them, carried together through the camera."""
    rng = np.random.default_rng(seed)
    body = rng.uniform(-0.05, 0.05, (40, 3))
    hand = np.concatenate([body[:5] + rng.normal(0.0, 2e-4, (5, 3)), body[:6] + 0.3])
    T_cam = se3.rigid(se3.exp_so3(np.cumsum(rng.normal(0.0, 0.05, (T, 3)), axis=0)), rng.normal(0.0, 0.1, (T, 3)))
    return body, se3.transform(T_cam, np.tile(hand, (T, 1, 1))), se3.transform(T_cam, np.tile(body, (T, 1, 1)))


@given(st.integers(0, 10**6))
@settings(max_examples=20, deadline=None)
def test_pairs_are_those_of_the_double_loop(seed: int) -> None:
    _, hand, object_ = held(seed)
    pairs = ContactPairs.of(hand, object_)
    distance = np.linalg.norm(hand[:, :, None] - object_[:, None], axis=-1)
    np.testing.assert_allclose(pairs.distance, distance.min(axis=2))
    np.testing.assert_array_equal(pairs.nearest, distance.argmin(axis=2))
    assert pairs.touching.sum() == 5 * T


@given(st.integers(0, 10**6), st.floats(0.004, 0.2))
@settings(max_examples=20, deadline=None)
def test_a_hand_that_is_shifted_is_off_by_its_shift_and_moves_alike(seed: int, shift: float) -> None:
    body, hand, object_ = held(seed)
    pairs = ContactPairs.of(hand, object_)
    exact = contact_deviation(pairs, hand, object_)
    np.testing.assert_allclose(exact, pairs.distance[:, :5].mean(axis=1))
    moved = hand + shift * np.array([0.6, 0.0, 0.8])
    assert np.all(np.abs(contact_deviation(pairs, moved, object_) - shift) < exact + 1e-9)
    assert motion_deviation(pairs, body, moved, object_, TIME) == pytest.approx(
        motion_deviation(pairs, body, hand, object_, TIME)
    )
    np.testing.assert_allclose(root_error((moved, object_), (hand, object_)), shift)


def test_a_hand_that_shakes_deviates_by_twice_its_shake() -> None:
    body, hand, object_ = held(3)
    pairs = ContactPairs.of(hand, object_)
    shaken = np.tile(object_[:1], (T, 1, 1)), np.tile(hand[:1], (T, 1, 1))
    shaken[1][::2] += [0.0, 0.01, 0.0]
    assert motion_deviation(pairs, body, shaken[1], shaken[0], TIME) == pytest.approx(0.01)


def test_contact_that_is_short_slides_or_is_missing_does_not_count() -> None:
    body, hand, object_ = held(4)
    pairs = ContactPairs.of(hand, object_)
    short = slice(0, 14)
    some = ContactPairs(pairs.nearest[short], pairs.distance[short])
    assert np.isnan(motion_deviation(some, body, hand[short], object_[short], TIME[short]))
    sliding = ContactPairs(np.tile(np.arange(T)[:, None], (1, hand.shape[1])), pairs.distance)
    assert np.isnan(motion_deviation(sliding, body, hand, object_, TIME))
    for end in (0, -1):  # in one frame alone, far enough for the mean over pairs of frames
        once = np.zeros(pairs.nearest.shape, int)
        once[end] = np.argmax(np.linalg.norm(body - body[0], axis=1))
        slid = motion_deviation(ContactPairs(once, pairs.distance), body, hand, object_, TIME)
        assert np.isnan(slid), end
    apart = ContactPairs(pairs.nearest, pairs.distance + ARCTIC_CONTACT_DISTANCE_M)
    assert np.isnan(contact_deviation(apart, hand, object_)).all()


def test_acceleration_is_that_of_the_vertices_about_their_middle() -> None:
    rng = np.random.default_rng(5)
    true = np.tile(rng.normal(size=(1, 8, 3)), (T, 1, 1))
    pull = rng.normal(size=(8, 3))
    pull -= pull.mean(axis=0)
    common = np.cumsum(rng.normal(size=(T, 1, 3)), axis=0)  # moves the middle, and does not count
    found = acceleration_error(true + 0.5 * TIME[:, None, None] ** 2 * pull + common, true, TIME)
    assert np.isnan(found[[0, -1]]).all()
    np.testing.assert_allclose(found[1:-1], np.linalg.norm(pull, axis=1).mean())
    gap = TIME + 0.1 * (np.arange(T) > 7)
    assert np.isnan(acceleration_error(true, true, gap)[[7, 8]]).all()


def test_vertices_are_right_relative_to_the_middle() -> None:
    true = np.random.default_rng(6).normal(size=(T, 10, 3))
    off = true + 5.0
    off[:, :2, 0] += [0.4, -0.4]  # their middle stays
    np.testing.assert_allclose(vertex_success(off, true, diameter=2.0), 0.8)
    np.testing.assert_allclose(vertex_success(true + 1.0, true, diameter=2.0), 1.0)
