"""Recalls over thresholds: areas under curves of ADD and ADD-S, and BOP's average recalls of MSSD and MSPD.

In each frame, of poses in the camera. AUC is as in YCB-Video (PoseCNN), up to 10 cm, by the exact area; MSSD and MSPD
are BOP's (Hodan et al., ECCVW 2020), the least over the object's symmetries of the largest distance of its vertices, in
space and in the image.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.spatial import ConvexHull, KDTree

from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.geometry.mesh import Mesh
from getagrip.metrics.pose import ObjectTrack
from getagrip.metrics.symmetry import Symmetries

MAX_AUC_ERROR_M = 0.10
"""Largest threshold of the areas under curves [m]."""
MSSD_THRESHOLDS = np.arange(1, 11) * 0.05
"""BOP's thresholds of MSSD, in diameters."""
MSPD_THRESHOLDS_PX = np.arange(1, 11) * 5.0
"""BOP's thresholds of MSPD [px], in images 640 px wide."""
N_RECALL_AXIS_ANGLES = 72
"""Angles about a continuous axis."""
N_RECALL_BALL_ROTATIONS = 500
"""Rotations of a ball."""
MAX_RECALL_VERTICES = 2000
"""Most vertices whose nearest one is looked for."""


def nearest_add(predicted: Float[ndarray, "T V 3"], true: Float[ndarray, "T V 3"]) -> Float[ndarray, "T"]:
    """Compute the mean distance of the true vertices to the nearest predicted ones (ADD-S) [m]."""
    some = true[:, :: -(-true.shape[1] // MAX_RECALL_VERTICES)]
    return np.array([KDTree(p).query(t)[0].mean() for p, t in zip(predicted, some, strict=True)])


def area_under_curve(error: Float[ndarray, "T"]) -> Float[ndarray, "T"]:
    """Compute what each frame adds to the area under the curve of recall by threshold, 0 to ``MAX_AUC_ERROR_M``, as a share."""
    return np.clip(1.0 - error / MAX_AUC_ERROR_M, 0.0, 1.0)


def all_symmetries(symmetries: Symmetries) -> Float[ndarray, "S 4 4"]:
    """Return every symmetry, those about continuous axes at even angles."""
    free = len(symmetries.axes)
    if free == 0:
        return symmetries.elements
    turns = np.arange(N_RECALL_AXIS_ANGLES)[:, None] * (2.0 * np.pi / N_RECALL_AXIS_ANGLES)
    angles = turns if free == 1 else se3.log_so3(se3.super_fibonacci(N_RECALL_BALL_ROTATIONS))
    return (symmetries.about(angles)[:, None] @ symmetries.elements).reshape(-1, 4, 4)


@dataclass(frozen=True)
class SymmetricErrors:
    """A predicted and a true object, whose errors are the least over its symmetries.

    Attributes:
        predicted, true: the poses in the camera.
        hull: (H, 3) vertices of the mesh's convex hull [m]: one of them moves the farthest, in space always and in the
            image nearly always.
        symmetries: (S, 4, 4) as of ``all_symmetries``.
    """

    predicted: ObjectTrack
    true: ObjectTrack
    hull: Float[ndarray, "H 3"]
    symmetries: Float[ndarray, "S 4 4"]

    @staticmethod
    def of(mesh: Mesh, predicted: ObjectTrack, true: ObjectTrack, symmetries: Symmetries) -> SymmetricErrors:
        """Make them of a mesh."""
        hull = mesh.vertices[ConvexHull(mesh.vertices, qhull_options="QJ").vertices]
        return SymmetricErrors(predicted, true, hull, all_symmetries(symmetries))

    def mssd(self) -> Float[ndarray, "T"]:
        """Compute the maximum symmetry-aware surface distance [m]."""
        return self._least(lambda points: points)

    def mspd(self, K: Float[ndarray, "T 3 3"]) -> Float[ndarray, "T"]:
        """Compute the maximum symmetry-aware projection distance [px]."""
        return self._least(lambda points: project(K, points))

    def _least(self, seen: Callable[[Float[ndarray, "T H 3"]], Float[ndarray, "T H d"]]) -> Float[ndarray, "T"]:
        predicted = seen(self.predicted.placed(self.hull))
        worst = [
            np.linalg.norm(predicted - seen(self.true.placed(se3.transform(S, self.hull))), axis=-1).max(axis=-1)
            for S in self.symmetries
        ]
        return np.asarray(np.min(worst, axis=0))


def recall_at_thresholds(error: Float[ndarray, "T"], thresholds: Float[ndarray, "k"]) -> Float[ndarray, "T"]:
    """Compute the share of the thresholds that each frame's error is below."""
    return np.asarray((error[:, None] < thresholds).mean(axis=1))
