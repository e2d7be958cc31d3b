"""The part of a surface below a limit has the area that it should have."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from getagrip.view.live.patch import ABOVE, NOTHING, patch


def area(vertices: np.ndarray, faces: np.ndarray) -> float:
    return float(trimesh.Trimesh(vertices, faces, process=False).area)


@pytest.mark.parametrize("limit", [-0.9, -0.21, 0.0, 0.4, 0.77])
def test_the_border_of_a_linear_value_is_exact(limit: float) -> None:
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, 8), np.linspace(0.0, 1.0, 5))
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    n = np.arange(x.size).reshape(x.shape)
    a, b, c, d = n[:-1, :-1].ravel(), n[:-1, 1:].ravel(), n[1:, 1:].ravel(), n[1:, :-1].ravel()
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    points, triangles = patch(vertices, faces, vertices[:, 0] + 0.3 * vertices[:, 1], limit)
    inside = np.mean(np.clip(limit - 0.3 * np.linspace(0.0, 1.0, 100_001), -1.0, 1.0) + 1.0)
    assert area(points, triangles) == pytest.approx(inside, abs=1e-5)
    assert np.allclose(points[:, 2], ABOVE)
    assert (np.cross(*np.diff(points[triangles], axis=1).swapaxes(0, 1))[:, 2] >= -1e-12).all()  # wound as before


def test_a_higher_limit_covers_more_and_at_last_everything() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.05)
    value = np.asarray(ball.vertices[:, 0])
    areas = [area(*patch(ball.vertices, ball.faces, value, limit)) for limit in np.linspace(-0.06, 0.06, 9)]
    assert areas == sorted(areas)
    assert areas[0] == 0.0
    assert areas[-1] == pytest.approx(ball.area * (1.0 + ABOVE / 0.05) ** 2, rel=1e-3)


def test_where_there_is_none_there_is_a_mesh_without_area() -> None:
    ball = trimesh.creation.icosphere(subdivisions=1)
    assert patch(ball.vertices, ball.faces, np.ones(len(ball.vertices)), 0.0) is NOTHING
    assert area(*NOTHING) == 0.0
