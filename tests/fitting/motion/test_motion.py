"""Laws of the motion models: Jacobians against finite differences, what a model can and cannot do, gauges."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy import ndarray

from getagrip.fitting.motion import (
    Fixed,
    Free,
    Frozen,
    Hinge,
    Motion,
    PosesInHand,
    Soft,
    hand_object_transforms,
    tangents,
)
from getagrip.geometry import se3

B, N = 3, 4


def unit(v: ndarray) -> ndarray:
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def fixed(rng: np.random.Generator, **options: bool) -> Fixed:
    R, centre = se3.exp_so3(rng.normal(size=(B, 3))), rng.normal(0.0, 0.1, (B, 3))
    return Fixed(R, centre, rng.normal(0.0, 0.1, B), N, **options)


def hinge(rng: np.random.Generator, **options: bool) -> Hinge:
    base = fixed(rng)
    point, direction = rng.normal(0.0, 0.1, (B, 3)), unit(rng.normal(size=(B, 3)))
    angle = rng.normal(0.0, 0.7, (B, N))
    return Hinge(base.R, base.centre, base.log_scale, point, direction, angle, ridge=2.0, **options)


def free(rng: np.random.Generator, **options: bool) -> Free:
    R, centre = se3.exp_so3(rng.normal(size=(B, N, 3))), rng.normal(0.0, 0.1, (B, N, 3))
    return Free(R, centre, rng.normal(0.0, 0.1, B), **options)


def soft(core: Callable[..., Fixed | Hinge]) -> Callable[..., Soft[Fixed] | Soft[Hinge]]:
    def make(rng: np.random.Generator, **options: bool) -> Soft[Fixed] | Soft[Hinge]:
        return Soft(core(rng, **options), rng.normal(0.0, 0.2, (B, N, 6)), (3.0, 5.0))

    return make


MODELS: dict[str, Callable[[np.random.Generator], Motion]] = {
    "fixed": fixed,
    "fixed, scale": lambda rng: fixed(rng, free_scale=True),
    "hinge": hinge,
    "hinge, scale": lambda rng: hinge(rng, free_scale=True),
    "hinge at its place": lambda rng: hinge(rng, free_location=False),
    "hinge at its place, scale": lambda rng: hinge(rng, free_location=False, free_scale=True),
    "free": free,
    "free, scale": lambda rng: free(rng, free_scale=True),
    "soft": soft(fixed),
    "soft, scale": lambda rng: soft(fixed)(rng, free_scale=True),
    "soft hinge": soft(hinge),
    "soft hinge, scale": lambda rng: soft(hinge)(rng, free_scale=True),
    "frozen": lambda rng: Frozen(soft(hinge)(rng, free_scale=True)),
}
EVERY = pytest.mark.parametrize("make", MODELS.values(), ids=MODELS.keys())


def sizes(motion: Motion) -> tuple[int, int]:
    shared, local = motion.jacobian()
    return shared.shape[-1], local.shape[-1]


def larger(motion: Any, factor: float) -> Any:
    """The motion in another unit of length."""
    unit = {"centre": factor, "point": factor, "deviation": np.repeat([factor, 1.0], 3)}
    changed = {name: unit[name] * value for name, value in vars(motion).items() if name in unit}
    if hasattr(motion, "core"):
        changed["core"] = larger(motion.core, factor)
    return replace(motion, **changed)


@EVERY
def test_lengths_are_the_parameters_that_have_a_unit_of_length(make: Callable[..., Motion]) -> None:
    """In another unit places change as much by a length, and more by an angle."""
    motion, factor = make(np.random.default_rng(9)), 10.0
    for J, scaled, lengths in zip(motion.jacobian(), larger(motion, factor).jacobian(), motion.lengths(), strict=True):
        expected = J.copy()
        expected[..., :3, ~lengths] *= factor
        np.testing.assert_allclose(scaled, expected, atol=1e-12)
        assert not J[..., 3:, lengths].any()


def local_vectors(here: PosesInHand, there: PosesInHand) -> ndarray:
    """The local 7-vectors (B, N, 7) that take one motion's poses to another's (``se3``)."""
    v = there.centre - here.centre
    w = se3.log_so3(there.R @ np.swapaxes(here.R, -1, -2))
    scale = np.log(there.scale / here.scale)
    return np.concatenate([v, w, np.broadcast_to(scale[:, None, None], (*v.shape[:2], 1))], axis=-1)


@EVERY
def test_jacobians_are_finite_differences_of_moved(make: Callable[[np.random.Generator], Motion]) -> None:
    motion = make(np.random.default_rng(1))
    S, L = sizes(motion)
    J_shared, J_local = motion.jacobian()
    assert J_shared.shape == (B, N, 7, S)
    assert J_local.shape == (B, N, 7, L)
    h = 1e-6
    here = motion.poses()

    def difference(shared: ndarray, local: ndarray) -> ndarray:
        ahead, behind = (motion.retract(s * shared, s * local).poses() for s in (h, -h))
        return (local_vectors(here, ahead) - local_vectors(here, behind)) / (2.0 * h)

    for k in range(S):
        shared = np.zeros((B, S))
        shared[:, k] = 1.0
        np.testing.assert_allclose(difference(shared, np.zeros((B, N, L))), J_shared[..., k], atol=1e-7)
    for k in range(L):
        local = np.zeros((B, N, L))
        local[..., k] = 1.0
        np.testing.assert_allclose(difference(np.zeros((B, S)), local), J_local[..., k], atol=1e-7)


@EVERY
def test_a_frames_own_parameters_move_no_other_frame(make: Callable[[np.random.Generator], Motion]) -> None:
    rng = np.random.default_rng(2)
    motion = make(rng)
    S, L = sizes(motion)
    local = np.zeros((B, N, L))
    local[:, 1] = 0.1 * rng.normal(size=(B, L))
    change = local_vectors(motion.poses(), motion.retract(np.zeros((B, S)), local).poses())
    np.testing.assert_allclose(change[:, [0, 2, 3]], 0.0, atol=1e-12)


@EVERY
def test_steps_are_taken_to_first_order(make: Callable[[np.random.Generator], Motion]) -> None:
    rng = np.random.default_rng(3)
    motion = make(rng)
    S, L = sizes(motion)
    shared, local = rng.normal(size=(B, S)), rng.normal(size=(B, N, L))
    J_shared, J_local = motion.jacobian()
    linear = (J_shared @ shared[:, None, :, None] + J_local @ local[..., None])[..., 0]
    errors = []
    for h in (1e-2, 1e-3):
        change = local_vectors(motion.poses(), motion.retract(h * shared, h * local).poses())
        errors.append(np.abs(change - h * linear).max())
    assert errors[1] < 0.02 * errors[0] + 1e-12  # the rest shrinks with the square of the step


@EVERY
def test_poses_are_rigid_and_hypotheses_side_by_side(make: Callable[[np.random.Generator], Motion]) -> None:
    a, b = make(np.random.default_rng(4)), make(np.random.default_rng(5))
    held = a.poses()
    assert held.R.shape == (B, N, 3, 3)
    assert held.centre.shape == (B, N, 3)
    assert se3.is_rigid(se3.rigid(held.R, held.centre)).all()
    one = a.take(np.array([2])).poses()
    np.testing.assert_array_equal(one.R[0], held.R[2])
    np.testing.assert_array_equal(one.scale, held.scale[[2]])
    mixed = a.where(np.array([True, False, True]), b).poses()
    np.testing.assert_array_equal(mixed.R[[0, 2]], held.R[[0, 2]])
    np.testing.assert_array_equal(mixed.R[1], b.poses().R[1])


@given(st.integers(0, 10**6))
def test_a_mesh_is_placed_where_its_poses_have_it_at_any_scale(seed: int) -> None:
    """``PosesInHand``'s own formula, and ``T_hand_obj`` of points that were scaled about the mesh's origin."""
    rng = np.random.default_rng(seed)
    poses, centre, points = free(rng, free_scale=True).poses(), rng.normal(size=3), rng.normal(size=(5, 3))
    scale = poses.scale[:, None, None, None]
    expected = scale * (points - centre) @ np.swapaxes(poses.R, -1, -2) + poses.centre[:, :, None]
    np.testing.assert_allclose(
        se3.transform(hand_object_transforms(poses, centre), scale * points), expected, atol=1e-12
    )


@EVERY
def test_turned_objects_stay_where_they_are(make: Callable[[np.random.Generator], Motion]) -> None:
    rng = np.random.default_rng(5)
    motion, R = make(rng), se3.exp_so3(rng.normal(size=(B, 3)))
    before, after = motion.poses(), motion.rotated(R).poses()
    np.testing.assert_allclose(after.R, before.R @ R[:, None], atol=1e-12)
    np.testing.assert_array_equal(after.centre, before.centre)
    np.testing.assert_array_equal(after.scale, before.scale)


@EVERY
def test_hypotheses_are_joined_in_order(make: Callable[[np.random.Generator], Motion]) -> None:
    rng = np.random.default_rng(6)
    one, other = make(rng), make(rng)
    both = one.concatenate(other).poses()
    np.testing.assert_array_equal(both.R, np.concatenate([one.poses().R, other.poses().R]))
    np.testing.assert_array_equal(both.centre, np.concatenate([one.poses().centre, other.poses().centre]))


@EVERY
def test_priors_are_quadratic(make: Callable[[np.random.Generator], Motion]) -> None:
    motion = make(np.random.default_rng(6))
    S, L = sizes(motion)
    prior = motion.prior()
    assert (prior.value >= 0).all()
    step = np.random.default_rng(7).normal(0.0, 0.1, (B, N, L))
    moved = motion.retract(np.zeros((B, S)), step).prior().value
    expected = prior.value + np.sum(prior.g * step + 0.5 * prior.diagonal * step**2, axis=(1, 2))
    np.testing.assert_allclose(moved, expected, atol=1e-10)


def test_a_scale_that_is_known_stays() -> None:
    rng = np.random.default_rng(8)
    for make in (fixed, hinge, free):
        motion = make(rng)
        S, L = sizes(motion)
        moved = motion.retract(rng.normal(size=(B, S)), rng.normal(size=(B, N, L)))
        np.testing.assert_array_equal(moved.poses().scale, motion.poses().scale)


def test_a_hinge_turns_about_its_line() -> None:
    """Eq. 3: points of the line stay where they are, and frames differ by rotations about it."""
    motion = hinge(np.random.default_rng(9))
    held = motion.poses()
    T = se3.rigid(held.R, held.centre)
    between = T[:, 1:] @ se3.inverse(T[:, :1])
    on_line = motion.point[:, None] + np.array([-0.1, 0.0, 0.3])[:, None] * motion.direction[:, None]
    for n in range(N - 1):
        np.testing.assert_allclose(se3.transform(between[:, n], on_line), on_line, atol=1e-12)
    line = se3.rotation_about_line(motion.point[:, None], motion.direction[:, None], motion.angle)
    base = se3.rigid(motion.R, motion.centre)
    np.testing.assert_allclose(T, line @ base[:, None], atol=1e-12)


@given(st.booleans(), st.integers(0, 10**6))
def test_zero_mean_changes_no_pose(free_location: bool, seed: int) -> None:
    motion = hinge(np.random.default_rng(seed), free_location=free_location)
    settled = motion.zero_mean()
    np.testing.assert_allclose(settled.angle.mean(axis=1), 0.0, atol=1e-12)
    np.testing.assert_allclose(settled.poses().R, motion.poses().R, atol=1e-12)
    np.testing.assert_allclose(settled.poses().centre, motion.poses().centre, atol=1e-12)
    if free_location:
        across = settled.centre - settled.point
        np.testing.assert_allclose(np.sum(across * settled.direction, axis=1), 0.0, atol=1e-12)
    else:
        np.testing.assert_array_equal(settled.point, motion.point)


def test_the_direction_of_a_hinge_keeps_its_length() -> None:
    rng = np.random.default_rng(10)
    motion = hinge(rng)
    for _ in range(20):
        motion = motion.retract(rng.normal(size=(B, 10)), rng.normal(size=(B, N, 1)))
    np.testing.assert_allclose(np.linalg.norm(motion.direction, axis=1), 1.0, atol=1e-12)


@given(st.integers(0, 10**6))
def test_tangents(seed: int) -> None:
    direction = unit(np.random.default_rng(seed).normal(size=(5, 3)))
    frame = np.concatenate([direction[:, None], tangents(direction)], axis=1)
    np.testing.assert_allclose(frame @ np.swapaxes(frame, -1, -2), np.tile(np.eye(3), (5, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(frame), 1.0)


@given(st.integers(0, 10**6), st.sampled_from([0.0, 1e-9, 1e-4, 0.3, 2.0]))
def test_left_jacobian(seed: int, length: float) -> None:
    rng = np.random.default_rng(seed)
    w, dw = length * unit(rng.normal(size=3)), 1e-6 * rng.normal(size=3)
    both = se3.log_so3(se3.exp_so3(w + dw) @ se3.exp_so3(w - dw).T)
    np.testing.assert_allclose(both, 2.0 * se3.left_jacobian(w) @ dw, atol=1e-12)


def test_a_soft_motion_without_deviation_is_its_core() -> None:
    core = hinge(np.random.default_rng(11), free_scale=True)
    motion = Soft(core, np.zeros((B, N, 6)), (1.0, 1.0))
    np.testing.assert_allclose(motion.poses().R, core.poses().R, atol=1e-15)
    np.testing.assert_allclose(motion.poses().centre, core.poses().centre)
    np.testing.assert_array_equal(motion.prior().value, core.prior().value)
    shifted = replace(motion, deviation=motion.deviation + 0.01 * np.eye(6)[0])
    np.testing.assert_allclose(shifted.poses().centre - core.poses().centre, [[[0.01, 0.0, 0.0]] * N] * B)
