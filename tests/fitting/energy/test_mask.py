"""The mask term: zero at the truth, the gradient of a finer E_mask, Hessians that a solver can trust."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy import ndarray

from getagrip.fitting.energy import PosesInCamera, no_bound
from getagrip.fitting.energy.mask import MASK_CROP_SIZE_PX, MASK_LEVELS_PX, MaskTerm, Observation
from getagrip.geometry.kernels.silhouette import pack, unpack
from getagrip.geometry.mesh import Mesh
from helpers import kernels as reference
from helpers.clips import box
from helpers.terms import (
    MESHES,
    differences,
    hypotheses_are_independent,
    is_trustworthy,
    moved,
    random_poses,
    scene,
    smooth_energy,
)


@pytest.mark.parametrize("which", sorted(MESHES))
@pytest.mark.parametrize("occluded", [False, True])
def test_e_mask_is_zero_at_the_truth_and_positive_elsewhere(which: str, occluded: bool) -> None:
    term, truth = scene(which, occluded=occluded)
    np.testing.assert_array_equal(term(truth, no_bound(truth)).value, 0.0)
    off = moved(truth, np.array([0.005, 0.0, 0.0, 0.0, 0.1, 0.0, 0.02]))
    assert (term(off, no_bound(off)).value > 10.0).all()


def test_a_finer_energy_is_what_the_specification_says() -> None:
    term, truth = scene("box", frames=1, occluded=True)
    mesh, o = MESHES["box"], term.observation
    off = moved(truth, np.array([0.004, -0.002, 0.01, 0.1, -0.05, 0.08, 0.03]))
    uvz = reference.project(mesh.vertices - mesh.centre, off.R[0, 0], off.centre[0, 0], off.scale[0], o.K[0])
    seen, valid = (unpack(bits[MASK_CROP_SIZE_PX][0], MASK_CROP_SIZE_PX) for bits in (o.observed, o.valid))
    assert smooth_energy(term, mesh, off, finer=3)[0, 0] == reference.mask_energy(uvz, mesh.faces, seen, valid, finer=3)


@pytest.mark.parametrize("occluded", [False, True])
@pytest.mark.slow
def test_the_contour_gives_the_gradient_of_e_mask(occluded: bool) -> None:
    """Away from the observed outline and the occluder's, that is: there E_mask has kinks, which delta rounds off."""
    cosines, ratios = [], []
    for which in ("box", "mug"):
        mesh = MESHES[which]
        radius = mesh.diameter / 2.0
        unit = np.array([radius, radius, radius, 1.0, 1.0, 1.0, 1.0])
        for seed in range(2):
            term, truth = scene(which, seed, occluded=occluded)
            rng = np.random.default_rng(seed)
            step = 0.06 * unit * rng.uniform(-1.0, 1.0, 7)
            step[6] = (-0.12, 0.12)[seed]
            off = moved(truth, step)
            local = replace(term, step=1.0, delta=1e-3)(off, no_bound(off))
            pixel = off.centre[..., 2].mean() / (term.observation.K[0, 0] * radius)

            def energy(poses: PosesInCamera, term: MaskTerm = term, mesh: Mesh = mesh) -> ndarray:
                return smooth_energy(term, mesh, poses)

            expected = unit * differences(energy, off, 0.5 * pixel * unit)
            found = unit * local.g
            lengths = np.linalg.norm(found, axis=-1), np.linalg.norm(expected, axis=-1)
            cosines.append(np.sum(found * expected, axis=-1) / (lengths[0] * lengths[1]))
            ratios.append(lengths[0] / lengths[1])
    assert np.mean(cosines) > 0.999
    assert np.mean(np.abs(np.array(ratios) - 1.0)) < 0.02


@settings(max_examples=10)
@given(
    st.sampled_from(sorted(MESHES)), st.integers(0, 10**6), st.sampled_from(MASK_LEVELS_PX), st.sampled_from([0.0, 1.0])
)
def test_hessians_of_e_mask(which: str, seed: int, level: int, coverage: float) -> None:
    term, truth = scene(which, seed % 3)
    step = np.random.default_rng(seed).normal(0.0, 0.1, 7) * [0.1, 0.1, 0.1, 1, 1, 1, 1]
    off = moved(truth, step)
    is_trustworthy(replace(term, level=level, coverage=coverage)(off, no_bound(off)))


def test_levels_agree_on_the_energy() -> None:
    term, truth = scene("mug")
    off = moved(truth, np.array([0.01, 0.0, 0.0, 0.0, 0.2, 0.0, 0.0]))
    values = [replace(term, level=level)(off, no_bound(off)).value for level in MASK_LEVELS_PX]
    for value in values[:-1]:
        np.testing.assert_allclose(value, values[-1], rtol=0.15)


