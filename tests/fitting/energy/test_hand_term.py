"""Laws of terms on an unknown hand: chain rule, moves that nobody can see, and the held hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from numpy import ndarray

from getagrip.fitting.energy import (
    HandInCamera,
    InHand,
    ObjectWithHand,
    OnHand,
    PosesInCamera,
    Quadratic,
    Term,
    no_bound,
)
from getagrip.geometry import se3
from helpers.terms import B, N, random_poses, some_term, total_hessian

F = 2
P = 14 + F


@dataclass(frozen=True)
class Fingers:
    """A term on all that a hand has: half its squared modes, and its height in the camera frame."""

    name: str = "fingers"

    def __call__(self, poses: HandInCamera, bound: ndarray) -> Quadratic:
        found = Quadratic.zero(poses, poses.size)
        found.value[:] = 0.5 * np.sum(poses.modes**2, axis=-1) + 0.5 * poses.centre[..., 1] ** 2
        found.g[..., 1], found.g[..., 7:] = poses.centre[..., 1], poses.modes
        found.H[..., 1, 1], found.H[..., range(7, 7 + F), range(7, 7 + F)] = 1.0, 1.0
        return found


def with_hand(rng: np.random.Generator) -> ObjectWithHand:
    """Objects and hands at random, near each other."""
    one, hand = random_poses(rng), random_poses(rng)
    middle, given = rng.normal(0.0, 0.05, 3), se3.rigid(se3.exp_so3(rng.normal(size=(N, 3))), rng.normal(size=(N, 3)))
    modes = rng.normal(size=(B, N, F))
    return ObjectWithHand(
        one.R, one.centre, one.scale, HandInCamera(hand.R, hand.centre, hand.scale, modes, middle, given)
    )


def moved(poses: ObjectWithHand, step: ndarray) -> ObjectWithHand:
    """Poses after a local vector of each frame (N, P); sizes, which frames share, by the mean."""

    def body(at: PosesInCamera, step: ndarray) -> tuple[ndarray, ndarray, ndarray]:
        scale = at.scale * np.exp(np.mean(step[:, 6]))
        return se3.exp_so3(step[:, 3:6]) @ at.R, at.centre + step[:, :3], scale

    hand = poses.hand
    there = HandInCamera(*body(hand, step[:, 7:14]), hand.modes + step[:, 14:], hand.middle, hand.given)
    return ObjectWithHand(*body(poses, step), there)


TERMS: dict[str, Callable[[np.random.Generator], Term]] = {
    "in hand": lambda rng: InHand(some_term("interaction", rng)),
    "in hand, tied": lambda rng: InHand(some_term("consistency", rng)),
    "on the hand": lambda rng: OnHand(some_term("reprojection", rng)),
    "on the hand, tied": lambda rng: OnHand(some_term("smoothness", rng)),
    "on fingers": lambda rng: OnHand(Fingers()),
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
            step[n if k not in (6, 13) else slice(None), k] = 1.0
            expected = local.g[:, n, k] if k not in (6, 13) else local.g[..., k].sum(axis=1)
            np.testing.assert_allclose(expected, difference(step), rtol=1e-4, atol=1e-5 * scale)


@EVERY
def test_hessians_can_be_trusted(kind: str) -> None:
    rng = np.random.default_rng(2)
    poses = with_hand(rng)
    H = total_hessian(TERMS[kind](rng)(poses, no_bound(poses)).within(P))
    np.testing.assert_allclose(H, np.swapaxes(H, 1, 2), atol=1e-9 * np.abs(H).max())
    eigenvalues = np.linalg.eigvalsh(H)
    assert (eigenvalues >= -1e-9 * np.abs(eigenvalues).max()).all()


@pytest.mark.parametrize("kind", ["in hand", "in hand, tied"])
def test_a_hand_and_its_object_may_move_together(kind: str) -> None:
    rng = np.random.default_rng(3)
    poses, term = with_hand(rng), TERMS[kind](rng)
    R, t = se3.exp_so3(rng.normal(size=(N, 3))), rng.normal(size=(N, 3))

    def there(at: PosesInCamera) -> tuple[ndarray, ndarray, ndarray]:
        return R @ at.R, (R @ at.centre[..., None])[..., 0] + t, at.scale

    hand = HandInCamera(*there(poses.hand), poses.hand.modes, poses.hand.middle, poses.hand.given)
    together = ObjectWithHand(*there(poses), hand)
    np.testing.assert_allclose(term(together, no_bound(poses)).value, term(poses, no_bound(poses)).value, rtol=1e-9)


def test_by_the_given_hand_a_term_in_the_hand_is_the_term() -> None:
    rng = np.random.default_rng(4)
    free, term = with_hand(rng), some_term("interaction", rng)
    given, middle = free.hand.given, free.hand.middle
    R, centre = np.tile(given[:, :3, :3], (B, 1, 1, 1)), np.tile(se3.transform(given, middle[None])[:, 0], (B, 1, 1))
    hand = HandInCamera(R, centre, np.ones(B), np.zeros((B, N, F)), middle, given)
    np.testing.assert_allclose(hand.T_cam_hand, np.tile(given, (B, 1, 1, 1)), atol=1e-12)
    held = PosesInCamera(free.R, free.centre, free.scale)
    expected = term(held, no_bound(held))
    for poses in (ObjectWithHand(*vars(held).values(), hand), held):
        found = InHand(term)(poses, no_bound(held))
        np.testing.assert_allclose(found.value, expected.value, rtol=1e-9)
        np.testing.assert_allclose(found.g[..., :7], expected.g, rtol=1e-9, atol=1e-9)


def test_a_term_on_a_held_hand_is_zero() -> None:
    poses = random_poses(np.random.default_rng(5))
    assert not OnHand(Fingers())(poses, no_bound(poses)).value.any()
