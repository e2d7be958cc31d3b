"""Initial poses learnt from true ones: rotations clustered on SO(3), and a mean translation (paper, appendix).

The paper starts from 50 rotations and one translation for each object and side of hand, found by clustering the true
poses of the grasps that it then evaluates. Here a file holds the grasps themselves, with the names of clips and
subjects: the poses for a clip are learnt without its own subject (``initial_poses``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import Clip
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.io import arrays, files

Way = Literal["geodesic", "axis-angle"]
"""How rotations are clustered."""
CLUSTERINGS: tuple[Way, ...] = get_args(Way)
PRIORS_VERSION = 2
"""Version of the file."""
MAX_CLUSTERS = 1000
_MAX_K_MEANS_ITERATIONS = 100
"""Maximum number of iterations of k-means, or of a mean rotation."""
_ROTATION_TOLERANCE_RAD = 1e-6
"""Angle below which rotations count as one [rad]."""


@dataclass(frozen=True)
class PosePriors:
    """Poses of objects in hands: N of them.

    Attributes:
        category: category of the object of each pose.
        side: ``left`` or ``right`` hand of each pose.
        T_hand_obj: (N, 4, 4) poses, object frame to hand frame [m].
        clips: names of the clips they were learnt from; empty where unknown.
        subjects: people whose hands were in these clips.
    """

    category: tuple[str, ...]
    side: tuple[str, ...]
    T_hand_obj: Float[ndarray, "N 4 4"]
    clips: tuple[str, ...] = ()
    subjects: tuple[str, ...] = ()

    def of(self, category: str, side: str) -> Float[ndarray, "k 4 4"]:
        """Return the poses of a category in a hand, of the most grasps first."""
        keys = zip(self.category, self.side, strict=True)
        return self.T_hand_obj[[n for n, key in enumerate(keys) if key == (category, side)]]

    def write(self, folder: Path) -> None:
        """Write them as ``<category>/<side>_<number>.npy``, for ``initial_poses.read_priors_folder``.

        Raises ``UsageError`` for a folder that exists, and for a category that cannot name a folder.
        """
        with files.new_folder(folder) as work:
            for category, side in sorted({*zip(self.category, self.side, strict=True)}):
                if not files.is_portable_name(category):
                    raise UsageError(
                        f"{folder} cannot be used with {files.shorten_value(category)}, which cannot name a folder"
                    )
                (work / category).mkdir(exist_ok=True)
                for n, T in enumerate(self.of(category, side)):
                    np.save(work / category / f"{side}_{n:03d}.npy", T)


def subject_from_provenance(clip: Clip) -> str:
    """Return the subject whose hand is in a clip, from its provenance; empty where unknown."""
    return str(clip.provenance.get("subject", ""))


@dataclass(frozen=True)
class TrueGraspPose:
    """The true pose of the object in the hand of one clip."""

    category: str
    side: str
    R: Float[ndarray, "3 3"]
    """Rotation of ``T_hand_obj`` in the middle frame."""
    centre: Float[ndarray, "3"]
    """Mean place of the mesh's centre in the hand frame [m]."""
    mesh_centre: Float[ndarray, "3"]
    """The mesh's centre in the object frame, at its true scale [m]."""
    clip: str
    subject: str
    """Person whose hand it is; empty where unknown."""


