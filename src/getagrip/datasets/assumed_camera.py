"""A camera for recordings that have none: it stands still where the person's eyes could be. Every number is a guess."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip.provenance import Source, assumed
from getagrip.geometry import se3

DISTANCE = 0.7
"""From the object's usual place [m]: about an arm's length."""
ELEVATION = np.radians(45.0)
"""How steeply it looks down [rad]."""
SIZE = (840, 600)
"""Width and height of its images [px], those of this package's ARCTIC masks."""
FOCAL = 600.0
"""Its focal length [px]: it sees 70 by 53 degrees."""
MIDDLE_KNUCKLE = 9
"""Among the 21 joints; the wrist is the first."""


@dataclass(frozen=True)
class PosedCamera:
    """A pinhole that may move."""

    K: Float[ndarray, "3 3"]
    size: tuple[int, int]
    T_cam_world: Float[ndarray, "T 4 4"]
    described: Source
    """What it is, for the provenance."""


def assumed_camera(places: Float[ndarray, "T 3"], hands: Iterable[Float[ndarray, "T 21 3"]]) -> PosedCamera:
    """A fixed camera that looks at the median of an object's places from the side from which the forearms come.

    ``hands`` are joints in this package's order. All is in the world frame [m], where z is up.
    """
    up = np.array([0.0, 0.0, 1.0])
    behind = np.concatenate([joints[:, 0] - joints[:, MIDDLE_KNUCKLE] for joints in hands]).mean(axis=0)
    behind -= (behind @ up) * up
    if np.linalg.norm(behind) < 1e-6:  # hands that point straight up or down: from anywhere
        behind = np.array([1.0, 0.0, 0.0])
    behind /= np.linalg.norm(behind)
    z = -(np.cos(ELEVATION) * behind + np.sin(ELEVATION) * up)
    x = np.cross(z, up) / np.cos(ELEVATION)
    side = f"on the forearms' side, {np.degrees(ELEVATION):.0f} degrees above it"
    return facing(np.stack([x, np.cross(z, x), z]), places, f"a guess: none is given; fixed, {side}")


def facing(R_cam_world: Float[ndarray, "3 3"], places: Float[ndarray, "T 3"], described: str) -> PosedCamera:
    """A fixed camera of some orientation that looks at the median of an object's places [m] from ``DISTANCE``."""
    T_cam_world = se3.rigid(R_cam_world, [0.0, 0.0, DISTANCE] - R_cam_world @ np.median(places, axis=0))
    K, size = pinhole()
    described += f", {DISTANCE:g} m from the object's median place, focal length {FOCAL:g} px"
    return PosedCamera(K, size, np.tile(T_cam_world, (len(places), 1, 1)), assumed(described))


def pinhole() -> tuple[Float[ndarray, "3 3"], tuple[int, int]]:
    """Its intrinsics, and the size of its images [px]."""
    return np.array([[FOCAL, 0.0, SIZE[0] / 2.0], [0.0, FOCAL, SIZE[1] / 2.0], [0.0, 0.0, 1.0]]), SIZE
