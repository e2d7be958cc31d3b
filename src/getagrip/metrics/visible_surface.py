"""BOP's visible surface discrepancy (VSD; Hodan et al., ECCV 2018 and ECCVW 2020): depth of two poses before a scene.

Where the depth image has no value, surfaces count as visible ("bop19"). Distances are along rays from the camera.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from numpy import ndarray

VSD_TOLERANCES = np.arange(1, 11) * 0.05
"""Tolerances of misalignment, in diameters; and the thresholds of the recall."""
VSD_VISIBILITY_TOLERANCE_M = 0.015
"""A surface is visible up to so far behind the scene's [m]."""

Image = Float[ndarray, "h w"]


def ray_lengths(K: Float[ndarray, "3 3"], size: tuple[int, int]) -> Image:
    """Return the lengths of rays to the plane at depth 1, through the centres of the pixels of a (width, height)."""
    x, y = ((np.arange(n) + 0.5 - K[axis, 2]) / K[axis, axis] for axis, n in enumerate(size))
    return np.asarray(np.sqrt(1.0 + x**2 + (y**2)[:, None]))


def discrepancy(predicted: Image, true: Image, scene: Image, tolerances: Float[ndarray, "k"]) -> Float[ndarray, "k"]:
    """Compute the share of the visible surface that is misaligned, for each tolerance [m].

    All are distances from the camera [m], of the object in both poses and of the scene; 0 where there is none. The
    result is 1 where nothing is visible.
    """
    in_front = (predicted > 0.0), (true > 0.0)
    seen = [
        there & ((z - scene <= VSD_VISIBILITY_TOLERANCE_M) | (scene == 0.0))
        for there, z in zip(in_front, (predicted, true), strict=True)
    ]
    visible, visible_true = seen[0] | (seen[1] & in_front[0]), seen[1]
    both, count = visible & visible_true, np.count_nonzero(visible | visible_true)
    if not count:
        return np.ones(len(tolerances))
    apart = np.abs(true[both] - predicted[both])
    wrong = np.array([np.count_nonzero(apart >= tolerance) for tolerance in tolerances])
    return np.asarray((wrong + count - len(apart)) / count)


def vsd_recall(errors: Float[ndarray, "k"]) -> float:
    """Compute the mean recall over tolerances and thresholds."""
    return float((errors[:, None] < VSD_TOLERANCES).mean())
