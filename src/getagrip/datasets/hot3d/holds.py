"""When a hand holds an object of HOT3D, and how whole recordings and holds become pieces."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.datasets.cutting import pieces
from getagrip.datasets.dataset import Note
from getagrip.datasets.tracks import Piece, Track
from getagrip.geometry import se3
from getagrip.grasps.stable import Definition

CONTACT = 0.005
"""A hand with a vertex so near to an object's surface touches it [m]."""
SHORTEST = 10
"""Frames of the shortest hold, and the fewest in which its object must be visible."""
DEFINITION = Definition(contact=CONTACT, shortest=SHORTEST)


def holds(tracks: Iterable[Track], _: Note = lambda _: None) -> Iterator[Piece]:
    """Where a hand touches an object without a break, for ``SHORTEST`` frames or more."""
    for track in tracks:
        distance = nearest(track)
        rows = np.flatnonzero(distance < CONTACT)
        runs = np.split(rows, np.flatnonzero(np.diff(track.numbers[rows]) != 1) + 1)
        for number, run in enumerate((run for run in runs if len(run) >= SHORTEST), start=1):
            first, last = track.numbers[run[[0, -1]]]
            yield Piece(
                track.take(run),
                name=hold_name(track) + f"-{number}" * (number > 1),
                made_of=f"a hold, frames {first} to {last}: the hand is {1e3 * distance[run].mean():.2f} mm from the "
                "object, mean over the frames",
            )


def hold_name(track: Track) -> str:
    """What clips of holds are called, without the count."""
    return f"{track.subject}_{track.sequence}-{track.category}-{track.side}"


def whole_tracks(tracks: Iterable[Track], note: Note) -> Iterator[Piece]:
    """All frames of each hand and object that touch for ``SHORTEST`` frames or more, as far as nothing is missing."""
    for track in tracks:
        if next(holds([track]), None) is not None:
            yield from pieces([track], note, DEFINITION, whole=True)


def nearest(track: Track) -> Float[ndarray, "T"]:
    """Distance of the hand's nearest vertex to the object's surface [m]; infinite where it may be above ``CONTACT``."""
    import igl

    mesh = track.object(0.0)
    tree = igl.AABB()
    tree.init(mesh.vertices, mesh.faces)
    low, high = mesh.vertices.min(axis=0) - CONTACT, mesh.vertices.max(axis=0) + CONTACT
    out = np.full(len(track), np.inf)
    for n, T_obj_hand in enumerate(se3.inverse(track.T_cam_obj) @ track.hand.T_cam_hand):
        points = se3.transform(T_obj_hand, track.hand.vertices[n])
        points = points[np.all((points >= low) & (points <= high), axis=1)]
        if len(points):
            out[n] = np.sqrt(tree.squared_distance(mesh.vertices, mesh.faces, points)[0].min())
    return out
