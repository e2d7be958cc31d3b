"""The compiled step against the readable one, ``least_squares.BlockArrow``."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy import ndarray

from getagrip.fitting.energy import Quadratic, Ties
from getagrip.fitting.motion import Prior
from getagrip.fitting.solver.damped_step import damped_steps
from getagrip.fitting.solver.solve import jacobian_in_camera
from getagrip.geometry import se3
from getagrip.least_squares import BlockArrow

B, N, S, L, FLOOR = 3, 5, 8, 4, 1e2


def definite(rng: np.random.Generator, *shape: int) -> ndarray:
    A = rng.normal(size=shape)
    return A @ np.swapaxes(A, -1, -2)


def equations(rng: np.random.Generator) -> tuple[ndarray, ndarray, Quadratic, Prior, ndarray, ndarray]:
    local = Quadratic(np.zeros((B, N)), rng.normal(size=(B, N, 7)), definite(rng, B, N, 7, 7))
    prior = Prior(
        np.zeros(B), rng.normal(size=(B, N, L)), rng.uniform(size=L), rng.normal(size=(B, S)), rng.uniform(size=S)
    )
    T = se3.rigid(se3.exp_so3(rng.normal(size=(N, 3))))
    return rng.normal(size=(B, N, 7, S)), rng.normal(size=(B, N, 7, L)), local, prior, T, np.array([1e-3, 0.1, 10.0])


def arrow_of(J_shared: ndarray, J_local: ndarray, local: Quadratic, prior: Prior, T: ndarray) -> BlockArrow:
    J = jacobian_in_camera(J_shared, J_local, T)
    arrow = BlockArrow.by(J, S, local.H, local.g, local.between_frames).plus(H_ll=prior.H, g_l=prior.g)
    assert prior.diagonal_shared is not None
    return arrow.plus(H_ss=np.diag(prior.diagonal_shared), g_s=prior.g_shared)


def test_it_is_the_step_of_the_block_arrow() -> None:
    J_shared, J_local, local, prior, T, damping = equations(np.random.default_rng(0))
    found = damped_steps(J_shared, J_local, local, prior, T[:, :3, :3], damping, FLOOR, np.inf)
    expected = arrow_of(J_shared, J_local, local, prior, T).step(damping, FLOOR)
    for some, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(some, other, rtol=1e-7, atol=1e-12)


def test_pairs_of_frames_count_exactly_by_shared_parameters_and_bounded_by_own_ones() -> None:
    rng = np.random.default_rng(1)
    J_shared, J_local, local, prior, T, damping = equations(rng)
    first, second = np.array([1, 2, 4]), np.array([0, 0, 3])
    a, b = rng.normal(size=(2, B, 3, 7))
    bound = np.zeros((B, N, 7, 7))
    for e, (i, j) in enumerate(zip(first, second, strict=True)):
        for n, x in ((i, a[:, e]), (j, b[:, e])):
            local.H[:, n] += x[:, :, None] * x[:, None]
            bound[:, n] += x[:, :, None] * x[:, None]
    tied = replace(local, ties=Ties(first, second, -a[..., :, None] * b[..., None, :], bound))
    found = damped_steps(J_shared, J_local, tied, prior, T[:, :3, :3], damping, FLOOR, np.inf)
    arrow = arrow_of(J_shared, J_local, tied, prior, T)
    own = jacobian_in_camera(J_shared, J_local, T)[..., S:]
    bounded = replace(arrow, cross=None, H_ll=arrow.H_ll + np.swapaxes(own, -1, -2) @ bound @ own)
    for some, other in zip(found, bounded.step(damping, FLOOR), strict=True):
        np.testing.assert_allclose(some, other, rtol=1e-7, atol=1e-12)
    assert arrow.cross is not None
    n, excess = np.arange(N), -arrow.cross
    excess[:, n, :, n] += np.swapaxes(bounded.H_ll - arrow.H_ll, 0, 1)
    assert np.linalg.eigvalsh(excess.reshape(B, N * L, N * L)).min() > -1e-9  # an upper bound


def test_a_step_is_cut_to_the_largest_turn_of_a_frame() -> None:
    J_shared, J_local, local, prior, T, damping = equations(np.random.default_rng(2))
    whole = damped_steps(J_shared, J_local, local, prior, T[:, :3, :3], damping, FLOOR, np.inf)
    cut = damped_steps(J_shared, J_local, local, prior, T[:, :3, :3], damping, FLOOR, 1e-3)
    moved = (J_shared @ cut[0][:, None, :, None] + J_local @ cut[1][..., None])[..., 0]
    turn, shift = (np.linalg.norm(moved[..., part], axis=-1) for part in (slice(3, 6), slice(3)))
    np.testing.assert_allclose(np.maximum(turn, 10.0 * shift).max(axis=1), 1e-3)
    np.testing.assert_allclose(cut[0] * whole[0][:, :1], whole[0] * cut[0][:, :1], rtol=1e-9)


@pytest.mark.parametrize("own", [0, 1])
def test_motions_of_one_pose_or_of_none_are_solved(own: int) -> None:
    J_shared, J_local, local, prior, T, damping = equations(np.random.default_rng(3))
    if own:
        J_shared, prior = J_shared[..., :0], replace(prior, g_shared=None, diagonal_shared=None)
    else:
        J_local, prior = J_local[..., :0], replace(prior, g=prior.g[..., :0], diagonal=prior.diagonal[:0])
    shared, step = damped_steps(J_shared, J_local, local, prior, T[:, :3, :3], damping, FLOOR, np.inf)
    assert shared.shape == (B, 0 if own else S)
    assert np.isfinite(step).all()
    assert np.isfinite(shared).all()
