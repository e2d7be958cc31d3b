"""Signed distances to an object, and the least of them of points on their way to it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.geometry.mesh import Mesh


class SignedDistance:
    """Signed distance to a mesh of closed parts, which may overlap, negative inside [m]."""

    def __init__(self, mesh: Mesh) -> None:
        import igl

        self._mesh, self._box = mesh, (mesh.vertices.min(axis=0), mesh.vertices.max(axis=0))
        self._tree, self._winding = igl.AABB(), igl.FastWindingNumberBVH()
        self._tree.init(mesh.vertices, mesh.faces)
        self._winding.init(mesh.vertices, mesh.faces)

    def __call__(self, X: Float[ndarray, "*batch 3"]) -> Float[ndarray, "*batch"]:
        """Distances at points in the mesh's frame."""
        flat = np.ascontiguousarray(X.reshape(-1, 3))
        distance = np.sqrt(self._tree.squared_distance(self._mesh.vertices, self._mesh.faces, flat)[0])
        boxed = np.flatnonzero(np.all((flat >= self._box[0]) & (flat <= self._box[1]), axis=1))
        inside = boxed[np.abs(self._winding.winding_number(flat[boxed])) > 0.5] if boxed.size else boxed
        distance[inside] *= -1.0
        return distance.reshape(X.shape[:-1])


class MinSignedDistance:
    """The least signed distance [m] of each of some groups of moving points.

    A distance changes by no more than the way of its point, so only points that may be the nearest are looked up.
    """

    def __init__(self, distance: SignedDistance, groups: int, X: Float[ndarray, "*#groups n 3"]) -> None:
        """``X`` is where the points are to begin with: those of each group, or of all of them."""
        self._distance = distance
        self._known = np.array(np.broadcast_to(distance(X), (groups, X.shape[-2])))
        self._at = np.array(np.broadcast_to(X, (*self._known.shape, 3)))

    def __call__(self, X: Float[ndarray, "B n 3"], which: Int[ndarray, "B"]) -> Float[ndarray, "B"]:
        """Return the least distance of each of the groups ``which``, whose points are now at X."""
        way, known = np.linalg.norm(X - self._at[which], axis=-1), self._known[which]
        group, point = np.nonzero((known - way <= (known + way).min(axis=1, keepdims=True)) & (way > 0.0))
        if group.size:
            now = X[group, point]
            known[group, point], way[group, point] = self._distance(now), 0.0
            self._known[which[group], point], self._at[which[group], point] = known[group, point], now
        return np.asarray((known - way).min(axis=1))
