"""Regrasps: one step of the object in the hand that is far larger than all others.

So it does where a hand lets go and grasps again; a clip is to hold one stable grasp.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.checks.evidence import Evidence
from getagrip.geometry import se3
from getagrip.metrics.symmetry import surface_points

MIN_REGRASP_FRAMES = 8
"""Fewer frames tell no step from another."""
USUAL_STEP_RANK = 3
"""Rank of the step that counts as a usual one in the clip."""
N_REGRASP_POINTS = 200
"""Points of the object's surface."""


def object_steps(it: Evidence) -> Float[ndarray, "n"]:
    """Return the step of the object's surface in the hand between frames (root mean square), in diameters."""
    assert it.T_hand_obj is not None
    surface = se3.transform(it.T_hand_obj, it.scale * surface_points(it.clip.mesh, N_REGRASP_POINTS)[None])
    moved = np.sqrt(np.square(surface[1:] - surface[:-1]).sum(axis=-1).mean(axis=-1))
    return np.asarray(moved / (it.scale * it.clip.mesh.diameter))


def regrasp_jump(it: Evidence) -> float:
    """Return the largest step, less two usual ones; NaN for few frames."""
    if len(it.clip) < MIN_REGRASP_FRAMES:
        return float("nan")
    largest = np.sort(object_steps(it))[::-1]
    return max(float(largest[0] - 2.0 * largest[USUAL_STEP_RANK]), 0.0)


def describe_largest_step(it: Evidence) -> str:
    """Say between which frames the largest step is."""
    n = int(np.argmax(object_steps(it)))
    return f"from frame {it.clip.frames[n]} to {it.clip.frames[n + 1]}"
