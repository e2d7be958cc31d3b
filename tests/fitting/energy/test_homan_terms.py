"""Smoothness and bending: values, derivatives, and motions that cost nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from getagrip.fitting.energy import PosesInCamera, no_bound
from getagrip.fitting.energy.homan_terms import BendingTerm, SmoothnessTerm, second_differences, vertex_moments
from helpers.terms import B, N, moved, random_poses, total_hessian


def test_smoothness_is_the_mean_square_of_the_vertices_steps() -> None:
    rng = np.random.default_rng(5)
    vertices, poses = rng.normal(0.01, 0.05, (40, 3)), random_poses(rng)
    value = SmoothnessTerm(vertex_moments(vertices), 7.0)(poses, no_bound(poses)).value.sum(axis=1)
    placed = poses.scale[:, None, None, None] * vertices @ np.swapaxes(poses.R, -1, -2) + poses.centre[:, :, None]
    expected = 7.0 * np.sum(np.diff(placed, axis=1) ** 2, axis=-1).mean(axis=-1).sum(axis=-1)
    np.testing.assert_allclose(value, expected, rtol=1e-9)


def test_curvature_is_that_of_the_energy_where_the_object_rests() -> None:
    """A step s from rest costs ``s^T H s / 2``, in every frame, between frames and at every scale."""
    rng = np.random.default_rng(11)
    term, one = SmoothnessTerm(vertex_moments(rng.normal(0.01, 0.05, (40, 3))), 7.0), random_poses(rng, frames=1)
    rest = PosesInCamera(one.R.repeat(N, axis=1), one.centre.repeat(N, axis=1), one.scale)
    H, h = total_hessian(term(rest, no_bound(rest))), 1e-4
    for n, k in np.ndindex(N, 6):
        step = 0.2 * rng.normal(size=(N, 7))
        step[n, k] += 1.0
        step[:, 6] = rng.normal()  # shared
        ahead, behind = (
            term(p, no_bound(p)).value.sum(axis=1) for p in (moved(rest, h * step), moved(rest, -h * step))
        )
        expected = np.array([step.ravel() @ H[b] @ step.ravel() for b in range(B)])
        np.testing.assert_allclose((ahead + behind) / h**2, expected, rtol=1e-4)


def bending(rng: np.random.Generator) -> BendingTerm:
    known = random_poses(rng, 1, 3)
    index, at = 1 + 2 * np.arange(N), np.array([0, 2, 2 * N + 3])
    return BendingTerm(vertex_moments(rng.normal(0.0, 0.03, (9, 3))), 1e5, index, at, known.R[0], known.centre[0])


def test_bending_has_the_derivatives_of_its_value() -> None:
    rng = np.random.default_rng(6)
    term, poses = bending(rng), random_poses(rng)
    local = term(poses, no_bound(poses))
    H = total_hessian(local)
    np.testing.assert_allclose(H, np.swapaxes(H, 1, 2), atol=1e-9 * np.abs(H).max())
    assert np.linalg.eigvalsh(H).min() > -1e-9 * np.abs(H).max()
    for n, k in np.ndindex(N, 6):
        step = np.zeros((N, 7))
        step[n, k] = 1e-6
        ahead, behind = (term(moved(poses, x), no_bound(poses)).value.sum(axis=1) for x in (step, -step))
        np.testing.assert_allclose(local.g[:, n, k], (ahead - behind) / 2e-6, atol=1e-4 * np.abs(local.g).max())


def test_what_moves_evenly_does_not_bend_however_far_apart_its_frames_are() -> None:
    rng = np.random.default_rng(7)
    term, R, speed = bending(rng), random_poses(rng, 1, 1).R[0, 0], rng.normal(size=3)
    where = [times[:, None] * speed for times in (term.index, term.known)]
    term = replace(term, R=np.tile(R, (3, 1, 1)), centre=where[1])
    poses = PosesInCamera(np.tile(R, (1, N, 1, 1)), where[0][None], np.ones(1))
    local = term(poses, no_bound(poses))
    np.testing.assert_allclose(local.value, 0.0, atol=1e-9)
    np.testing.assert_allclose(local.g, 0.0, atol=1e-6)
    frames = np.array([4, 0, 1, 9])
    np.testing.assert_allclose(second_differences(frames) @ frames**2.0, 2.0 * np.sqrt([2.0, 4.0]))
