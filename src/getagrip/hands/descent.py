"""Hands in several frames that share a shape, taken downhill by Levenberg-Marquardt (``least_squares``)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, Self, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.least_squares import BlockArrow, DampingRules, Ending, minimise

N_FRAME_PARAMETERS = 51
"""Numbers of each frame: the step of T_cam_hand and the pose. What all frames share follows them."""
DESCENT_RULES = DampingRules(
    damping=1e-3, success=0.1, failure=10.0, least=1e-9, most=1e8, rejections=np.inf, tolerance=1e-5, small_steps=1
)

Equations = tuple[float, Float[ndarray, "T D D"], Float[ndarray, "T D"]]
"""The cost, and per frame J^T J and J^T r of its own numbers and of the shared ones."""


class HandUnknowns(Protocol):
    """The unknowns."""

    def retract(self, frames: Float[ndarray, "T 51"], shared: Float[ndarray, "S"]) -> Self:
        """Return the hands after a step."""
        ...


Sought = TypeVar("Sought", bound=HandUnknowns)


@dataclass(frozen=True)
class _DescentState(Generic[Sought]):
    """Hands with their cost and its derivatives (``least_squares.State``)."""

    hands: Sought
    equations: Callable[[Sought], Equations]
    value: float
    H: Float[ndarray, "T D D"]
    g: Float[ndarray, "T D"]

    @property
    def cost(self) -> Float[ndarray, "1"]:
        return np.array([self.value])

    def trial(self, active: Int[ndarray, "1"], damping: Float[ndarray, "1"]) -> _DescentState[Sought]:
        arrow = BlockArrow.of(
            self.H[None], self.g[None], shared=slice(N_FRAME_PARAMETERS, None), own=slice(N_FRAME_PARAMETERS)
        )
        shared, frames = arrow.step(damping)
        hands = self.hands.retract(frames[0], shared[0])
        return _DescentState(hands, self.equations, *self.equations(hands))

    def accept(
        self, trial: _DescentState[Sought], active: Int[ndarray, "1"], better: Bool[ndarray, "1"]
    ) -> _DescentState[Sought]:
        return trial if better[0] else self


def descend(hands: Sought, equations: Callable[[Sought], Equations], steps: int) -> tuple[Sought, float, bool]:
    """Descend to the minimum near some hands.

    Return it, its cost, and whether the last step changed next to nothing.
    """
    found = minimise(_DescentState(hands, equations, *equations(hands)), steps, DESCENT_RULES)
    return found.state.hands, found.state.value, found.endings[0] is not Ending.LIMIT
