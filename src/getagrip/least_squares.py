"""Batched Levenberg-Marquardt: the damping loop over problems side by side, and the block-arrow system.

What is minimised is the caller's: anything that has a cost, can be tried at a damped step, and can take over the trials
that were better.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from typing import Generic, Protocol, Self, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray


class SolverState(Protocol):
    """B problems at their current parameters."""

    @property
    def cost(self) -> Float[ndarray, "B"]: ...

    def trial(self, active: Int[ndarray, "n"], damping: Float[ndarray, "n"]) -> Self:
        """Return the active problems alone, each after a step with its damping."""
        ...

    def accept(self, trial: Self, active: Int[ndarray, "n"], better: Bool[ndarray, "n"]) -> Self:
        """Replace the active problems whose trial is better by their trial."""
        ...


S = TypeVar("S", bound=SolverState)


class Ending(Enum):
    """Why a problem's iterations ended."""

    LOST = "the initial cost was not finite"
    CONVERGED = "further steps gain almost nothing"
    STUCK = "no step lowers the cost"
    LIMIT = "the limit of iterations"


@dataclass(frozen=True)
class DampingRules:
    """How damping follows success and failure, and when a problem is done.

    Attributes:
        damping: damping at the first step.
        success: factor on the damping after a step that lowered the cost.
        failure: factor on the damping after a step that did not.
        least: smallest damping.
        most: largest damping; beyond it a problem is stuck.
        rejections: number of rejected steps in a row after which a problem is stuck.
        tolerance: a step that gains less than this share of the cost is small.
        small_steps: number of small steps in a row after which a problem has converged.
    """

    damping: float = 1e-2
    success: float = 0.3
    failure: float = 6.0
    least: float = 1e-7
    most: float = 1e7
    rejections: float = 4
    tolerance: float = 1e-3
    small_steps: int = 2


@dataclass(frozen=True)
class Minimum(Generic[S]):
    """The result of the iterations.

    Attributes:
        state: the state of least cost that was found.
        endings: how each problem ended.
        evaluations: number of problems evaluated, all iterations together.
    """

    state: S
    endings: list[Ending]
    evaluations: int


DEFAULT_DAMPING_RULES = DampingRules()


def minimise(state: S, iterations: int, rules: DampingRules = DEFAULT_DAMPING_RULES) -> Minimum[S]:
    """Minimise every problem, in at most ``iterations`` iterations of one evaluation each."""
    B = len(state.cost)
    damping = np.full(B, rules.damping)
    rejected, small = np.zeros(B, int), np.zeros(B, int)
    evaluations = B
    finite = np.isfinite(state.cost)
    for _ in range(iterations):
        stuck = (rejected >= rules.rejections) | (damping > rules.most)
        active = np.flatnonzero(finite & ~stuck & (small < rules.small_steps))
        if active.size == 0:
            break
        cost = state.cost[active]
        trial = state.trial(active, damping[active])
        evaluations += active.size
        better = trial.cost < cost
        gain = np.where(better, cost - trial.cost, 0.0)
        gains_little = better & (gain < rules.tolerance * cost)
        small[active] = np.where(gains_little, small[active] + 1, np.where(better, 0, small[active]))
        rejected[active] = np.where(better, 0, rejected[active] + 1)
        factor = np.where(better, rules.success, rules.failure)
        damping[active] = np.maximum(damping[active] * factor, rules.least)
        state = state.accept(trial, active, better)
    stuck = (rejected >= rules.rejections) | (damping > rules.most)
    endings = [
        Ending.LOST if not f else Ending.CONVERGED if c else Ending.STUCK if s else Ending.LIMIT
        for f, c, s in zip(finite, small >= rules.small_steps, stuck, strict=True)
    ]
    return Minimum(state, endings, evaluations)


def damp_hessian(H: Float[ndarray, "*batch n n"], damping: ndarray, floor: float = 0.0) -> Float[ndarray, "*batch n n"]:
    """Raise a Hessian's diagonal in proportion; ``floor`` is added to directions that the cost does not see.

    ``damping`` has the batch's axes, or some axes of length 1 in their place.
    """
    diagonal = damping[..., None] * (np.diagonal(H, axis1=-2, axis2=-1) + floor)
    return np.asarray(H + diagonal[..., None] * np.eye(H.shape[-1]))


