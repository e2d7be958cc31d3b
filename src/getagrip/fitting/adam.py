"""The fit of a motion model to an energy by Adam (Kingma and Ba, 2015), by gradients only.

The paper names no optimiser; its authors' later code uses Adam. This one minimises the same terms over the same
parameters as ``solve.minimise``, which is far quicker.

- **Parameters** are those of the motion model (``Motion.retract``): a step turns and shifts the current pose and axis,
  so that rotations stay rotations. Moments are kept in these local coordinates.
- **Units.** Adam's steps are about as long in every parameter, so lengths need a unit: 1 rad (of angles, and 1 of the
  log scale) is worth ``METRES``, as in the Levenberg-Marquardt steps (``solve.LONGEST``).
- **Rate.** It falls to zero by half a cosine, and the best iterate counts, not the last.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.fitting.energy import Quadratic, Term
from getagrip.fitting.motion import Motion
from getagrip.fitting.solve import Solution, evaluate
from getagrip.result import Status

M = TypeVar("M", bound=Motion)

METRES = 0.1
"""Metres worth a radian."""
DECAY = (0.9, 0.999)
"""Decay rates of the first and the second moment: Adam's defaults."""


def descend(
    motion: M, terms: Sequence[Term], T_cam_hand: Float[ndarray, "N 4 4"], iterations: int, rate: float
) -> Solution[M]:
    """Take each of B hypotheses downhill, at ``rate`` [rad] a step to begin with; the best iterate of each."""
    shared, local = motion.lengths()
    unit = np.where(np.concatenate([shared, np.tile(local, len(T_cam_hand))]), METRES, 1.0)
    B, S = len(motion.poses().scale), len(shared)
    free = np.full(B, np.inf)
    mean, square = np.zeros((B, len(unit))), np.zeros((B, len(unit)))
    for k in range(iterations + 1):
        state = evaluate(motion, terms, T_cam_hand, free)
        cost = np.where(np.isnan(state.cost), np.inf, state.cost)
        if k == 0:
            best, least, values = motion, cost, state.values
        else:
            better = cost < least
            best, least = motion.where(better, best), np.where(better, cost, least)
            values = np.where(better[:, None], state.values, values)
        g_shared, g_local = gradient(motion, state.local, T_cam_hand)
        g = np.nan_to_num(unit * np.concatenate([g_shared, g_local.reshape(B, -1)], axis=1))
        mean, square = DECAY[0] * mean + (1.0 - DECAY[0]) * g, DECAY[1] * square + (1.0 - DECAY[1]) * g**2
        corrected = mean / (1.0 - DECAY[0] ** (k + 1)), square / (1.0 - DECAY[1] ** (k + 1))
        now = 0.5 * rate * (1.0 + np.cos(np.pi * k / iterations))
        step = -now * unit * corrected[0] / (np.sqrt(corrected[1]) + 1e-12)
        motion = motion.retract(step[:, :S], step[:, S:].reshape(g_local.shape))
    names = [*(term.name for term in terms), "prior"]
    status = [Status.FINISHED if np.isfinite(energy) else Status.INVISIBLE for energy in least]
    evaluations = B * len(T_cam_hand) * (iterations + 1)
    return Solution(best, least, dict(zip(names, values.T, strict=True)), status, evaluations)


def gradient(
    motion: Motion, local: Quadratic, T_cam_hand: Float[ndarray, "N 4 4"]
) -> tuple[Float[ndarray, "B S"], Float[ndarray, "B N L"]]:
    """Compute the energy's gradient by the shared and by the per-frame parameters, the motion's own prior included."""
    R = T_cam_hand[:, :3, :3]
    in_hand = [(part[..., None, :] @ R)[..., 0, :] for part in (local.g[..., :3], local.g[..., 3:6])]
    g = np.concatenate([*in_hand, local.g[..., 6:]], axis=-1)[..., None, :]
    J_shared, J_local = motion.jacobian()
    return (g @ J_shared)[..., 0, :].sum(axis=1), (g @ J_local)[..., 0, :] + motion.prior().g
