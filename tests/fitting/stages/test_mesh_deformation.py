"""The mesh fit, and the misfit that calls for it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from getagrip.clip import Clip, Masks, with_masks
from getagrip.fitting.energy import PosesInCamera
from getagrip.fitting.energy.mask import MaskTerm, SilhouetteMesh, observe_masks
from getagrip.fitting.methods import all_frames
from getagrip.fitting.methods.all_frames import coarse_energy, misfit_of, search_of
from getagrip.fitting.motion import Fixed, PosesInHand, Soft
from getagrip.fitting.objective import mask_energy
from getagrip.fitting.options import Options
from getagrip.fitting.problem import FITTED_MESH_CONTACT_FACTOR, Problem, prepare_problem
from getagrip.fitting.solver.solve import evaluate, minimise
from getagrip.fitting.stages.mesh_deformation import (
    MIN_DEFORMATION_DIAMETERS,
    MIN_MESH_MISFIT,
    fit_shape,
    relative_contour_error,
    stiffen_ridge,
)
from getagrip.geometry import se3
from getagrip.geometry.kernels.silhouette import silhouettes, unpack
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.profile import N_PROFILE_RADII, Profile
from getagrip.geometry.warp import Warp
from getagrip.provenance import Source, assumed
from getagrip.reconstruct import reconstruct
from getagrip.report.pictures.result_view import View
from getagrip.result import read_result, write_result
from getagrip.synthetic.objects import misfit as unlike
from getagrip.synthetic.scene import ground_truth_masks, make_scene
from helpers.clips import box
from helpers.scenes import SMALL, scene, scores

STRETCH = np.array([1.15, 0.88, 1.0])


def stretched(clip: Clip) -> Clip:
    """The clip with a mesh that is only of the object's kind."""
    return replace(clip, mesh=Mesh(clip.mesh.vertices * STRETCH, clip.mesh.faces))


def at_truth(problem: Problem) -> Soft[Fixed]:
    """One hypothesis: the true poses."""
    clip, truth = problem.clip, problem.clip.truth
    assert truth is not None
    T = se3.inverse(clip.hand.T_cam_hand) @ truth.T_cam_obj
    centre = se3.transform(T, truth.scale * clip.mesh.centre[None])[:, 0]
    poses = PosesInHand(T[None, :, :3, :3], centre[None], np.array([truth.scale]))
    core = Fixed(T[:1, :3, :3], centre[:1], np.log(poses.scale), len(clip))
    return Soft.around(core, poses, (1e4, 1e2))


def shape_at_truth(clip: Clip, masks: Masks, misfit: float = 10.0, options: Options | None = None) -> Warp | None:
    problem = prepare_problem(with_masks(clip, masks), options or Options())
    return fit_shape(problem, at_truth(problem), np.arange(len(clip)), misfit)


def test_another_shape_is_found_from_silhouettes() -> None:
    clip, masks = scene("mug", 0)
    warp = shape_at_truth(stretched(clip), masks)
    assert warp is not None
    given = stretched(clip).mesh
    assert unlike(warp(given), clip.mesh) < 0.5 * unlike(given, clip.mesh)


@pytest.mark.parametrize("known", [False, True])
def test_sides_of_a_built_in_box_stay_flat(known: bool) -> None:
    """Seen is a box with a bent side; where only the kind is known, it is explained by stretches."""
    made = make_scene("box", 0, SMALL)
    x, y, z = made.object.vertices.T
    masks = ground_truth_masks(replace(made, object=Mesh(np.stack([x, y + z**2, z], axis=1), made.object.faces)))
    clip = made.clip
    mesh = stretched(clip).mesh
    source = Source("a scan") if known else assumed("a box")
    warp = shape_at_truth(replace(clip, mesh=mesh, scale="free", provenance={"mesh": source}), masks)
    assert warp is not None
    points = np.column_stack([mesh.vertices, np.ones(len(mesh.vertices))])
    off = warp(mesh).vertices - points @ np.linalg.lstsq(points, warp(mesh).vertices, rcond=None)[0]
    assert (np.abs(off).max() < 0.004 * mesh.diameter) != known


def body_of_another_profile(kind: str) -> tuple[Clip, Masks, Mesh]:
    """A clip with a built-in shape, the masks of another body, and its mesh.

    Its radii differ from the built-in shape's by a wave that no stretch and no bend makes.
    """
    made = make_scene(kind, 0, SMALL)
    mesh = made.clip.mesh
    times = np.exp(0.25 * np.sin(np.linspace(0.0, 2.5 * np.pi, N_PROFILE_RADII)))
    true = Mesh(Profile.of(mesh).widened(times).moved(mesh.vertices), mesh.faces)
    guessed = replace(made.clip, scale="free", provenance={"mesh": assumed(f"a {kind}")})
    return guessed, ground_truth_masks(replace(made, object=true)), true


