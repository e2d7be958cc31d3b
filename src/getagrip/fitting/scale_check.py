"""Scale check: whether the energy prefers another scale than the known one.

From the solution on, a few iterations are made with a free scale. If mesh, hand and camera agree in size, the energy
hardly falls: contact with the hand determines the depth, and depth and masks determine the size.
"""

from __future__ import annotations

import numpy as np

from getagrip.fitting.problem import MethodResult, Problem
from getagrip.fitting.solve import minimise

SCALE_CHECK_LEVEL_PX, SCALE_CHECK_ITERATIONS = 128, 8
"""Resolution [px] and iterations of the fit."""


def scale_check(problem: Problem, found: MethodResult) -> tuple[float, float]:
    """Check whether the energy prefers another scale, in a few iterations with a free scale.

    Return the factor that the energy prefers, and the share of energy that it saves.

    NaN where the scale was free, and for a method that has no motion of its own.
    """
    if found.motion is None or found.energy_of is None or problem.clip.scale == "free":
        return float("nan"), float("nan")
    frames, T_cam_hand = np.arange(len(problem.clip)), problem.clip.hand.T_cam_hand
    terms, motion = found.energy_of(problem)(SCALE_CHECK_LEVEL_PX, frames), found.motion.take(np.zeros(1, int))
    before = float(minimise(motion, terms, T_cam_hand, 0).energy[0])
    after = minimise(motion.with_free_scale(), terms, T_cam_hand, SCALE_CHECK_ITERATIONS)
    factor = float(after.motion.poses().scale[0] / found.poses.scale[0])
    return factor, (before - float(after.energy[0])) / max(abs(before), 1e-9)
