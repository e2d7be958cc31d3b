"""Points of the contour, and what the fit makes of them, against their readable specification."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy import ndarray

from getagrip.geometry.kernels import silhouette
from getagrip.geometry.kernels.silhouette import pack, unpack
from helpers import kernels as reference
from helpers.kernels import callable_part
from helpers.posed_meshes import MESHES, SEEDS, SIZE, WHICH, blobs, outlined

sample_contour, sample_field, match_boundary, accumulate = (
    callable_part(part)
    for part in (silhouette.sample_contour, silhouette.sample_field, silhouette.match_boundary, silhouette.accumulate)
)


@pytest.mark.compiles
@given(WHICH, SEEDS, st.sampled_from([0.7, 1.0, 2.5]), st.sampled_from([1.0, 0.25]))
def test_contour_points(which: str, seed: int, step: float, zoom: float) -> None:
    uvz, edges, bits = outlined(MESHES[which], seed)
    uvz[:2] /= zoom  # positions are those of the crop, the mask is that of the level
    _, valid = blobs(seed)
    points, lines = np.zeros((7, 1500)), np.empty((12, edges.shape[1]))
    n = sample_contour(uvz, edges, edges.shape[1], zoom, step, bits, pack(valid), lines, points)
    expected = reference.sample_contour(uvz.T, edges.T, zoom, step, unpack(bits, SIZE), valid)
    assert n == expected.shape[1]
    np.testing.assert_allclose(points[:5, :n], expected[:5], rtol=1e-9, atol=1e-9)


@settings(max_examples=8)
@given(SEEDS)
@pytest.mark.slow
def test_contour_points_lie_on_the_contour_and_face_outward(seed: int) -> None:
    uvz, edges, bits = outlined(MESHES["mug"], seed)
    points = np.zeros((7, 1500))
    everywhere, lines = pack(np.ones((SIZE, SIZE), bool)), np.empty((12, edges.shape[1]))
    n = sample_contour(uvz, edges, edges.shape[1], 1.0, 1.0, bits, everywhere, lines, points)
    within = np.all((points[:2, :n] > 1.0) & (points[:2, :n] < SIZE - 1.0), axis=0)
    at, normal = points[:2, :n][:, within], points[3:5, :n][:, within]
    np.testing.assert_allclose(np.linalg.norm(normal, axis=0), 1.0)
    finer = reference.silhouette(uvz.T * [8, 8, 1], MESHES["mug"].faces, (8 * SIZE, 8 * SIZE))
    outside, inside = (finer[tuple(np.int64(8 * (at + s * normal))[::-1])] for s in (0.3, -0.3))
    assert outside.sum() <= 0.15 * len(outside)  # a few: at sharp corners another part of the outline is near
    assert inside.sum() >= 0.85 * len(inside)


def _points(rng: np.random.Generator, n: int) -> ndarray:
    points = np.zeros((7, 60))
    angle = rng.uniform(0.0, 2.0 * np.pi, n)
    points[:2, :n] = rng.uniform(0.0, 256.0, (2, n))
    points[silhouette.Z, :n] = rng.uniform(0.2, 0.6, n)
    points[3:5, :n] = np.cos(angle), np.sin(angle)
    points[silhouette.ROW_DISTANCE, :n], points[silhouette.ROW_WEIGHT, :n] = (
        rng.normal(size=n),
        rng.uniform(0.1, 2.0, n),
    )
    return points


@given(SEEDS, st.integers(0, 60))
def test_distances_are_looked_up_between_pixels(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    points, field = _points(rng, n), rng.normal(size=(128, 128)).astype(np.float32)
    expected = reference.sample_field(points[:, :n], field, 0.5, 2.0, 0.3)
    sample_field(points, n, field, 0.5, 2.0, 0.3)
    # The kernel stops short of the last row and column by a millionth of a pixel.
    np.testing.assert_allclose(points[:, :n], expected, rtol=1e-4, atol=1e-4)


@given(SEEDS, st.integers(0, 60))
def test_observed_points_take_hold_of_the_contour(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    points = _points(rng, n)
    targets = np.column_stack([rng.uniform(0, 256, (20, 2)), _points(rng, 20)[3:5, :20].T, rng.uniform(1, 4, 20)])
    matched = np.empty((7, 20))
    value = match_boundary(points, n, targets, 6400.0, 0.7, 2.0, matched)
    expected, expected_value = reference.match_boundary(points[:, :n], targets, 6400.0, 0.7, 2.0)
    np.testing.assert_allclose(matched, expected, rtol=1e-9, atol=1e-9)
    assert value == pytest.approx(expected_value)


@given(SEEDS, st.integers(0, 60))
def test_normal_equations(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    points = _points(rng, n)
    centre, K = np.array([0.0, 0.0, 0.4]) + rng.normal(0.0, 0.1, 3), np.array([400.0, 380.0, 120.0, 130.0])
    g, H = np.zeros(7), np.zeros((7, 7))
    accumulate(points, n, centre, K, g, H)
    expected_g, expected_H = reference.normal_equations(points[:, :n], centre, K)
    np.testing.assert_allclose(g, expected_g, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(np.triu(H), np.triu(expected_H), rtol=1e-9, atol=1e-6)
    assert not np.tril(H, -1).any()


def test_a_contour_point_moves_as_its_derivative_says() -> None:
    rng = np.random.default_rng(0)
    points = _points(rng, 1)
    points[silhouette.ROW_DISTANCE, 0] = points[silhouette.ROW_WEIGHT, 0] = 1.0
    centre, K = np.array([0.02, -0.01, 0.4]), np.array([400.0, 380.0, 120.0, 130.0])
    a, _ = reference.normal_equations(points[:, :1], centre, K)
    u, v, z, nx, ny = points[:5, 0]
    X = np.array([(u - K[2]) * z / K[0], (v - K[3]) * z / K[1], z])
    for k in range(7):

        def along(t: float, k: int = k) -> float:
            step = t * np.eye(7)[k]
            Y = X + step[:3] + np.cross(step[3:6], X - centre) + step[6] * (X - centre)
            return float(nx * (K[0] * Y[0] / Y[2] + K[2]) + ny * (K[1] * Y[1] / Y[2] + K[3]))

        assert a[k] == pytest.approx((along(1e-6) - along(-1e-6)) / 2e-6, rel=1e-5)


def test_pixels_beyond_the_mask_are_neither_set_nor_read() -> None:
    bits, places = pack(np.ones((64, 64), bool)), [-np.inf, -1e9, -0.1, 0.0, 63.9, 64.0, 1e9, np.inf, np.nan]
    for x, y in product(places, places):
        assert bool(silhouette._is_set.py_func(bits, x, y)) == (0.0 <= x < 64.0 and 0.0 <= y < 64.0)
