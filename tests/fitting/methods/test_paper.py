"""The paper's method: its start, its choice, and departures that lead from it to ours, one by one."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from getagrip.clip import with_masks
from getagrip.errors import UsageError
from getagrip.evaluation import evaluate
from getagrip.evaluation.metric import IOU
from getagrip.fitting.initial_poses import initial_poses
from getagrip.fitting.methods import paper
from getagrip.fitting.motion import Fixed
from getagrip.fitting.options import Departures, Options
from getagrip.fitting.problem import Problem, prepare
from getagrip.fitting.solve import in_camera
from getagrip.geometry.mesh import Mesh
from getagrip.result import Status
from getagrip.timelines.reconstruct import reconstruct
from helpers.clips import small_clip

NAMES = [field.name for field in fields(Departures)]
ALL = Departures(**dict.fromkeys(NAMES, True))


def small_problem(options: Options | None = None) -> Problem:
    """A clip whose object's origin is not its centre."""
    clip, masks = small_clip()
    mesh = Mesh(clip.mesh.vertices + np.array([0.01, 0.02, 0.03]), clip.mesh.faces)
    return prepare(with_masks(replace(clip, mesh=mesh), masks), options or Options(method="paper", inits=3))


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
    monkeypatch.setattr(paper, "ITERATIONS", 5)
    made = Departures(**{name: True, "optimiser": name in ("optimiser", "search")})
    letter = reconstruct(*small_clip(), Options(method="paper", inits=3))
    result = reconstruct(*small_clip(), Options(method="paper", inits=3, departures=made))
    assert letter.status == Status.FINISHED
    assert result.options["departures"][name]
    assert set(result.energy) == {"total", "mask", "push", "pull", "prior"}
    if name != "choice":  # of few poses the best IOU may have the least energy
        assert result.energy != letter.energy


def test_a_search_needs_its_optimiser() -> None:
    with pytest.raises(UsageError, match=r"missing departures\.optimiser"):
        Departures(search=True)


def test_other_methods_have_no_departures() -> None:
    with pytest.raises(UsageError, match="departures cannot be used with method 'one-dof'"):
        Options(method="one-dof", departures=Departures(push=True))


def test_the_axis_starts_as_the_z_axis_through_the_origin_of_the_cad() -> None:
    problem = small_problem()
    initial = initial_poses(problem.clip, problem.masks, 3)
    hinge = paper.about_z(initial, problem.clip.mesh.centre)
    assert not hinge.angle.any()
    assert hinge.ridge == 0.0
    held = hinge.poses()
    np.testing.assert_allclose(held.centre, initial.poses().centre, atol=1e-15)
    on_axis = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.2]]) - problem.clip.mesh.centre
    in_hand = held.scale[:, None, None] * on_axis @ np.swapaxes(held.R[:, 0], 1, 2) + held.centre[:, :1]
    off = np.cross(in_hand - hinge.point[:, None], hinge.direction[:, None])
    np.testing.assert_allclose(off, 0.0, atol=1e-12)


def test_the_iou_by_which_is_chosen_is_the_metrics(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paper, "ITERATIONS", 5)
    clip, masks = small_clip()
    result = reconstruct(clip, masks, Options(method="paper", inits=2))
    problem = prepare(with_masks(clip, masks), Options(method="paper", inits=2))
    T = result.T_hand_obj[0]
    motion = Fixed(T[None, :3, :3], (T[:3, :3] @ clip.mesh.centre + T[:3, 3])[None], np.zeros(1), len(clip))
    still = replace(result, T_hand_obj=np.tile(T, (len(clip), 1, 1)))
    measured = evaluate(still, clip, masks, wanted=[IOU]).metrics["iou"]
    poses = in_camera(motion, problem.clip.hand.T_cam_hand)
    assert paper.crop_iou(problem, poses)[0] == pytest.approx(measured, abs=0.01)


def test_the_best_iou_is_chosen_not_the_least_energy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paper, "ITERATIONS", 5)
    problem = small_problem(Options(method="paper", inits=8))
    found = paper.every_start(problem, paper.initial_of(problem), paper.energy_of(problem), lambda _: None)
    all_poses, best = (
        in_camera(one.motion, problem.clip.hand.T_cam_hand) for one in (found, paper.chosen(problem, found))
    )
    by_iou = paper.crop_iou(problem, best)
    assert by_iou[0] == paper.crop_iou(problem, all_poses).max()
    assert (np.diff(by_iou) <= 0.0).all()
    ours = replace(problem, options=replace(problem.options, departures=Departures(choice=True)))
    assert paper.chosen(ours, found).energy[0] == found.energy.min()


def test_all_poses_are_reported_quarter_by_quarter(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paper, "ITERATIONS", 2)
    stages: list[str] = []
    reconstruct(*small_clip(), Options(method="paper", inits=2), lambda name, _: stages.append(name))
    assert [name for name in stages if name in paper.PARTS] == list(paper.PARTS)
