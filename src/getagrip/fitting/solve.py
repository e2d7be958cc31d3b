"""Levenberg-Marquardt on the block-arrow normal equations, for many hypotheses at once.

The energy is a sum of terms over frames plus the motion model's own prior. Terms give gradient and Hessian by each
frame's local 7-vector, the motion model its Jacobian; here they are summed, the per-frame parameters are eliminated
(Schur complement; not where a term ties frames to each other), and a step is kept only if the energy itself has fallen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Generic, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.fitting.energy import Local, Poses, Term
from getagrip.fitting.motion import Motion

M = TypeVar("M", bound=Motion)

_ACCEPTED, _REJECTED = 0.3, 6.0
"""Factors on the damping after a step."""
_FLOOR = 1e2
"""Curvature assumed in directions that the energy does not see [px^2 per m^2 or rad^2]."""
_LONGEST = 0.6
"""Longest step of a frame's rotation [rad]; translations scale with it at 10 cm a radian."""


class Status(StrEnum):
    """How a minimisation ended, as a sentence that says what to do about it."""

    CONVERGED = "converged: further steps gain less than 0.1 % of the energy"
    STUCK = "stopped: no step lowers the energy any more"
    LIMIT = "stopped at the iteration limit while the energy was still falling a little; --thorough goes on longer"
    INVISIBLE = "failed: the object is behind the camera or too near to it in every hypothesis tried"


@dataclass(frozen=True)
class Solution(Generic[M]):
    """The best parameters found from each start."""

    motion: M
    energy: Float[ndarray, "B"]
    terms: dict[str, Float[ndarray, "B"]]
    """Energy per term, summed over frames; ``prior`` is the motion model's own."""
    status: list[Status]
    evaluations: int
    """Frame evaluations spent."""

    def take(self, index: Int[ndarray, "n"]) -> Solution[M]:
        """Some of the solutions."""
        return Solution(
            self.motion.take(index),
            self.energy[index],
            {name: value[index] for name, value in self.terms.items()},
            [self.status[i] for i in index],
            self.evaluations,
        )

    def joined(self, other: Solution[M]) -> Solution[M]:
        """These solutions, then the other's."""
        return Solution(
            self.motion.joined(other.motion),
            np.concatenate([self.energy, other.energy]),
            {name: np.concatenate([value, other.terms[name]]) for name, value in self.terms.items()},
            [*self.status, *other.status],
            self.evaluations + other.evaluations,
        )


def in_camera(motion: Motion, T_cam_hand: Float[ndarray, "N 4 4"]) -> Poses:
    """The motion's poses as the terms want them."""
    held = motion.poses()
    R_cam_hand = T_cam_hand[:, :3, :3]
    centre = (R_cam_hand @ held.centre[..., None])[..., 0] + T_cam_hand[:, :3, 3]
    # Kernels are compiled for one layout; another would compile each of them again.
    return Poses(np.ascontiguousarray(R_cam_hand @ held.R), np.ascontiguousarray(centre), held.scale)


@dataclass
class _State(Generic[M]):
    """Hypotheses with everything known about them at their current parameters."""

    motion: M
    local: Local
    terms: ndarray
    """(B, terms + 1): energy per term, then the prior."""

    @property
    def energy(self) -> Float[ndarray, "B"]:
        return np.asarray(self.terms.sum(axis=1))


def evaluate(
    motion: M, terms: Sequence[Term], T_cam_hand: Float[ndarray, "N 4 4"], bound: Float[ndarray, "B"]
) -> _State[M]:
    """Energy and derivatives; derivatives may be missing where the energy exceeds ``bound``."""
    poses = in_camera(motion, T_cam_hand)
    prior = motion.prior().value
    values = np.empty((len(prior), len(terms) + 1))
    values[:, -1] = prior
    total: Local | None = None
    for k, term in enumerate(terms):
        with np.errstate(invalid="ignore"):  # behind the camera: no bound, and nothing of it left
            local = term(poses, bound - prior - values[:, :k].sum(axis=1))
        values[:, k] = local.value.sum(axis=1)
        total = local if total is None else total + local
    assert total is not None
    return _State(motion, total, values)


