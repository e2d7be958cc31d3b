"""Subdivision: the same surface, closed where it was, no long edge, about as many vertices as asked for."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from getagrip.geometry.mesh import Mesh, edge_length, subdivide_surface

BOX = trimesh.creation.box((0.3, 0.1, 0.02))
MESH = Mesh(np.asarray(BOX.vertices), np.asarray(BOX.faces))


@given(st.floats(0.01, 0.4))
@pytest.mark.slow
def test_the_surface_stays_and_no_edge_is_longer(longest: float) -> None:
    vertices, faces = subdivide_surface(MESH.vertices, MESH.faces, longest)
    fine = Mesh(vertices, faces)
    assert fine.is_closed
    assert fine.volume == pytest.approx(MESH.volume)
    assert fine.vertex_areas.sum() == pytest.approx(MESH.vertex_areas.sum())
    np.testing.assert_array_equal(vertices[: len(MESH.vertices)], MESH.vertices)
    assert np.linalg.norm(vertices[faces] - vertices[np.roll(faces, 1, axis=1)], axis=-1).max() <= longest


def test_a_face_is_split_by_how_many_of_its_edges_are_long() -> None:
    flat, tall = [[0.0, 0.0], [2.0, 0.0], [1.0, 0.3]], [[0.0, 0.0], [0.2, 0.0], [0.1, 1.0]]
    even = [[0.0, 0.0], [1.0, 0.0], [0.5, 0.9]]
    for corners, longest, faces in ((flat, 2.5, 1), (flat, 1.5, 2), (tall, 0.6, 3), (even, 0.9, 4)):
        found = subdivide_surface(np.pad(corners, ((0, 0), (0, 1))), np.array([[0, 1, 2]]), longest)
        assert len(found[1]) == faces
        assert np.all(Mesh(*found).normals[:, 2] > 0)  # every small triangle is wound as the large one


def test_about_as_many_vertices_as_asked_for() -> None:
    ball = trimesh.creation.icosphere(1)
    for mesh in (MESH, Mesh(np.asarray(ball.vertices), np.asarray(ball.faces))):
        longest = edge_length(float(mesh.vertex_areas.sum()), 4500)
        assert 2000 < len(subdivide_surface(mesh.vertices, mesh.faces, longest)[0]) < 9000
