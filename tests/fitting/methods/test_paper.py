"""The paper's method: it ends at the truth; its start, its choice, departures that lead from it to ours; baselines."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Literal

import numpy as np
import pytest
from numpy import ndarray

from getagrip.clip import FrameMasks, Masks, with_masks
from getagrip.errors import UsageError
from getagrip.fitting.methods import method_of, paper, single_frame
from getagrip.fitting.motion import Fixed
from getagrip.fitting.options import Departures, Options
from getagrip.fitting.problem import Problem, prepare_problem
from getagrip.fitting.solver.initial_poses import initial_poses
from getagrip.fitting.solver.solve import evaluate, poses_in_camera
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.geometry.rasterize import true_masks
from getagrip.metrics import evaluate as evaluate_module
from getagrip.metrics.evaluate.metric import IOU
from getagrip.reconstruct import reconstruct
from getagrip.result import Status
from getagrip.synthetic.scene import synthesise
from getagrip.synthetic.scene_options import SceneOptions
from helpers.clips import small_clip

NAMES = [field.name for field in fields(Departures)]
ALL = Departures(**dict.fromkeys(NAMES, True))


def small_problem(options: Options | None = None) -> Problem:
    """A clip whose object's origin is not its centre."""
    clip, masks = small_clip()
    mesh = Mesh(clip.mesh.vertices + np.array([0.01, 0.02, 0.03]), clip.mesh.faces)
    return prepare_problem(with_masks(replace(clip, mesh=mesh), masks), options or Options(method="paper", inits=3))


@pytest.mark.slow
def test_with_all_departures_it_is_one_dof() -> None:
    ours = reconstruct(*small_clip(), Options(method="one-dof", inits=4, hands="as-given"))
    all_made = reconstruct(*small_clip(), Options(method="paper", inits=4, departures=ALL))
    np.testing.assert_array_equal(all_made.T_hand_obj, ours.T_hand_obj)
    np.testing.assert_array_equal(all_made.candidates.energy, ours.candidates.energy)
    assert all_made.energy == ours.energy


@pytest.mark.slow
def test_at_a_free_scale_one_dof_has_twice_as_many_initial_poses() -> None:
    clip, masks = small_clip()
    clip = replace(clip, scale="free")
    ours = reconstruct(clip, masks, Options(method="one-dof", inits=2, hands="as-given"))
    same = reconstruct(clip, masks, Options(method="paper", inits=4, departures=ALL))
    np.testing.assert_array_equal(same.T_hand_obj, ours.T_hand_obj)
    assert same.energy == ours.energy


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.slow
def test_each_departure_can_be_made_alone(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paper, "PAPER_ITERATIONS", 5)
    made = Departures(**{name: True, "optimiser": name in ("optimiser", "search")})
    letter = reconstruct(*small_clip(), Options(method="paper", inits=3))
    result = reconstruct(*small_clip(), Options(method="paper", inits=3, departures=made))
    assert letter.status == Status.FINISHED
    assert result.options["departures"][name]
    assert set(result.energy) == {"total", "mask", "push", "pull", "prior"}
    if name != "choice":  # of few poses the best IOU may have the least energy
        assert result.energy != letter.energy


def grasp_seen_from(focal: float, moves: bool, free: bool) -> tuple[Problem, ndarray]:
    """Make a problem whose hand is as large in the image at any focal length, with the truth among its starts.

    The true poses in the hand come second: all alike, or turned by up to 20 degrees about the CAD's z-axis.
    """
    clip, _ = synthesise("mug", 0, SceneOptions(frames=5, size=(320, 240), focal=300.0))
    assert clip.truth is not None
    T_cam_hand, K = clip.hand.T_cam_hand.copy(), clip.K.copy()
    T_hand_obj = se3.inverse(T_cam_hand) @ clip.truth.T_cam_obj
    about_z = np.array([0.0, 0.0, 0.35 * moves]) * np.linspace(-1.0, 1.0, len(clip))[:, None]
    T_hand_obj = T_hand_obj[2] @ se3.rigid(se3.exp_so3(about_z))
    T_cam_hand[:, 2, 3] *= focal / K[:, 0, 0]
    K[:, [0, 1], [0, 1]] = focal
    hand = se3.transform(T_cam_hand, clip.hand.vertices)
    held = se3.transform(T_cam_hand @ T_hand_obj, clip.mesh.vertices)
    masks = Masks.of(
        FrameMasks(*true_masks((held[n], clip.mesh.faces), [(hand[n], clip.hand.faces)], [], K[n], clip.size))
        for n in range(len(clip))
    )
    scale: Literal["known", "free"] = "free" if free else "known"
    clip = replace(clip.with_hand_at(T_cam_hand), K=K, scale=scale, truth=None)
    turned = se3.rigid(se3.exp_so3(np.array([[0.0, 0.0, 0.0], [1.5, 0.0, 0.0], [0.0, 1.5, 0.0]])))
    problem = prepare_problem(with_masks(clip, masks), Options(method="paper", inits=len(turned)))
    return replace(problem, prior_poses=T_hand_obj[2] @ turned), T_hand_obj


