"""Where hand and object are in contact, on both of their surfaces, frame by frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh, decimate
from getagrip.geometry.subdivide import fine
from getagrip.metrics.contact import close_holes, moving_distance
from getagrip.view.gap import FACES, VERTICES
from getagrip.view.live.column import Column
from getagrip.view.live.patch import patch

REACH = 0.03
"""Distances [m] are exact up to here; what is farther away counts as so far."""


@dataclass(frozen=True, eq=False)
class Touch:
    """Distances [m], negative inside, in one frame.

    Attributes:
        object: (Vo,) of the vertices of ``Surfaces.fine`` to the hand.
        hand: (Vh,) of the hand's vertices to the object.
    """

    object: Float[ndarray, "Vo"]
    hand: Float[ndarray, "Vh"]


class Surfaces:
    """The surfaces of a column as they are shown [m]: the object in its own frame, the hand in the hand frame."""

    def __init__(self, column: Column) -> None:
        self._column = column
        self._known: dict[int, Touch] = {}

    @cached_property
    def object(self) -> Mesh:
        """The object at the size that was found, decimated if it is large."""
        view = self._column.view
        mesh = decimate(view.clip.mesh, FACES)
        return Mesh(view.result.scale * mesh.vertices, mesh.faces)

    @cached_property
    def fine(self) -> Mesh:
        """The same with more vertices, on which contact is marked."""
        return fine([self.object], VERTICES)[0]

    @property
    def hand_faces(self) -> Int[ndarray, "F 3"]:
        """Faces of the hand."""
        return self._column.view.clip.hand.faces

    def hand(self, n: int) -> Float[ndarray, "V 3"]:
        """The hand in the hand frame."""
        return np.asarray(self._column.view.clip.hand.vertices[n])

    def touch(self, n: int) -> Touch:
        """The distances in frame ``n``, computed once."""
        if n not in self._known:
            T_hand_obj, hand = self._column.view.result.T_hand_obj[n], self.hand(n)
            posed = se3.transform(T_hand_obj, self.fine.vertices)
            to_hand = _distance(posed, *close_holes(hand, self.hand_faces))
            back = se3.transform(se3.inverse(T_hand_obj), hand)
            self._known[n] = Touch(to_hand, _distance(back, self.object.vertices, self.object.faces))
        return self._known[n]

    def on_object(self, n: int, threshold: float) -> tuple[Float[ndarray, "W 3"], Int[ndarray, "G 3"]]:
        """Where the object is within ``threshold`` [m] of the hand, as a mesh in the object's frame."""
        return patch(self.fine.vertices, self.fine.faces, self.touch(n).object, threshold)

    def on_hand(self, n: int, threshold: float) -> tuple[Float[ndarray, "W 3"], Int[ndarray, "G 3"]]:
        """Where the hand is within ``threshold`` [m] of the object, as a mesh in the hand frame."""
        return patch(self.hand(n), self.hand_faces, self.touch(n).hand, threshold)


def _distance(
    points: Float[ndarray, "P 3"], vertices: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"]
) -> Float[ndarray, "P"]:
    return np.minimum(moving_distance(points[None], vertices[None], faces, REACH)[0], REACH)
