"""The ground truth of a clip, and the joint of an object with two parts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.geometry import se3
from getagrip.io.array_data import ArrayData


@dataclass(frozen=True, eq=False)
class Joint(ArrayData):
    """The joint of an articulated object: one part of it rotates about a line, the other has the object's pose.

    Attributes:
        moves: (V,) vertices of the mesh that belong to the part that rotates.
        point: (3,) a point of the line, in the object frame [m].
        direction: (3,) its direction, of length 1; angles count about it by the right-hand rule.
        angle: the articulation angle at which the mesh is [rad].
    """

    moves: Bool[ndarray, "V"]
    point: Float[ndarray, "3"]
    direction: Float[ndarray, "3"]
    angle: float = 0.0

    def at(self, vertices: Float[ndarray, "V 3"], angles: Float[ndarray, "T"]) -> Float[ndarray, "T V 3"]:
        """Return the mesh's vertices with the joint at some angles [rad], in the object frame [m]."""
        out = np.tile(vertices, (len(angles), 1, 1))
        turn = se3.rotation_about_line(self.point, self.direction, angles - self.angle)
        out[:, self.moves] = se3.transform(turn, vertices[self.moves])
        return out


@dataclass(frozen=True, eq=False)
class Truth(ArrayData):
    """The ground truth of a clip (``truth.npz``).

    Attributes:
        T_cam_obj: (T, 4, 4) true pose of the object, object frame to camera frame [m].
        scale: true factor by which the mesh is scaled before it is posed.
        T_cam_hand: (T, 4, 4) true pose of the hand, hand frame to camera frame [m]; that of the clip if no other is
            known.
        hand_vertices: (T, V, 3) true vertices of the hand in the hand frame [m]; those of the clip if no others are
            known.
        articulation: (T,) angle of the object's joint [rad]; None for objects without one.
        joint: the joint; None where there is none, or where only the angle is known.
    """

    T_cam_obj: Float[ndarray, "T 4 4"]
    scale: float
    T_cam_hand: Float[ndarray, "T 4 4"]
    hand_vertices: Float[ndarray, "T V 3"]
    articulation: Float[ndarray, "T"] | None = None
    joint: Joint | None = None

    def object_vertices(self, vertices: Float[ndarray, "V 3"], frames: slice) -> Float[ndarray, "n V 3"]:
        """Return the true vertices in the object frame [m] in some frames: scaled, with the true angle of the joint."""
        if self.joint is None or self.articulation is None:
            return np.tile(self.scale * vertices, (len(self.T_cam_obj[frames]), 1, 1))
        return self.scale * self.joint.at(vertices, self.articulation[frames])