@pytest.mark.parametrize("kind", ["bottle", "glass"])
def test_the_profile_of_a_body_of_revolution_is_found(kind: str) -> None:
    guessed, masks, true = body_of_another_profile(kind)
    mesh, warp = guessed.mesh, shape_at_truth(guessed, masks)
    assert warp is not None
    assert warp.profile is not None
    assert unlike(warp(mesh), true) < 0.45 * unlike(mesh, true)
    left_out = shape_at_truth(guessed, masks, options=Options(without=("profile",)))
    assert left_out is not None
    assert left_out.profile is None
    own = ground_truth_masks(make_scene(kind, 0, SMALL))
    assert shape_at_truth(guessed, own) is None  # of an object that has the built-in shape
    measured = shape_at_truth(replace(guessed, provenance={"mesh": Source("a scan")}), masks)
    assert measured is not None
    assert measured.profile is None  # of a mesh that somebody gave, even of such a kind
    assert unlike(warp(mesh), true) < 0.7 * unlike(measured(mesh), true)


def test_the_radii_of_a_box_are_no_part_of_its_shape() -> None:
    clip, masks = scene("box", 0)
    warp = shape_at_truth(replace(stretched(clip), scale="free", provenance={"mesh": assumed("a box")}), masks)
    assert warp is not None
    assert warp.profile is None


def test_the_objects_own_mesh_is_kept() -> None:
    clip, masks = scene("mug", 0)
    assert shape_at_truth(clip, masks) is None
    assert shape_at_truth(stretched(clip), masks, misfit=0.9 * MIN_MESH_MISFIT) is None


def test_a_motion_that_is_not_fitted_yet_does_not_deform_the_mesh() -> None:
    clip, masks = scene("mug", 0)
    problem, frames = prepare_problem(with_masks(clip, masks), Options()), np.arange(len(clip))
    true = at_truth(problem)
    astray = replace(
        true, deviation=true.deviation + np.random.default_rng(0).normal(scale=0.002, size=(1, len(clip), 6))
    )
    rough = minimise(astray, mask_energy(problem)(64, frames), clip.hand.T_cam_hand, 0)
    assert (
        relative_contour_error(problem.observation, float(rough.terms["mask"][0]) / len(clip)) > 2.0 * MIN_MESH_MISFIT
    )
    assert misfit_of(problem, search_of(problem, lambda stage: None), rough.motion) < MIN_MESH_MISFIT


def test_a_shape_near_the_mesh_is_taken_for_the_meshs_own(monkeypatch: pytest.MonkeyPatch) -> None:
    clip, masks = scene("mug", 0)
    warp = shape_at_truth(stretched(clip), masks)
    assert warp is not None
    deformed = warp.displacement(stretched(clip).mesh) / stretched(clip).mesh.diameter
    assert deformed > MIN_DEFORMATION_DIAMETERS
    monkeypatch.setattr("getagrip.fitting.stages.mesh_deformation.MIN_DEFORMATION_DIAMETERS", 1.01 * deformed)
    assert shape_at_truth(stretched(clip), masks) is None


def test_contact_reaches_farther_and_counts_more_where_the_mesh_is_fitted() -> None:
    clip, masks = scene("mug", 0)
    given = prepare_problem(with_masks(clip, masks), Options())
    fitted = given.warped(Warp.by(clip.mesh.centre, 1.0, np.zeros((9, 3))))
    motion = at_truth(given)
    shifts = 0.02 * np.concatenate([np.eye(3), -np.eye(3)])
    core = motion.core.take(np.zeros(6, int))
    near = replace(motion.take(np.zeros(6, int)), core=replace(core, centre=core.centre + shifts))
    values = []
    for problem in (given, fitted):
        named = {term.name: term for term in coarse_energy(problem)(64, np.arange(len(clip)))}
        push, pull = named["push"], named["pull"]
        values.append(evaluate(near, [push, pull], clip.hand.T_cam_hand, np.full(6, np.inf)).values)
    push, pull = values[1].T[:2] - FITTED_MESH_CONTACT_FACTOR * values[0].T[:2]
    assert values[0][:, 0].max() > 0.0
    np.testing.assert_allclose(push, 0.0, atol=1e-9 * values[0].max())
    assert pull.min() > -1e-9 * values[0].max()
    assert pull.max() > 0.2 * values[0][:, 1].max()  # fingers too far away to be drawn to the given mesh


@pytest.mark.parametrize("method", ["soft-hinge", "one-dof"])
@pytest.mark.slow
def test_a_result_has_the_shape_and_says_so(tmp_path: Path, method: str) -> None:
    clip, masks = scene("mug", 0)
    given = stretched(clip)
    options = Options(method=method, inits=6)
    result = reconstruct(given, masks, options)
    assert result.warp is not None
    assert any("the object's shape is an assumption" in note for note in result.notes)
    deformed = result.warp.displacement(given.mesh) / given.mesh.diameter
    assert result.checks["mesh-deformed"] == pytest.approx(deformed)
    (message,) = (finding.message for finding in result.findings if finding.check == "mesh-deformed")
    by = 1e3 * result.scale * result.warp.displacement(given.mesh)
    assert message.startswith(
        f"to meet the masks the mesh was deformed by {by:.1f} mm, so its shape is an assumption; "
    )
    as_given = reconstruct(given, masks, replace(options, mesh="as-given"))
    assert as_given.warp is None
    assert result.mean_iou > as_given.mean_iou
    found = scores(result, given, masks)
    assert found["iou"] == pytest.approx(result.mean_iou, abs=0.01)  # of the same mesh
    assert read_result(write_result(result, tmp_path / "result"))[0] == result
    view = View.of(result, given, masks)
    np.testing.assert_array_equal(view.clip.mesh.vertices, result.warp(given.mesh).vertices)
    true = view.true()
    assert true is not None
    assert true.clip.mesh == given.mesh
    assert "shape is a guess" in view.size_in_words


