"""E_mask: its observation, gaps between masks, zero at the truth, gradients of a finer energy, Hessians."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy import ndarray

from getagrip.bench.inputs.perturbations import Gapped
from getagrip.clip import Clip, Masks, with_masks
from getagrip.fitting import problem
from getagrip.fitting.energy import PosesInCamera, no_bound
from getagrip.fitting.energy.mask import (
    DISTANCE_FIELD_SIZE_PX,
    MASK_CROP_SIZE_PX,
    MASK_LEVELS_PX,
    MAX_GAP_PX,
    N_COVERAGE_TARGETS,
    MaskTerm,
    Observation,
    SilhouetteMesh,
    find_gap_pixels,
    observe_masks,
)
from getagrip.fitting.hand import hand_silhouette
from getagrip.fitting.objective import mask_energy
from getagrip.fitting.options import Options
from getagrip.fitting.problem import prepare_problem
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.geometry.kernels.silhouette import pack, silhouettes, unpack
from getagrip.geometry.mesh import Mesh
from helpers import kernels as reference
from helpers import scenes
from helpers.clips import box
from helpers.scenes import SHORT
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

K = np.array([[200.0, 0.0, 80.0], [0.0, 210.0, 60.0], [0.0, 0.0, 1.0]])
WIDTH, HEIGHT = 160, 120


def discs(at: list[tuple[float, float]], radius: float = 20.0) -> ndarray:
    i, j = np.indices((HEIGHT, WIDTH)) + 0.5
    return np.stack([(i - y) ** 2 + (j - x) ** 2 < radius**2 for x, y in at])


def observed(seen: ndarray, ignore: ndarray | None = None, use_ignore: bool = True) -> Observation:
    ignore = np.zeros_like(seen) if ignore is None else ignore
    return observe_masks(Masks(seen, ignore), np.tile(K, (len(seen), 1, 1)), use_ignore)


def at_level(bits: dict[int, ndarray], level: int = MASK_CROP_SIZE_PX) -> ndarray:
    return unpack(bits[level], level)


def test_what_an_observation_holds() -> None:
    o = observed(discs([(60.0, 50.0), (90.0, 70.0)]))
    assert sorted(o.observed) == sorted(o.valid) == sorted(MASK_LEVELS_PX)
    for level in MASK_LEVELS_PX:
        assert at_level(o.observed, level).shape == at_level(o.valid, level).shape == (2, level, level)
        share = at_level(o.observed, level).mean(axis=(1, 2))
        np.testing.assert_allclose(share, np.pi / 4 / 1.8**2, rtol=0.05)
    np.testing.assert_array_equal(o.area, at_level(o.observed).sum(axis=(1, 2)))
    assert o.field.shape == (2, DISTANCE_FIELD_SIZE_PX, DISTANCE_FIELD_SIZE_PX)
    assert o.targets.shape == (2, N_COVERAGE_TARGETS, 5)
    one = o.take(np.array([1]))
    np.testing.assert_array_equal(one.field, o.field[[1]])
    np.testing.assert_array_equal(one.crops.corner, o.crops.corner[[1]])


@given(st.integers(0, 10**6))
def test_the_cameras_of_the_crops_see_the_same(seed: int) -> None:
    rng = np.random.default_rng(seed)
    o = observed(discs([(70.0, 60.0)]))
    X = np.array([0.0, 0.0, 0.5]) + rng.uniform(-0.1, 0.1, (10, 3))
    fx, fy, cx, cy = o.K[0]
    inside = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    expected = (project(K, X) - o.crops.corner[0]) * o.crops.zoom
    np.testing.assert_allclose(project(inside, X), expected, atol=1e-9)


def test_rendering_with_the_cameras_of_the_crops_gives_the_observed_mask() -> None:
    mesh = box(0.1, 0.06, 0.04)
    t = SilhouetteMesh.of(mesh, np.zeros(3))
    R, centre = se3.exp_so3(np.array([[0.3, 0.5, 0.2]])), np.array([[0.01, -0.02, 0.4]])

    def drawn(K4: ndarray, height: int, width: int) -> ndarray:
        bits = np.empty((1, height, -(-width // 64)), np.uint64)
        silhouettes(R, centre, np.ones(1), t.vertices, t.planes, t.edges, t.closed, K4, bits)
        return unpack(bits, width)

    seen = drawn(np.array([[200.0, 210.0, 80.0, 60.0]]), HEIGHT, WIDTH)
    o = observed(seen)
    again = drawn(o.K, MASK_CROP_SIZE_PX, MASK_CROP_SIZE_PX)
    pixel = o.crops.zoom  # crop pixels per image pixel: the observed outline is known to half of one
    outline = (np.abs(o.field) < pixel).sum() * (MASK_CROP_SIZE_PX / DISTANCE_FIELD_SIZE_PX) ** 2
    assert (again ^ at_level(o.observed)).sum() < 0.5 * outline
    sides = again.sum() / at_level(o.observed).sum()
    assert sides == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("zoom", [0.8, 1.0, 1.02, 1.5, 2.0])
def test_no_level_takes_an_object_for_larger_or_smaller_than_it_is(zoom: float) -> None:
    frames = np.arange(12)
    size = (
        zoom * 0.5 * DISTANCE_FIELD_SIZE_PX / 1.8
    )  # so that the crops at 128 pixels have the images' resolution, or nearly
    at = np.array([80.0, 60.0]) + np.stack([np.sin(frames), np.cos(2.0 * frames)], axis=1)
    i, j = np.indices((HEIGHT, WIDTH)) + 0.5
    boxes = np.stack([np.maximum(abs(j - u), abs(i - v)) < 0.5 * size for u, v in at])
    o = observed(boxes)
    true = (size * o.crops.zoom) ** 2
    for level in MASK_LEVELS_PX:
        share = (
            at_level(o.observed, level).sum(axis=(1, 2)).mean()
            * (MASK_CROP_SIZE_PX / level) ** 2
            / boxes.sum(axis=(1, 2)).mean()
        )
        assert share / o.crops.zoom**2 == pytest.approx(1.0, abs=0.015), level
    inside = (o.field < 0.0).sum(axis=(1, 2)).mean() * (MASK_CROP_SIZE_PX / DISTANCE_FIELD_SIZE_PX) ** 2
    assert inside == pytest.approx(true, rel=0.06)


def test_nothing_is_known_beyond_the_image() -> None:
    o = observed(discs([(10.0, 60.0)]))
    u = (np.arange(MASK_CROP_SIZE_PX) + 0.5) / o.crops.zoom + o.crops.corner[0, 0]
    assert u[0] < 0.0
    np.testing.assert_array_equal(
        at_level(o.valid)[0], np.broadcast_to(u >= 0.0, (MASK_CROP_SIZE_PX, MASK_CROP_SIZE_PX))
    )


def test_hidden_pixels_do_not_count_unless_asked_to() -> None:
    seen = discs([(80.0, 60.0)])
    ignore = np.zeros_like(seen)
    ignore[:, :, 85:] = True
    visible = seen & ~ignore
    o, blind = observed(visible, ignore), observed(visible, ignore, use_ignore=False)
    hidden = ~at_level(o.valid)[0]
    assert hidden.any()
    assert not (hidden & at_level(o.observed)[0]).any()
    assert at_level(blind.valid).all()
    # No boundary point lies on the border with the occluder.
    image_u = o.targets[0, :, 0] / o.crops.zoom + o.crops.corner[0, 0]
    used = o.targets[0, :, 4] > 0
    assert used.sum() == N_COVERAGE_TARGETS
    assert np.sum(image_u[used] > 84.0) <= 2  # those at its ends, which are visible


def test_nothing_is_the_object_where_all_is_hidden() -> None:
    seen = discs([(80.0, 60.0)])
    ignore = np.zeros_like(seen)
    ignore[:, 40:80, 80:120] = True
    o = observed(seen & ~ignore, ignore)
    for level in MASK_LEVELS_PX:
        hidden = ~at_level(o.valid, level)
        assert hidden.any()
        assert not (hidden & at_level(o.observed, level)).any()


def test_where_object_and_ignored_overlap_the_object_wins() -> None:
    seen = discs([(80.0, 60.0)])
    o = observed(seen, np.ones_like(seen))
    np.testing.assert_array_equal(at_level(o.valid), at_level(o.observed))


@settings(max_examples=10)
@given(st.floats(40.0, 120.0), st.floats(40.0, 80.0), st.floats(24.0, 36.0))
def test_fields_and_targets_of_a_disc(x: float, y: float, radius: float) -> None:
    o = observed(discs([(x, y)], radius))
    field, zoom = o.field[0], o.crops.zoom
    centre, r = (np.array([x, y]) - o.crops.corner[0]) * zoom, radius * zoom
    v, u = (np.indices((DISTANCE_FIELD_SIZE_PX, DISTANCE_FIELD_SIZE_PX)) + 0.5) * (
        MASK_CROP_SIZE_PX / DISTANCE_FIELD_SIZE_PX
    )
    expected = np.hypot(u - centre[0], v - centre[1]) - r
    known = at_level(o.valid, 128)[0]
    tolerance = 1.5 * zoom + 2.0  # a pixel of the image, and one of the field
    assert np.abs(field - expected)[known].max() < tolerance
    points = o.targets[0][o.targets[0, :, 4] > 0]
    out = points[:, :2] - centre
    assert np.abs(np.linalg.norm(out, axis=1) - r).max() < tolerance
    cosine = np.sum(out * points[:, 2:4], axis=1) / np.linalg.norm(out, axis=1)
    assert np.median(cosine) > 0.9
    # Counted in steps from pixel to pixel, a circle's outline is up to sqrt(2) shorter than it is.
    assert 0.6 * 2 * np.pi * r < points[:, 4].sum() < 1.2 * 2 * np.pi * r


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


def strips(gap: int, size: int = 96, top: int = 20, bottom: int = 70) -> tuple[ndarray, ndarray]:
    """An object left of a gap and what hides it right of it; (N = 1, size, size) each."""
    observed, hidden = np.zeros((2, 1, size, size), bool)
    observed[0, top:bottom, 20:40] = True
    hidden[0, top:bottom, 40 + gap : 80] = True
    return observed, hidden


@pytest.mark.parametrize("gap", [1, 2, 5, MAX_GAP_PX])
def test_a_gap_is_what_lies_between(gap: int) -> None:
    observed, hidden = strips(gap)
    found = find_gap_pixels(observed, hidden)
    expected = np.zeros_like(found)
    expected[0, 20:70, 40 : 40 + gap] = True
    np.testing.assert_array_equal(found & expected, expected)
    beyond = np.argwhere(found & ~expected)  # rounded corners at the ends
    assert len(beyond) <= gap * gap
    for changed in (lambda m: m[:, ::-1], lambda m: m[:, :, ::-1], lambda m: np.swapaxes(m, 1, 2)):
        np.testing.assert_array_equal(
            find_gap_pixels(*(np.ascontiguousarray(changed(m)) for m in (observed, hidden))), changed(found)
        )
    np.testing.assert_array_equal(find_gap_pixels(hidden, observed), found)


def test_wider_spaces_and_touching_masks_are_no_gaps() -> None:
    assert not find_gap_pixels(*strips(0)).any()
    assert not find_gap_pixels(*strips(MAX_GAP_PX + 1)).any()
    observed, hidden = strips(3)
    assert not find_gap_pixels(observed, np.zeros_like(hidden)).any()
    assert not find_gap_pixels(np.zeros_like(observed), hidden).any()


def test_exact_masks_have_corners_and_no_gaps() -> None:
    """Where an outline goes behind the hand at right angles, nothing lies across; where it is acute, little does."""
    observed, hidden = np.zeros((2, 1, 96, 96), bool)
    i, j = np.indices((96, 96))
    hidden[0] = i >= 60
    for slope in (0.0, 0.5, 2.0):
        observed[0] = (i < 60) & (i > 10) & (j > 30 + slope * (60 - i) * 0.5) & (j < 80)
        assert not find_gap_pixels(observed, hidden).any()


def test_pixels_in_gaps_do_not_count_at_any_level() -> None:
    clip, masks = scenes.scene("can", 0, SHORT)
    exact, gapped = (observe_masks(m, clip.K) for m in (masks, Gapped(2.0)(clip, masks, 0)[1]))
    assert (exact.has_gaps, gapped.has_gaps) == (False, True)
    assert gapped.take(np.array([0])).has_gaps
    for level in MASK_LEVELS_PX:
        np.testing.assert_array_equal(gapped.observed[level], exact.observed[level])
        seen, valid = (unpack(bits[level], level) for bits in (gapped.observed, gapped.valid))
        assert (valid | ~seen).all()


def test_other_frames_of_a_clip_have_gaps_where_the_fitted_ones_have() -> None:
    clip, masks = scenes.scene("can", 0, SHORT)
    gapped = Gapped(2.0)(clip, masks, 0)[1]
    for fitted, others in ((masks, gapped), (gapped, masks)):
        first = prepare_problem(with_masks(clip, fitted), Options())
        assert first.at(with_masks(clip, others)).observation.has_gaps == first.observation.has_gaps
    np.testing.assert_array_equal(
        first.at(with_masks(clip, gapped)).observation.valid[MASK_CROP_SIZE_PX],
        first.observation.valid[MASK_CROP_SIZE_PX],
    )


@pytest.mark.slow
def test_exact_hands_stay_where_their_masks_are_too_small_all_round(monkeypatch: pytest.MonkeyPatch) -> None:
    clip, masks = scenes.scene("can", 0, SHORT)
    gapped = Gapped(3.0)(clip, masks, 0)[1]
    grown = turned(prepare_problem(with_masks(clip, gapped), Options()).clip)
    monkeypatch.setattr(hand_silhouette, "MASK_GROWTH_RANGE_PX", (np.inf, 0.0))
    as_given = turned(prepare_problem(with_masks(clip, gapped), Options()).clip)
    assert grown < 1.0
    assert grown < 0.3 * as_given


def turned(clip: Clip) -> float:
    """By how much the hand was turned [degrees], mean over frames."""
    assert clip.truth is not None
    return float(
        np.degrees(se3.angle_between(clip.hand.T_cam_hand[:, :3, :3], clip.truth.T_cam_hand[:, :3, :3])).mean()
    )


@pytest.mark.slow
def test_gaps_speak_against_the_truth_unless_they_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    clip, masks = scenes.scene("can", 0, SHORT)
    gapped = Gapped(2.0)(clip, masks, 0)[1]
    exact, found = energy_at_truth(clip, masks), energy_at_truth(clip, gapped)
    notes = [prepare_problem(with_masks(clip, some), Options()).notes for some in (masks, gapped)]
    assert [any("gaps" in note for note in of_some) for of_some in notes] == [False, True]
    assert not prepare_problem(with_masks(clip, gapped), Options(method="paper")).observation.has_gaps
    monkeypatch.setattr(problem, "GAP_SHARE", 1.0)
    believed = energy_at_truth(clip, gapped)
    assert believed > 3.0 * exact
    assert found - exact < 0.4 * (believed - exact)


def energy_at_truth(clip: Clip, masks: Masks) -> float:
    """E_mask at the true poses, all frames together."""
    prepared = prepare_problem(with_masks(clip, masks), replace(Options(), hands="as-given"))
    assert prepared.clip.truth is not None
    T = prepared.clip.truth.T_cam_obj
    centre = se3.transform(T, np.tile(clip.mesh.centre, (len(T), 1, 1)))[:, 0]
    poses = PosesInCamera(T[None, :, :3, :3], centre[None], np.ones(1))
    (term,) = mask_energy(prepared)(MASK_CROP_SIZE_PX, np.arange(len(T)))
    return float(term(poses, np.full(1, np.inf)).value.sum())
