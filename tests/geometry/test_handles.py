"""The handle of a mesh is found where it is, and no spout, lip or corner is taken for one."""

from __future__ import annotations

import numpy as np
import pytest

from getagrip.geometry.handles import find_handle, spread_along
from getagrip.geometry.mesh import Mesh
from getagrip.synthetic.categories import SHAPE_MAKERS

BOWS = ("mug", "cup", "kettle", "pitcher", "french_press", "jug", "watering_can")
BARS = ("pan", "saucepan", "waffle_iron")
OTHERS = ("mixer", "spray_bottle")
"""Kinds with a handle above, and with a lever."""


@pytest.mark.parametrize("kind", sorted(SHAPE_MAKERS))
def test_a_built_in_kind_has_a_handle_or_none(kind: str) -> None:
    assert (find_handle(SHAPE_MAKERS[kind]()) is not None) == (kind in (*BOWS, *BARS, *OTHERS))


@pytest.mark.parametrize("kind", [*BOWS, *BARS])
def test_the_handle_is_in_front_and_in_the_middle(kind: str) -> None:
    mesh = SHAPE_MAKERS[kind]()
    line = find_handle(mesh)
    assert line is not None
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    middle = line.mean(axis=0)
    assert middle[0] > 0.5 * (low + high)[0] + 0.1 * mesh.diameter
    assert abs(middle[1]) < 0.02 * mesh.diameter
    assert np.ptp(line[:, 1]) < 0.12 * mesh.diameter
    assert (low < line).all()
    assert (line < high).all()


@pytest.mark.parametrize("axes", [(1, 2, 0), (2, 0, 1)])
def test_any_axis_of_the_frame_may_be_the_body_s(axes: tuple[int, int, int]) -> None:
    """The frame's place and size do not matter either."""
    mesh = SHAPE_MAKERS["kettle"]()
    other = Mesh(1.3 * mesh.vertices[:, axes] + np.array([0.4, -0.2, 0.1]), mesh.faces)
    line, same = find_handle(mesh), find_handle(other)
    assert line is not None
    assert same is not None
    away = np.linalg.norm((1.3 * line[:, axes] + np.array([0.4, -0.2, 0.1]))[:, None] - same, axis=-1).min(axis=0)
    assert away.max() < 0.05 * other.diameter
    assert np.median(away) < 0.02 * other.diameter


def test_points_between_corners_are_as_close_as_found_ones() -> None:
    corners = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.1, 0, 0], [0.1, 0.001, 0]])
    line = spread_along(corners, 0.2)
    assert np.linalg.norm(np.diff(line, axis=0), axis=1).max() <= 0.025 * 0.2 + 1e-12
    assert {*map(tuple, corners)} <= {*map(tuple, line)}
    np.testing.assert_array_equal(spread_along(corners[:1], 0.2), corners[:1])


def test_flat_and_degenerate_meshes_have_no_handle() -> None:
    flat = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    assert find_handle(flat) is None
    assert find_handle(Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]))) is None
