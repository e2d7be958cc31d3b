"""Starting poses learnt from true ones: rotations clustered on SO(3), and a mean translation (paper, appendix).

The paper starts from 50 rotations and one translation for each object and side of hand, found by clustering the true
poses of the grasps that it then evaluates. What is learnt here carries the names of its clips and subjects with it, so
that it can be refused for them (``priors``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import Clip
from getagrip.errors import InputError
from getagrip.fitting.pose_priors import Priors, subject_of
from getagrip.geometry import se3

Way = Literal["geodesic", "axis-angle"]
"""How rotations are clustered."""
_ROUNDS = 100
"""Rounds of k-means or of a mean, if it does not settle before."""
_SAME = 1e-6
"""Rotations nearer than this are one [rad]."""


@dataclass(frozen=True)
class Hold:
    """What is learnt from one clip: where the object truly is in the hand."""

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
    """Whose hand it is; empty where unknown."""


def hold(clip: Clip) -> Hold:
    """What a clip teaches. Raises ``InputError`` where it has no truth."""
    truth = clip.truth
    if truth is None:
        raise InputError(clip.origin / "truth.npz", "", "no such file", "the true poses, to learn from")
    T_hand_obj = se3.inverse(truth.T_cam_hand) @ truth.T_cam_obj
    mesh_centre = truth.scale * clip.mesh.centre
    return Hold(
        category=clip.category,
        side=clip.side,
        R=T_hand_obj[len(clip) // 2, :3, :3],
        centre=se3.transform(T_hand_obj, mesh_centre[None])[:, 0].mean(axis=0),
        mesh_centre=mesh_centre,
        clip=clip.name,
        subject=subject_of(clip),
    )


def learn(holds: Sequence[Hold], k: int, way: Way = "geodesic", seed: int = 0) -> Priors:
    """k rotations and one translation for each category and side of hand.

    The translation is the mean place of the object's centre, so that it does not matter where a CAD has its origin:
    ``T_hand_obj = [R_i | centre - R_i mesh_centre]``. Fewer than k different rotations are all taken as they are.
    """
    category, side, poses = list[str](), list[str](), list[ndarray]()
    for key in sorted({(h.category, h.side) for h in holds}):
        here = [h for h in holds if (h.category, h.side) == key]
        R = clustered(np.stack([h.R for h in here]), k, way, seed)
        centre, mesh_centre = (np.mean([getattr(h, name) for h in here], axis=0) for name in ("centre", "mesh_centre"))
        poses.append(se3.rigid(R, centre - R @ mesh_centre))
        category += [key[0]] * len(R)
        side += [key[1]] * len(R)
    subjects = tuple(sorted({h.subject for h in holds} - {""}))
    return Priors(tuple(category), tuple(side), np.concatenate(poses), tuple(sorted(h.clip for h in holds)), subjects)


def clustered(R: Float[ndarray, "n 3 3"], k: int, way: Way = "geodesic", seed: int = 0) -> Float[ndarray, "m 3 3"]:
    """At most k rotations that stand for n by k-means, those that stand for most first.

    ``geodesic``: on SO(3), with the angle between rotations for their distance, and for their mean the rotation of
    least mean squared angle. ``axis-angle``: of rotation vectors, as in the paper; there, half turns about opposite
    directions are far apart though they are the same. The first means are drawn by ``seed`` far from each other
    (k-means++).
    """
    rng = np.random.default_rng(seed)
    if way == "geodesic":
        return _k_means(R, k, lambda a, b: se3.angle_between(a[:, None], b[None]), karcher_mean, rng)
    vectors = se3.log_so3(R)
    means = _k_means(
        vectors, k, lambda a, b: np.linalg.norm(a[:, None] - b[None], axis=-1), lambda w: w.mean(axis=0), rng
    )
    return se3.exp_so3(means)


def karcher_mean(R: Float[ndarray, "n 3 3"]) -> Float[ndarray, "3 3"]:
    """The rotation of least mean squared angle to n others: from the mean matrix's nearest rotation, by fixed point."""
    mean = se3.nearest_rotation(R.mean(axis=0))
    for _ in range(_ROUNDS):
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
    """At most k means of n points (Lloyd), of the fullest cluster first; fewer where points are the same."""
    chosen = [int(rng.integers(len(points)))]
    while len(chosen) < k:
        squared = distances(points, points[chosen]).min(axis=1) ** 2
        if squared.max() < _SAME**2:
            break
        chosen.append(int(rng.choice(len(points), p=squared / squared.sum())))
    means = points[chosen]
    label = np.full(len(points), -1)
    for _ in range(_ROUNDS):
        nearest = distances(points, means).argmin(axis=1)
        if np.array_equal(nearest, label):
            break
        _, label = np.unique(nearest, return_inverse=True)  # a mean that has lost all its points goes
        means = np.stack([mean(points[label == i]) for i in range(label.max() + 1)])
    return means[np.argsort(-np.bincount(label), kind="stable")]
