"""The plane that objects lie on, from their poses while they lie still."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.geometry import se3

UP_GUESS = np.array([0.0, -0.8, -0.6])
"""Up as a camera sees it that looks down at a table by about 37 degrees; only a start."""
TOUCHES = 0.003
"""Points of an object this near to its lowest one lie on the plane [m]."""
ASTRAY = 0.01
"""An object whose lowest point is this far from the plane counts half [m]: it lies on another, or its pose is wrong."""
ROUNDS = 30


def support_plane(resting: Sequence[Float[ndarray, "_ 3"]]) -> tuple[Float[ndarray, "3"], float]:
    """Unit normal, up, and height along it of the plane on which objects rest, from their posed vertices [m].

    Least squares over their lowest points, which depend on the plane: a few rounds of it. Each object counts as one,
    and less where it seems to rest on something else (Cauchy's weights).
    """
    up = UP_GUESS
    for _ in range(ROUNDS):
        heights = [points @ up for points in resting]
        lowest = [points[h < h.min() + TOUCHES] for points, h in zip(resting, heights, strict=True)]
        least = np.array([h.min() for h in heights])
        of_object = 1.0 / (1.0 + ((least - np.median(least)) / ASTRAY) ** 2)
        points = np.concatenate(lowest)
        weight = np.concatenate([np.full(len(p), np.sqrt(w / len(p))) for p, w in zip(lowest, of_object, strict=True)])
        middle = np.average(points, axis=0, weights=weight**2)
        normal = np.linalg.svd(weight[:, None] * (points - middle), full_matrices=False)[2][-1]
        up = normal if normal @ up > 0 else -normal
    return up, float(np.median([(points @ up).min() for points in resting]))


def world_of_plane(up: Float[ndarray, "3"], height: float) -> Float[ndarray, "4 4"]:
    """``T_world_cam`` of a world whose z axis is up, the plane at z = 0, the camera above its origin."""
    x = np.cross([0.0, 1.0, 0.0], up)
    x /= np.linalg.norm(x)
    R = np.stack([x, np.cross(up, x), up])
    return se3.rigid(R, np.array([0.0, 0.0, -height]))
