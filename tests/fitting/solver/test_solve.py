"""Levenberg-Marquardt on terms whose minimum is known: matching points, and frames tied to each other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy import ndarray

from getagrip.fitting.energy import PosesInCamera, Quadratic, Term
from getagrip.fitting.energy.homan_terms import InteractionTerm, SmoothnessTerm, vertex_moments
from getagrip.fitting.motion import Fixed, Free, Hinge, Motion, Soft
from getagrip.fitting.solver import solve
from getagrip.fitting.solver.solve import (
    CURVATURE_FLOOR,
    energy_gradient,
    evaluate,
    minimise,
    minimise_by_adam,
    poses_in_camera,
)
from getagrip.geometry import se3
from getagrip.least_squares import DampingRules
from getagrip.result import Status
from helpers.terms import N as TERM_FRAMES
from helpers.terms import random_poses, some_term

N = 5
STIFF = 1e6
POINTS = np.array([[0.05, 0.0, 0.0], [0.0, 0.07, 0.0], [0.0, 0.0, 0.04], [-0.03, -0.03, -0.02]])


@dataclass(frozen=True)
class Match:
    """``stiffness / 2`` times the squared distances of the object's points to given ones: N frames of them."""

    target: ndarray
    stiffness: float = STIFF
    name: str = "match"
    calls: list[ndarray] | None = None

    def __call__(self, poses: PosesInCamera, bound: ndarray) -> Quadratic:
        arm = poses.scale[:, None, None, None] * POINTS @ np.swapaxes(poses.R, -1, -2)
        r = poses.centre[:, :, None] + arm - self.target
        eye = np.broadcast_to(np.eye(3), (*arm.shape, 3))
        J = np.concatenate([eye, -se3.hat(arm), arm[..., None]], axis=-1)
        value = 0.5 * np.sum(r**2, axis=(2, 3))
        g, H = np.einsum("bnpki,bnpk->bni", J, r), np.einsum("bnpki,bnpkj->bnij", J, J)
        if self.calls is not None:
            self.calls.append(bound)
        return Quadratic(self.stiffness * value, self.stiffness * g, self.stiffness * H)


@dataclass(frozen=True)
class Lazy(Match):
    """The same, with nonsense for derivatives where the bound allows it."""

    def __call__(self, poses: PosesInCamera, bound: ndarray) -> Quadratic:
        local = super().__call__(poses, bound)
        beyond = local.value.sum(axis=1) > bound
        local.g[beyond], local.H[beyond] = np.nan, np.nan
        return local


@dataclass(frozen=True)
class Blind(Match):
    """The same, infinite for an object behind the camera."""

    def __call__(self, poses: PosesInCamera, bound: ndarray) -> Quadratic:
        local = super().__call__(poses, bound)
        local.value[poses.centre[..., 2] < 0.0] = np.inf
        return local


def truth(rng: np.random.Generator, hypotheses: int, free_scale: bool) -> Hinge:
    """A hinge, the same in every hypothesis."""
    R, direction = se3.exp_so3(rng.normal(size=3)), rng.normal(size=3)
    one = Hinge(
        R=R[None],
        centre=rng.normal(0.0, 0.05, (1, 3)),
        log_scale=np.full(1, 0.2 if free_scale else 0.0),
        point=rng.normal(0.0, 0.05, (1, 3)),
        direction=(direction / np.linalg.norm(direction))[None],
        angle=np.linspace(-0.5, 0.5, N)[None],
        free_scale=free_scale,
    )
    return one.take(np.zeros(hypotheses, int))


def track(rng: np.random.Generator) -> ndarray:
    return se3.rigid(se3.exp_so3(rng.normal(size=(N, 3))), np.array([0.0, 0.0, 0.5]) + rng.normal(0.0, 0.1, (N, 3)))


def targets(motion: Motion, T_cam_hand: ndarray) -> ndarray:
    """Where the points are in the first hypothesis."""
    poses = poses_in_camera(motion, T_cam_hand)
    return np.asarray(poses.centre[0, :, None] + poses.scale[0] * POINTS @ np.swapaxes(poses.R[0], -1, -2))


def nudged(motion: Any, rng: np.random.Generator, size: float) -> Any:
    """The motion after a random step: another one of the same kind."""
    S, L = (J.shape[-1] for J in motion.jacobian())
    B = len(motion.poses().scale)
    length = size * np.array([0.1, 0.1, 0.1, 1.0, 1.0, 1.0, *[0.3] * 20])
    return motion.retract(rng.normal(size=(B, S)) * length[:S], rng.normal(size=(B, N, L)) * length[6 : 6 + L])