def minimise(
    motion: M,
    terms: Sequence[Term],
    T_cam_hand: Float[ndarray, "N 4 4"],
    iterations: int,
    damping: float = 1e-2,
    tolerance: float = 1e-3,
) -> Solution[M]:
    """Minimise the sum of terms from each of the motion's B hypotheses.

    A hypothesis stops after two successive steps that gain less than ``tolerance`` of its energy, after four
    rejected steps in a row, or at the limit of iterations (each one evaluation).
    """
    B, N = len(motion.poses().scale), len(T_cam_hand)
    state = evaluate(motion, terms, T_cam_hand, np.full(B, np.inf))
    lam = np.full(B, damping)
    rejects, small = np.zeros(B, int), np.zeros(B, int)
    evaluations = B * N
    alive = np.isfinite(state.energy)
    for _ in range(iterations):
        active = np.flatnonzero(alive & (rejects < 4) & (small < 2))
        if active.size == 0:
            break
        now = _take(state, active)
        shared, local = _step(now, lam[active], T_cam_hand)
        trial = evaluate(now.motion.moved(shared, local), terms, T_cam_hand, now.energy)
        evaluations += active.size * N
        better = trial.energy < now.energy
        gain = np.where(better, now.energy - trial.energy, 0.0)
        small[active] = np.where(
            better & (gain < tolerance * now.energy), small[active] + 1, np.where(better, 0, small[active])
        )
        rejects[active] = np.where(better, 0, rejects[active] + 1)
        lam[active] = np.clip(lam[active] * np.where(better, _ACCEPTED, _REJECTED), 1e-7, 1e7)
        state = _merge(state, trial, active, better)
    status = [
        Status.INVISIBLE if not a else Status.CONVERGED if s >= 2 else Status.STUCK if r >= 4 else Status.LIMIT
        for a, s, r in zip(alive, small, rejects, strict=True)
    ]
    names = [*(t.name for t in terms), "prior"]
    return Solution(state.motion, state.energy, dict(zip(names, state.terms.T, strict=True)), status, evaluations)


def _step(
    state: _State[M], lam: Float[ndarray, "B"], T_cam_hand: Float[ndarray, "N 4 4"]
) -> tuple[Float[ndarray, "B S"], Float[ndarray, "B N L"]]:
    """The damped Gauss-Newton step: eliminate the per-frame parameters, solve for the shared ones, substitute back."""
    J_shared, J_local = state.motion.jacobian()
    S, L = J_shared.shape[-1], J_local.shape[-1]
    prior = state.motion.prior()
    J = np.concatenate([J_shared, J_local], axis=-1)
    R = T_cam_hand[:, :3, :3]
    J_cam = np.concatenate([R @ J[..., :3, :], R @ J[..., 3:6, :], J[..., 6:, :]], axis=-2)
    Jt = np.swapaxes(J_cam, -1, -2)
    A = Jt @ (state.local.H @ J_cam)
    b = (Jt @ state.local.g[..., None])[..., 0]
    H_ss, g_s = A[..., :S, :S].sum(axis=1), b[..., :S].sum(axis=1)
    H_sl, H_ll, g_l = A[..., :S, S:], A[..., S:, S:], b[..., S:] + prior.g
    H_ll = H_ll + np.diag(prior.diagonal)
    across = None
    if state.local.across is not None:
        tied = _tied(state.local.across, J_cam[..., :S], J_cam[..., S:])
        H_ss, H_sl, across = H_ss + tied[0], H_sl + tied[1], tied[2]
    H_ss = H_ss + _diagonal(lam[:, None] * (np.diagonal(H_ss, axis1=-2, axis2=-1) + _FLOOR))
    H_ll = H_ll + _diagonal(lam[:, None, None] * (np.diagonal(H_ll, axis1=-2, axis2=-1) + _FLOOR))
    if across is not None:
        shared, local = _coupled(H_ss, H_sl, H_ll, across, g_s, g_l)
    elif L == 0:
        shared, local = -np.linalg.solve(H_ss, g_s[..., None])[..., 0], np.zeros((*b.shape[:2], 0))
    else:
        right = np.concatenate([np.swapaxes(H_sl, -1, -2), g_l[..., None]], axis=-1)
        solved = right / H_ll if L == 1 else np.linalg.solve(H_ll, right)
        schur = H_ss - (H_sl @ solved[..., :S]).sum(axis=1)
        reduced = g_s - (H_sl @ solved[..., S:]).sum(axis=1)[..., 0]
        shared = -np.linalg.solve(schur, reduced[..., None])[..., 0] if S else np.zeros_like(g_s)
        local = -(solved[..., S] + (solved[..., :S] @ shared[:, None, :, None])[..., 0])
    moved = (J_shared @ shared[:, None, :, None] + J_local @ local[..., None])[..., 0]
    reach = np.maximum(np.linalg.norm(moved[..., 3:6], axis=-1), 10.0 * np.linalg.norm(moved[..., :3], axis=-1)).max(
        axis=1
    )
    shrink = np.minimum(1.0, _LONGEST / np.maximum(reach, 1e-12))
    return shared * shrink[:, None], local * shrink[:, None, None]


