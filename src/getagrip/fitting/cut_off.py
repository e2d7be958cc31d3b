"""The distance by which further iterations, after the iteration limit, would move the object."""

from __future__ import annotations

import numpy as np

from getagrip.fitting.problem import MethodResult, Problem
from getagrip.fitting.solve import minimise
from getagrip.result import Status

LEVEL, ITERATIONS = 256, 8
"""Resolution and iterations of the usual search's last stage [px]: as many again are made."""


def cut_off(problem: Problem, found: MethodResult) -> float:
    """Compute how far further iterations would move points of the object's surface, root mean square over frames [m].

    The result stays as it is: only going on tells whether the search stopped early. 0 where it did not stop at the
    limit; NaN for a method that has no motion of its own.
    """
    if found.status is not Status.LIMIT:
        return 0.0
    if found.motion is None or found.energy_of is None:
        return float("nan")
    terms, motion = found.energy_of(problem)(LEVEL, np.arange(len(problem.clip))), found.motion.take(np.zeros(1, int))
    after = minimise(motion, terms, problem.clip.hand.T_cam_hand, ITERATIONS).motion.poses()
    first, then = (
        poses.scale[0] * problem.surface.points @ np.swapaxes(poses.R[0], -1, -2) + poses.centre[0][:, None]
        for poses in (found.poses, after)
    )
    return float(np.sqrt(np.mean(np.sum((then - first) ** 2, axis=-1))))
