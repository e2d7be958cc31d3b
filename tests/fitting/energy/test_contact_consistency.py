"""The contact-consistency term: an object that is still in the hand costs nothing, what all frames do alike is free."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy import ndarray

from getagrip.fitting.energy import PosesInCamera, no_bound
from getagrip.fitting.energy.contact_consistency import N_PARTNERS, ContactConsistencyTerm, pairs_of_frames
from getagrip.geometry import se3
from helpers.terms import B, N, moved, random_poses, some_term, total_hessian


@given(st.integers(0, 10**6))
@settings(max_examples=15)
def test_consistency_lies_below_the_quadratic_that_is_minimised(seed: int) -> None:
    """For moves that shift the object only: squared distances are then quadratic, so small ones are compared."""
    rng = np.random.default_rng(seed)
    term, poses = some_term("consistency", rng), random_poses(rng)
    local = term(poses, no_bound(poses))
    step = np.zeros((N, 7))
    step[:, :3] = 1e-5 * rng.normal(size=(N, 3))
    x = step.ravel()
    model = local.value.sum(axis=1) + local.g.reshape(B, -1) @ x + 0.5 * x @ total_hessian(local) @ x
    after = moved(poses, step)
    assert (term(after, no_bound(after)).value.sum(axis=1) <= model * (1.0 + 1e-6)).all()


def in_rigid_hand(rng: np.random.Generator) -> tuple[PosesInCamera, ndarray]:
    """An object that keeps still in a hand before a moving camera, and points of the hand."""
    T_cam_hand = se3.rigid(se3.exp_so3(rng.normal(size=(N, 3))), np.array([0.0, 0.0, 0.5]) + rng.normal(size=(N, 3)))
    T = T_cam_hand @ se3.rigid(se3.exp_so3(rng.normal(size=3)), rng.normal(0.0, 0.05, 3))
    hand = se3.transform(T_cam_hand, rng.normal(0.0, 0.04, (6, 3)))
    poses = PosesInCamera(np.ascontiguousarray(T[None, :, :3, :3]), np.ascontiguousarray(T[None, :, :3, 3]), np.ones(1))
    return poses, hand


def test_an_object_still_in_the_hand_is_consistent() -> None:
    rng = np.random.default_rng(0)
    poses, hand = in_rigid_hand(rng)
    term = ContactConsistencyTerm(rng.normal(0.0, 0.03, (5, 3)), hand, np.full(N, 1e6))
    local = term(poses, no_bound(poses))
    np.testing.assert_allclose(local.value, 0.0, atol=1e-9)
    np.testing.assert_allclose(local.g, 0.0, atol=1e-6)


def test_consistency_does_not_hold_back_what_all_frames_do_alike() -> None:
    rng = np.random.default_rng(1)
    poses, hand = in_rigid_hand(rng)
    term = ContactConsistencyTerm(rng.normal(0.0, 0.03, (5, 3)), hand, np.full(N, 1e6))
    local = term(poses, no_bound(poses))
    between = local.between_frames
    assert between is not None
    # A shift in the object's frame, which keeps still in the hand's, and a change of the scale.
    shift = (poses.R[0] @ rng.normal(size=3)).reshape(N, 3)
    for common in (np.concatenate([shift, np.zeros((N, 4))], axis=1), np.tile(np.eye(7)[6], (N, 1))):
        held_back = (local.H[0] @ common[..., None])[..., 0] + np.einsum("iajb,jb->ia", between[0], common)
        np.testing.assert_allclose(held_back, 0.0, atol=1e-9 * np.abs(local.H).max())


def test_consistency_is_the_mean_difference_of_squared_distances() -> None:
    rng = np.random.default_rng(2)
    points, hand = rng.normal(0.0, 0.03, (5, 3)), rng.normal(0.0, 0.05, (N, 6, 3))
    poses, weight = random_poses(rng), np.arange(1.0, N + 1.0)
    value = ContactConsistencyTerm(points, hand, weight, delta=1e-12)(poses, no_bound(poses)).value.sum(axis=1)
    placed = poses.scale[:, None, None, None] * points @ np.swapaxes(poses.R, -1, -2) + poses.centre[:, :, None]
    D = np.sum((hand[:, None] - placed[..., None, :]) ** 2, axis=-1)
    expected = np.abs(D[:, :, None] - D[:, None]).mean(axis=(2, 3, 4)) @ weight
    np.testing.assert_allclose(value, expected, rtol=1e-9)


def test_long_clips_compare_each_frame_with_as_many_others() -> None:
    for count in (N_PARTNERS + 2, 50, 51, 200):
        first, second = pairs_of_frames(count)
        assert len({tuple(sorted(pair)) for pair in zip(first, second, strict=True)}) == len(first)
        assert (np.bincount(np.concatenate([first, second])) == N_PARTNERS).all()
    first, second = pairs_of_frames(N_PARTNERS + 1)
    assert len(first) == N_PARTNERS * (N_PARTNERS + 1) / 2


def test_the_mean_over_partners_is_nearly_that_over_all_frames() -> None:
    rng = np.random.default_rng(3)
    count = 120
    points, hand = rng.normal(0.0, 0.03, (5, 3)), rng.normal(0.0, 0.05, (count, 6, 3))
    poses = random_poses(rng, frames=count)
    value = ContactConsistencyTerm(points, hand, np.ones(count))(poses, no_bound(poses)).value.sum(axis=1)
    placed = poses.scale[:, None, None, None] * points @ np.swapaxes(poses.R, -1, -2) + poses.centre[:, :, None]
    D = np.sum((hand[:, None] - placed[..., None, :]) ** 2, axis=-1)
    expected = np.stack([np.abs(d[:, None] - d).mean(axis=(1, 2, 3)).sum() for d in D])
    np.testing.assert_allclose(value, expected, rtol=0.03)


def test_the_exact_hessian_is_that_of_all_pairs() -> None:
    rng = np.random.default_rng(5)
    term, poses = some_term("consistency", rng), random_poses(rng)
    assert isinstance(term, ContactConsistencyTerm)
    exact = replace(term, exact=True)(poses, no_bound(poses))
    assert exact.cross is not None
    assert exact.ties is None
    np.testing.assert_array_equal(total_hessian(exact), total_hessian(term(poses, no_bound(poses))))


def test_a_lost_step_gets_no_derivatives_of_consistency() -> None:
    rng = np.random.default_rng(4)
    term, poses = some_term("consistency", rng), random_poses(rng)
    for bound in (np.zeros(B), np.full(B, np.nan)):
        assert not term(poses, bound).g.any()
