"""Signed distances of points to a surface, at rest or moving: of hand and object to each other."""

from __future__ import annotations

import atexit
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.errors import GetagripError
from getagrip.geometry.mesh import edge_table

MAX_SCENE_COORDINATE_M = 1e5
"""No point of any scene is farther from its origin [m]."""
MAX_CACHED_SURFACES = 64
"""Most surfaces whose search trees are kept, of at most ``MAX_CACHED_SURFACE_FACES`` faces each: hands of the latest frames, 50 MB."""
MAX_CACHED_SURFACE_FACES = 2000


def signed_distance(
    points: Float[ndarray, "P 3"],
    vertices: Float[ndarray, "V 3"],
    faces: Int[ndarray, "F 3"],
    max_distance: float = np.inf,
) -> Float[ndarray, "P"]:
    """Compute the distance [m] of points to a surface, negative inside; beyond ``max_distance`` it may be infinite.

    Inside is where the winding number exceeds a half (Barill et al., "Fast Winding Numbers for Soups and Clouds",
    2018): right also for bodies of several overlapping closed parts, where the nearest surface's normal misleads.
    """
    return moving_distance(points[None], vertices[None], faces, max_distance)[0]


def moving_distance(
    points: Float[ndarray, "T P 3"],
    vertices: Float[ndarray, "T V 3"],
    faces: Int[ndarray, "F 3"],
    max_distance: float = np.inf,
) -> Float[ndarray, "T P"]:
    """Compute ``signed_distance`` of moving points to a moving surface.

    From frame to frame a distance changes by no more than the point and the surface have moved, and its sign changes
    only where it passes zero. A distance that is thus known to be beyond ``max_distance``, or a side that is known to
    be the same as before, is not computed again. Raises ``GetagripError`` for coordinates beyond all scenes, at which
    libigl's search would run out of its memory.
    """
    if not max(np.abs(points).max(initial=0.0), np.abs(vertices).max(initial=0.0)) < MAX_SCENE_COORDINATE_M:
        raise GetagripError(
            f"distances of points more than {MAX_SCENE_COORDINATE_M:g} m away, or of no number, are not computed"
        )

    closed = bool(np.all(edge_table(faces)[:, 3] < len(faces)))  # else one can get inside without crossing the surface
    inside, least = np.zeros(points.shape[1], dtype=bool), np.full(points.shape[1], -np.inf)
    out = np.full(points.shape[:2], np.inf)
    moved = np.inf
    for n, (x, surface) in enumerate(zip(points, vertices, strict=True)):
        if n > 0:
            moved = np.linalg.norm(surface - vertices[n - 1], axis=1).max()
            step = x - points[n - 1]
            least -= np.sqrt(np.einsum("pk,pk->p", step, step)) + moved + 1e-9
        if moved > 0.0:
            here = _SearchSurface.of(surface, faces)
        sides = np.maximum(surface.min(axis=0) - x, x - surface.max(axis=0))
        outside = np.maximum(np.maximum(sides[:, 0], sides[:, 1]), sides[:, 2])  # the bounding box, by so much
        boxed = outside <= 0.0
        unsure = np.flatnonzero(boxed & ((least <= 0.0) | (not closed)))
        if unsure.size:
            inside[unsure] = here.encloses(x[unsure])
        inside &= boxed
        asked = np.flatnonzero((outside <= max_distance) & (inside | (least <= max_distance)))
        if asked.size:
            least[asked] = here.distance(x[asked])
            out[n, asked] = np.where(inside[asked], -least[asked], least[asked])
    return out


@dataclass(frozen=True)
class _SearchSurface:
    """A surface at rest and its search trees, each made when it is first needed."""

    vertices: Float[ndarray, "V 3"]
    faces: Int[ndarray, "F 3"]

    @staticmethod
    def of(vertices: Float[ndarray, "V 3"], faces: Int[ndarray, "F 3"]) -> _SearchSurface:
        """Return a surface; results that are compared on a clip share those of its hand."""
        vertices, faces = np.asarray(vertices, np.float64), np.asarray(faces, np.int64)
        return (
            _cached_surface(vertices.tobytes(), faces.tobytes())
            if len(faces) <= MAX_CACHED_SURFACE_FACES
            else _SearchSurface(vertices, faces)
        )

    def distance(self, points: Float[ndarray, "P 3"]) -> Float[ndarray, "P"]:
        """Compute the distance of points [m], without a sign."""
        return np.sqrt(self._tree.squared_distance(self.vertices, self.faces, points)[0])

    def encloses(self, points: Float[ndarray, "P 3"]) -> Bool[ndarray, "P"]:
        """Return the points inside, by their winding numbers."""
        return np.abs(self._winding.winding_number(points)) > 0.5

    @cached_property
    def _tree(self) -> Any:
        import igl

        tree = igl.AABB()
        tree.init(self.vertices, self.faces)
        return tree

    @cached_property
    def _winding(self) -> Any:
        import igl

        winding = igl.FastWindingNumberBVH()
        winding.init(self.vertices, self.faces)
        return winding


@lru_cache(maxsize=MAX_CACHED_SURFACES)
def _cached_surface(vertices: bytes, faces: bytes) -> _SearchSurface:
    return _SearchSurface(np.frombuffer(vertices).reshape(-1, 3), np.frombuffer(faces, np.int64).reshape(-1, 3))


atexit.register(_cached_surface.cache_clear)  # libigl's bindings report trees that outlive them as leaks


def close_holes(
    vertices: Float[ndarray, "*batch V 3"], faces: Int[ndarray, "F 3"]
) -> tuple[Float[ndarray, "*batch W 3"], Int[ndarray, "G 3"]]:
    """Close each hole (MANO's wrist) by a fan of faces about the mean of its border."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    edges = edge_table(faces)
    border = edges[edges[:, 3] == len(faces), :2]
    if not len(border):
        return vertices, faces
    V = vertices.shape[-2]
    linked = coo_array((np.ones(len(border)), (border[:, 0], border[:, 1])), shape=(V, V))
    _, hole = np.unique(connected_components(linked, directed=False)[1][border[:, 0]], return_inverse=True)
    # A mean over each hole's border, of all holes at once: a triangle soup has as many holes as faces.
    around = coo_array((np.ones(len(border)), (hole, border[:, 0])), shape=(int(hole.max()) + 1, V)).tocsr()
    flat = np.moveaxis(vertices, -2, 0).reshape(V, -1)
    tips = (around @ flat / around.sum(axis=1)[:, None]).reshape(-1, *vertices.shape[:-2], 3)
    tips = np.moveaxis(tips, 0, -2)
    fan = np.stack([border[:, 1], border[:, 0], V + hole], axis=1)
    return np.concatenate([vertices, tips], axis=-2), np.concatenate([faces, fan])