def _tied(
    across: Float[ndarray, "B N 7 N 7"], J_s: Float[ndarray, "B N 7 S"], J_l: Float[ndarray, "B N 7 L"]
) -> tuple[Float[ndarray, "B S S"], Float[ndarray, "B N S L"], Float[ndarray, "B N L N L"]]:
    """The Hessian between frames by the parameters: ``sum_ij Js_i^T A_ij Js_j``, ``sum_i Js_i^T A_ij Jl_j``,
    ``Jl_i^T A_ij Jl_j``.
    """
    B, N, _, S = J_s.shape
    L = J_l.shape[-1]
    flat, tall = across.reshape(B, N * 7, N * 7), J_s.reshape(B, N * 7, S)
    right = flat @ tall
    ss = np.swapaxes(tall, -1, -2) @ right
    sl = np.swapaxes(right.reshape(B, N, 7, S), -1, -2) @ J_l
    right = np.swapaxes(flat.reshape(B, N * 7, N, 7), 1, 2) @ J_l  # (B, j, i 7, L)
    right = np.swapaxes(right, 1, 2).reshape(B, N, 7, N * L)
    return ss, sl, (np.swapaxes(J_l, -1, -2) @ right).reshape(B, N, L, N, L)


def _coupled(
    H_ss: Float[ndarray, "B S S"],
    H_sl: Float[ndarray, "B N S L"],
    H_ll: Float[ndarray, "B N L L"],
    across: Float[ndarray, "B N L N L"],
    g_s: Float[ndarray, "B S"],
    g_l: Float[ndarray, "B N L"],
) -> tuple[Float[ndarray, "B S"], Float[ndarray, "B N L"]]:
    """The step where terms tie frames to each other: nothing can be eliminated, the system is solved as it is."""
    B, N, L = g_l.shape
    S = g_s.shape[1]
    n = np.arange(N)
    A = np.empty((B, S + N * L, S + N * L))
    A[:, :S, :S] = H_ss
    A[:, :S, S:] = np.swapaxes(H_sl, 1, 2).reshape(B, S, N * L)
    A[:, S:, :S] = np.swapaxes(A[:, :S, S:], 1, 2)
    blocks = across.copy()
    blocks[:, n, :, n] += np.swapaxes(H_ll, 0, 1)
    A[:, S:, S:] = blocks.reshape(B, N * L, N * L)
    step = -np.linalg.solve(A, np.concatenate([g_s, g_l.reshape(B, N * L)], axis=1)[..., None])[..., 0]
    return step[:, :S], step[:, S:].reshape(B, N, L)


def _diagonal(values: Float[ndarray, "*batch n"]) -> Float[ndarray, "*batch n n"]:
    return values[..., None] * np.eye(values.shape[-1])


def _take(state: _State[M], index: ndarray) -> _State[M]:
    return _State(state.motion.take(index), state.local.take(index), state.terms[index])


def _merge(state: _State[M], trial: _State[M], active: ndarray, better: Bool[ndarray, "n"]) -> _State[M]:
    """The state with the accepted trials in place."""
    if not better.any():
        return state
    rows = active[better]
    position = np.zeros(len(state.terms), int)
    position[active] = np.arange(len(active))
    accepted = np.zeros(len(state.terms), bool)
    accepted[rows] = True
    motion = trial.motion.take(position).where(accepted, state.motion)
    local, new = state.local, trial.local
    local.value[rows], local.g[rows], local.H[rows] = new.value[better], new.g[better], new.H[better]
    if local.across is not None and new.across is not None:
        local.across[rows] = new.across[better]
    state.terms[rows] = trial.terms[better]
    return _State(motion, local, state.terms)