def at_hinge(at: Hinge) -> Hinge:
    return at


def at_fixed(at: Hinge) -> Fixed:
    return Fixed(at.R, at.centre, at.log_scale, N, at.free_scale)


def at_free(at: Hinge) -> Free:
    held = at.poses()
    return Free(held.R, held.centre, at.log_scale, at.free_scale)


def at_soft(at: Hinge) -> Soft[Hinge]:
    return Soft(at, np.zeros((len(at.R), N, 6)), (1e3, 1e3))


KINDS: dict[str, Callable[[Hinge], Motion]] = {"fixed": at_fixed, "hinge": at_hinge, "free": at_free, "soft": at_soft}
EVERY = pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS.keys())


def problem(
    kind: Callable[[Hinge], Motion], free_scale: bool, hypotheses: int = 2, size: float = 0.1, seed: int = 0
) -> tuple[Motion, Motion, ndarray, ndarray]:
    """A true motion, starts near it, T_cam_hand, and where the points truly are."""
    rng = np.random.default_rng(seed)
    T = track(rng)
    true = kind(truth(rng, hypotheses, free_scale))
    return true, nudged(true, rng, size), T, targets(true, T)


@EVERY
@pytest.mark.parametrize("free_scale", [False, True])
def test_every_motion_finds_a_known_minimum(kind: Callable[[Hinge], Motion], free_scale: bool) -> None:
    true, start, T, target = problem(kind, free_scale)
    solution = minimise(start, [Match(target)], T, iterations=40, rules=DampingRules(tolerance=1e-12))
    np.testing.assert_allclose(solution.energy, 0.0, atol=1e-6)
    found, expected = solution.motion.poses(), true.poses()
    np.testing.assert_allclose(found.R, expected.R, atol=1e-4)
    np.testing.assert_allclose(found.centre, expected.centre, atol=1e-5)
    np.testing.assert_allclose(found.scale, expected.scale, atol=1e-4)


@EVERY
def test_a_step_is_that_of_the_dense_system(kind: Callable[[Hinge], Motion]) -> None:
    """Eliminating the frames changes nothing: S + N L equations, damped as the solver damps them."""
    damping = 1e-2
    _, start, T, target = problem(kind, True, hypotheses=1, size=0.02)
    solution = minimise(start, [Match(target)], T, iterations=1, rules=DampingRules(damping=damping))
    J_shared, J_local = start.jacobian()
    S, L = J_shared.shape[-1], J_local.shape[-1]
    prior, local = start.prior(), Match(target)(poses_in_camera(start, T), np.full(1, np.inf))
    H, g = np.zeros((S + N * L, S + N * L)), np.zeros(S + N * L)
    for n in range(N):
        block = np.zeros((7, 7))
        block[:3, :3] = block[3:6, 3:6] = T[n, :3, :3]
        block[6, 6] = 1.0
        J = np.zeros((7, S + N * L))
        J[:, :S], J[:, S + n * L : S + (n + 1) * L] = block @ J_shared[0, n], block @ J_local[0, n]
        H += J.T @ local.H[0, n] @ J
        g += J.T @ local.g[0, n]
    H[S:, S:] += np.diag(np.tile(prior.diagonal, N))
    g[S:] += prior.g[0].ravel()
    H += damping * np.diag(np.diag(H) + CURVATURE_FLOOR)
    step = -np.linalg.solve(H, g)
    expected = start.retract(step[None, :S], step[S:].reshape(1, N, L)).poses()
    found = solution.motion.poses()
    np.testing.assert_allclose(found.R, expected.R, atol=1e-9)
    np.testing.assert_allclose(found.centre, expected.centre, atol=1e-9)
    np.testing.assert_allclose(found.scale, expected.scale, atol=1e-9)


@EVERY
def test_hypotheses_are_independent(kind: Callable[[Hinge], Motion]) -> None:
    _, start, T, target = problem(kind, True, hypotheses=4, size=0.5)
    together = minimise(start, [Match(target)], T, iterations=6)
    for b in range(4):
        alone = minimise(start.take(np.array([b])), [Match(target)], T, iterations=6)
        assert alone.energy[0] == pytest.approx(together.energy[b], rel=1e-9, abs=1e-9)
        np.testing.assert_allclose(alone.motion.poses().R[0], together.motion.poses().R[b], atol=1e-9)
        assert alone.status[0] == together.status[b]


