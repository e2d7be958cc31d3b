"""Errors of the object's pose in the hand or in the camera, and recalls over thresholds.

``PoseErrors``: ADD, rotation and translation, up to the object's symmetries.

All others are of poses in the camera, per frame. Areas under the curves of ADD and ADD-S follow YCB-Video
(PoseCNN), up to 10 cm, by exact integration. BOP's MSSD and MSPD (Hodan et al., ECCVW 2020) are the maximum distance of
the object's vertices, in space and in the image, minimised over its symmetries. BOP's visible surface discrepancy (VSD;
Hodan et al., ECCV 2018 and ECCVW 2020) compares depth images of two poses in a scene; pixels without depth count as
visible ("bop19"), and distances are along rays from the camera.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.geometry.mesh import Mesh
from getagrip.metrics.symmetry import Symmetries

ADD_SUCCESS_FRACTION = 0.1
"""ADD below which a pose is right [true diameters]."""
N_AXIS_ANGLES = 36
"""Number of sampled angles about a continuous axis; the best one is refined."""
N_BALL_ROTATIONS = 500
"""Number of sampled rotations of a ball."""
N_SYMMETRY_VERTICES = 500
"""Number of vertices by which a symmetry is chosen; reported errors include all vertices."""
VSD_TOLERANCES = np.arange(1, 11) * 0.05
"""Tolerances of misalignment [diameters], which are the thresholds of the recall, too."""
VSD_VISIBILITY_TOLERANCE_M = 0.015
"""Maximum distance behind the scene's surface at which a surface is visible [m]."""
Image = Float[ndarray, "h w"]
MAX_AUC_ERROR_M = 0.10
"""Maximum threshold of the areas under curves [m]."""
MSSD_THRESHOLDS = np.arange(1, 11) * 0.05
"""BOP's thresholds of MSSD [diameters]."""
MSPD_THRESHOLDS_PX = np.arange(1, 11) * 5.0
"""BOP's thresholds of MSPD [px of an image 640 px wide]."""
N_RECALL_AXIS_ANGLES = 72
"""Number of angles about a continuous axis."""
N_RECALL_BALL_ROTATIONS = 500
"""Number of rotations of a ball."""
MAX_RECALL_VERTICES = 2000
"""Maximum number of vertices whose nearest vertex is searched."""


@dataclass(frozen=True)
class ObjectTrack:
    """Predicted or true poses of an object, and its scale.

    Attributes:
        T_ref_obj: (T, 4, 4) poses in a frame of reference, the hand's or the camera's; compared tracks share it.
        scale: scale of the object.
    """

    T_ref_obj: Float[ndarray, "T 4 4"]
    scale: float

    def placed(self, points: Float[ndarray, "P 3"]) -> Float[ndarray, "T P 3"]:
        """Transform points from the object's own frame to the frame of reference [m]."""
        return np.asarray(se3.transform(self.T_ref_obj, self.scale * points))


@dataclass(frozen=True)
class PoseErrors:
    """Errors of each frame.

    Attributes:
        add: (T,) mean distance between corresponding vertices, each object at its own scale [m].
        rotation: (T,) angle between the rotations [rad].
        translation: (T,) distance between the objects' centres (middles of the bounding box) [m].
        diameter: diameter of the true object at its true scale [m].
    """

    add: Float[ndarray, "T"]
    rotation: Float[ndarray, "T"]
    translation: Float[ndarray, "T"]
    diameter: float

    @property
    def frame_success(self) -> Float[ndarray, "T"]:
        """1 in frames whose own ADD is below 10 % of the diameter, 0 in the others."""
        return (self.add < ADD_SUCCESS_FRACTION * self.diameter).astype(float)

    @property
    def success(self) -> bool:
        """The paper's ADD: mean over vertices and frames below 10 % of the diameter."""
        return bool(self.add.mean() < ADD_SUCCESS_FRACTION * self.diameter)


def pose_errors(
    mesh: Mesh, predicted: ObjectTrack, true: ObjectTrack, symmetry: Float[ndarray, "4 4"] | None = None
) -> PoseErrors:
    """Compute the errors of a prediction; ``symmetry``, a map of the unscaled object to itself, moves the true pose."""
    S = np.eye(4) if symmetry is None else symmetry
    A, b = _displacement_map(predicted, true, S)
    add = np.stack([np.linalg.norm(mesh.vertices @ M.T + c, axis=1).mean() for M, c in zip(A, b, strict=True)])
    return PoseErrors(
        add=add,
        rotation=se3.angle_between(predicted.T_ref_obj[:, :3, :3], true.T_ref_obj[:, :3, :3] @ S[:3, :3]),
        translation=np.linalg.norm(A @ mesh.centre + b, axis=1),
        diameter=mesh.diameter * true.scale,
    )


