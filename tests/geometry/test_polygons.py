"""Polygons cut into triangles."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from getagrip.geometry.mesh_files import parse_mesh
from getagrip.geometry.polygons import triangulated


@pytest.mark.parametrize("seed", range(20))
def test_area_boundary_and_turn_of_simple_polygons_are_kept(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(4, 40))
    angle = 2 * np.pi * (np.arange(count) + rng.uniform(0, 0.8, count)) / count
    flat = rng.uniform(0.05, 1.0, count)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    points = flat @ axes[:2] + rng.normal(size=3)
    normal = np.cross(axes[0], axes[1])
    triangles = np.array(triangulated(points))
    corners = points[triangles]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) @ normal / 2
    x, y = flat.T
    assert len(triangles) == count - 2
    assert (areas > 0).all()
    assert areas.sum() == pytest.approx(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2)
    edges = {(int(t[n]), int(t[(n + 1) % 3])) for t in triangles for n in range(3)}
    assert {edge for edge in edges if edge[::-1] not in edges} == {(n, (n + 1) % count) for n in range(count)}


def test_a_concave_quad_of_an_obj_keeps_its_notch(tmp_path: Path) -> None:
    path = tmp_path / "dart.obj"
    path.write_text("v 0 0 0\nv 2 -1 0\nv 1 0 0\nv 2 1 0\nf 2 3 4 1\n")
    vertices, faces = parse_mesh(path)
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    assert np.cross(b - a, c - a)[:, 2].tolist() in ([-1.0, -1.0], [1.0, 1.0])
