"""Silhouettes by the kernels against their readable specification, on meshes of all kinds."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy import ndarray

from getagrip.geometry.kernels import silhouette
from getagrip.geometry.kernels.silhouette import MIN_SILHOUETTE_DEPTH_M, pack, silhouettes, unpack
from helpers import kernels as reference
from helpers.clips import box
from helpers.kernels import callable_part
from helpers.posed_meshes import MESHES, SEEDS, SIZE, WHICH, outlined, pose, project, soup, tables

mismatch = callable_part(silhouette.mismatch)


@given(WHICH, SEEDS)
def test_projection(which: str, seed: int) -> None:
    mesh = MESHES[which]
    R, centre, scale, K = pose(seed)
    uvz = np.empty((3, len(mesh.vertices)))
    visible = project(np.ascontiguousarray(mesh.vertices.T), R, centre, scale, K, uvz)
    expected = reference.project(mesh.vertices, R, centre, scale, K)
    np.testing.assert_allclose(uvz.T, expected, rtol=1e-12, atol=1e-12)
    assert visible == (expected[:, 2].min() >= MIN_SILHOUETTE_DEPTH_M)


@given(WHICH, SEEDS)
def test_silhouette_edges(which: str, seed: int) -> None:
    mesh = MESHES[which]
    uvz, edges, _ = outlined(mesh, seed)
    np.testing.assert_array_equal(edges.T, reference.silhouette_edges(uvz.T, mesh.edges, mesh.faces))


@given(WHICH, SEEDS)
@pytest.mark.slow
def test_a_silhouette_covers_what_its_faces_cover(which: str, seed: int) -> None:
    mesh = MESHES[which]
    uvz, _, bits = outlined(mesh, seed)
    np.testing.assert_array_equal(unpack(bits, SIZE), reference.silhouette(uvz.T, mesh.faces, (SIZE, SIZE)))


@settings(max_examples=10)
@given(st.integers(0, 10**6))
def test_any_triangle_soup_has_a_silhouette(seed: int) -> None:
    mesh = soup(seed)
    uvz, _, bits = outlined(mesh, seed)
    np.testing.assert_array_equal(unpack(bits, SIZE), reference.silhouette(uvz.T, mesh.faces, (SIZE, SIZE)))


@settings(max_examples=10)
@given(WHICH, SEEDS, st.integers(5, 90), st.integers(5, 150))
@pytest.mark.slow
def test_silhouettes_of_many_poses_in_images_of_any_size(which: str, seed: int, height: int, width: int) -> None:
    mesh = MESHES[which]
    poses = [pose(seed + k) for k in range(4)]
    R, centre, scale, K = (np.array(x) for x in zip(*poses, strict=True))
    centre[3, 2] = MIN_SILHOUETTE_DEPTH_M  # this one reaches behind the camera: nothing is drawn
    t = tables(mesh)
    bits = np.empty((4, height, -(-width // 64)), np.uint64)
    silhouettes(R, centre, scale, t.vertices, t.planes, t.edges, t.closed, K, bits)
    for k, mask in enumerate(unpack(bits, width)):
        uvz = reference.project(mesh.vertices, R[k], centre[k], scale[k], K[k])
        np.testing.assert_array_equal(mask, reference.silhouette(uvz, mesh.faces, (height, width)))
    assert not unpack(bits, width)[3].any()


def test_a_silhouette_may_fill_the_image_or_miss_it() -> None:
    t = tables(box(0.2, 0.2, 0.2))
    K = np.tile([100.0, 100.0, 32.0, 32.0], (2, 1))
    bits = np.empty((2, 64, 1), np.uint64)
    centre = np.array([[0.0, 0.0, 0.2], [5.0, 0.0, 0.5]])
    silhouettes(np.tile(np.eye(3), (2, 1, 1)), centre, np.ones(2), t.vertices, t.planes, t.edges, t.closed, K, bits)
    full, none = unpack(bits, 64)
    assert full.all()
    assert not none.any()


@given(hnp.arrays(bool, st.tuples(st.integers(1, 3), st.integers(1, 5), st.integers(1, 200))))
def test_masks_survive_packing(masks: ndarray) -> None:
    bits = pack(masks)
    assert bits.shape == (*masks.shape[:2], -(-masks.shape[2] // 64))
    np.testing.assert_array_equal(unpack(bits, masks.shape[2]), masks)


@given(hnp.arrays(bool, (3, 7, 128)))
def test_mismatch_counts_pixels(masks: ndarray) -> None:
    assert mismatch(*pack(masks)) == reference.mismatch(*masks)
