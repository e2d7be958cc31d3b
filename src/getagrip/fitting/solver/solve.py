"""The fit of a motion model to an energy, for many hypotheses at once: by Levenberg-Marquardt, or by Adam.

The energy is a sum of terms over frames plus the motion model's own prior. Terms give gradient and Hessian by each
frame's local 7-vector, the motion model its Jacobian; their sums are transformed to the model's parameters.
Levenberg-Marquardt (``minimise``, by ``least_squares``) keeps a step only if the energy itself has fallen.

Adam (``minimise_by_adam``; Kingma and Ba, 2015) uses gradients only, and is far slower. The paper names no optimiser;
its authors' later code uses Adam.

- **Parameters** are those of the motion model (``Motion.retract``): a step turns and shifts the current pose and axis,
  so that rotations stay rotations. Moments are kept in these local coordinates.
- **Units.** Adam's steps are about as long in every parameter, so lengths need a unit: 1 rad (of angles, and 1 of the
  log scale) is worth ``METRES_PER_RADIAN``, as in the longest Levenberg-Marquardt step.
- **Rate.** It falls to zero by half a cosine, and the best iterate counts, not the last.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import reduce
from typing import Generic, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip import least_squares
from getagrip.fitting.energy import HandInCamera, ObjectWithHand, PosesInCamera, Quadratic, Term
from getagrip.fitting.motion import HandPoses, Motion, PosesInHand, transform_poses
from getagrip.fitting.solver.damped_step import damped_steps
from getagrip.least_squares import DEFAULT_DAMPING_RULES, BlockArrow, DampingRules, Ending
from getagrip.result import Status

M = TypeVar("M", bound=Motion)

CURVATURE_FLOOR = 1e2
"""Curvature assumed in directions that leave the energy unchanged [px^2 per m^2 or rad^2]."""
MAX_ROTATION_STEP_RAD = 0.6
"""Maximum step of a frame's rotation [rad]; a translation's is 10 cm per radian of it."""
METRES_PER_RADIAN = 0.1
"""Length that is worth a radian, in Adam's steps."""
ADAM_DECAY_RATES = (0.9, 0.999)
"""Decay rates of the first and the second moment: Adam's defaults."""
STATUS_OF_ENDING = {
    Ending.LOST: Status.INVISIBLE,
    Ending.CONVERGED: Status.CONVERGED,
    Ending.STUCK: Status.STUCK,
    Ending.LIMIT: Status.LIMIT,
}


@dataclass(frozen=True)
class Solution(Generic[M]):
    """The best parameters found from each start.

    Attributes:
        motion: the best motion of each hypothesis.
        energy: (B,) energy of each, priors included [px^2 of the 256-pixel crop].
        terms: per term, (B,): its energy summed over frames; ``prior`` is the motion model's own.
        status: end of each minimisation.
        evaluations: number of frames evaluated, in all.
    """

    motion: M
    energy: Float[ndarray, "B"]
    terms: dict[str, Float[ndarray, "B"]]
    status: list[Status]
    evaluations: int

    def take(self, index: Int[ndarray, "n"]) -> Solution[M]:
        """Return some of the solutions."""
        terms = {name: value[index] for name, value in self.terms.items()}
        status = [self.status[i] for i in index]
        return Solution(self.motion.take(index), self.energy[index], terms, status, self.evaluations)

    def concatenate(self, other: Solution[M]) -> Solution[M]:
        """Return these solutions, then the other's."""
        motion, energy = self.motion.concatenate(other.motion), np.concatenate([self.energy, other.energy])
        terms = {name: np.concatenate([value, other.terms[name]]) for name, value in self.terms.items()}
        return Solution(motion, energy, terms, [*self.status, *other.status], self.evaluations + other.evaluations)


def poses_in_camera(motion: Motion, T_cam_hand: Float[ndarray, "N 4 4"]) -> PosesInCamera:
    """Return the motion's poses as the terms read them."""
    seen = transform_poses(motion.poses(), T_cam_hand)
    if seen.hand is None:
        return PosesInCamera(*_to_kernel_layout(seen))
    hand = HandInCamera(*_to_kernel_layout(seen.hand), seen.hand.frame.middle)
    return ObjectWithHand(*_to_kernel_layout(seen), hand, PosesInCamera(*_to_kernel_layout(seen.hand.grasped)))