@dataclass(frozen=True)
class BlockArrow:
    """Block-arrow normal equations: S parameters that all frames share, and L of each of N frames, in B problems.

    Attributes:
        H_ss: Hessian by the shared parameters.
        H_sl: by the shared parameters and each frame's own.
        H_ll: by each frame's own.
        g_s, g_l: gradients.
        cross: Hessian between the frames' own parameters, where terms tie frames to each other; ``[:, n, :, n]`` is
            added to ``H_ll``.
    """

    H_ss: Float[ndarray, "B S S"]
    H_sl: Float[ndarray, "B N S L"]
    H_ll: Float[ndarray, "B N L L"]
    g_s: Float[ndarray, "B S"]
    g_l: Float[ndarray, "B N L"]
    cross: Float[ndarray, "B N L N L"] | None = None

    @staticmethod
    def of(H: Float[ndarray, "B N P P"], g: Float[ndarray, "B N P"], shared: slice, own: slice) -> BlockArrow:
        """Sum frames' equations by P numbers each, some of which are shared.

        The slices may be one and the same: each frame's numbers are then a shared part plus its own.
        """
        H_ss, g_s = H[..., shared, shared].sum(axis=1), g[..., shared].sum(axis=1)
        return BlockArrow(H_ss, H[..., shared, own], H[..., own, own], g_s, g[..., own])

    @staticmethod
    def by(
        J: Float[ndarray, "B N P Q"],
        S: int,
        H: Float[ndarray, "B N P P"],
        g: Float[ndarray, "B N P"],
        cross: Float[ndarray, "B N P N P"] | None,
    ) -> BlockArrow:
        """Sum them by Q parameters, S shared ones first, on which the P numbers of each frame depend by J."""
        Jt = np.swapaxes(J, -1, -2)
        alone = BlockArrow.of(Jt @ (H @ J), (Jt @ g[..., None])[..., 0], slice(S), slice(S, None))
        if cross is None:
            return alone
        tied = cross.any(axis=(0, 1, 3, 4))  # of a long vector, often a part
        if not tied.all():
            J, cross = J[..., tied, :], cross[:, :, tied][..., tied]
        ss, sl, ll = _transform_cross_hessian(cross, J[..., :S], J[..., S:])
        return replace(alone, H_ss=alone.H_ss + ss, H_sl=alone.H_sl + sl, cross=ll)

    def plus(
        self,
        H_ss: ndarray | None = None,
        g_s: ndarray | None = None,
        H_ll: ndarray | None = None,
        g_l: ndarray | None = None,
        cross: ndarray | None = None,
    ) -> BlockArrow:
        """Add priors on the parameters, of shapes that broadcast to those of the fields."""
        if cross is not None and self.cross is None:
            cross = np.broadcast_to(cross, (len(self.g_l), *cross.shape))
        return replace(
            self,
            H_ss=self.H_ss if H_ss is None else self.H_ss + H_ss,
            g_s=self.g_s if g_s is None else self.g_s + g_s,
            H_ll=self.H_ll if H_ll is None else self.H_ll + H_ll,
            g_l=self.g_l if g_l is None else self.g_l + g_l,
            cross=cross if self.cross is None else self.cross if cross is None else self.cross + cross,
        )

    def step(
        self, damping: Float[ndarray, "B"], floor: float = 0.0
    ) -> tuple[Float[ndarray, "B S"], Float[ndarray, "B N L"]]:
        """Return the damped step of the shared parameters and of each frame's own (``damp_hessian``)."""
        H_ss, H_ll = damp_hessian(self.H_ss, damping, floor), damp_hessian(self.H_ll, damping[:, None], floor)
        return replace(self, H_ss=H_ss, H_ll=H_ll).solved()

    def solved(self) -> tuple[Float[ndarray, "B S"], Float[ndarray, "B N L"]]:
        """Return the step to where the gradient is zero.

        Frames that know of each other only through what is shared are eliminated (Schur complement). Where ``cross``
        ties them, parameters that it does not touch are eliminated, and the rest is solved as it is.
        """
        if self.cross is not None:
            tied = np.asarray(self.cross.any(axis=(0, 1, 3, 4)))
            return self._solved_together(self.cross) if tied.all() else self._loose_first(self.cross, tied)
        H_sl, g_s, g_l = self.H_sl, self.g_s, self.g_l
        S, L = g_s.shape[-1], g_l.shape[-1]
        if L == 0:
            return -np.linalg.solve(self.H_ss, g_s[..., None])[..., 0], np.zeros_like(g_l)
        right = np.concatenate([np.swapaxes(H_sl, -1, -2), g_l[..., None]], axis=-1)
        solved = right / self.H_ll if L == 1 else np.linalg.solve(self.H_ll, right)
        schur = self.H_ss - (H_sl @ solved[..., :S]).sum(axis=1)
        reduced = g_s - (H_sl @ solved[..., S:]).sum(axis=1)[..., 0]
        shared = -np.linalg.solve(schur, reduced[..., None])[..., 0] if S else np.zeros_like(g_s)
        return shared, -(solved[..., S] + (solved[..., :S] @ shared[:, None, :, None])[..., 0])

    def reduced(self) -> Float[ndarray, "B S S"]:
        """Return the Hessian by the shared parameters, each frame's own at their best (Schur complement).

        What ``cross`` ties is left out.
        """
        return self.H_ss - (self.H_sl @ np.linalg.solve(self.H_ll, np.swapaxes(self.H_sl, -1, -2))).sum(axis=1)

    def _loose_first(
        self, cross: Float[ndarray, "B N L N L"], tied: Bool[ndarray, "L"]
    ) -> tuple[Float[ndarray, "B S"], Float[ndarray, "B N L"]]:
        """Take the step where some of each frame's parameters are tied to other frames and some are not."""
        H_st, H_su = self.H_sl[..., tied], self.H_sl[..., ~tied]
        H_tu, H_uu = self.H_ll[..., tied, :][..., ~tied], self.H_ll[..., ~tied, :][..., ~tied]
        columns = [np.swapaxes(H_su, -1, -2), np.swapaxes(H_tu, -1, -2), self.g_l[..., ~tied, None]]
        S, solved = len(self.g_s[0]), np.linalg.solve(H_uu, np.concatenate(columns, axis=-1))
        by_s, by_t, by_u = solved[..., :S], solved[..., S:-1], solved[..., -1:]
        shared, own = BlockArrow(
            self.H_ss - (H_su @ by_s).sum(axis=1),
            H_st - H_su @ by_t,
            self.H_ll[..., tied, :][..., tied] - H_tu @ by_t,
            self.g_s - (H_su @ by_u).sum(axis=1)[..., 0],
            self.g_l[..., tied] - (H_tu @ by_u)[..., 0],
            cross[:, :, tied][..., tied],
        ).solved()
        step = np.empty_like(self.g_l)
        step[..., tied] = own
        step[..., ~tied] = -(by_u + by_s @ shared[:, None, :, None] + by_t @ own[..., None])[..., 0]
        return shared, step

    def _solved_together(
        self, cross: Float[ndarray, "B N L N L"]
    ) -> tuple[Float[ndarray, "B S"], Float[ndarray, "B N L"]]:
        """Take the step where frames are tied to each other: nothing can be eliminated."""
        B, N, L = self.g_l.shape
        S = self.g_s.shape[1]
        n = np.arange(N)
        A = np.empty((B, S + N * L, S + N * L))
        A[:, :S, :S] = self.H_ss
        A[:, :S, S:] = np.swapaxes(self.H_sl, 1, 2).reshape(B, S, N * L)
        A[:, S:, :S] = np.swapaxes(A[:, :S, S:], 1, 2)
        blocks = cross.copy()
        blocks[:, n, :, n] += np.swapaxes(self.H_ll, 0, 1)
        A[:, S:, S:] = blocks.reshape(B, N * L, N * L)
        g = np.concatenate([self.g_s, self.g_l.reshape(B, N * L)], axis=1)
        step = -np.linalg.solve(A, g[..., None])[..., 0]
        return step[:, :S], step[:, S:].reshape(B, N, L)


def _transform_cross_hessian(
    cross: Float[ndarray, "B N P N P"], J_s: Float[ndarray, "B N P S"], J_l: Float[ndarray, "B N P L"]
) -> tuple[Float[ndarray, "B S S"], Float[ndarray, "B N S L"], Float[ndarray, "B N L N L"]]:
    """Take the Hessian between frames to the parameters.

    ``sum_ij Js_i^T A_ij Js_j``, ``sum_i Js_i^T A_ij Jl_j``, ``Jl_i^T A_ij Jl_j``.
    """
    B, N, P, S = J_s.shape
    L = J_l.shape[-1]
    flat, tall = cross.reshape(B, N * P, N * P), J_s.reshape(B, N * P, S)
    right = flat @ tall
    ss = np.swapaxes(tall, -1, -2) @ right
    sl = np.swapaxes(right.reshape(B, N, P, S), -1, -2) @ J_l
    right = np.swapaxes(flat.reshape(B, N * P, N, P), 1, 2) @ J_l  # (B, j, i P, L)
    right = np.swapaxes(right, 1, 2).reshape(B, N, P, N * L)
    return ss, sl, (np.swapaxes(J_l, -1, -2) @ right).reshape(B, N, L, N, L)
