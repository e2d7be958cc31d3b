"""Laws of all terms: derivatives, independent hypotheses, bounds, and terms on a hand whose pose is unknown."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy import ndarray

from getagrip.clip import with_masks
from getagrip.fitting.energy import HandInCamera, InHand, ObjectWithHand, OnHand, PosesInCamera, Term, no_bound
from getagrip.fitting.energy.contact_consistency import ContactConsistencyTerm
from getagrip.fitting.energy.homan_terms import InteractionTerm, ReprojectionTerm, SmoothnessTerm, vertex_moments
from getagrip.fitting.methods.all_frames import add_contact_consistency, coarse_energy, make_initial_poses
from getagrip.fitting.options import Options
from getagrip.fitting.problem import prepare_problem
from getagrip.fitting.solver.solve import poses_in_camera
from getagrip.geometry import camera, se3
from helpers.scenes import SHORT, scene
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


P = 21
SIZES = (6, 13, 20)


def with_hand(rng: np.random.Generator) -> ObjectWithHand:
    """Objects and hands at random, near each other."""
    one, hand, in_hand = (random_poses(rng) for _ in range(3))
    middle = rng.normal(0.0, 0.05, 3)
    return ObjectWithHand(*vars(one).values(), HandInCamera(*vars(hand).values(), middle), in_hand)


def moved_with_hand(poses: ObjectWithHand, step: ndarray) -> ObjectWithHand:
    """Poses after a local vector of each frame (N, P); sizes, which frames share, by the mean."""

    def body(at: PosesInCamera, step: ndarray) -> tuple[ndarray, ndarray, ndarray]:
        scale = at.scale * np.exp(np.mean(step[:, 6]))
        return se3.exp_so3(step[:, 3:6]) @ at.R, at.centre + step[:, :3], scale

    hand = poses.hand
    there = HandInCamera(*body(hand, step[:, 7:14]), hand.middle)
    return ObjectWithHand(*body(poses, step), there, PosesInCamera(*body(poses.in_hand, step[:, -7:])))


TERMS: dict[str, Callable[[np.random.Generator], Term]] = {
    "in hand": lambda rng: InHand(some_term("interaction", rng)),
    "in hand, tied": lambda rng: InHand(some_term("consistency", rng)),
    "on the hand": lambda rng: OnHand(some_term("reprojection", rng)),
    "on the hand, tied": lambda rng: OnHand(some_term("smoothness", rng)),
}
EVERY = pytest.mark.parametrize("kind", TERMS)


@EVERY
def test_gradients(kind: str) -> None:
    rng = np.random.default_rng(1)
    poses, term, h = with_hand(rng), TERMS[kind](rng), 1e-6
    local = term(poses, no_bound(poses)).within(P)
    scale = np.abs(local.g).max()

    def difference(step: ndarray) -> ndarray:
        ahead, behind = (moved_with_hand(poses, sign * h * step) for sign in (1.0, -1.0))
        values = [term(p, no_bound(p)).value.sum(axis=1) for p in (ahead, behind)]
        return np.asarray((values[0] - values[1]) / (2.0 * h))

    for k in range(P):
        for n in range(N):
            step = np.zeros((N, P))
            step[n if k not in SIZES else slice(None), k] = 1.0
            expected = local.g[:, n, k] if k not in SIZES else local.g[..., k].sum(axis=1)
            np.testing.assert_allclose(expected, difference(step), rtol=1e-4, atol=1e-5 * scale)


@EVERY
def test_hessians_can_be_trusted(kind: str) -> None:
    rng = np.random.default_rng(2)
    poses = with_hand(rng)
    H = total_hessian(TERMS[kind](rng)(poses, no_bound(poses)).within(P))
    np.testing.assert_allclose(H, np.swapaxes(H, 1, 2), atol=1e-9 * np.abs(H).max())
    eigenvalues = np.linalg.eigvalsh(H)
    assert (eigenvalues >= -1e-9 * np.abs(eigenvalues).max()).all()


def test_a_term_in_a_fixed_hand_is_the_term() -> None:
    rng = np.random.default_rng(4)
    term, poses = some_term("interaction", rng), random_poses(rng)
    found, expected = (at(poses, no_bound(poses)) for at in (InHand(term), term))
    np.testing.assert_array_equal(found.g, expected.g)


def test_a_term_on_a_fixed_hand_is_zero() -> None:
    rng = np.random.default_rng(5)
    term, poses = OnHand(some_term("reprojection", rng)), random_poses(rng)
    assert not term(poses, no_bound(poses)).value.any()


@pytest.mark.parametrize("k", range(4))
@pytest.mark.slow
def test_a_bound_changes_nothing_within_it(k: int) -> None:
    problem = prepare_problem(with_masks(*scene("mug", 1, SHORT)), Options(inits=4))
    poses = poses_in_camera(make_initial_poses(problem), problem.clip.hand.T_cam_hand)
    poses = replace(poses, scale=2.0 * poses.scale)  # so large that the hand is in it
    terms = add_contact_consistency(problem, coarse_energy(problem))(64, np.arange(len(problem.clip)))
    assert terms[0].name == "handle", "the bounds of all others count what it saves"
    term = terms[1:][k]
    free = term(poses, no_bound(poses))
    total = free.value.sum(axis=1)
    assert (total > 0.0).any(), term.name
    bound = np.array([1.001, 0.5, 0.0, 2.0]) * total - np.array([0.0, 0.0, 1.0, 0.0])
    found = term(poses, bound)
    within = total <= bound
    assert within.tolist() == [True, total[1] == 0.0, False, True]
    for name in ("value", "g", "H"):
        np.testing.assert_array_equal(getattr(found, name)[within], getattr(free, name)[within])
    over = ~within & (bound >= 0.0)
    assert np.all(found.value.sum(axis=1)[over] > bound[over])
