"""Meshes: edge tables against brute force, winding, normals, reading and decimating."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from conftest import box
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from getagrip.mesh import SUFFIXES, Mesh, decimate, diameter, edge_table, merged, read_mesh, vertex_normals, write_mesh

triangles = st.permutations(range(6)).map(lambda order: order[:3])
soups = st.lists(triangles, min_size=1, max_size=12).map(np.array)


def sphere(radius: float = 0.05, subdivisions: int = 2) -> Mesh:
    made = trimesh.creation.icosphere(subdivisions, radius)
    return Mesh(np.asarray(made.vertices), np.asarray(made.faces, dtype=np.int64))


def half_edges(faces: np.ndarray) -> Counter[tuple[int, int, int]]:
    """(start, end, face) of each half-edge."""
    return Counter((int(f[k]), int(f[(k + 1) % 3]), n) for n, f in enumerate(faces) for k in range(3))


@given(faces=soups)
def test_each_half_edge_stands_in_one_row(faces: np.ndarray) -> None:
    table = edge_table(faces)
    rows: Counter[tuple[int, int, int]] = Counter()
    for v0, v1, f1, f2 in table.tolist():
        rows[v0, v1, f1] += 1
        if f2 < len(faces):
            rows[v1, v0, f2] += 1
    assert rows == half_edges(faces)


@given(faces=soups)
def test_no_half_edges_stay_single_that_could_be_paired(faces: np.ndarray) -> None:
    single = Counter((v0, v1) for v0, v1, _, f2 in edge_table(faces).tolist() if f2 == len(faces))
    assert not any((v1, v0) in single for v0, v1 in single)


def test_closed_meshes_obey_eulers_formula() -> None:
    for mesh in (box(1, 1, 1), sphere()):
        assert mesh.is_closed
        assert len(mesh.vertices) - len(mesh.edges) + len(mesh.faces) == 2
    assert not Mesh(box(1, 1, 1).vertices, box(1, 1, 1).faces[1:]).is_closed


def test_known_measures() -> None:
    mesh = box(1.0, 2.0, 2.0)
    assert mesh.volume == pytest.approx(4.0)
    assert mesh.diameter == pytest.approx(3.0)
    assert mesh.vertex_areas.sum() == pytest.approx(16.0)
    inside = mesh.planes[:, :3] @ mesh.centre + mesh.planes[:, 3]
    assert (inside < 0).all()
    np.testing.assert_allclose(sorted(-inside), sorted([0.5] * 4 + [1.0] * 8))


def test_normals_of_a_sphere_point_outward() -> None:
    mesh = sphere()
    outward = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    assert np.sum(mesh.normals * outward, axis=1).min() > 0.999
    both = vertex_normals(np.stack([mesh.vertices, 2 * mesh.vertices]), mesh.faces)
    np.testing.assert_allclose(both[0], both[1])


@given(points=arrays(float, (12, 3), elements=st.floats(-1.0, 1.0)))
def test_the_diameter_is_the_largest_distance(points: np.ndarray) -> None:
    distances = np.linalg.norm(points[:, None] - points[None], axis=-1)
    assert diameter(points) == pytest.approx(distances.max(), abs=1e-9)


@given(copies=st.lists(st.integers(0, 7), min_size=1, max_size=20))
def test_merging_finds_the_first_of_equal_vertices(copies: list[int]) -> None:
    vertices = box(1, 1, 1).vertices[copies]
    assert merged(vertices).tolist() == [copies.index(vertex) for vertex in copies]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_meshes_survive_being_written(tmp_path: Path, suffix: str) -> None:
    mesh = sphere()
    write_mesh(tmp_path / f"mesh{suffix}", mesh)
    back = read_mesh(tmp_path / f"mesh{suffix}")
    assert back.is_closed
    assert len(back.vertices) == len(mesh.vertices)
    assert back.volume == pytest.approx(mesh.volume, rel=1e-5)
    np.testing.assert_allclose(np.sort(back.vertices, axis=0), np.sort(mesh.vertices, axis=0), atol=1e-7)


def test_closed_meshes_wound_inward_are_turned(tmp_path: Path) -> None:
    mesh = sphere()
    write_mesh(tmp_path / "inward.ply", Mesh(mesh.vertices, mesh.faces[:, ::-1].copy()))
    assert read_mesh(tmp_path / "inward.ply").volume == pytest.approx(mesh.volume, rel=1e-5)


def test_vertices_without_faces_are_left_out(tmp_path: Path) -> None:
    (tmp_path / "m.obj").write_text("v .1 .1 .1\nv 0 0 0\nv .1 0 0\nv 0 .1 0\nf 2 3 4\n")
    mesh = read_mesh(tmp_path / "m.obj")
    assert len(mesh.vertices) == 3
    assert mesh.faces.tolist() == [[0, 1, 2]]


def test_materials_beside_a_mesh_are_not_opened(tmp_path: Path, refused: Callable[..., str]) -> None:
    (tmp_path / "m.obj").write_text("mtllib ../../secret.mtl\nv 0 0 0\nv .1 0 0\nv 0 .1 0\nf 1 2 3\n")
    assert len(read_mesh(tmp_path / "m.obj").faces) == 1
    refused(lambda: read_mesh(tmp_path / "none.obj"), "none.obj: mesh", "no such file")
    refused(lambda: read_mesh(tmp_path / "m.blend"), "m.blend: mesh", "'.blend'")


def test_decimating_keeps_size_and_shape() -> None:
    mesh = sphere(subdivisions=4)
    small = decimate(mesh, 400)
    assert len(small.faces) <= 410
    assert small.is_closed
    assert small.diameter == pytest.approx(mesh.diameter, rel=0.05)
    assert small.volume == pytest.approx(mesh.volume, rel=0.05)
    assert decimate(small, 400 + len(small.faces)) is small
