"""Distances to a mesh against their readable specification, and that against libigl."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy import ndarray

from getagrip.geometry.kernels import closest
from getagrip.geometry.kernels.closest import GRID_SLACK_SPACINGS, FaceGrid
from getagrip.geometry.mesh import Mesh
from getagrip.synthetic import objects
from helpers import kernels as reference
from helpers.kernels import callable_part
from helpers.posed_meshes import MESHES, SEEDS, pose

screen, signed_distance = callable_part(closest.screen), callable_part(closest.signed_distance)


def _corners(mesh: Mesh) -> tuple[ndarray, ndarray]:
    return mesh.vertices[mesh.faces], mesh.planes[:, :3]


@pytest.mark.parametrize("which", ["box", "mug", "spoon"])
@pytest.mark.slow
def test_the_specification_of_distance_agrees_with_libigl(which: str) -> None:
    import igl

    mesh = {"box": MESHES["box"], "mug": MESHES["mug"], "spoon": objects.spoon()}[which]
    low, high = mesh.vertices.min(axis=0) - 0.03, mesh.vertices.max(axis=0) + 0.03
    points = np.random.default_rng(1).uniform(low, high, (300, 3))
    d, n = reference.signed_distance(points, *_corners(mesh))
    expected = igl.signed_distance(points, mesh.vertices, mesh.faces, sign_type=igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL)[
        0
    ]
    np.testing.assert_allclose(d, expected, atol=1e-7)
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1.0, atol=1e-9)


@settings(max_examples=10)
@given(st.sampled_from(["box", "mug", "sheet", "two boxes"]), SEEDS)
@pytest.mark.slow
def test_distance_from_a_grid_of_near_faces(which: str, seed: int) -> None:
    mesh = MESHES[which]
    corners, normals = _corners(mesh)
    grid = FaceGrid.of(corners, margin=0.03)
    rng = np.random.default_rng(seed)
    far = grid.origin + grid.spacing * (np.array(grid.face.shape) - 1)
    points = rng.uniform(grid.origin, far, (100, 3))
    exact, direction = reference.signed_distance(points, corners, normals)
    found = np.array([signed_distance(*p, corners, grid.normals, grid.face, grid.origin, grid.spacing) for p in points])
    assert (np.abs(found[:, 0]) >= np.abs(exact) - 1e-8).all()  # it is the distance to a face, if not the nearest
    right = np.abs(found[:, 0] - exact) < 1e-9
    assert right.mean() > 0.8
    assert np.mean(np.abs(found[:, 0] - exact) < 5e-4) >= 0.97
    clear = right & (np.abs(exact) > 1e-4)
    np.testing.assert_allclose(found[clear, 1:], direction[clear], atol=1e-4)


@pytest.mark.parametrize("which", ["mug", "plate", "bowl"])
@pytest.mark.slow
def test_inside_and_outside_of_thin_walls(which: str) -> None:
    mesh = getattr(objects, which)()
    corners, normals = _corners(mesh)
    grid = FaceGrid.of(corners, margin=0.03)
    rng = np.random.default_rng(2)
    face = rng.integers(len(corners), size=400)
    height = rng.uniform(-0.001, 0.003, (400, 1))
    points = np.einsum("pk,pki->pi", rng.dirichlet([1.0, 1.0, 1.0], 400), corners[face]) + height * normals[face]
    exact, _ = reference.signed_distance(points, corners, normals)
    found = np.array(
        [signed_distance(*p, corners, grid.normals, grid.face, grid.origin, grid.spacing)[0] for p in points]
    )
    assert np.mean(np.sign(found) == np.sign(exact)) > 0.99
    assert np.mean(np.abs(found - exact) < 2e-4) > 0.98


@settings(max_examples=10)
@given(SEEDS)
@pytest.mark.slow
def test_screening_brings_points_into_the_frame_of_the_object(seed: int) -> None:
    mesh = MESHES["mug"]
    corners, normals = _corners(mesh)
    grid = FaceGrid.of(corners, margin=0.03)
    rng = np.random.default_rng(seed)
    R, centre, scale, _ = pose(seed)
    points = centre + rng.normal(0.0, 0.05, (50, 3))
    local, rough = np.empty((50, 3)), np.empty(50)
    screen(points, R, centre, scale, grid.distance, grid.origin, grid.spacing, local, rough)
    expected, expected_rough = reference.screen(points, R, centre, scale, grid.distance, grid.origin, grid.spacing)
    np.testing.assert_allclose(local, expected, atol=1e-12)
    np.testing.assert_array_equal(rough, expected_rough)
    near = np.isfinite(rough)
    exact, _ = reference.signed_distance(local[near], corners, normals)
    assert (np.abs(rough[near] - exact) <= GRID_SLACK_SPACINGS * grid.spacing).all()