def _to_kernel_layout(
    poses: PosesInHand | HandPoses,
) -> tuple[Float[ndarray, "B N 3 3"], Float[ndarray, "B N 3"], Float[ndarray, "B"]]:
    """Copy poses to the only layout that kernels are compiled for."""
    return np.ascontiguousarray(poses.R), np.ascontiguousarray(poses.centre), poses.scale


@dataclass
class _MotionState(Generic[M]):
    """Hypotheses with energy and derivatives at their current parameters (``least_squares.State``)."""

    motion: M
    local: Quadratic
    values: ndarray
    """(B, terms + 1): energy per term, then the prior."""
    terms: Sequence[Term]
    T_cam_hand: Float[ndarray, "N 4 4"]

    @property
    def cost(self) -> Float[ndarray, "B"]:
        return np.asarray(self.values.sum(axis=1))

    def trial(self, active: Int[ndarray, "n"], damping: Float[ndarray, "n"]) -> _MotionState[M]:
        motion, local = self.motion.take(active), self.local.take(active)
        shared, per_frame = _damped_step(motion, local, damping, self.T_cam_hand)
        return evaluate(motion.retract(shared, per_frame), self.terms, self.T_cam_hand, self.cost[active])

    def accept(self, trial: _MotionState[M], active: Int[ndarray, "n"], better: Bool[ndarray, "n"]) -> _MotionState[M]:
        if not better.any():
            return self
        rows, chosen = active[better], np.flatnonzero(better)
        if len(rows) == len(self.values):
            return trial
        self.local.put(rows, trial.local.take(chosen))
        self.values[rows] = trial.values[better]
        motion = self.motion.updated(rows, trial.motion.take(chosen))
        return replace(self, motion=motion)


def evaluate(
    motion: M, terms: Sequence[Term], T_cam_hand: Float[ndarray, "N 4 4"], bound: Float[ndarray, "B"]
) -> _MotionState[M]:
    """Evaluate energy and derivatives; derivatives may be missing where the energy exceeds ``bound``."""
    poses = poses_in_camera(motion, T_cam_hand)
    prior = motion.prior().value
    values = np.empty((len(prior), len(terms) + 1))
    values[:, -1] = prior
    total: Quadratic | None = None
    for k, term in enumerate(terms):
        with np.errstate(invalid="ignore"):  # behind the camera: infinity minus infinity
            local = term(poses, bound - prior - values[:, :k].sum(axis=1)).within(poses.size)
        values[:, k] = local.value.sum(axis=1)
        total = local if total is None else total + local
    assert total is not None
    return _MotionState(motion, total, values, terms, T_cam_hand)


def minimise(
    motion: M,
    terms: Sequence[Term],
    T_cam_hand: Float[ndarray, "N 4 4"],
    iterations: int,
    rules: DampingRules = DEFAULT_DAMPING_RULES,
    threads: int = 1,
) -> Solution[M]:
    """Minimise the sum of terms from each of B hypotheses, each until the rules stop it.

    Hypotheses are independent, so ``threads`` share them; the result is the same to the last bit.
    """
    shares = np.array_split(np.arange(len(motion.poses().scale)), threads)
    some = [motion.take(share) for share in shares if len(share)]
    if len(some) < 2:
        return _minimise_together(motion, terms, T_cam_hand, iterations, rules)
    with ThreadPoolExecutor(len(some)) as pool:
        found = pool.map(lambda part: _minimise_together(part, terms, T_cam_hand, iterations, rules), some)
        return reduce(lambda first, then: first.concatenate(then), found)


def _minimise_together(
    motion: M, terms: Sequence[Term], T_cam_hand: Float[ndarray, "N 4 4"], iterations: int, rules: DampingRules
) -> Solution[M]:
    B, N = len(motion.poses().scale), len(T_cam_hand)
    start = evaluate(motion, terms, T_cam_hand, np.full(B, np.inf))
    found = least_squares.minimise(start, iterations, rules)
    status = [STATUS_OF_ENDING[ending] for ending in found.endings]
    values = _name_terms(terms, found.state.values)
    return Solution(found.state.motion, found.state.cost, values, status, found.evaluations * N)


