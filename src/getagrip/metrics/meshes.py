"""Contact between a hand and an object whose mesh is another one in each frame, as systems without a CAD give it.

Stable contact area compares the points in contact in two frames, so they must be the same points. A mesh that is made
anew in each frame has none that are; the hand has. So there the ``hand`` side of ``contact`` is what can be told, and
the other two only where all meshes have the same faces: a mesh that is moved or bent.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.geometry.mesh import Mesh
from getagrip.metrics.contact import AREA_POINTS, REACH, SIDES, ContactDistances, Side, close_holes, signed_distance
from getagrip.metrics.symmetry import at_places, surface_places


def mesh_distances(
    meshes: Sequence[Mesh | None], hand_vertices: Float[ndarray, "T V 3"], hand_faces: Int[ndarray, "F 3"]
) -> tuple[ContactDistances, tuple[Side, ...]]:
    """Distances between the mesh of each frame and a hand, both in the hand frame, and the sides that can be compared.

    Where a frame has no mesh, nothing is near. Where meshes have different numbers of vertices, ``object`` is filled up
    with points that are infinitely far; ``area`` has no points where sides cannot be compared.
    """
    there = [mesh for mesh in meshes if mesh is not None]
    same = bool(there) and all(np.array_equal(mesh.faces, there[0].faces) for mesh in there)
    face, along = (
        surface_places(there[0], AREA_POINTS if same else 0) if there else (np.zeros(0, int), np.zeros((0, 2)))
    )
    hands, faces = close_holes(hand_vertices, hand_faces)
    T = len(meshes)
    out = ContactDistances(
        object=np.full((T, max((len(mesh.vertices) for mesh in there), default=1)), np.inf),
        hand=np.full((T, hand_vertices.shape[1]), np.inf),
        area=np.full((T, len(face)), np.inf),
    )
    for n, mesh in enumerate(meshes):
        if mesh is not None:
            V = len(mesh.vertices)
            points = np.concatenate([mesh.vertices, at_places(mesh, face, along)])
            to_hand = signed_distance(points, hands[n], faces, REACH)
            out.object[n, :V], out.area[n] = to_hand[:V], to_hand[V:]
            out.hand[n] = signed_distance(hand_vertices[n], mesh.vertices, mesh.faces, REACH)
    return out, SIDES if same else ("hand",)
