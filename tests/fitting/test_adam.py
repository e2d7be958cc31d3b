"""Laws of Adam on terms whose minimum is known: it gets there, never ends worse, and knows no unit of energy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy import ndarray

from getagrip.fitting.energy import PosesInCamera, Quadratic
from getagrip.fitting.motion import Fixed, Free, Hinge, Motion
from getagrip.fitting.solver import solve
from getagrip.fitting.solver.solve import energy_gradient, evaluate, minimise_by_adam
from getagrip.geometry import se3
from getagrip.result import Status

B, N = 2, 4
T_CAM_HAND = se3.rigid(se3.exp_so3(np.random.default_rng(5).normal(size=(N, 3))), np.zeros((N, 3)))


@dataclass(frozen=True)
class Match:
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
    R, centre, log_scale = se3.exp_so3(rng.normal(size=(B, 3))), rng.normal(0.0, 0.05, (B, 3)), np.zeros(B)
    fixed = Fixed(R, centre, log_scale, N, free_scale=True)
    held = fixed.poses()
    hinge = Hinge(R, centre, log_scale, centre, R[:, :, 2], rng.normal(0.0, 0.2, (B, N)), free_scale=True, ridge=3.0)
    return {
        "fixed": lambda: fixed,
        "free": lambda: Free(held.R.copy(), held.centre.copy(), log_scale, free_scale=True),
        "hinge": lambda: hinge,
        "hinge at its place": lambda: replace(hinge, free_location=False, free_scale=False),
    }


def target(motion: Motion, rng: np.random.Generator) -> Match:
    """Where the first hypothesis' points come after a step."""
    shared, local = motion.lengths()
    step = [np.where(lengths, 0.01, 0.1) * rng.normal(size=(B, *shape, len(lengths))) for lengths, shape in
            ((shared, ()), (local, (N,)))]  # fmt: skip
    poses = solve.poses_in_camera(motion.retract(*step), T_CAM_HAND)
    arm = poses.scale[:, None, None, None] * (0.1 * np.eye(3)) @ np.swapaxes(poses.R, -1, -2)
    return Match((poses.centre[:, :, None] + arm)[0])


@pytest.mark.parametrize("kind", motions())
def test_gradients_by_the_parameters(kind: str) -> None:
    motion = motions()[kind]()
    term, free, h = target(motion, np.random.default_rng(2)), np.full(B, np.inf), 1e-6
    g_shared, g_local = energy_gradient(motion, evaluate(motion, [term], T_CAM_HAND, free).local, T_CAM_HAND)
    S, L = g_shared.shape[1], g_local.shape[2]
    assert tuple(map(len, motion.lengths())) == (S, L)

    def energy(shared: ndarray, local: ndarray) -> ndarray:
        step = np.tile(shared, (B, 1)), np.tile(local, (B, 1, 1))
        return evaluate(motion.retract(*step), [term], T_CAM_HAND, free).cost

    for k in range(S):
        step = h * np.eye(S)[k], np.zeros((N, L))
        expected = (energy(*step) - energy(-step[0], step[1])) / (2.0 * h)
        np.testing.assert_allclose(g_shared[:, k], expected, rtol=1e-4, atol=1e-4 * np.abs(g_shared).max())
    for k in range(N * L):
        step = np.zeros(S), h * np.eye(N * L)[k].reshape(N, L)
        expected = (energy(*step) - energy(step[0], -step[1])) / (2.0 * h)
        np.testing.assert_allclose(g_local.reshape(B, -1)[:, k], expected, rtol=1e-4, atol=1e-4 * np.abs(g_local).max())


@pytest.mark.parametrize("kind", motions())
def test_it_comes_to_the_minimum_that_levenberg_marquardt_finds(kind: str) -> None:
    motion = motions()[kind]()
    term = target(motion, np.random.default_rng(3))
    start = evaluate(motion, [term], T_CAM_HAND, np.full(B, np.inf)).cost
    least = solve.minimise(motion, [term], T_CAM_HAND, 100).energy
    found = minimise_by_adam(motion, [term], T_CAM_HAND, 100, 0.05)
    assert found.status == [Status.FINISHED] * B
    assert (found.energy - least <= 0.05 * (start - least)).all()
    np.testing.assert_allclose(sum(found.terms.values()), found.energy)
    np.testing.assert_allclose(evaluate(found.motion, [term], T_CAM_HAND, found.energy).cost, found.energy)


def test_it_never_ends_worse_than_it_began() -> None:
    motion = motions()["hinge"]()
    term = target(motion, np.random.default_rng(4))
    start = evaluate(motion, [term], T_CAM_HAND, np.full(B, np.inf)).cost
    assert (minimise_by_adam(motion, [term], T_CAM_HAND, 3, 5.0).energy <= start).all()  # a rate that leads astray


def test_the_unit_of_energy_does_not_matter() -> None:
    motion = replace(motions()["hinge"](), ridge=0.0)  # type: ignore[type-var]
    term = target(motion, np.random.default_rng(6))
    ends = [
        minimise_by_adam(motion, [replace(term, stiffness=s)], T_CAM_HAND, 40, 0.02).motion.poses() for s in (1e3, 1e6)
    ]
    np.testing.assert_allclose(ends[0].centre, ends[1].centre, atol=1e-6)


def test_what_is_behind_the_camera_is_lost() -> None:
    @dataclass(frozen=True)
    class Nowhere:
        name: str = "nowhere"

        def __call__(self, poses: PosesInCamera, bound: ndarray) -> Quadratic:
            found = Quadratic.zero(poses)
            found.value[0] = np.inf
            return found

    found = minimise_by_adam(motions()["fixed"](), [Nowhere()], T_CAM_HAND, 2, 0.1)
    assert found.status == [Status.INVISIBLE, Status.FINISHED]