def _name_terms(terms: Sequence[Term], values: ndarray) -> dict[str, Float[ndarray, "B"]]:
    return dict(zip([*(term.name for term in terms), "prior"], values.T, strict=True))


def _damped_step(
    motion: Motion, local: Quadratic, damping: Float[ndarray, "B"], T_cam_hand: Float[ndarray, "N 4 4"]
) -> tuple[Float[ndarray, "B S"], Float[ndarray, "B N L"]]:
    """Solve for the damped Gauss-Newton step of the shared and per-frame parameters, cut to the maximum step."""
    J_shared, J_local = motion.jacobian()
    prior = motion.prior()
    if local.cross is None and prior.cross is None and J_local.shape[2] == 7:
        R_cam_hand = T_cam_hand[:, :3, :3]
        return damped_steps(
            J_shared, J_local, local, prior, R_cam_hand, damping, CURVATURE_FLOOR, MAX_ROTATION_STEP_RAD
        )
    shared, per_frame = _motion_equations(motion, J_shared, J_local, local, T_cam_hand).step(damping, CURVATURE_FLOOR)
    moved = (J_shared @ shared[:, None, :, None] + J_local @ per_frame[..., None])[..., 0]
    if moved.shape[-1] > 7:
        moved = np.concatenate([moved[..., :7], moved[..., 7:14]], axis=1)
    turn, shift = np.linalg.norm(moved[..., 3:6], axis=-1), np.linalg.norm(moved[..., :3], axis=-1)
    shrink = np.minimum(1.0, MAX_ROTATION_STEP_RAD / np.maximum(np.maximum(turn, 10.0 * shift).max(axis=1), 1e-12))
    return shared * shrink[:, None], per_frame * shrink[:, None, None]


def _motion_equations(
    motion: Motion,
    J_shared: Float[ndarray, "B N P S"],
    J_local: Float[ndarray, "B N P L"],
    local: Quadratic,
    T_cam_hand: Float[ndarray, "N 4 4"],
) -> BlockArrow:
    """Sum the normal equations of the motion's parameters, with its own prior."""
    prior, J = motion.prior(), jacobian_in_camera(J_shared, J_local, T_cam_hand)
    arrow = BlockArrow.by(J, J_shared.shape[-1], local.H, local.g, local.between_frames)
    arrow = arrow.plus(H_ll=prior.H, g_l=prior.g, cross=prior.cross)
    if prior.diagonal_shared is None:
        return arrow
    return arrow.plus(H_ss=np.diag(prior.diagonal_shared), g_s=prior.g_shared)


def inverse_of_shared(
    motion: Motion, terms: Sequence[Term], T_cam_hand: Float[ndarray, "N 4 4"], last: int
) -> Float[ndarray, "n n"]:
    """Compute the inverse Hessian by all parameters of the first hypothesis; return the last shared ones' block.

    Multiplied by twice the energy of one standard deviation, the block is their covariance.
    """
    motion = motion.take(np.zeros(1, int))
    local = evaluate(motion, terms, T_cam_hand, np.full(1, np.inf)).local
    arrow = _motion_equations(motion, *motion.jacobian(), local, T_cam_hand)
    S, L = arrow.g_s.shape[-1], arrow.g_l.shape[-1]
    arrow = replace(arrow, H_ss=arrow.H_ss + CURVATURE_FLOOR * np.eye(S), H_ll=arrow.H_ll + CURVATURE_FLOOR * np.eye(L))
    unit = np.eye(S)[-last:, None]
    return -np.stack([replace(arrow, g_s=one, g_l=np.zeros_like(arrow.g_l)).solved()[0][0, -last:] for one in unit])


def jacobian_in_camera(
    J_shared: Float[ndarray, "B N P S"], J_local: Float[ndarray, "B N P L"], T_cam_hand: Float[ndarray, "N 4 4"]
) -> Float[ndarray, "B N P Q"]:
    """Stack a motion's Jacobians by columns, of local vectors in the camera's frame."""
    J, R = np.concatenate([J_shared, J_local], axis=-1), T_cam_hand[:, :3, :3]
    parts = [R @ J[..., :3, :], R @ J[..., 3:6, :], J[..., 6:7, :]]
    if J.shape[-2] > 7:  # the hand, its fingers, and the object in the hand
        parts += [R @ J[..., 7:10, :], R @ J[..., 10:13, :], J[..., 13:-7, :]]
        parts += [R @ J[..., -7:-4, :], R @ J[..., -4:-1, :], J[..., -1:, :]]
    return np.concatenate(parts, axis=-2)