def true_grasp_pose(clip: Clip) -> TrueGraspPose:
    """Learn the pose of a clip's grasp. Raises ``InputError`` for a clip without ground truth."""
    truth = clip.truth
    if truth is None:
        raise InputError(clip.origin / "truth.npz", "", "no such file", "the true poses, to learn from")
    T_hand_obj = se3.inverse(truth.T_cam_hand) @ truth.T_cam_obj
    mesh_centre = truth.scale * clip.mesh.centre
    return TrueGraspPose(
        category=clip.category,
        side=clip.side,
        R=T_hand_obj[len(clip) // 2, :3, :3],
        centre=se3.transform(T_hand_obj, mesh_centre[None])[:, 0].mean(axis=0),
        mesh_centre=mesh_centre,
        clip=clip.name,
        subject=subject_from_provenance(clip),
    )


@dataclass(frozen=True)
class LearntGrasps:
    """Grasps, and the settings by which initial poses are learnt from them: the content of a file of ``init learn``."""

    holds: tuple[TrueGraspPose, ...]
    k: int = 50
    """Maximum number of rotations of each category and side of hand."""
    way: Way = "geodesic"
    seed: int = 0

    def without(self, clip: str, subject: str) -> LearntGrasps:
        """Return all grasps but a clip's own and those of its subject, where the subject is known."""
        kept = (h for h in self.holds if h.clip != clip and not (subject and h.subject == subject))
        return replace(self, holds=tuple(kept))

    def of(self, category: str, side: str) -> LearntGrasps:
        """Return the grasps of a category in a hand."""
        return replace(self, holds=tuple(h for h in self.holds if (h.category, h.side) == (category, side)))

    def poses(self) -> PosePriors:
        """Learn the initial poses."""
        if not self.holds:
            return PosePriors((), (), np.zeros((0, 4, 4)))
        return learn_pose_priors(self.holds, self.k, self.way, self.seed)

    def write(self, path: Path) -> None:
        """Write it as an ``.npz`` file, with its folder if missing."""
        path.parent.mkdir(parents=True, exist_ok=True)
        names = {"category": "category", "side": "side", "clips": "clip", "subjects": "subject"}
        texts = {key: np.array([getattr(h, name) for h in self.holds], np.str_) for key, name in names.items()}
        numbers = {key: np.stack([getattr(h, key) for h in self.holds]) for key in ("R", "centre", "mesh_centre")}
        how = {"version": PRIORS_VERSION, "k": self.k, "way": self.way, "seed": self.seed}
        arrays.write(path, {**{key: np.array(value) for key, value in how.items()}, **texts, **numbers})


def learn_pose_priors(holds: Sequence[TrueGraspPose], k: int, way: Way = "geodesic", seed: int = 0) -> PosePriors:
    """Learn k rotations and one translation for each category and side of hand.

    The translation is the mean place of the object's centre, so that the place of a CAD's origin does not matter:
    ``T_hand_obj = [R_i | centre - R_i mesh_centre]``. At most k distinct rotations are taken unchanged.
    """
    category, side, poses = list[str](), list[str](), list[ndarray]()
    for key in sorted({(h.category, h.side) for h in holds}):
        here = [h for h in holds if (h.category, h.side) == key]
        R = cluster_rotations(np.stack([h.R for h in here]), k, way, seed)
        centre, mesh_centre = (np.mean([getattr(h, name) for h in here], axis=0) for name in ("centre", "mesh_centre"))
        poses.append(se3.rigid(R, centre - R @ mesh_centre))
        category += [key[0]] * len(R)
        side += [key[1]] * len(R)
    clips, subjects = tuple(sorted(h.clip for h in holds)), tuple(sorted({h.subject for h in holds} - {""}))
    return PosePriors(tuple(category), tuple(side), np.concatenate(poses), clips, subjects)


def cluster_rotations(
    R: Float[ndarray, "n 3 3"], k: int, way: Way = "geodesic", seed: int = 0
) -> Float[ndarray, "m 3 3"]:
    """Cluster n rotations into at most k by k-means, the largest clusters first.

    ``geodesic``: on SO(3), with the angle between rotations for their distance, and for their mean the rotation of
    least mean squared angle. ``axis-angle``: of rotation vectors, as in the paper, which puts half turns about opposite
    directions far apart though they are the same. The first means are drawn by ``seed`` far from each other
    (k-means++).
    """
    rng = np.random.default_rng(seed)
    if way == "geodesic":
        return _k_means(R, k, lambda a, b: se3.angle_between(a[:, None], b[None]), karcher_mean, rng)

    def distances(a: Float[ndarray, "n 3"], b: Float[ndarray, "m 3"]) -> Float[ndarray, "n m"]:
        return np.linalg.norm(a[:, None] - b[None], axis=-1)

    return se3.exp_so3(_k_means(se3.log_so3(R), k, distances, lambda w: w.mean(axis=0), rng))


def karcher_mean(R: Float[ndarray, "n 3 3"]) -> Float[ndarray, "3 3"]:
    """Find the rotation of least mean squared angle to n others, by fixed point from the mean matrix."""
    mean = se3.nearest_rotation(R.mean(axis=0))
    for _ in range(_MAX_K_MEANS_ITERATIONS):
        step = se3.log_so3(R @ mean.T).mean(axis=0)
        mean = se3.exp_so3(step) @ mean
        if np.linalg.norm(step) < 1e-9:
            break
    return mean


def _k_means(
    points: Float[ndarray, "n ..."],
    k: int,
    distances: Callable[[ndarray, ndarray], Float[ndarray, "n m"]],
    mean: Callable[[ndarray], ndarray],
    rng: np.random.Generator,
) -> Float[ndarray, "m ..."]:
    """Find at most k means of n points (Lloyd), the largest cluster's first; fewer where points coincide."""
    chosen = [int(rng.integers(len(points)))]
    while len(chosen) < k:
        squared = distances(points, points[chosen]).min(axis=1) ** 2
        if squared.max() < _ROTATION_TOLERANCE_RAD**2:
            break
        chosen.append(int(rng.choice(len(points), p=squared / squared.sum())))
    means = points[chosen]
    label = np.full(len(points), -1)
    for _ in range(_MAX_K_MEANS_ITERATIONS):
        nearest = distances(points, means).argmin(axis=1)
        if np.array_equal(nearest, label):
            break
        _, label = np.unique(nearest, return_inverse=True)  # a mean that has lost all its points goes
        means = np.stack([mean(points[label == i]) for i in range(label.max() + 1)])
    return means[np.argsort(-np.bincount(label), kind="stable")]