@EVERY
def test_the_energy_never_rises(kind: Callable[[Hinge], Motion]) -> None:
    _, start, T, target = problem(kind, True, hypotheses=5, size=1.5)
    energies = [minimise(start, [Match(target)], T, iterations=k).energy for k in range(8)]
    assert (np.diff(energies, axis=0) <= 0.0).all()
    assert (energies[-1] < energies[0]).all()


def test_derivatives_beyond_the_bound_are_not_read() -> None:
    _, start, T, target = problem(at_hinge, True, hypotheses=5, size=1.5)
    whole, lazy = (minimise(start, [term(target)], T, iterations=12) for term in (Match, Lazy))
    np.testing.assert_array_equal(whole.energy, lazy.energy)
    np.testing.assert_array_equal(whole.motion.poses().R, lazy.motion.poses().R)


def test_the_bound_of_a_term_is_what_the_terms_before_it_leave() -> None:
    _, start, T, target = problem(at_soft, False, hypotheses=3, size=0.3)
    calls: list[ndarray] = []
    terms = [Match(target), Match(target, calls=calls)]
    spent = terms[0](poses_in_camera(start, T), np.full(3, np.inf)).value.sum(axis=1) + start.prior().value
    evaluate(start, terms, T, np.full(3, 1e9))
    np.testing.assert_allclose(calls[0], 1e9 - spent)


def test_invisible_hypotheses_are_reported_and_left_alone() -> None:
    _, start, T, target = problem(at_fixed, False, hypotheses=3)
    assert isinstance(start, Fixed)
    behind = start.centre.copy()
    behind[1] = [0.0, 0.0, -50.0]
    T = se3.rigid(np.tile(np.eye(3), (N, 1, 1)), T[:, :3, 3])
    start = replace(start, centre=behind)
    solution = minimise(start, [Blind(target)], T, iterations=10)
    assert solution.status[1] is Status.INVISIBLE
    assert np.isinf(solution.energy[1])
    np.testing.assert_array_equal(solution.motion.centre[1], behind[1])
    assert np.isfinite(solution.energy[[0, 2]]).all()
    assert Status.INVISIBLE not in (solution.status[0], solution.status[2])


def test_statuses_say_what_happened() -> None:
    true, start, T, target = problem(at_hinge, False, hypotheses=1)
    assert minimise(start, [Match(target)], T, iterations=1).status == [Status.LIMIT]
    floor = Match(target + 0.01 * np.random.default_rng(3).normal(size=target.shape))
    assert minimise(start, [floor], T, iterations=60).status == [Status.CONVERGED]
    at_minimum = minimise(start, [floor], T, iterations=60, rules=DampingRules(tolerance=0.0)).motion
    assert minimise(at_minimum, [floor], T, iterations=60, rules=DampingRules(tolerance=0.0)).status == [Status.STUCK]
    for status in Status:
        assert status.sentence != status.value
    assert true is not start


def test_terms_and_prior_sum_to_the_energy() -> None:
    _, start, T, target = problem(at_soft, False, hypotheses=3, size=0.3)
    terms = [Match(target, name="one"), Match(target + 0.01, stiffness=0.3 * STIFF, name="two")]
    solution = minimise(start, terms, T, iterations=4)
    assert list(solution.terms) == ["one", "two", "prior"]
    np.testing.assert_allclose(sum(solution.terms.values()), solution.energy)
    np.testing.assert_allclose(solution.terms["prior"], solution.motion.prior().value)
    some = solution.take(np.array([2, 0]))
    np.testing.assert_array_equal(some.energy, solution.energy[[2, 0]])
    assert some.status == [solution.status[2], solution.status[0]]


def test_a_softer_ridge_lets_frames_go_their_way() -> None:
    """Frames that do not move as one: a stiff soft motion is the core's, a weak one takes up the rest."""
    rng = np.random.default_rng(5)
    T = track(rng)
    wild = at_free(truth(rng, 1, False))
    target = targets(nudged(wild, rng, 0.1), T)
    core = at_fixed(truth(np.random.default_rng(5), 1, False))
    energies = []
    for ridge in (1e-3, 1e3, 1e12):
        start = Soft(core, np.zeros((1, N, 6)), (ridge, ridge))
        energies.append(
            minimise(start, [Match(target)], T, iterations=60, rules=DampingRules(tolerance=1e-9)).energy[0]
        )
    rigid = minimise(core, [Match(target)], T, iterations=60, rules=DampingRules(tolerance=1e-9)).energy[0]
    assert energies[0] < energies[1] < energies[2]
    assert energies[0] < 1e-2 * rigid
    assert energies[2] == pytest.approx(rigid, rel=1e-3)


