"""Procedural objects: closed, outward, of known size and genus."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from getagrip.geometry.mesh import Mesh
from getagrip.geometry.mesh_files import MAX_MESH_EXTENT_M
from getagrip.synthetic import objects
from getagrip.synthetic.categories import SHAPE_MAKERS
from getagrip.synthetic.objects import Tube, loft, merge_closed_meshes, torus

PARTS = {
    "scissors": 4, "capsule_machine": 4, "espresso_machine": 4, "microwave": 2, "mixer": 3, "spray_bottle": 3,
    "hammer": 2,
}  # fmt: skip
"""How many closed parts, where it is not one."""
HANDLES = {
    "mug": 1, "cup": 1, "kettle": 1, "mixer": 1, "pitcher": 1, "scissors": 2, "tape": 1,
    "french_press": 1, "jug": 1, "watering_can": 1,
}  # fmt: skip
"""Genus, where it is not 0."""


def euler(mesh: Mesh) -> int:
    return len(mesh.vertices) - len(mesh.edges) + len(mesh.faces)


def is_manifold(mesh: Mesh) -> bool:
    """Each directed edge once, with its opposite."""
    halves = Counter(zip(mesh.faces.ravel().tolist(), np.roll(mesh.faces, -1, axis=1).ravel().tolist(), strict=True))
    return set(halves.values()) == {1} and all((b, a) in halves for a, b in halves)


@pytest.mark.parametrize("name", sorted(SHAPE_MAKERS))
def test_objects_are_closed_outward_and_of_plausible_size(name: str) -> None:
    mesh = SHAPE_MAKERS[name]()
    assert is_manifold(mesh)
    assert mesh.volume > 0.0
    assert 500 <= len(mesh.faces) <= 1400
    assert 0.05 < mesh.diameter < MAX_MESH_EXTENT_M
    assert len(np.unique(mesh.vertices, axis=0)) == len(mesh.vertices)
    corners = mesh.vertices[mesh.faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    assert areas.min() > 1e-12 * mesh.diameter**2


@pytest.mark.parametrize("name", sorted(SHAPE_MAKERS))
def test_euler_characteristic_counts_parts_and_handles(name: str) -> None:
    """Scissors are two blades and two rings, and a ring has a hole as a handle has."""
    assert euler(SHAPE_MAKERS[name]()) == 2 * PARTS.get(name, 1) - 2 * HANDLES.get(name, 0)


def test_machines_are_as_tall_as_asked_for() -> None:
    for make in (objects.capsule_machine, objects.espresso_machine):
        low = make(height=0.18).vertices[:, 2].min()
        assert low == pytest.approx(-0.09)


@given(radius=st.floats(0.02, 0.06), height=st.floats(0.06, 0.3))
@settings(max_examples=20, deadline=None)
def test_sizes_are_the_sizes_asked_for(radius: float, height: float) -> None:
    for make in (objects.can, objects.bottle):
        extent = np.ptp(make(radius=radius, height=height).vertices, axis=0)
        np.testing.assert_allclose(extent, [2 * radius, 2 * radius, height], rtol=0.02)


def test_vessels_stand_on_their_origin_and_hold_water() -> None:
    for make in (objects.bowl, objects.mug, objects.cup, objects.plate):
        mesh = make()
        assert mesh.vertices[:, 2].min() == pytest.approx(0.0)
        # An open vessel is far from filling its hull: the wall comes down again inside.
        assert mesh.volume < 0.5 * np.prod(np.ptp(mesh.vertices, axis=0))


def test_a_cylinder_has_its_volume() -> None:
    n, r, h = 200, 0.5, 2.0
    phi = np.arange(n) * 2 * np.pi / n
    circle = np.stack([r * np.cos(phi), r * np.sin(phi), np.zeros(n)], axis=-1)
    mesh = loft(np.stack([circle, circle + np.array([0.0, 0.0, h])]))
    assert mesh.volume == pytest.approx(np.pi * r**2 * h, rel=1e-3)


def test_a_torus_has_its_volume_but_for_the_coarse_section() -> None:
    phi = np.arange(100) * 2 * np.pi / 100
    ring = np.stack([np.cos(phi), np.sin(phi), np.zeros(100)], axis=-1)
    octagon = 2 * np.sqrt(2) * 0.1**2
    assert torus(ring, np.array([0.0, 0.0, 1.0]), 0.1).volume == pytest.approx(2 * np.pi * octagon, rel=1e-2)


def test_a_tube_adds_volume_and_keeps_the_surface_closed() -> None:
    phi = np.arange(16) * np.pi / 8
    circle = np.stack([np.cos(phi), np.sin(phi), np.zeros(16)], axis=-1)
    rings = circle + np.linspace(0, 2, 9)[:, None, None] * np.array([0, 0, 1])
    bar = np.stack([np.linspace(1, 3, 6), np.zeros(6), np.ones(6)], axis=-1)
    tube = Tube(bar, np.array([0.0, 1.0, 0.0]), np.full(6, 0.1), np.full(6, 0.1), capped=True)
    plain, with_bar = loft(rings), loft(rings, [tube])
    assert is_manifold(with_bar)
    assert euler(with_bar) == 2
    assert with_bar.volume > plain.volume + 1.2 * 2 * np.sqrt(2) * 0.1**2


def test_parts_keep_their_volumes() -> None:
    can, box = objects.can(), objects.box()
    both = merge_closed_meshes([can, box])
    assert both.volume == pytest.approx(can.volume + box.volume)
    assert euler(both) == 4
