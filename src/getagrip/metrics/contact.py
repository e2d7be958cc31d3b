"""Contact of hand and object: where it is, how stable (SCA), and how deep they penetrate each other.

Stable contact area: the mean, over pairs of frames i < j, of IOU(S_i, S_j), S_i the points in contact in frame i
(paper, Sec. 5.2). A point is in contact where its signed distance to the other surface is at most a threshold; inside
counts at any depth. Three sets of points are in use:

- ``object``: the object's vertices, against the hand: the paper's;
- ``hand``: the hand's vertices, against the object: the authors' later code's;
- ``area``: points sampled evenly over the object's surface, against the hand: it does not depend on the triangulation
  (a box has eight vertices, none of them in the grasp).

Two empty sets have IOU 0, as in the authors' code: a hand that never touches is not a stable grasp.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.io.choices import check_values
from getagrip.metrics.pose import ObjectTrack
from getagrip.metrics.surface_distance import close_holes, moving_distance
from getagrip.metrics.symmetry import surface_points

Side = Literal["object", "hand", "area"]
CONTACT_SIDES: tuple[Side, ...] = get_args(Side)
CONTACT_THRESHOLDS_M = (0.0, 0.005, 0.010)
"""Contact thresholds in use [m]."""
MAX_SIGNED_DISTANCE_M = 0.011
"""Signed distances are exact up to here [m]; beyond, they may be infinite."""
MAX_CONTACT_THRESHOLD_MM = 50.0
"""Largest threshold that anybody may ask for [mm]."""
N_AREA_SAMPLES = 2000
_POINT_DESCRIPTIONS: dict[Side, str] = {
    "object": "object vertices",
    "hand": "hand vertices",
    "area": "object points by area",
}


@dataclass(frozen=True)
class ContactDefinition:
    """A definition of contact: the points that count, and their distance.

    Attributes:
        side: whose points are tested: a field of ``ContactDistances``.
        threshold: largest signed distance to the other surface [m].
    """

    side: Side
    threshold: float

    def __post_init__(self) -> None:
        check_values(self)

    @property
    def distance(self) -> str:
        """The threshold as text."""
        return f"{1e3 * self.threshold:g} mm"

    @property
    def key(self) -> str:
        """Its part of the key of a metric: ``object_10mm``."""
        return f"{self.side}_{1e3 * self.threshold:g}mm"

    @property
    def description(self) -> str:
        """In a sentence: "object vertices within 10 mm"."""
        return f"{_POINT_DESCRIPTIONS[self.side]} within {self.distance}"


def contact_definitions_at(thresholds: Sequence[float]) -> tuple[ContactDefinition, ...]:
    """Return the paper's definition, by object vertices, at thresholds of 0 to 50 mm.

    Raises ``UsageError`` for others.
    """
    bad = next((mm for mm in thresholds if not 0.0 <= mm <= MAX_CONTACT_THRESHOLD_MM), None)
    if bad is not None:
        raise UsageError(f"--contact must be 0 to {MAX_CONTACT_THRESHOLD_MM:g} mm (got {bad:g} mm)")
    return tuple(dict.fromkeys(ContactDefinition("object", mm / 1e3) for mm in thresholds))


CONTACT_DEFINITIONS = tuple(
    ContactDefinition(side, threshold) for side in CONTACT_SIDES for threshold in CONTACT_THRESHOLDS_M
)
"""All that are evaluated."""


@dataclass(frozen=True)
class ContactDistances:
    """Signed distances [m] between hand and object in each frame, negative inside; exact up to ``MAX_SIGNED_DISTANCE_M``.

    Attributes:
        object: (T, Vo) object vertices to the hand.
        hand: (T, Vh) hand vertices to the object.
        area: (T, P) points sampled evenly over the object to the hand.
    """

    object: Float[ndarray, "T Vo"]
    hand: Float[ndarray, "T Vh"]
    area: Float[ndarray, "T P"]

    def take(self, index: Int[ndarray, "n"]) -> ContactDistances:
        """Return those of some of the frames."""
        return ContactDistances(self.object[index], self.hand[index], self.area[index])

    def contact(self, side: Side, threshold: float) -> Bool[ndarray, "T _"]:
        """Return the points in contact: signed distance at most ``threshold`` [m]."""
        distance: ndarray = getattr(self, side)
        return distance <= threshold

    def depth(self, side: Side) -> Float[ndarray, "T _"]:
        """Return the depth [m] of each point inside the other body; zero outside."""
        distance: ndarray = getattr(self, side)
        return np.maximum(-distance, 0.0)


def contact_distances(
    mesh: Mesh,
    tracks: Sequence[ObjectTrack],
    hand_vertices: Float[ndarray, "T V 3"],
    hand_faces: Int[ndarray, "F 3"],
    max_distance: float = MAX_SIGNED_DISTANCE_M,
) -> list[ContactDistances]:
    """Compute distances between an object and a hand (in the hand frame), both ways, for each track of the object.

    They are exact up to ``max_distance`` [m]. Holes of the hand are closed first. Tracks share the hand's search trees.
    """
    points = np.concatenate([mesh.vertices, surface_points(mesh, N_AREA_SAMPLES)])
    V, P = len(mesh.vertices), len(points)
    in_hand = np.concatenate([se3.transform(track.T_ref_obj, track.scale * points) for track in tracks], axis=1)
    to_hand = moving_distance(in_hand, *close_holes(hand_vertices, hand_faces), max_distance)
    out = []
    for k, track in enumerate(tracks):
        in_object = se3.transform(se3.inverse(track.T_ref_obj), hand_vertices)
        vertices = np.broadcast_to(track.scale * mesh.vertices, (len(in_object), V, 3))
        to_object = moving_distance(in_object, vertices, mesh.faces, max_distance)
        out.append(ContactDistances(to_hand[:, k * P : k * P + V], to_object, to_hand[:, k * P + V : (k + 1) * P]))
    return out


@dataclass(frozen=True)
class StableContact:
    """How stable contact is, by one definition of it.

    Attributes:
        sca: stable contact area: mean over pairs of different frames.
        diagonal: the same with each frame paired with itself, too.
        share: (T,) share of the points in contact, in each frame.
    """

    sca: float
    diagonal: float
    share: Float[ndarray, "T"]


def stable_contact(distances: ContactDistances, definition: ContactDefinition) -> StableContact:
    """Measure the stable contact of a sequence."""
    contact = distances.contact(definition.side, definition.threshold)
    overlap = pairwise_iou(contact)
    return StableContact(
        stable_contact_area(overlap), stable_contact_area(overlap, diagonal=True), contact.mean(axis=1)
    )


def pairwise_iou(contact: Bool[ndarray, "T P"]) -> Float[ndarray, "T T"]:
    """Compute the IOU of the contact sets of every pair of frames; 0 for empty sets, also of one with itself."""
    bits = np.packbits(contact, axis=1)
    both = np.stack([np.bitwise_count(bits & row).sum(axis=1, dtype=float) for row in bits])
    count = np.diag(both)
    either = count[:, None] + count[None, :] - both
    return np.where(either > 0, both / np.maximum(either, 1.0), 0.0)


def stable_contact_area(overlap: Float[ndarray, "T T"], diagonal: bool = False) -> float:
    """Compute SCA from the pairwise IOU: the mean over pairs i < j (the paper's), or over the full T x T matrix.

    With the diagonal (the authors' code) each frame also counts with itself: never overlapping contacts then score
    1 / T. NaN where there is no pair.
    """
    if diagonal:
        return float(overlap.mean())
    T = len(overlap)
    return float(overlap[np.triu_indices(T, k=1)].mean()) if T > 1 else float("nan")
