"""ARCTIC's metrics of motion (Fan et al., CVPR 2023, Sec. 5): contact deviation, motion deviation and acceleration.

They compare corresponding vertices of hand and object in the camera frame: the predicted hand must have the vertices of
the true hand. Distances are from vertex to vertex, without symmetries, as in ARCTIC's code.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

ARCTIC_CONTACT_DISTANCE_M = 3e-3
"""Distance below which vertices are in contact [m]."""
MIN_CONTACT_WINDOW_S = 0.5
"""Minimum duration of a window of stable contact [s]: 15 frames of ARCTIC."""
VERTEX_SUCCESS_FRACTION = 0.05
"""Error, relative to the object's middle, below which a vertex is right [diameters]."""


@dataclass(frozen=True)
class ContactPairs:
    """The nearest vertex of the true object for each vertex of the true hand.

    Attributes:
        nearest: (T, Vh) index of the object's vertex.
        distance: (T, Vh) distance [m].
    """

    nearest: Int[ndarray, "T Vh"]
    distance: Float[ndarray, "T Vh"]

    @staticmethod
    def of(hand: Float[ndarray, "T Vh 3"], object_: Float[ndarray, "T Vo 3"]) -> ContactPairs:
        """Find the nearest vertices in each frame, in any common frame of reference [m]."""
        from scipy.spatial import KDTree

        found = [KDTree(o).query(h, distance_upper_bound=np.inf) for h, o in zip(hand, object_, strict=True)]
        distance, nearest = (np.stack(part) for part in zip(*found, strict=True))
        return ContactPairs(nearest, distance)

    @property
    def touching(self) -> Bool[ndarray, "T Vh"]:
        """True for the hand's vertices in contact."""
        return self.distance < ARCTIC_CONTACT_DISTANCE_M


def contact_deviation(
    pairs: ContactPairs, hand: Float[ndarray, "T Vh 3"], object_: Float[ndarray, "T Vo 3"]
) -> Float[ndarray, "T"]:
    """Compute the mean predicted distance of the vertices in true contact [m] (CDev); NaN without contact."""
    partner = np.take_along_axis(object_, pairs.nearest[..., None], axis=1)
    distance = np.where(pairs.touching, np.linalg.norm(hand - partner, axis=-1), 0.0)
    count = pairs.touching.sum(axis=1)
    return np.where(count > 0, distance.sum(axis=1) / np.maximum(count, 1), np.nan)


def motion_deviation(
    pairs: ContactPairs,
    rigid: Float[ndarray, "Vo 3"],
    hand: Float[ndarray, "T Vh 3"],
    object_: Float[ndarray, "T Vo 3"],
    time: Float[ndarray, "T"],
) -> float:
    """Compute the relative motion, between frames, of two predicted vertices in stable contact [m] (MDev).

    It is the mean over windows in which a vertex of the hand is truly in contact for ``MIN_CONTACT_WINDOW_S`` without
    sliding: its nearest vertices, in the object's own frame (``rigid``), are at most ``ARCTIC_CONTACT_DISTANCE_M``
    apart on average. NaN without such a window. Unlike in ARCTIC's code, a window may begin with the clip's first frame
    or end with its last, as a stable grasp does.
    """
    from scipy.spatial.distance import pdist

    deviations = []
    for first, last, i in _windows(pairs.touching, time):
        partners = pairs.nearest[first : last + 1, i]
        if pdist(rigid[partners]).mean() > ARCTIC_CONTACT_DISTANCE_M:
            continue
        j = np.bincount(partners).argmax()
        apart = hand[first : last + 1, i] - object_[first : last + 1, j]
        deviations.append(np.linalg.norm(np.diff(apart, axis=0), axis=1).mean())
    return float(np.mean(deviations)) if deviations else float("nan")


def _windows(touching: Bool[ndarray, "T Vh"], time: Float[ndarray, "T"]) -> Iterator[tuple[int, int, int]]:
    """Yield first frame, last frame and vertex of every window of uninterrupted contact of sufficient duration."""
    if len(time) < 2:
        return
    frame = float(np.median(np.diff(time)))
    for i in np.flatnonzero(touching.any(axis=0)):
        edges = np.flatnonzero(np.diff(touching[:, i].astype(np.int8), prepend=0, append=0))
        for first, end in edges.reshape(-1, 2):
            if time[end - 1] - time[first] + frame > MIN_CONTACT_WINDOW_S - 1e-6 and end - first > 1:
                yield int(first), int(end) - 1, int(i)


def acceleration_error(
    predicted: Float[ndarray, "T V 3"], true: Float[ndarray, "T V 3"], time: Float[ndarray, "T"]
) -> Float[ndarray, "T"]:
    """Compute the mean error of the vertices' acceleration relative to their middle [m/s^2] (ACC), per frame.

    NaN in the first and last frame, and where the intervals to the previous and next frame differ.
    """
    out, step = np.full(len(true), np.nan), np.diff(time)
    error = (predicted - predicted.mean(axis=1, keepdims=True)) - (true - true.mean(axis=1, keepdims=True))
    second = (error[:-2] - 2.0 * error[1:-1] + error[2:]) / (step[1:] * step[:-1])[:, None, None]
    even = np.isclose(step[1:], step[:-1])
    out[1:-1] = np.where(even, np.linalg.norm(second, axis=-1).mean(axis=1), np.nan)
    return out


def root_error(
    predicted: tuple[Float[ndarray, "T Vh 3"], Float[ndarray, "T Vo 3"]],
    true: tuple[Float[ndarray, "T Vh 3"], Float[ndarray, "T Vo 3"]],
) -> Float[ndarray, "T"]:
    """Compute the error of the vector from the hand's to the object's middle [m] (MRRPE)."""
    arms = [object_.mean(axis=1) - hand.mean(axis=1) for hand, object_ in (predicted, true)]
    return np.asarray(np.linalg.norm(arms[0] - arms[1], axis=1))


def vertex_success(
    predicted: Float[ndarray, "T V 3"], true: Float[ndarray, "T V 3"], diameter: float
) -> Float[ndarray, "T"]:
    """Compute the fraction of right vertices of the object, relative to its middle (ARCTIC's success rate)."""
    error = (predicted - predicted.mean(axis=1, keepdims=True)) - (true - true.mean(axis=1, keepdims=True))
    return np.asarray((np.linalg.norm(error, axis=-1) < VERTEX_SUCCESS_FRACTION * diameter).mean(axis=1))
