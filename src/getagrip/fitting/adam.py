"""The fit of a motion model to an energy by Adam (Kingma and Ba, 2015), by gradients only.

The paper names no optimiser; its authors' later code uses Adam. This one minimises the same terms over the same
parameters as ``solve.minimise``, which is far quicker.

- **Parameters** are those of the motion model (``Motion.retract``): a step turns and shifts the current pose and axis,
  so that rotations stay rotations. Moments are kept in these local coordinates.
- **Units.** Adam's steps are about as long in every parameter, so lengths need a unit: 1 rad (of angles, and 1 of the
  log scale) is worth ``METRES_PER_RADIAN``, as in the Levenberg-Marquardt steps (``solve.LONGEST``).
- **Rate.** It falls to zero by half a cosine, and the best iterate counts, not the last.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.fitting.energy import Quadratic, Term
from getagrip.fitting.motion import Motion
from getagrip.fitting.solve import Solution, evaluate
from getagrip.result import Status

M = TypeVar("M", bound=Motion)

METRES_PER_RADIAN = 0.1
"""Metres worth a radian."""
ADAM_DECAY_RATES = (0.9, 0.999)
"""Decay rates of the first and the second moment: Adam's defaults."""


@dataclass
class Adam:
    """Adam's two moments of the parameters of B hypotheses, and the steps that follow from them.

    The rate falls to zero by half a cosine over all iterations.
    """

    unit: Float[ndarray, "P"]
    """Length that is worth a radian, of each parameter."""
    iterations: int
    rate: float
    """Length of the first step [rad]."""

    def __post_init__(self) -> None:
        self.done, self.mean, self.square = 0, np.zeros(1), np.zeros(1)

    def step(self, g: Float[ndarray, "B P"]) -> Float[ndarray, "B P"]:
        """Take a gradient into the moments, and return the step that follows."""
        g = np.nan_to_num(self.unit * g)
        now = 0.5 * self.rate * (1.0 + np.cos(np.pi * self.done / self.iterations))
        self.done += 1
        self.mean = ADAM_DECAY_RATES[0] * self.mean + (1.0 - ADAM_DECAY_RATES[0]) * g
        self.square = ADAM_DECAY_RATES[1] * self.square + (1.0 - ADAM_DECAY_RATES[1]) * g**2
        mean, square = (
            self.mean / (1.0 - ADAM_DECAY_RATES[0] ** self.done),
            self.square / (1.0 - ADAM_DECAY_RATES[1] ** self.done),
        )
        return -now * self.unit * mean / (np.sqrt(square) + 1e-12)


def minimise_by_adam(
    motion: M, terms: Sequence[Term], T_cam_hand: Float[ndarray, "N 4 4"], iterations: int, rate: float
) -> Solution[M]:
    """Take each of B hypotheses downhill, at ``rate`` [rad] a step to begin with; the best iterate of each."""
    shared, local = motion.lengths()
    B, S = len(motion.poses().scale), len(shared)
    adam = Adam(
        np.where(np.concatenate([shared, np.tile(local, len(T_cam_hand))]), METRES_PER_RADIAN, 1.0), iterations, rate
    )
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
    names = [*(term.name for term in terms), "prior"]
    status = [Status.FINISHED if np.isfinite(energy) else Status.INVISIBLE for energy in least]
    evaluations = B * len(T_cam_hand) * (iterations + 1)
    return Solution(best, least, dict(zip(names, values.T, strict=True)), status, evaluations)


def energy_gradient(
    motion: Motion, local: Quadratic, T_cam_hand: Float[ndarray, "N 4 4"]
) -> tuple[Float[ndarray, "B S"], Float[ndarray, "B N L"]]:
    """Compute the energy's gradient by the shared and by the per-frame parameters, the motion's own prior included."""
    R = T_cam_hand[:, :3, :3]
    in_hand = [(part[..., None, :] @ R)[..., 0, :] for part in (local.g[..., :3], local.g[..., 3:6])]
    g = np.concatenate([*in_hand, local.g[..., 6:]], axis=-1)[..., None, :]
    J_shared, J_local = motion.jacobian()
    return (g @ J_shared)[..., 0, :].sum(axis=1), (g @ J_local)[..., 0, :] + motion.prior().g
