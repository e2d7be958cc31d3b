"""Whether the object would rather have another size than the one it is said to have.

From the solution on, the scale is a parameter for a few iterations, too. If mesh, hand and camera agree in size,
nothing is gained: contact with the hand tells the depth, and depth and masks tell the size.
"""

from __future__ import annotations

import numpy as np

from getagrip.fitting.problem import MethodResult, Problem
from getagrip.fitting.solve import minimise

LEVEL, ITERATIONS = 128, 8
"""Resolution [px] and iterations of the fit."""


def scale_check(problem: Problem, found: MethodResult) -> tuple[float, float]:
    """How many times as large the object would rather be, and what share of the energy of the best solution that saves.

    NaN where the scale was free, and for a method that has no motion of its own.
    """
    if found.motion is None or found.energy_of is None or problem.clip.scale == "free":
        return float("nan"), float("nan")
    frames, T_cam_hand = np.arange(len(problem.clip)), problem.clip.hand.T_cam_hand
    terms, motion = found.energy_of(problem)(LEVEL, frames), found.motion.take(np.zeros(1, int))
    before = float(minimise(motion, terms, T_cam_hand, 0).energy[0])
    after = minimise(motion.with_free_scale(), terms, T_cam_hand, ITERATIONS)
    factor = float(after.motion.poses().scale[0] / found.poses.scale[0])
    return factor, (before - float(after.energy[0])) / max(abs(before), 1e-9)