def test_hidden_pixels_say_nothing() -> None:
    """An object that moves behind an occluder costs nothing and feels nothing."""
    term, truth = scene("box", frames=1)
    seen, valid = (
        unpack(bits[MASK_CROP_SIZE_PX], MASK_CROP_SIZE_PX)
        for bits in (term.observation.observed, term.observation.valid)
    )
    hidden = replace(term.observation, valid={**term.observation.valid, MASK_CROP_SIZE_PX: pack(np.zeros_like(valid))})
    off = moved(truth, np.array([0.01, 0.0, 0.0, 0.0, 0.2, 0.0, 0.0]))
    local = replace(term, observation=hidden)(off, no_bound(off))
    assert seen.any()
    for array in (local.value, local.g, local.H):
        assert not array.any()


def test_beyond_the_bound_only_the_value_is_known() -> None:
    term, truth = scene("box")
    off = moved(truth, np.full(7, 0.03))
    full = term(off, no_bound(off))
    total = full.value.sum(axis=1)
    for bound, known in ((total + 1.0, True), (total - 1.0, False)):
        local = term(off, bound)
        np.testing.assert_array_equal(local.value, full.value)
        np.testing.assert_array_equal(local.g, full.g if known else 0.0)
        np.testing.assert_array_equal(local.H, full.H if known else 0.0)


def test_an_object_at_the_camera_has_infinite_energy() -> None:
    """Whichever frame it is that nothing can be drawn of; the solver asks for derivatives without a bound."""
    term, truth = scene("box")
    for frames in ([0], [1], [0, 1]):
        centre = truth.centre.copy()
        centre[:, frames, 2] *= -1.0
        near = PosesInCamera(truth.R, centre, truth.scale)
        local = term(near, no_bound(near))
        assert np.isinf(local.value.sum())
        assert not local.g.any()


def test_observed_points_pull_an_object_that_overlaps_nothing() -> None:
    """Two spoons side by side: the area's gradient only shrinks the misplaced one, coverage moves it home."""
    term, truth = scene("spoon", frames=1)
    away = np.zeros(7)
    away[0] = 0.02
    off = moved(truth, away)
    coarse = replace(term, level=64, step=1.0, delta=2.0)
    with_coverage = replace(coarse, coverage=1.0)(off, no_bound(off)).g[0, 0, :3]
    without = coarse(off, no_bound(off)).g[0, 0, :3]
    home = -np.array([1.0, 0.0, 0.0])
    assert -with_coverage @ home > abs(-without @ home)


@pytest.mark.parametrize("level", MASK_LEVELS_PX)
def test_observed_points_reach_40_pixels_of_the_level(level: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A thin rod beside itself is pulled home from within their reach and from no farther; 64 pixels end before."""
    monkeypatch.setitem(MESHES, "rod", box(0.12, 0.003, 0.003))
    term, truth = scene("rod", frames=1)
    across = np.array([-truth.R[0, 0, 1, 0], truth.R[0, 0, 0, 0], 0.0]) / np.linalg.norm(truth.R[0, 0, :2, 0])
    pixel = MASK_CROP_SIZE_PX / level * truth.centre[0, 0, 2] / term.observation.K[0, 0]
    for shift, reached in ((5.0, True), (30.0 if level == 64 else 37.0, True), (46.0, False)):
        off = moved(truth, np.array([*shift * pixel * across, 0.0, 0.0, 0.0, 0.0]))
        with_coverage, without = (
            replace(term, level=level, step=1.0, coverage=weight)(off, no_bound(off)).g[0, 0, :3] @ across
            for weight in (1.0, 0.0)
        )
        assert (with_coverage > without) == reached


def test_hypotheses_do_not_know_of_each_other() -> None:
    term, _ = scene("mug")
    hypotheses_are_independent(term, random_poses(np.random.default_rng(4), 3, 2))


def test_observation_is_not_changed_by_its_reader() -> None:
    term, truth = scene("box", occluded=True)
    before = deepcopy(term.observation)
    off = moved(truth, np.full(7, 0.03))
    for level in MASK_LEVELS_PX:
        replace(term, level=level, coverage=1.0)(off, no_bound(off))
    for one, other in zip(leaves(before), leaves(term.observation), strict=True):
        np.testing.assert_array_equal(one, other)


def leaves(observation: Observation) -> list[ndarray]:
    """All arrays of an observation."""
    o = observation
    return [o.crops.corner, o.K, *o.observed.values(), *o.valid.values(), o.field, o.targets, o.area]
