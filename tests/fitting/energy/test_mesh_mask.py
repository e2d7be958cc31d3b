"""E_mask by shape: agreement with E_mask by pose, and its gradient by the shape alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from getagrip.fitting.energy import PosesInCamera, mesh_mask, no_bound
from getagrip.fitting.energy.mask import MaskTerm
from getagrip.fitting.energy.mesh_mask import MaskByShape
from getagrip.geometry.mesh import Mesh, subdivide_surface
from getagrip.geometry.profile import N_PROFILE_RADII, Profile
from getagrip.geometry.warp import Warp
from helpers.kernels import callable_part
from helpers.terms import MESHES, moved, scene, smooth_energy

RADIUS = 0.05
NO_WIDTHS = np.zeros((1, 0))
unwarped = callable_part(mesh_mask._unwarp_monomials)


def by_shape(which: str, term: MaskTerm) -> MaskByShape:
    mesh = MESHES[which]
    return MaskByShape(mesh, mesh.centre, RADIUS, term.observation, term.level, term.step, term.delta)


def off_the_truth(which: str, seed: int = 0) -> tuple[MaskTerm, PosesInCamera]:
    term, truth = scene(which, seed, occluded=True)
    return term, moved(truth, np.array([0.003, -0.002, 0.004, 0.05, -0.05, 0.04, 0.03]))


@pytest.mark.parametrize("which", ["box", "mug"])
def test_without_a_shape_it_is_e_mask(which: str) -> None:
    term, off = off_the_truth(which)
    value, g, H = by_shape(which, term)(off, np.zeros((1, 9, 3)), NO_WIDTHS)
    expected = term(off, no_bound(off))
    np.testing.assert_array_equal(value, expected.value)
    np.testing.assert_allclose(g[..., :7], expected.g, rtol=1e-9)
    np.testing.assert_allclose(H[..., :7, :7], expected.H, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(H, np.swapaxes(H, -1, -2))


def test_a_similarity_by_shape_is_one_by_pose() -> None:
    term, off = off_the_truth("mug")
    _, g, _ = by_shape("mug", term)(off, np.zeros((1, 9, 3)), NO_WIDTHS)
    linear = g[..., 7:16].reshape(*g.shape[:2], 3, 3)  # by x, y, z, along x, y, z
    np.testing.assert_allclose(np.trace(linear, axis1=-2, axis2=-1), g[..., 6])
    i, j = [1, 2, 0], [2, 0, 1]
    turned = linear[..., i, j] - linear[..., j, i]  # about the object's own axes
    np.testing.assert_allclose((off.R @ turned[..., None])[..., 0], g[..., 3:6])


def test_places_are_traced_back_through_the_warp() -> None:
    """Within 0.6 % of how far they were carried."""
    rng, found = np.random.default_rng(0), np.empty(9)
    for _ in range(20):
        shape, places = rng.normal(0.0, 0.04, (9, 3)), rng.uniform(-0.6, 0.6, (50, 3))
        carried = Warp.by(np.zeros(3), 1.0, shape).moved(places)
        least = 6e-3 * np.abs(carried - places).max()
        for place, at in zip(places, carried, strict=True):
            unwarped(at, shape, found)
            np.testing.assert_allclose(found[:3], place, atol=least)
            x, y, z = found[:3]
            np.testing.assert_allclose(found[3:], [x * x, x * y, x * z, y * y, y * z, z * z])


@pytest.mark.slow
def test_the_contour_gives_the_gradient_by_shape() -> None:
    """Of a mesh that is warped already, away from kinks; as the gradient by pose (``test_mask``)."""
    found, expected = [], []
    for which, seed in (("box", 0), ("mug", 1)):
        term, truth = scene(which, seed)
        off = moved(truth, np.array([0.001, -0.001, 0.004, 0.02, -0.02, 0.02, 0.15]))
        rng = np.random.default_rng(seed)
        mesh = Mesh(*subdivide_surface(MESHES[which].vertices, MESHES[which].faces, 0.008))  # edges bend, too
        shape = rng.normal(0.0, 0.04, (9, 3))
        fine = replace(by_shape(which, term), mesh=mesh, step=1.0, delta=1e-3)
        gradient = fine(off, shape[None], NO_WIDTHS)[1][0, :, 7:].sum(axis=0)
        for _ in range(3):
            direction = rng.normal(size=(9, 3))
            around = [Warp.by(mesh.centre, RADIUS, shape + h * direction)(mesh) for h in (-2e-3, 2e-3)]
            # Poses are about the given mesh's centre.
            less, more = (smooth_energy(term, one, about(off, one.centre - mesh.centre)).sum() for one in around)
            found.append(gradient @ direction.ravel())
            expected.append((more - less) / 4e-3)
    off_by = np.abs(np.array(found) - expected) / np.abs(expected).max()
    assert np.mean(off_by) < 0.02


def test_a_profile_that_changes_nothing_leaves_e_mask_and_the_other_derivatives_as_they_are() -> None:
    term, off = off_the_truth("mug")
    shape = np.random.default_rng(0).normal(0.0, 0.02, (1, 9, 3))
    plain = by_shape("mug", term)
    round_ = replace(plain, profile=Profile.of(plain.mesh))
    expected, found = plain(off, shape, NO_WIDTHS), round_(off, shape, np.zeros((1, N_PROFILE_RADII)))
    np.testing.assert_array_equal(found[0], expected[0])
    np.testing.assert_allclose(found[1][..., :34], expected[1], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found[2], np.swapaxes(found[2], -1, -2))


@pytest.mark.slow
def test_the_contour_gives_the_gradient_by_radii() -> None:
    """Of a body that is warped and has another profile already."""
    found, expected = [], []
    for seed in range(3):
        term, truth = scene("mug", seed)
        off = moved(truth, np.array([0.001, -0.001, 0.004, 0.02, -0.02, 0.02, 0.15]))
        rng = np.random.default_rng(seed)
        mesh = Mesh(*subdivide_surface(MESHES["mug"].vertices, MESHES["mug"].faces, 0.008))
        shape, widths = rng.normal(0.0, 0.04, (9, 3)), 0.1 * np.sin(np.linspace(seed, seed + 3.0, N_PROFILE_RADII))
        fine = replace(by_shape("mug", term), mesh=mesh, step=1.0, delta=1e-3, profile=Profile.of(MESHES["mug"]))
        gradient = fine(off, shape[None], widths[None])[1][0, :, 34:].sum(axis=0)
        for _ in range(3):
            direction = rng.normal(size=N_PROFILE_RADII)
            around = [fine.warp(shape, widths + h * direction)(mesh) for h in (-2e-3, 2e-3)]
            less, more = (smooth_energy(term, one, about(off, one.centre - mesh.centre)).sum() for one in around)
            found.append(gradient @ direction)
            expected.append((more - less) / 4e-3)
    off_by = np.abs(np.array(found) - expected) / np.abs(expected).max()
    assert np.mean(off_by) < 0.02


def about(poses: PosesInCamera, shift: np.ndarray) -> PosesInCamera:
    """The same poses about another point of the object."""
    return replace(poses, centre=poses.centre + poses.scale[:, None, None] * (poses.R @ shift))