class Tied:
    """A term that ties frames to each other by nothing."""

    name = "tied"

    def __init__(self, inner: Term) -> None:
        self.inner = inner

    def __call__(self, poses: PosesInCamera, bound: ndarray) -> Quadratic:
        local = self.inner(poses, bound)
        return replace(local, cross=np.zeros((*local.g.shape, *local.g.shape[1:])))


@pytest.mark.parametrize("free_scale", [False, True])
def test_tied_by_nothing_frames_are_solved_as_ever(free_scale: bool) -> None:
    rng = np.random.default_rng(8)
    poses = random_poses(rng)
    terms = [some_term("reprojection", rng), some_term("interaction", rng)]
    start = Free(poses.R, poses.centre, np.log(poses.scale), free_scale)
    T = np.tile(np.eye(4), (TERM_FRAMES, 1, 1))
    alone = minimise(start, terms, T, 4)
    tied = minimise(start, [Tied(term) for term in terms], T, 4)
    np.testing.assert_allclose(alone.energy, tied.energy, rtol=1e-6)
    np.testing.assert_allclose(alone.motion.centre, tied.motion.centre, atol=1e-6)


def test_steps_of_tied_frames_are_newton_steps() -> None:
    """The smoothness of a body that may only be shifted is quadratic, and its minimum between two images known."""
    rng = np.random.default_rng(9)
    centre = np.array([0.0, 0.0, 0.5]) + rng.normal(0.0, 0.02, (1, TERM_FRAMES, 3))
    start = Free(np.tile(np.eye(3), (1, TERM_FRAMES, 1, 1)), centre, np.zeros(1))
    smooth, fixed = SmoothnessTerm(vertex_moments(np.zeros((1, 3))), 2e5), InteractionTerm(centre[0].copy(), 1e5)
    chain = 2.0 * np.eye(TERM_FRAMES) - np.eye(TERM_FRAMES, k=1) - np.eye(TERM_FRAMES, k=-1)
    chain[0, 0] = chain[-1, -1] = 1.0
    expected = np.linalg.solve(1e5 * np.eye(TERM_FRAMES) + 2e5 * chain, 1e5 * centre[0])
    found = minimise(
        start, [smooth, fixed], np.tile(np.eye(4), (TERM_FRAMES, 1, 1)), 12, rules=DampingRules(tolerance=1e-12)
    ).motion.centre[0]
    np.testing.assert_allclose(found, expected, atol=1e-6)


ADAM_B, ADAM_N = 2, 4
ADAM_T = se3.rigid(se3.exp_so3(np.random.default_rng(5).normal(size=(ADAM_N, 3))), np.zeros((ADAM_N, 3)))


@dataclass(frozen=True)
class MatchAxes:
    """Squared distances of three points of the object to given ones."""

    target: ndarray
    stiffness: float = 1e4
    name: str = "match"

    def __call__(self, poses: PosesInCamera, bound: ndarray) -> Quadratic:
        arm = poses.scale[:, None, None, None] * (0.1 * np.eye(3)) @ np.swapaxes(poses.R, -1, -2)
        error = (poses.centre[:, :, None] + arm - self.target).reshape(*poses.centre.shape[:2], 9)
        eye = np.broadcast_to(np.eye(3), (*arm.shape, 3))
        J = np.concatenate([eye, -se3.hat(arm), arm[..., None]], axis=-1).reshape(*error.shape, 7)
        return Quadratic.of_squares(error, J, self.stiffness)


def motions() -> dict[str, Callable[[], Motion]]:
    rng = np.random.default_rng(1)
    R, centre, log_scale = (
        se3.exp_so3(rng.normal(size=(ADAM_B, 3))),
        rng.normal(0.0, 0.05, (ADAM_B, 3)),
        np.zeros(ADAM_B),
    )
    fixed = Fixed(R, centre, log_scale, ADAM_N, free_scale=True)
    held = fixed.poses()
    hinge = Hinge(
        R,
        centre,
        log_scale,
        centre,
        R[:, :, 2],
        rng.normal(0.0, 0.2, (ADAM_B, ADAM_N)),
        free_scale=True,
        ridge=3.0,
    )
    return {
        "fixed": lambda: fixed,
        "free": lambda: Free(held.R.copy(), held.centre.copy(), log_scale, free_scale=True),
        "hinge": lambda: hinge,
        "hinge at its place": lambda: replace(hinge, free_location=False, free_scale=False),
    }


