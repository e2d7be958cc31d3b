"""Warps of meshes: what they leave alone, and that a settled one holds no similarity."""

from __future__ import annotations

import numpy as np

from getagrip.geometry import se3
from getagrip.geometry.warp import Warp, align_similarity, remove_similarity
from helpers.clips import box

MESH = box(0.1, 0.06, 0.04)


def drawn(seed: int, size: float = 0.05) -> Warp:
    rng = np.random.default_rng(seed)
    return Warp.by(rng.normal(0.0, 0.02, 3), 0.06, rng.normal(0.0, size, (9, 3)))


def test_a_warp_by_nothing_leaves_the_mesh_as_it_is() -> None:
    warp = drawn(0, 0.0)
    np.testing.assert_allclose(warp(MESH).vertices, MESH.vertices, atol=1e-15)
    assert warp.displacement(MESH) < 1e-15


def test_how_much_space_expands_is_the_determinant_of_the_jacobian() -> None:
    warp, X, step = drawn(0, 0.2), MESH.vertices, 1e-6
    columns = [(warp.moved(X + step * e) - warp.moved(X - step * e)) / (2.0 * step) for e in np.eye(3)]
    np.testing.assert_allclose(warp.expansion(X), np.linalg.det(np.stack(columns, axis=-1)), rtol=1e-6)


def test_a_settled_warp_is_the_same_shape_where_the_mesh_is_and_as_large() -> None:
    for seed in range(5):
        warp = drawn(seed)
        still, T, size = remove_similarity(warp, MESH, resize=True)
        X = np.random.default_rng(seed).normal(0.0, 0.05, (20, 3))
        np.testing.assert_allclose(warp.moved(X), se3.transform(T, size * still.moved(X)), atol=1e-14)
        again, same = align_similarity(MESH, still(MESH), resize=True)
        np.testing.assert_allclose(again, np.eye(4), atol=1e-12)
        assert abs(same - 1.0) < 1e-12
        assert still.displacement(MESH) < warp.displacement(MESH)
