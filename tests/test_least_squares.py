"""Laws of the damping loop and of the block-arrow step, on problems whose answer is known."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import cycle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy import ndarray

from getagrip.least_squares import BlockArrow, DampingRules, Ending, Minimum, damp_hessian, minimise


@dataclass(frozen=True)
class Parabola:
    """B parabolas ``|x|^2 / 2`` in a plane; some are not finite to begin with, one has no downhill step."""

    x: ndarray
    flat: bool = False

    @property
    def cost(self) -> ndarray:
        return np.ones(len(self.x)) if self.flat else 0.5 * np.sum(self.x**2, axis=1)

    def trial(self, active: ndarray, damping: ndarray) -> Parabola:
        return replace(self, x=self.x[active] / (1.0 + 1.0 / damping[:, None]))

    def accept(self, trial: Parabola, active: ndarray, better: ndarray) -> Parabola:
        x = self.x.copy()
        x[active[better]] = trial.x[better]
        return replace(self, x=x)


def test_every_problem_goes_down_on_its_own() -> None:
    start = Parabola(np.array([[1.0, 0.0], [np.inf, 0.0], [0.0, 3.0]]))
    found = minimise(start, 30)
    assert found.endings[1] is Ending.LOST
    np.testing.assert_allclose(found.state.x[[0, 2]], 0.0, atol=1e-6)
    np.testing.assert_array_equal(found.state.x[1], start.x[1])
    alone = minimise(Parabola(start.x[2:]), 30)
    np.testing.assert_array_equal(alone.state.x[0], found.state.x[2])


def test_endings() -> None:
    start = Parabola(np.ones((1, 2)))
    assert minimise(start, 0).endings == [Ending.LIMIT]
    assert minimise(replace(start, flat=True), 30).endings == [Ending.STUCK]
    assert minimise(replace(start, flat=True), 30, DampingRules(rejections=np.inf, most=10.0)).endings == [Ending.STUCK]
    assert minimise(start, 30, DampingRules(tolerance=2.0)).endings == [Ending.CONVERGED]


@dataclass(frozen=True)
class Told:
    """One problem whose trials gain the shares of the cost that are told, in turn; the dampings are written down."""

    gains: Iterator[float]
    cost: ndarray = field(default_factory=lambda: np.ones(1))
    dampings: list[float] = field(default_factory=list)

    def trial(self, active: ndarray, damping: ndarray) -> Told:
        self.dampings.extend(damping)
        return replace(self, cost=self.cost * (1.0 - next(self.gains)))

    def accept(self, trial: Told, active: ndarray, better: ndarray) -> Told:
        return trial if better[0] else self


LARGE, SMALL, WORSE = 0.75, 0.25, -1.0
RULES = DampingRules(tolerance=0.5, rejections=3, small_steps=2)


@pytest.mark.parametrize(
    ("gains", "ending", "steps"),
    [
        ([SMALL, LARGE], Ending.LIMIT, 12),  # small steps count in a row
        ([SMALL, SMALL], Ending.CONVERGED, 2),
        ([LARGE, SMALL, WORSE, SMALL], Ending.CONVERGED, 4),  # one that is not taken is no step
        ([LARGE], Ending.LIMIT, 12),
        ([RULES.tolerance], Ending.LIMIT, 12),  # as much as the tolerance is not small
        ([WORSE], Ending.STUCK, 3),
        ([0.0], Ending.STUCK, 3),  # no lower cost is no success
        ([WORSE, WORSE, LARGE], Ending.LIMIT, 12),  # so do steps that are not taken
        ([WORSE, WORSE, SMALL], Ending.CONVERGED, 6),
    ],
)
def test_endings_are_told_by_steps_in_a_row(gains: list[float], ending: Ending, steps: int) -> None:
    found: Minimum[Told] = minimise(Told(cycle(gains)), 12, RULES)
    assert found.endings == [ending]
    assert len(found.state.dampings) == steps
    assert found.evaluations == 1 + steps


@given(st.lists(st.sampled_from([LARGE, WORSE]), min_size=30, max_size=30))
def test_damping_follows_success_and_failure_between_its_limits(gains: list[float]) -> None:
    rules = DampingRules(damping=1.0, success=0.5, failure=4.0, least=0.125, most=64.0, rejections=np.inf)
    state = minimise(Told(iter(gains)), 30, rules).state
    expected = [1.0]
    for gain in gains:
        expected.append(expected[-1] * 4.0 if gain < 0.0 else max(expected[-1] * 0.5, 0.125))
        if expected[-1] > 64.0:
            break
    assert state.dampings == expected[:-1]


@pytest.mark.parametrize("S", [0, 1, 3])
@pytest.mark.parametrize("L", [0, 1, 4])
@pytest.mark.parametrize("tied", [False, True])
def test_the_arrow_step_is_that_of_the_dense_system(S: int, L: int, tied: bool) -> None:
    if not S + L or (tied and not L):
        return
    rng = np.random.default_rng(0)
    B, N = 2, 3
    J = rng.normal(size=(B, N, 20, S + L))  # each frame's errors by what is shared and by its own numbers
    between = rng.normal(size=(B, 20, N * L)) if tied else np.zeros((B, 20, N * L))
    dense = np.zeros((B, S + N * L, S + N * L))
    for n in range(N):
        own = np.concatenate([np.arange(S), S + n * L + np.arange(L)]).astype(int)
        dense[:, own[:, None], own] += np.swapaxes(J[:, n], -1, -2) @ J[:, n]
    extra = (np.swapaxes(between, -1, -2) @ between).reshape(B, N, L, N, L)
    for n in range(N):
        extra[:, n, :, n] = 0.0
    dense[:, S:, S:] += extra.reshape(B, N * L, N * L) + 100.0 * np.eye(N * L)
    g = rng.normal(size=(B, S + N * L))
    blocks = dense[:, S:, S:].reshape(B, N, L, N, L)
    n = np.arange(N)
    arrow = BlockArrow(
        H_ss=dense[:, :S, :S],
        H_sl=np.swapaxes(dense[:, :S, S:].reshape(B, S, N, L), 1, 2),
        H_ll=np.swapaxes(blocks[:, n, :, n], 0, 1),
        g_s=g[:, :S],
        g_l=g[:, S:].reshape(B, N, L),
        cross=extra if tied else None,
    )
    shared, local = arrow.solved()
    expected = -np.linalg.solve(dense, g[..., None])[..., 0]
    np.testing.assert_allclose(np.concatenate([shared, local.reshape(B, -1)], axis=1), expected, atol=1e-10)
    if not tied:  # the covariance of what is shared is a block of the whole one
        np.testing.assert_allclose(np.linalg.inv(arrow.reduced()), np.linalg.inv(dense)[:, :S, :S], atol=1e-10)


def test_damping_raises_the_diagonal_alone() -> None:
    H = np.random.default_rng(1).normal(size=(2, 3, 3))
    raised = damp_hessian(H, np.array([0.0, 2.0]), floor=1.0) - H
    np.testing.assert_array_equal(raised[0], 0.0)
    np.testing.assert_allclose(raised[1], np.diag(2.0 * (np.diag(H[1]) + 1.0)))


@pytest.mark.parametrize("tied", [0, 2])
def test_parameters_that_are_not_tied_are_eliminated(tied: int) -> None:
    rng = np.random.default_rng(4)
    B, N, S, L = 2, 3, 2, 4
    J, g = rng.normal(size=(B, N, 20, S + L)), rng.normal(size=(B, N, S + L))
    between = np.zeros((B, N, L, N, L))
    root = rng.normal(size=(B, 20, N * tied))
    between[:, :, :tied, :, :tied] = (np.swapaxes(root, -1, -2) @ root).reshape(B, N, tied, N, tied)
    n = np.arange(N)
    between[:, n, :, n] = 0.0
    alone = BlockArrow.of(np.swapaxes(J, -1, -2) @ J, g, slice(S), slice(S, None)).plus(H_ll=100.0 * np.eye(L))
    arrow = replace(alone, cross=between)
    for found, expected in zip(arrow.solved(), arrow._solved_together(between), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-10)


@pytest.mark.parametrize("tied", [False, True])
def test_a_system_by_parameters_is_that_of_the_stacked_jacobian(tied: bool) -> None:
    rng = np.random.default_rng(2)
    B, N, P, S, L = 2, 3, 5, 2, 3
    J, g = rng.normal(size=(B, N, P, S + L)), rng.normal(size=(B, N, P))
    root = rng.normal(size=(B, 40, N * P))
    whole = (np.swapaxes(root, 1, 2) @ root).reshape(B, N, P, N, P)
    n = np.arange(N)
    H = np.swapaxes(whole[:, n, :, n], 0, 1)
    cross = whole.copy() if tied else np.zeros_like(whole)
    cross[:, n, :, n] = 0.0
    all_J = np.zeros((B, N, P, S + N * L))
    all_J[..., :S] = J[..., :S]
    for k in range(N):
        all_J[:, k, :, S + k * L : S + (k + 1) * L] = J[:, k, :, S:]
    flat, dense = all_J.reshape(B, N * P, -1), cross.copy()
    dense[:, n, :, n] += np.swapaxes(H, 0, 1)
    A = np.swapaxes(flat, 1, 2) @ dense.reshape(B, N * P, N * P) @ flat
    expected = -np.linalg.solve(A, np.swapaxes(flat, 1, 2) @ g.reshape(B, N * P, 1))[..., 0]
    shared, own = BlockArrow.by(J, S, H, g, cross if tied else None).solved()
    np.testing.assert_allclose(np.concatenate([shared, own.reshape(B, -1)], axis=1), expected, atol=1e-8)


def test_a_shared_part_of_the_same_numbers() -> None:
    """With a prior on both parts, the sum of the two is what a frame alone asks for, drawn to the others."""
    rng = np.random.default_rng(3)
    H, g = np.tile(np.eye(2), (1, 4, 1, 1)), rng.normal(size=(1, 4, 2))
    loose, stiff = 1e-6 * np.eye(2), 1e6 * np.eye(2)
    shared, own = BlockArrow.of(H, g, slice(2), slice(2)).plus(H_ss=loose, H_ll=stiff).solved()
    np.testing.assert_allclose(shared, -g.mean(axis=1), rtol=1e-5)
    np.testing.assert_allclose(own, 0.0, atol=1e-5)
