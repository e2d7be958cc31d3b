"""A hand as 20 rigid bones between its 21 joints, for programs that know rigid bodies only."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.export.scene import Scene
from getagrip.geometry import se3

HAND_JOINT_NAMES = (
    "wrist",
    *(f"{finger}_{part}" for finger in ("thumb", "index", "middle", "ring", "pinky") for part in (1, 2, 3, "tip")),
)
"""Names of the 21 joints in this package's order: wrist, then each finger from the palm to the tip."""
BONE_END_JOINTS = tuple((0 if n % 4 == 1 else n - 1, n) for n in range(1, 21))
"""The joints at the beginning and the end of each bone."""
BONE_RADIUS_QUANTILE = 0.25
"""Share of a bone's vertices that are nearer than its radius."""
MIN_BONE_RADIUS_M = 0.003
"""Least radius of a bone [m], whatever the mesh."""


@dataclass(frozen=True)
class Bones:
    """The bones of a hand over T frames.

    Attributes:
        T_hand_bone: (T, 20, 4, 4) poses: the origin is where the bone begins, z along it.
        length: (20,) median lengths [m].
        radius: (20,) half of their thickness [m], such that they lie within the hand.
    """

    T_hand_bone: Float[ndarray, "T 20 4 4"]
    length: Float[ndarray, "20"]
    radius: Float[ndarray, "20"]

    @staticmethod
    def of(scene: Scene) -> Bones | None:
        """Return the bones of the scene's hand; None where its joints are not known."""
        if scene.joints is None:
            return None
        begin, end = (scene.joints[:, [pair[k] for pair in BONE_END_JOINTS]] for k in (0, 1))
        along = end - begin
        length = np.linalg.norm(along, axis=-1)
        straight = np.where(length[..., None] > 1e-6, along / np.maximum(length, 1e-6)[..., None], [0.0, 0.0, 1.0])
        rest = se3.rotation_between(np.array([0.0, 0.0, 1.0]), straight[0])
        R = se3.rotation_between(straight[:1], straight) @ rest
        typical = np.median(length, axis=0)
        return Bones(se3.rigid(R, begin), typical, _bone_radii(bone_distances(scene)))


def bone_distances(scene: Scene) -> Float[ndarray, "V 20"]:
    """Compute the distance of each vertex from each bone in the first frame [m]. The joints are known."""
    assert scene.joints is not None
    begin, end = (scene.joints[0, [pair[k] for pair in BONE_END_JOINTS]] for k in (0, 1))
    points, along = scene.hand_vertices[0], end - begin
    share = np.sum((points[:, None] - begin) * along, axis=-1) / np.maximum(np.sum(along**2, axis=-1), 1e-12)
    nearest = begin + np.clip(share, 0.0, 1.0)[..., None] * along
    return np.asarray(np.linalg.norm(points[:, None] - nearest, axis=-1))


def _bone_radii(distance: Float[ndarray, "V 20"]) -> Float[ndarray, "20"]:
    """Compute each bone's distance to the surface near it, over the vertices that no other bone is nearer to.

    A capsule as thick as the palm would reach into the object.
    """
    owner = np.argmin(distance, axis=1)
    found = [
        np.quantile(distance[owner == n, n], BONE_RADIUS_QUANTILE) if np.any(owner == n) else MIN_BONE_RADIUS_M
        for n in range(distance.shape[1])
    ]
    return np.maximum(found, MIN_BONE_RADIUS_M)