@pytest.mark.slow
def test_a_result_says_that_its_profile_is_fitted(tmp_path: Path) -> None:
    guessed, masks, true = body_of_another_profile("bottle")
    result = reconstruct(guessed, masks, Options(inits=6))
    assert result.warp is not None
    assert result.warp.profile is not None
    assert "the profile of its body is fitted: radii of 0." in result.assumptions["shape"]
    assert unlike(result.warp(guessed.mesh), true) < 0.6 * unlike(guessed.mesh, true)
    back = read_result(write_result(result, tmp_path / "result"))[0]
    assert back == result
    view = View.of(back, guessed, masks)  # of which pictures and exports are made
    np.testing.assert_array_equal(view.clip.mesh.vertices, result.warp(guessed.mesh).vertices)


@pytest.mark.slow
def test_a_hinge_that_explains_the_masks_keeps_the_input_mesh(monkeypatch: pytest.MonkeyPatch) -> None:
    clip, masks = scene("mug", 0)
    as_given = reconstruct(clip, masks, Options(method="one-dof", inits=8, mesh="as-given"))
    monkeypatch.setattr(all_frames, "coarse_fit", None)  # the soft fit of another shape is not even begun
    fitted = reconstruct(clip, masks, Options(method="one-dof", inits=8))
    np.testing.assert_array_equal(fitted.T_hand_obj, as_given.T_hand_obj)
    assert fitted.energy == as_given.energy


FRAMES = 8
HELD = box(0.1, 0.06, 0.04)


def misfit_at_truth(pixels: int, fitted: Mesh = HELD) -> float:
    """The misfit of a mesh at the true poses of a box, in images of so many pixels."""
    rng = np.random.default_rng(0)
    R = se3.exp_so3(rng.normal(size=(FRAMES, 3)))
    centre = np.array([0.0, 0.0, 0.5]) + rng.uniform(-0.02, 0.02, (FRAMES, 3))
    f, c = 1.4 * pixels, 0.5 * pixels
    t = SilhouetteMesh.of(HELD, np.zeros(3))
    bits = np.empty((FRAMES, pixels, -(-pixels // 64)), np.uint64)
    silhouettes(R, centre, np.ones(FRAMES), *t.tables, np.tile([f, f, c, c], (FRAMES, 1)), bits)
    seen = unpack(bits, pixels)
    K = np.tile([[f, 0.0, c], [0.0, f, c], [0.0, 0.0, 1.0]], (FRAMES, 1, 1))
    observation = observe_masks(Masks(seen, np.zeros_like(seen)), K)
    term = MaskTerm(SilhouetteMesh.of(fitted, np.zeros(3)), observation, level=64)
    poses = PosesInCamera(R[None], centre[None], np.ones(1))
    return relative_contour_error(observation, float(term(poses, np.full(1, np.inf)).value.mean()))


@pytest.mark.parametrize("pixels", [320, 640, 1280])
def test_the_objects_own_mesh_leaves_no_more_than_pixels_do(pixels: int) -> None:
    assert misfit_at_truth(pixels) < 1.2


def test_a_template_mesh_leaves_more() -> None:
    wide = Mesh(HELD.vertices * [1.0, 1.2, 1.0], HELD.faces)
    wider = Mesh(HELD.vertices * [1.0, 1.4, 1.0], HELD.faces)
    assert 1.5 < misfit_at_truth(640, wide) < misfit_at_truth(640, wider)


def test_deviations_get_stiffer_where_masks_are_explained_worse() -> None:
    ridge = (1.5e6, 1e4)
    assert stiffen_ridge(ridge, 0.3) == stiffen_ridge(ridge, 1.0) == ridge
    once, twice = stiffen_ridge(ridge, 2.0), stiffen_ridge(ridge, 4.0)
    assert ridge < once < twice
    assert once[0] / once[1] == pytest.approx(ridge[0] / ridge[1])


def test_where_no_contour_is_seen_nothing_is_known() -> None:
    everything = np.ones((2, 40, 40), dtype=bool)
    K = np.tile([[50.0, 0.0, 20.0], [0.0, 50.0, 20.0], [0.0, 0.0, 1.0]], (2, 1, 1))
    assert relative_contour_error(observe_masks(Masks(everything, np.zeros_like(everything)), K), 100.0) == 1.0
