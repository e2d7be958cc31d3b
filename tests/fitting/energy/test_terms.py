"""Laws of the terms in numpy: gradients against finite differences, Hessians that a solver can trust, still bodies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy import ndarray

from getagrip.fitting.energy import PosesInCamera, Term, no_bound
from getagrip.fitting.energy.contact_consistency import ContactConsistencyTerm
from getagrip.fitting.energy.homan_terms import InteractionTerm, ReprojectionTerm, SmoothnessTerm, vertex_moments
from getagrip.geometry import camera, se3
from helpers.terms import K4, N, hypotheses_are_independent, moved, random_poses, some_term, total_hessian

KINDS = ("consistency", "smoothness", "reprojection", "interaction")


@pytest.mark.parametrize("kind", KINDS)
def test_gradients_of_the_terms(kind: str) -> None:
    rng = np.random.default_rng(3)
    term, poses = some_term(kind, rng), random_poses(rng)

    def energy(p: PosesInCamera) -> ndarray:
        return term(p, no_bound(p)).value.sum(axis=1)

    local, h = term(poses, no_bound(poses)), 1e-6
    scale = np.abs(local.g).max()
    for n in range(N):
        for k in range(6):
            step = np.zeros((N, 7))
            step[n, k] = h
            expected = (energy(moved(poses, step)) - energy(moved(poses, -step))) / (2.0 * h)
            np.testing.assert_allclose(local.g[:, n, k], expected, rtol=1e-4, atol=1e-5 * scale)
    grown = h * np.eye(7)[6]
    expected = (energy(moved(poses, grown)) - energy(moved(poses, -grown))) / (2.0 * h)
    np.testing.assert_allclose(local.g[..., 6].sum(axis=1), expected, rtol=1e-4, atol=1e-5 * scale)


@pytest.mark.parametrize("kind", KINDS)
@given(st.integers(0, 10**6))
@settings(max_examples=8)
def test_hessians_of_the_terms_can_be_trusted(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    poses = random_poses(rng)
    H = total_hessian(some_term(kind, rng)(poses, no_bound(poses)))
    np.testing.assert_allclose(H, np.swapaxes(H, 1, 2), atol=1e-9 * np.abs(H).max())
    eigenvalues = np.linalg.eigvalsh(H)
    assert (eigenvalues >= -1e-9 * np.abs(eigenvalues).max()).all()


def test_a_still_body_is_smooth_and_at_its_image() -> None:
    rng = np.random.default_rng(6)
    R, centre = se3.exp_so3(rng.normal(size=3)), np.array([0.02, -0.01, 0.5])
    poses = PosesInCamera(np.tile(R, (1, N, 1, 1)), np.tile(centre, (1, N, 1)), np.ones(1))
    points = rng.normal(0.0, 0.03, (5, 3))
    K = np.array([[560.0, 0.0, 128.0], [0.0, 570.0, 120.0], [0.0, 0.0, 1.0]])
    seen = np.tile(camera.project(K, points @ R.T + centre), (N, 1, 1))
    terms: list[Term] = [
        SmoothnessTerm(vertex_moments(points), 1e5),
        ReprojectionTerm(np.tile(points, (N, 1, 1)), K4, seen, 3.0),
        InteractionTerm(np.tile(centre, (N, 1)), 1e4),
    ]
    for term in terms:
        local = term(poses, no_bound(poses))
        np.testing.assert_allclose(local.value, 0.0, atol=1e-9)
        np.testing.assert_allclose(local.g, 0.0, atol=1e-6)


@pytest.mark.parametrize("kind", ["consistency", "smoothness"])
def test_where_the_camera_stands_does_not_matter(kind: str) -> None:
    rng = np.random.default_rng(7)
    term, poses = some_term(kind, rng), random_poses(rng)
    T = se3.rigid(se3.exp_so3(rng.normal(size=3)), rng.normal(size=3))
    R, t = T[:3, :3], T[:3, 3]
    turned = PosesInCamera(R @ poses.R, poses.centre @ R.T + t, poses.scale)
    if isinstance(term, ContactConsistencyTerm):
        there: Term = replace(term, hand=se3.transform(T, term.hand))
    else:
        there = term
    np.testing.assert_allclose(term(poses, no_bound(poses)).value, there(turned, no_bound(turned)).value, rtol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_hypotheses_do_not_know_of_each_other(kind: str) -> None:
    rng = np.random.default_rng(10)
    hypotheses_are_independent(some_term(kind, rng), random_poses(rng))


@pytest.mark.parametrize("kind", KINDS)
def test_some_hypotheses_are_overwritten_whole(kind: str) -> None:
    rng = np.random.default_rng(12)
    term = some_term(kind, rng)
    one, other = (term(poses, no_bound(poses)) for poses in (random_poses(rng), random_poses(rng)))
    kept, index = one.take(np.array([0])), np.array([1])
    one.put(index, other.take(index))
    for part in ("value", "g", "H", "cross"):
        new, first, second = (getattr(of, part) for of in (one, kept, other.take(index)))
        assert new is None or np.array_equal(new, np.concatenate([first, second]))
