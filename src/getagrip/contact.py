"""What touches: points on the object's surface, and the hand's contact regions, as the push and pull terms read them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip import se3
from getagrip.clip import FINGERS, HandTrack
from getagrip.kernels.nearest import spread_points
from getagrip.mesh import Mesh, vertex_normals


@dataclass(frozen=True)
class SurfacePoints:
    """Points spread evenly over an object, about its centre. The paper sums over vertices; points make the terms
    independent of how a mesh is triangulated (a box has eight vertices, none of them where it is held)."""

    position: Float[ndarray, "3 P"]
    normal: Float[ndarray, "3 P"]

    @staticmethod
    def of(mesh: Mesh, centre: Float[ndarray, "3"], count: int) -> SurfacePoints:
        """Systematic sampling by area, the place inside each triangle from a low-discrepancy sequence; no randomness."""
        corners = mesh.vertices[mesh.faces]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        filled = np.cumsum(area)
        face = np.searchsorted(filled, (np.arange(count) + 0.5) / count * filled[-1])
        r = np.sqrt((0.5 + np.arange(count) * 0.7548776662466927) % 1.0)
        t = (0.5 + np.arange(count) * 0.5698402909980532) % 1.0
        a, b, c = np.moveaxis(corners[face], 1, 0)
        position = (1 - r)[:, None] * a + (r * (1 - t))[:, None] * b + (r * t)[:, None] * c - centre
        normal = mesh.planes[face, :3]
        return SurfacePoints(np.ascontiguousarray(position.T), np.ascontiguousarray(normal.T))


@dataclass(frozen=True)
class HandContacts:
    """The vertices of a hand's contact regions in the camera frame, fingertips first."""

    position: Float[ndarray, "N 3 Q"]
    normal: Float[ndarray, "N 3 Q"]
    region: Int[ndarray, "6"]
    """Where each of the five fingertip regions begins, and where the last ends; palm regions follow."""

    @staticmethod
    def of(hand: HandTrack, per_region: int | None = None) -> HandContacts:
        """All vertices of the regions, or at most ``per_region`` spread evenly over each."""
        T = hand.T_cam_hand
        vertices = se3.transform(T, hand.vertices)
        normals = vertex_normals(vertices, hand.faces)
        names = [*FINGERS, *sorted(set(hand.regions) - set(FINGERS))]
        ids = [hand.regions[name] for name in names]
        if per_region is not None:
            ids = [i[spread_points(hand.vertices[0, i], per_region)] for i in ids]
        index = np.concatenate(ids)
        ends = np.concatenate([[0], np.cumsum([len(i) for i in ids[: len(FINGERS)]])])
        return HandContacts(
            np.ascontiguousarray(np.swapaxes(vertices[:, index], 1, 2)),
            np.ascontiguousarray(np.swapaxes(normals[:, index], 1, 2)),
            ends,
        )

    def take(self, index: Int[ndarray, "n"]) -> HandContacts:
        """The contacts at some of the frames."""
        return HandContacts(self.position[index], self.normal[index], self.region)