def best_symmetry(
    mesh: Mesh, predicted: ObjectTrack, true: ObjectTrack, symmetries: Symmetries
) -> Float[ndarray, "4 4"]:
    """Find the symmetry with the least ADD over the whole sequence: one for all frames, as in BOP and HOT3D.

    Continuous rotations are sampled (36 angles; 500 rotations of a ball), and a simplex search refines the best sample,
    so that sampling causes no error.
    """
    vertices = mesh.vertices[:: max(1, len(mesh.vertices) // N_SYMMETRY_VERTICES)]

    def cost(S: Float[ndarray, "4 4"]) -> float:
        A, b = _displacement_map(predicted, true, S)
        return float(np.linalg.norm(vertices @ np.swapaxes(A, 1, 2) + b[:, None], axis=2).mean())

    free = len(symmetries.axes)
    if free == 0:
        angles = np.zeros((1, 0))
    elif free == 1:
        angles = np.arange(N_AXIS_ANGLES)[:, None] * 2.0 * np.pi / N_AXIS_ANGLES
    else:
        angles = se3.log_so3(se3.super_fibonacci(N_BALL_ROTATIONS))
    rotations = symmetries.about(angles)
    samples = [(cost(rotation @ S), k, S) for k, rotation in enumerate(rotations) for S in symmetries.elements]
    _, k, S = min(samples, key=lambda sample: sample[0])
    if free == 0:
        return S
    from scipy.optimize import minimize

    start = angles[k] + np.vstack([np.zeros(free), np.radians(8.0) * np.eye(free)])
    options = {"initial_simplex": start, "xatol": 1e-6, "fatol": 1e-9}
    found = minimize(lambda x: cost(symmetries.about(x) @ S), angles[k], method="Nelder-Mead", options=options)
    return symmetries.about(found.x) @ S


def _displacement_map(
    predicted: ObjectTrack, true: ObjectTrack, S: Float[ndarray, "4 4"]
) -> tuple[Float[ndarray, "T 3 3"], Float[ndarray, "T 3"]]:
    """Displacement A x + b of the unscaled object's point x, in the frame of reference [m]: return (A, b)."""
    P, Q = predicted.T_ref_obj, true.T_ref_obj
    A = predicted.scale * P[:, :3, :3] - true.scale * Q[:, :3, :3] @ S[:3, :3]
    return A, P[:, :3, 3] - Q[:, :3, 3] - true.scale * Q[:, :3, :3] @ S[:3, 3]


def ray_lengths(K: Float[ndarray, "3 3"], size: tuple[int, int]) -> Image:
    """Compute the lengths of rays through pixel centres to the plane at depth 1; ``size`` is (width, height) [px]."""
    x, y = ((np.arange(n) + 0.5 - K[axis, 2]) / K[axis, axis] for axis, n in enumerate(size))
    return np.asarray(np.sqrt(1.0 + x**2 + (y**2)[:, None]))


def discrepancy(predicted: Image, true: Image, scene: Image, tolerances: Float[ndarray, "k"]) -> Float[ndarray, "k"]:
    """Compute the misaligned fraction of the visible surface, for each tolerance [m]; 1 if nothing is visible.

    Images are distances from the camera [m], of the object in both poses and of the scene; 0 where unknown.
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
    """Compute the mean recall of VSD over tolerances and thresholds."""
    return float((errors[:, None] < VSD_TOLERANCES).mean())


def nearest_add(predicted: Float[ndarray, "T V 3"], true: Float[ndarray, "T V 3"]) -> Float[ndarray, "T"]:
    """Compute the mean distance of the true vertices from the nearest predicted ones (ADD-S) [m]."""
    from scipy.spatial import KDTree

    some = true[:, :: -(-true.shape[1] // MAX_RECALL_VERTICES)]
    return np.array([KDTree(p).query(t)[0].mean() for p, t in zip(predicted, some, strict=True)])


def area_under_curve(error: Float[ndarray, "T"]) -> Float[ndarray, "T"]:
    """Compute each frame's part of the area under the curve of recall over thresholds, 0 to ``MAX_AUC_ERROR_M``."""
    return np.clip(1.0 - error / MAX_AUC_ERROR_M, 0.0, 1.0)


def all_symmetries(symmetries: Symmetries) -> Float[ndarray, "S 4 4"]:
    """Return all symmetries, with even angles about continuous axes."""
    free = len(symmetries.axes)
    if free == 0:
        return symmetries.elements
    turns = np.arange(N_RECALL_AXIS_ANGLES)[:, None] * (2.0 * np.pi / N_RECALL_AXIS_ANGLES)
    angles = turns if free == 1 else se3.log_so3(se3.super_fibonacci(N_RECALL_BALL_ROTATIONS))
    return (symmetries.about(angles)[:, None] @ symmetries.elements).reshape(-1, 4, 4)


@dataclass(frozen=True)
class SymmetricErrors:
    """Errors of a predicted object, minimised over its symmetries.

    Attributes:
        predicted, true: poses in the camera.
        hull: (H, 3) vertices of the mesh's convex hull [m]: one of them has the maximum distance, always in space and
            nearly always in the image.
        symmetries: (S, 4, 4) as from ``all_symmetries``.
    """

    predicted: ObjectTrack
    true: ObjectTrack
    hull: Float[ndarray, "H 3"]
    symmetries: Float[ndarray, "S 4 4"]

    @staticmethod
    def of(mesh: Mesh, predicted: ObjectTrack, true: ObjectTrack, symmetries: Symmetries) -> SymmetricErrors:
        """Make the errors of a mesh's poses."""
        from scipy.spatial import ConvexHull

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
    """Compute the fraction of thresholds above each frame's error."""
    return np.asarray((error[:, None] < thresholds).mean(axis=1))
