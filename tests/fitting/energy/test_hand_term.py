"""Laws of terms on an unknown hand: chain rule, moves that nobody can see, and the held hand."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy import ndarray

from getagrip.fitting.energy import HandInCamera, InHand, ObjectWithHand, OnHand, PosesInCamera, Term, no_bound
from getagrip.geometry import se3
from helpers.terms import N, random_poses, some_term, total_hessian

P = 21
SIZES = (6, 13, 20)


def with_hand(rng: np.random.Generator) -> ObjectWithHand:
    """Objects and hands at random, near each other."""
    one, hand, in_hand = (random_poses(rng) for _ in range(3))
    middle = rng.normal(0.0, 0.05, 3)
    return ObjectWithHand(*vars(one).values(), HandInCamera(*vars(hand).values(), middle), in_hand)


def moved(poses: ObjectWithHand, step: ndarray) -> ObjectWithHand:
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
        ahead, behind = (moved(poses, sign * h * step) for sign in (1.0, -1.0))
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


def test_a_term_in_a_held_hand_is_the_term() -> None:
    rng = np.random.default_rng(4)
    term, poses = some_term("interaction", rng), random_poses(rng)
    found, expected = (at(poses, no_bound(poses)) for at in (InHand(term), term))
    np.testing.assert_array_equal(found.g, expected.g)


def test_a_term_on_a_held_hand_is_zero() -> None:
    rng = np.random.default_rng(5)
    term, poses = OnHand(some_term("reprojection", rng)), random_poses(rng)
    assert not term(poses, no_bound(poses)).value.any()
