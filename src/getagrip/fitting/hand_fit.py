"""Fit a hand's errors to evidence, under a prior on trackers' errors.

Minimised is, over the errors x_n = b + e_n of each frame (``HandErrors``), b the same in all frames,

    unit * sum_n E_n(x_n) + 1/2 |b / bias|^2 + 1/2 sum_n |e_n / jitter|^2
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.least_squares import BlockArrow

OnErrors = Callable[[Float[ndarray, "N P"]], tuple[Float[ndarray, "N"], Float[ndarray, "N P"], Float[ndarray, "N P P"]]]
"""From the errors of each frame to the evidence's value, gradient and Gauss-Newton Hessian."""


@dataclass(frozen=True)
class AssumedErrors:
    """Standard deviations that are assumed of b and of e_n, and the weight of a unit of evidence."""

    bias: Float[ndarray, "Q"]
    jitter: Float[ndarray, "Q"]
    unit: float = 1.0


@dataclass(frozen=True)
class HandFit:
    """Errors, and all that is known about them (``least_squares.State``, of one problem)."""

    seen: OnErrors
    assumed: AssumedErrors
    shared: Float[ndarray, "P"]
    own: Float[ndarray, "N P"]
    value: Float[ndarray, "N"] = field(repr=False)
    g: Float[ndarray, "N P"] = field(repr=False)
    H: Float[ndarray, "N P P"] = field(repr=False)

    @staticmethod
    def of(
        seen: OnErrors, assumed: AssumedErrors, own: Float[ndarray, "N P"], shared: Float[ndarray, "P"] | None = None
    ) -> HandFit:
        """Evaluate the cost at some errors."""
        shared = np.zeros(own.shape[1]) if shared is None else shared
        return HandFit(seen, assumed, shared, own, *seen(shared + own))

    @property
    def errors(self) -> Float[ndarray, "N P"]:
        """Errors of each frame."""
        return self.shared + self.own

    @property
    def cost(self) -> Float[ndarray, "1"]:
        P = len(self.shared)
        prior = np.sum((self.shared / self.assumed.bias[:P]) ** 2) + np.sum((self.own / self.assumed.jitter[:P]) ** 2)
        return np.array([self.assumed.unit * float(self.value.sum()) + 0.5 * prior])

    def trial(self, active: Int[ndarray, "n"], damping: Float[ndarray, "n"]) -> HandFit:
        P, unit = len(self.shared), self.assumed.unit
        bias, jitter = self.assumed.bias[:P] ** -2.0, self.assumed.jitter[:P] ** -2.0
        arrow = BlockArrow.of(unit * self.H[None], self.g[None], slice(P), slice(P))
        arrow = replace(arrow, g_s=unit * arrow.g_s, g_l=unit * arrow.g_l)
        arrow = arrow.plus(np.diag(bias), bias * self.shared, np.diag(jitter), jitter * self.own)
        shared, own = arrow.step(damping)
        return HandFit.of(self.seen, self.assumed, self.own + own[0], self.shared + shared[0])

    def accept(self, trial: HandFit, active: Int[ndarray, "n"], better: Bool[ndarray, "n"]) -> HandFit:
        return trial if better.all() else self