def target(motion: Motion, rng: np.random.Generator) -> MatchAxes:
    """Where the first hypothesis' points come after a step."""
    shared, local = motion.lengths()
    step = [np.where(lengths, 0.01, 0.1) * rng.normal(size=(ADAM_B, *shape, len(lengths))) for lengths, shape in
            ((shared, ()), (local, (ADAM_N,)))]  # fmt: skip
    poses = solve.poses_in_camera(motion.retract(*step), ADAM_T)
    arm = poses.scale[:, None, None, None] * (0.1 * np.eye(3)) @ np.swapaxes(poses.R, -1, -2)
    return MatchAxes((poses.centre[:, :, None] + arm)[0])


@pytest.mark.parametrize("kind", motions())
def test_gradients_by_the_parameters(kind: str) -> None:
    motion = motions()[kind]()
    term, free, h = target(motion, np.random.default_rng(2)), np.full(ADAM_B, np.inf), 1e-6
    g_shared, g_local = energy_gradient(motion, evaluate(motion, [term], ADAM_T, free).local, ADAM_T)
    S, L = g_shared.shape[1], g_local.shape[2]
    assert tuple(map(len, motion.lengths())) == (S, L)

    def energy(shared: ndarray, local: ndarray) -> ndarray:
        step = np.tile(shared, (ADAM_B, 1)), np.tile(local, (ADAM_B, 1, 1))
        return evaluate(motion.retract(*step), [term], ADAM_T, free).cost

    for k in range(S):
        step = h * np.eye(S)[k], np.zeros((ADAM_N, L))
        expected = (energy(*step) - energy(-step[0], step[1])) / (2.0 * h)
        np.testing.assert_allclose(g_shared[:, k], expected, rtol=1e-4, atol=1e-4 * np.abs(g_shared).max())
    for k in range(ADAM_N * L):
        step = np.zeros(S), h * np.eye(ADAM_N * L)[k].reshape(ADAM_N, L)
        expected = (energy(*step) - energy(step[0], -step[1])) / (2.0 * h)
        np.testing.assert_allclose(
            g_local.reshape(ADAM_B, -1)[:, k], expected, rtol=1e-4, atol=1e-4 * np.abs(g_local).max()
        )


@pytest.mark.parametrize("kind", motions())
def test_it_comes_to_the_minimum_that_levenberg_marquardt_finds(kind: str) -> None:
    motion = motions()[kind]()
    term = target(motion, np.random.default_rng(3))
    start = evaluate(motion, [term], ADAM_T, np.full(ADAM_B, np.inf)).cost
    least = solve.minimise(motion, [term], ADAM_T, 100).energy
    found = minimise_by_adam(motion, [term], ADAM_T, 100, 0.05)
    assert found.status == [Status.FINISHED] * ADAM_B
    assert (found.energy - least <= 0.05 * (start - least)).all()
    np.testing.assert_allclose(sum(found.terms.values()), found.energy)
    np.testing.assert_allclose(evaluate(found.motion, [term], ADAM_T, found.energy).cost, found.energy)


def test_it_never_ends_worse_than_it_began() -> None:
    motion = motions()["hinge"]()
    term = target(motion, np.random.default_rng(4))
    start = evaluate(motion, [term], ADAM_T, np.full(ADAM_B, np.inf)).cost
    assert (minimise_by_adam(motion, [term], ADAM_T, 3, 5.0).energy <= start).all()  # a rate that leads astray


def test_the_unit_of_energy_does_not_matter() -> None:
    motion = replace(motions()["hinge"](), ridge=0.0)  # type: ignore[type-var]
    term = target(motion, np.random.default_rng(6))
    ends = [minimise_by_adam(motion, [replace(term, stiffness=s)], ADAM_T, 40, 0.02).motion.poses() for s in (1e3, 1e6)]
    np.testing.assert_allclose(ends[0].centre, ends[1].centre, atol=1e-6)


def test_an_object_behind_the_camera_is_lost() -> None:
    @dataclass(frozen=True)
    class Nowhere:
        name: str = "nowhere"

        def __call__(self, poses: PosesInCamera, bound: ndarray) -> Quadratic:
            found = Quadratic.zero(poses)
            found.value[0] = np.inf
            return found

    found = minimise_by_adam(motions()["fixed"](), [Nowhere()], ADAM_T, 2, 0.1)
    assert found.status == [Status.INVISIBLE, Status.FINISHED]