def hessian(motion: Motion, terms: Sequence[Term], T_cam_hand: Float[ndarray, "N 4 4"]) -> Float[ndarray, "B N P P"]:
    """Compute the Gauss-Newton Hessian of each frame's terms by the shared parameters, then those of the frame.

    The motion's own prior and Hessians between frames are left out.
    """
    local = evaluate(motion, terms, T_cam_hand, np.full(len(motion.poses().scale), np.inf)).local
    J = jacobian_in_camera(*motion.jacobian(), T_cam_hand)
    return np.asarray(np.swapaxes(J, -1, -2) @ (local.H @ J))


@dataclass
class Adam:
    """Adam's two moments of the parameters of B hypotheses, and its steps; the rate falls to zero by half a cosine."""

    unit: Float[ndarray, "P"]
    """Length that is worth a radian, of each parameter."""
    iterations: int
    rate: float
    """Length of the first step [rad]."""

    def __post_init__(self) -> None:
        self.done, self.mean, self.square = 0, np.zeros(1), np.zeros(1)

    def step(self, g: Float[ndarray, "B P"]) -> Float[ndarray, "B P"]:
        """Add a gradient to the moments, and return the next step."""
        g = np.nan_to_num(self.unit * g)
        now = 0.5 * self.rate * (1.0 + np.cos(np.pi * self.done / self.iterations))
        self.done += 1
        first, second = ADAM_DECAY_RATES
        self.mean = first * self.mean + (1.0 - first) * g
        self.square = second * self.square + (1.0 - second) * g**2
        mean, square = self.mean / (1.0 - first**self.done), self.square / (1.0 - second**self.done)
        return -now * self.unit * mean / (np.sqrt(square) + 1e-12)


def minimise_by_adam(
    motion: M, terms: Sequence[Term], T_cam_hand: Float[ndarray, "N 4 4"], iterations: int, rate: float
) -> Solution[M]:
    """Minimise from each of B hypotheses by Adam, with an initial step of ``rate`` [rad]; keep the best iterates."""
    shared, local = motion.lengths()
    B, S = len(motion.poses().scale), len(shared)
    lengths = np.concatenate([shared, np.tile(local, len(T_cam_hand))])
    adam = Adam(np.where(lengths, METRES_PER_RADIAN, 1.0), iterations, rate)
    free = np.full(B, np.inf)
    best, least = motion, free
    values = np.zeros((B, len(terms) + 1))
    for _ in range(iterations + 1):
        state = evaluate(motion, terms, T_cam_hand, free)
        better = state.cost < least
        best, least = motion.where(better, best), np.where(better, state.cost, least)
        values = np.where(better[:, None], state.values, values)
        g_shared, g_local = energy_gradient(motion, state.local, T_cam_hand)
        step = adam.step(np.concatenate([g_shared, g_local.reshape(B, -1)], axis=1))
        motion = motion.retract(step[:, :S], step[:, S:].reshape(g_local.shape))
    status = [Status.FINISHED if np.isfinite(energy) else Status.INVISIBLE for energy in least]
    return Solution(best, least, _name_terms(terms, values), status, B * len(T_cam_hand) * (iterations + 1))


def energy_gradient(
    motion: Motion, local: Quadratic, T_cam_hand: Float[ndarray, "N 4 4"]
) -> tuple[Float[ndarray, "B S"], Float[ndarray, "B N L"]]:
    """Compute the energy's gradient by the shared and by the per-frame parameters, the motion's own prior included."""
    R = T_cam_hand[:, :3, :3]
    in_hand = [(part[..., None, :] @ R)[..., 0, :] for part in (local.g[..., :3], local.g[..., 3:6])]
    g = np.concatenate([*in_hand, local.g[..., 6:]], axis=-1)[..., None, :]
    J_shared, J_local = motion.jacobian()
    return (g @ J_shared)[..., 0, :].sum(axis=1), (g @ J_local)[..., 0, :] + motion.prior().g
