"""A pose followed from frame to frame by the masks, whatever the hand does.

The object's pose in the world changes little from one frame to the next, and each mask says how. Depth and what a
silhouette does not show stay as they were: deviations from the frame before are under a ridge.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.fitting.motion import Fixed, Frozen, Soft
from getagrip.fitting.objective import NOTHING, mask_of
from getagrip.fitting.solve import minimise
from getagrip.timelines.footage import Footage
from getagrip.timelines.hypotheses import Hypotheses

RIDGE = (5e4, 300.0)
"""Stiffness of a frame's motion from where it was expected [px^2 per m^2, per rad^2]."""
STEPS = ((64, 6), (128, 5))
"""Resolution [px] and iterations in each frame."""


def follow(footage: Footage, rows: Int[ndarray, "n"], start: Hypotheses) -> Hypotheses:
    """Hypotheses of one frame, taken through others in the given order, which may lead back in time.

    In frames that do not show the object it stays where it was.
    """
    seen = footage.observed(rows)
    K, scale = len(start.R), start.scale
    R, centre = start.R[:, 0], start.centre[:, 0]
    out = Hypotheses(np.empty((K, len(rows), 3, 3)), np.empty((K, len(rows), 3)), scale, start.energy)
    step: Float[ndarray, "K 3"] = np.zeros((K, 3))
    energy, T_cam_world = mask_of(footage.problem(seen)) if len(seen) else NOTHING, footage.T_cam_world[seen]
    frame = 0
    for n, row in enumerate(rows):
        if frame == len(seen) or row != seen[frame]:
            out.R[:, n], out.centre[:, n] = R, centre
            continue
        here, frame = np.array([frame]), frame + 1
        fixed = Fixed(R, centre + 0.5 * step, np.log(scale), 1)
        motion = Frozen(Soft(fixed, np.zeros((K, 1, 6)), RIDGE))
        for level, iterations in STEPS:
            motion = minimise(motion, energy(level, here), T_cam_world[here], iterations).motion
        poses = motion.poses()
        step, R, centre = poses.centre[:, 0] - centre, poses.R[:, 0], poses.centre[:, 0]
        out.R[:, n], out.centre[:, n] = R, centre
    return out
