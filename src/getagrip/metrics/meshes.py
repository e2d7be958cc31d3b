"""Contact between a hand and an object with a new mesh in each frame, as systems without a CAD model reconstruct it.

Stable contact area compares the points in contact in two frames, so they must be the same points. New meshes have no
points in common; the hand has. So only the ``hand`` side of ``contact`` can be measured, and the other two where all
meshes have the same faces: one mesh that moves or deforms.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.geometry.mesh import Mesh
from getagrip.metrics.contact import CONTACT_SIDES, MAX_SIGNED_DISTANCE_M, N_AREA_SAMPLES, ContactDistances, Side
from getagrip.metrics.surface_distance import close_holes, signed_distance
from getagrip.metrics.symmetry import points_at_samples, surface_samples


def mesh_distances(
    meshes: Sequence[Mesh | None], hand_vertices: Float[ndarray, "T V 3"], hand_faces: Int[ndarray, "F 3"]
) -> tuple[ContactDistances, tuple[Side, ...]]:
    """Compute distances between the mesh of each frame and a hand, both in the hand frame, and the comparable sides.

    In a frame without a mesh all distances are infinite. Where meshes have different numbers of vertices, ``object`` is
    padded with infinite distances; ``area`` has no points where sides cannot be compared.
    """
    there = [mesh for mesh in meshes if mesh is not None]
    same = bool(there) and all(np.array_equal(mesh.faces, there[0].faces) for mesh in there)
    face, along = (
        surface_samples(there[0], N_AREA_SAMPLES if same else 0) if there else (np.zeros(0, int), np.zeros((0, 2)))
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
            points = np.concatenate([mesh.vertices, points_at_samples(mesh, face, along)])
            to_hand = signed_distance(points, hands[n], faces, MAX_SIGNED_DISTANCE_M)
            out.object[n, :V], out.area[n] = to_hand[:V], to_hand[V:]
            out.hand[n] = signed_distance(hand_vertices[n], mesh.vertices, mesh.faces, MAX_SIGNED_DISTANCE_M)
    return out, CONTACT_SIDES if same else ("hand",)
