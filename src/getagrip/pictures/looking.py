"""A distant camera that looks at something from a chosen side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.geometry import se3

CAMERA_DISTANCE_RADII = 8.0
"""In radii of what is looked at: nearly an orthographic view."""
TILE_FILL_FRACTION = 0.92
"""Share of the tile that it fills."""


@dataclass(frozen=True, eq=False)
class DistantCamera:
    """A camera: ``T_view_frame`` maps points [m] of the frame of what it looks at, ``K`` then to ``size`` pixels."""

    T_view_frame: Float[ndarray, "4 4"]
    K: Float[ndarray, "3 3"]
    size: int


def look_at(
    points: Float[ndarray, "n 3"], side: Float[ndarray, "3"], up: Float[ndarray, "3"], size: int
) -> DistantCamera:
    """Place a camera that sees all the points from the direction ``side``, with ``up`` upwards, of any length.

    Where ``up`` is along ``side``, or either is zero, another direction takes its place.
    """
    forward = -_normalise_or(side, np.array([0.0, 0.0, 1.0]))
    other = np.eye(3)[np.argmin(np.abs(forward))]
    down = -_normalise_or(
        _orthogonal_component(np.asarray(up, dtype=float), forward), _orthogonal_component(other, forward)
    )
    R = np.stack([np.cross(down, forward), down, forward])
    seen = points @ R.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    radius = float(np.linalg.norm(high - low)) / 2.0
    t = np.array([0.0, 0.0, CAMERA_DISTANCE_RADII * radius]) - (low + high) / 2.0
    nearest = CAMERA_DISTANCE_RADII * radius - (high[2] - low[2]) / 2.0
    f = TILE_FILL_FRACTION * size * nearest / float((high - low)[:2].max())
    K = np.array([[f, 0.0, size / 2.0], [0.0, f, size / 2.0], [0.0, 0.0, 1.0]])
    return DistantCamera(se3.rigid(R, t), K, size)


def _orthogonal_component(v: Float[ndarray, "3"], along: Float[ndarray, "3"]) -> Float[ndarray, "3"]:
    return np.asarray(v - (v @ along) * along)


def _normalise_or(v: Float[ndarray, "3"], instead: Float[ndarray, "3"]) -> Float[ndarray, "3"]:
    """Normalise a vector; that of another where it is almost zero."""
    length = float(np.linalg.norm(v))
    return np.asarray(v / length if length > 1e-9 else instead / np.linalg.norm(instead))
