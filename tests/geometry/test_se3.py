"""Rigid motions: maps and their inverses, composition, half turns."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from getagrip.geometry import se3

vectors = arrays(float, 3, elements=st.floats(-3.0, 3.0))
points = arrays(float, (5, 3), elements=st.floats(-3.0, 3.0))
units = vectors.filter(lambda v: np.linalg.norm(v) > 1e-2).map(lambda v: v / np.linalg.norm(v))
angles = st.sampled_from([0.0, 1e-12, 1e-9, 1e-6, 1e-4, 1e-3, np.pi - 1e-6, np.pi - 1e-9, np.pi]) | st.floats(
    0.0, np.pi
)
motions = st.builds(lambda w, t: se3.rigid(se3.exp_so3(w), t), vectors, vectors)


@given(a=vectors, b=vectors)
def test_hat_is_the_cross_product(a: np.ndarray, b: np.ndarray) -> None:
    np.testing.assert_allclose(se3.hat(a) @ b, np.cross(a, b), atol=1e-12)


@given(axis=units, angle=angles)
def test_rotation_vectors_survive_the_round_trip(axis: np.ndarray, angle: float) -> None:
    w = se3.log_so3(se3.exp_so3(angle * axis))
    # At half a turn both directions of the axis are the same rotation.
    near = min(np.abs(w - angle * axis).max(), np.abs(w + angle * axis).max() if angle > np.pi - 1e-6 else np.inf)
    assert near < 1e-7
    assert np.linalg.norm(w) <= np.pi + 1e-12


@given(w=vectors)
def test_exp_gives_rotations(w: np.ndarray) -> None:
    R = se3.exp_so3(w)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    np.testing.assert_allclose(se3.exp_so3(se3.log_so3(R)), R, atol=1e-7)


@pytest.mark.parametrize("axis", np.eye(3))
def test_half_turns_about_the_axes(axis: np.ndarray) -> None:
    R = 2.0 * np.outer(axis, axis) - np.eye(3)
    np.testing.assert_allclose(np.abs(se3.log_so3(R)), np.pi * axis)
    np.testing.assert_allclose(se3.exp_so3(np.pi * axis), R, atol=1e-15)


@given(w=vectors)
def test_quaternions_survive_the_round_trip(w: np.ndarray) -> None:
    R = se3.exp_so3(w)
    q = se3.quaternion(R)
    assert q[0] >= 0.0
    assert np.linalg.norm(q) == pytest.approx(1.0)
    np.testing.assert_allclose(se3.from_quaternion(3.0 * q), R, atol=1e-12)
    np.testing.assert_allclose(se3.from_quaternion(-q), R, atol=1e-12)


@given(a=motions, b=motions, X=points)
def test_adjacent_names_cancel(a: np.ndarray, b: np.ndarray, X: np.ndarray) -> None:
    np.testing.assert_allclose(se3.transform(a @ b, X), se3.transform(a, se3.transform(b, X)), atol=1e-9)
    np.testing.assert_allclose(se3.inverse(a) @ a, np.eye(4), atol=1e-9)
    np.testing.assert_allclose(se3.inverse(a @ b), se3.inverse(b) @ se3.inverse(a), atol=1e-9)


@given(point=vectors, axis=units, angle=st.floats(-3.0, 3.0), t=st.floats(-2.0, 2.0))
def test_a_line_stays_where_it_is_turned_about(point: np.ndarray, axis: np.ndarray, angle: float, t: float) -> None:
    T = se3.rotation_about_line(point, axis, np.array(angle))
    on_line = (point + t * axis)[None]
    np.testing.assert_allclose(se3.transform(T, on_line), on_line, atol=1e-9)
    back = se3.rotation_about_line(point, axis, np.array(-angle))
    np.testing.assert_allclose(back @ T, np.eye(4), atol=1e-9)
    assert se3.angle_between(np.eye(3), T[:3, :3]) == pytest.approx(abs(angle), abs=1e-6)


@given(T=motions)
def test_rigid_motions_are_distinguished_from_others(T: np.ndarray) -> None:
    assert se3.is_rigid(T)
    assert not se3.is_rigid(T @ np.diag([1.0, 1.0, -1.0, 1.0]))
    assert not se3.is_rigid(T @ np.diag([1.1, 1.1, 1.1, 1.0]))
    assert not se3.is_rigid(T.T + np.array([[0.0] * 4] * 3 + [[1.0, 0.0, 0.0, 0.0]]))


@given(w=vectors, noise=arrays(float, (3, 3), elements=st.floats(-0.1, 0.1)))
def test_the_nearest_rotation_is_one_and_no_other_is_nearer(w: np.ndarray, noise: np.ndarray) -> None:
    R = se3.exp_so3(w)
    np.testing.assert_allclose(se3.nearest_rotation(R), R, atol=1e-12)
    M = R + noise
    nearest = se3.nearest_rotation(M)
    assert se3.is_rigid(se3.rigid(nearest), tolerance=1e-9)
    assert np.linalg.norm(M - nearest) <= np.linalg.norm(noise) + 1e-12


def test_operations_take_batches() -> None:
    w = np.random.default_rng(0).standard_normal((2, 3, 3))
    for function in (se3.hat, se3.exp_so3):
        np.testing.assert_array_equal(function(w)[1, 2], function(w[1, 2]))
    R = se3.exp_so3(w)
    np.testing.assert_allclose(se3.log_so3(R)[1, 2], se3.log_so3(R[1, 2]))
    assert se3.rigid(R, np.zeros(3)).shape == (2, 3, 4, 4)


def test_super_fibonacci_covers_all_rotations() -> None:
    R = se3.super_fibonacci(50)
    probes = se3.exp_so3(np.random.default_rng(0).standard_normal((500, 3)) * 2.0)
    nearest = np.degrees(se3.angle_between(R[None], probes[:, None]).min(axis=1))
    assert nearest.mean() < 35.0
    assert nearest.max() < 70.0