@pytest.mark.parametrize("focal", [500.0, 16_680.0, 50_000.0])
@pytest.mark.parametrize("free", [False, True])
@pytest.mark.parametrize("moves", [False, True])
@pytest.mark.slow
def test_it_ends_at_the_truth_that_is_among_its_starts(focal: float, free: bool, moves: bool) -> None:
    """Push and pull in millimetres leave it; a height with a sign lets an object of free scale grow."""
    problem, T_hand_obj = grasp_seen_from(focal, moves, free)
    found = paper.fit(problem, lambda _: None)
    assert found.motion is not None
    assert paper.crop_iou(problem, poses_in_camera(found.motion, problem.clip.hand.T_cam_hand))[0] >= 0.95
    assert found.poses.scale[0] == pytest.approx(1.0, abs=0.1)
    about = problem.clip.mesh.vertices - problem.clip.mesh.centre
    vertices = found.poses.scale[0] * about @ np.swapaxes(found.poses.R[0], 1, 2) + found.poses.centre[0, :, None]
    off = np.linalg.norm(vertices - se3.transform(T_hand_obj, problem.clip.mesh.vertices), axis=-1)
    assert off.mean() < 0.15 * problem.clip.mesh.diameter


@pytest.mark.parametrize("focal", [500.0, 50_000.0])
def test_no_size_has_less_energy_than_the_true_one(focal: float) -> None:
    """The object as large in the image: nearer to the camera and smaller, or farther and larger."""
    problem, T_hand_obj = grasp_seen_from(focal, moves=False, free=True)
    sizes = np.array([1.0, 0.3, 0.7, 1.4, 3.0, 20.0])
    eye = se3.inverse(problem.clip.hand.T_cam_hand[2])[:3, 3]
    true_centre = se3.transform(T_hand_obj[2], problem.clip.mesh.centre[None])[0]
    nearer = eye + sizes[:, None] * (true_centre - eye)
    for centre in (nearer, np.tile(true_centre, (len(sizes), 1))):
        R = np.tile(T_hand_obj[2, :3, :3], (len(sizes), 1, 1))
        motion = Fixed(R, centre, np.log(sizes), len(problem.clip), free_scale=True)
        terms = paper.paper_energy(problem)(256, np.arange(len(problem.clip)))
        cost = evaluate(motion, terms, problem.clip.hand.T_cam_hand, np.full(len(sizes), np.inf)).cost
        assert (cost > 0.0).all()
        assert cost[0] == cost.min()


