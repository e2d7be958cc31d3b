"""The largest distance between two of many points: exact, and in little memory."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.distance import pdist

from getagrip.geometry.mesh import diameter


def cloud(kind: str, count: int, seed: int) -> np.ndarray:
    """Random points; on a sphere and on a lattice very many pairs are as far apart as the farthest, or nearly."""
    points = np.random.default_rng(seed).standard_normal((count, 3))
    if kind == "sphere":
        return points / np.linalg.norm(points, axis=1, keepdims=True)
    if kind == "antipodes":
        half = cloud("sphere", (count + 1) // 2, seed)
        return np.concatenate([half, -half]) * 0.05
    if kind == "lattice":
        return np.round(points) * 0.1
    if kind == "plane":
        return points * [1.0, 0.3, 0.0]
    return points * 0.1 + 20.0 if kind == "far off" else points


@pytest.mark.parametrize("kind", ["ball", "sphere", "antipodes", "lattice", "plane", "far off"])
@given(count=st.sampled_from([1, 2, 3, 40, 700]), seed=st.integers(0, 2**32 - 1))
def test_the_diameter_is_the_largest_distance_to_the_last_bit(kind: str, count: int, seed: int) -> None:
    points = cloud(kind, count, seed)
    assert diameter(points) == pdist(points).max(initial=0.0)


def test_the_diameter_of_a_plane_misses_no_point() -> None:
    points = cloud("plane", 3000, 0)
    assert diameter(points) == pdist(points).max()


@given(points=arrays(float, (12, 3), elements=st.floats(-1.0, 1.0)))
def test_the_diameter_of_any_points_is_the_largest_distance(points: np.ndarray) -> None:
    distances = np.linalg.norm(points[:, None] - points[None], axis=-1)
    assert diameter(points) == pytest.approx(distances.max(), abs=1e-9)


@pytest.mark.parametrize("kind", ["sphere", "antipodes"])
@pytest.mark.slow
def test_the_diameter_takes_memory_in_proportion_to_the_points(kind: str) -> None:
    """All of them are corners of their convex hull: a table of their distances would take 1.6 GB."""
    assert peak(cloud(kind, 20_000, 0)) < 4e6


def test_copies_of_a_point_are_one_to_the_diameter() -> None:
    assert peak(np.repeat(0.1 * np.eye(3), 7_000, axis=0)) < 4e6


def peak(points: np.ndarray) -> int:
    """The most memory that ``diameter`` holds at a time, in bytes."""
    tracemalloc.start()
    try:
        diameter(points)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