@pytest.mark.parametrize("method", ["paper-static", "paper-dynamic", "paper-single-frame", "paper-homan"])
@pytest.mark.slow
def test_the_papers_baselines_have_its_energy_optimiser_and_choice(
    method: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(paper, "PAPER_ITERATIONS", 60)
    problem, T_hand_obj = grasp_seen_from(600.0, moves=False, free=False)
    problem = replace(problem, options=replace(problem.options, method=method))
    calls: list[str] = []
    for name in ("paper_push_of", "paper_pull_of"):
        term = getattr(paper, name)
        monkeypatch.setattr(paper, name, lambda *args, term=term, name=name: calls.append(name) or term(*args))
    found = method_of(method).fit(problem, lambda _: None)
    assert {*calls} == {"paper_push_of", "paper_pull_of"}
    assert found.status == Status.FINISHED
    assert {"mask", "push", "pull"} <= {*found.terms}
    centre = se3.transform(T_hand_obj, problem.clip.mesh.centre[None])[:, 0]
    assert np.linalg.norm(found.poses.centre[0] - centre, axis=1).mean() < 0.15 * problem.clip.mesh.diameter


def test_single_frames_know_nothing_of_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """The pose of a frame is the same, whatever the other frames show."""
    monkeypatch.setattr(paper, "PAPER_ITERATIONS", 10)
    problem, _ = grasp_seen_from(600.0, moves=True, free=False)
    whole = paper.single_frame(problem, lambda _: None)
    energy = paper.paper_energy(problem)
    start = single_frame.initial_of_frame(problem, 3)
    alone = paper.choose_solutions(
        problem, paper.fit_every_start(problem, start, energy, lambda _: None, np.array([3])), np.array([3])
    )
    np.testing.assert_array_equal(alone.motion.R[0], whole.poses.R[0, 3])


def test_a_search_needs_its_optimiser() -> None:
    with pytest.raises(UsageError, match=r"missing departures\.optimiser"):
        Departures(search=True)


def test_other_methods_have_no_departures() -> None:
    with pytest.raises(UsageError, match="departures cannot be used with method 'one-dof'"):
        Options(method="one-dof", departures=Departures(push=True))


def test_the_axis_starts_as_the_z_axis_through_the_origin_of_the_cad() -> None:
    problem = small_problem()
    initial = initial_poses(problem.clip, problem.masks, 3)
    hinge = paper.hinge_about_z(initial, problem.clip.mesh.centre)
    assert not hinge.angle.any()
    assert hinge.ridge == 0.0
    held = hinge.poses()
    np.testing.assert_allclose(held.centre, initial.poses().centre, atol=1e-15)
    on_axis = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.2]]) - problem.clip.mesh.centre
    in_hand = held.scale[:, None, None] * on_axis @ np.swapaxes(held.R[:, 0], 1, 2) + held.centre[:, :1]
    off = np.cross(in_hand - hinge.point[:, None], hinge.direction[:, None])
    np.testing.assert_allclose(off, 0.0, atol=1e-12)


def test_the_iou_by_which_is_chosen_is_the_metrics(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paper, "PAPER_ITERATIONS", 5)
    clip, masks = small_clip()
    result = reconstruct(clip, masks, Options(method="paper", inits=2))
    problem = prepare_problem(with_masks(clip, masks), Options(method="paper", inits=2))
    T = result.T_hand_obj[0]
    motion = Fixed(T[None, :3, :3], (T[:3, :3] @ clip.mesh.centre + T[:3, 3])[None], np.zeros(1), len(clip))
    still = replace(result, T_hand_obj=np.tile(T, (len(clip), 1, 1)))
    measured = evaluate_module.evaluate(still, clip, masks, wanted=[IOU]).metrics["iou"]
    poses = poses_in_camera(motion, problem.clip.hand.T_cam_hand)
    assert paper.crop_iou(problem, poses)[0] == pytest.approx(measured, abs=0.01)


def test_the_best_iou_is_chosen_not_the_least_energy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paper, "PAPER_ITERATIONS", 5)
    problem = small_problem(Options(method="paper", inits=8))
    found = paper.fit_every_start(
        problem, paper.make_initial_poses(problem), paper.paper_energy(problem), lambda _: None
    )
    all_poses, best = (
        poses_in_camera(one.motion, problem.clip.hand.T_cam_hand)
        for one in (found, paper.choose_solutions(problem, found))
    )
    by_iou = paper.crop_iou(problem, best)
    assert by_iou[0] == paper.crop_iou(problem, all_poses).max()
    assert (np.diff(by_iou) <= 0.0).all()
    ours = replace(problem, options=replace(problem.options, departures=Departures(choice=True)))
    assert paper.choose_solutions(ours, found).energy[0] == found.energy.min()


def test_all_poses_are_reported_quarter_by_quarter(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paper, "PAPER_ITERATIONS", 2)
    stages: list[str] = []
    reconstruct(*small_clip(), Options(method="paper", inits=2), lambda name, _: stages.append(name))
    assert [name for name in stages if name in paper.START_QUARTERS] == list(paper.START_QUARTERS)
