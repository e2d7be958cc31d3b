"""The search: duplicates, rotations, half turns, stages, and the thorough schedule."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
import trimesh

from getagrip.fitting.energy import Quadratic
from getagrip.fitting.energy.term import PosesInCamera
from getagrip.fitting.motion import Fixed
from getagrip.fitting.options import Options
from getagrip.fitting.problem import ObjectSurface
from getagrip.fitting.solver.search import (
    DEFAULT_SCHEDULE,
    GLOBAL_ROTATIONS,
    LOCAL_ROTATIONS,
    THOROUGH_SCHEDULE,
    Rotations,
    Schedule,
    Search,
    Stage,
    drawn_rotations,
    explore_rotations,
    starts_have_met,
    suppress_duplicates,
    within_factor,
)
from getagrip.fitting.solver.solve import Solution, minimise
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.metrics.contact import signed_distance
from getagrip.reconstruct import reconstruct
from getagrip.result import Status
from getagrip.synthetic.categories import SYNTHETIC_CATEGORIES
from helpers.clips import box
from helpers.scenes import SHORT, SMALL, scene, scores

CORNERS = np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)]) * [0.1, 0.06, 0.04] - [0.05, 0.03, 0.02]


@cache
def box_surface() -> ObjectSurface:
    """Made by the first test that looks at it: kernels are loaded for that."""
    return ObjectSurface.of(box(0.1, 0.06, 0.04))


def test_near_copies_of_a_better_hypothesis_are_dropped() -> None:
    eye = np.tile(np.eye(3), (5, 1, 1))
    centre = np.array([[0.0, 0, 0], [1e-4, 0, 0], [0.05, 0, 0], [0.1, 0, 0], [0.2, 0, 0]])
    motion = Fixed(eye, centre, np.zeros(5), 3)
    energy = np.array([2.0, 1.0, 5.0, 3.0, np.inf])
    np.testing.assert_array_equal(suppress_duplicates(motion.poses(), energy, box_surface(), keep=9), [1, 3, 2])
    np.testing.assert_array_equal(suppress_duplicates(motion.poses(), energy, box_surface(), keep=2), [1, 3])
    assert len(suppress_duplicates(motion.poses(), np.full(5, np.inf), box_surface(), keep=2)) == 0


def test_rounds_end_where_two_starts_have_met_far_ahead_of_the_others() -> None:
    eye = np.tile(np.eye(3), (4, 1, 1))
    centre = np.array([[0.0, 0, 0], [1e-3, 0, 0], [0.05, 0, 0], [0.1, 0, 0]])

    def met(energy: list[float], independent: int = 4) -> bool:
        motion = Fixed(eye, centre, np.zeros(4), 3)
        found = Solution(motion, np.array(energy), {}, [Status.CONVERGED] * 4, 0)
        return starts_have_met(found, independent, box_surface())

    assert met([1.0, 1.2, 1.6, 2.0])
    assert met([1.0, 1.2, np.inf, np.inf])
    assert not met([1.0, 1.2, 1.4, 2.0])  # another pose is too near
    assert not met([1.6, 1.2, 1.0, 2.0])  # only one start is in the best
    assert not met([1.0, 1.2, 1.6, 2.0], independent=1)  # the second was rotated out of the first
    assert not met([np.inf] * 4)


def test_the_distance_of_two_poses_is_that_of_points_to_the_posed_mesh() -> None:
    surface, rng = box_surface(), np.random.default_rng(5)
    mesh = box(0.1, 0.06, 0.04)
    R = se3.exp_so3(rng.normal(size=(4, 2, 3)) * np.array([0.0, 0.05, 0.1, 1.0])[:, None, None])
    centre, scale = rng.normal(size=(4, 2, 3)) * 0.004, np.array([1.0, 1.0, 1.1, 0.95])
    found, near_ones = surface.rms_distance(R[0], centre[0], 1.05, R, centre, scale), 0
    for n in range(4):
        gaps = []
        for k in range(2):
            moved = 1.05 * surface.points @ R[0, k].T + centre[0, k]
            own = (moved - centre[n, k]) @ R[n, k] / scale[n] + mesh.centre
            gaps.append(signed_distance(own, mesh.vertices, mesh.faces))
        exact = float(np.sqrt(np.mean(np.square(gaps))) / mesh.diameter)
        assert found[n] <= exact + 1e-9
        if np.abs(gaps).max() < 0.02:  # farther off it is a lower bound
            near_ones += 1
            assert found[n] == pytest.approx(exact, rel=1e-6, abs=1e-9)
    assert near_ones >= 3
    limit = float(np.median(found))
    limited = surface.rms_distance(R[0], centre[0], 1.05, R, centre, scale, within=limit)
    np.testing.assert_array_equal(limited, np.where(found <= limit, found, np.inf))


@pytest.mark.parametrize("by", [GLOBAL_ROTATIONS, LOCAL_ROTATIONS])
def test_rotations_are_by_as_much_as_asked(by: Rotations) -> None:
    R = drawn_rotations(box_surface().axes, by, 30, np.random.default_rng(3))
    angle = np.degrees(se3.angle_between(R, np.eye(3)))
    for k, (least, most) in enumerate((by.random, by.principal)):
        of = angle[30 * k : 30 * k + 30]
        assert ((of >= least - 1e-4) & (of <= most + 1e-4)).all()
    axis = se3.log_so3(R[30:]) / np.radians(angle[30:, None])
    assert np.allclose(np.abs(axis @ box_surface().axes.T).max(axis=1), 1.0, atol=1e-6)


def test_a_half_turn_about_a_principal_axis_puts_the_box_on_itself() -> None:
    R = drawn_rotations(box_surface().axes, GLOBAL_ROTATIONS, 30, np.random.default_rng(3))[30:]
    assert len(np.unique(R.round(6) + 0.0, axis=0)) == 3
    for turn in R:
        gaps = np.linalg.norm((CORNERS @ turn.T)[:, None] - CORNERS[None], axis=-1)
        np.testing.assert_allclose(gaps.min(axis=1), 0.0, atol=1e-9)


def test_a_bottle_that_has_spun_is_the_same_and_one_that_was_tilted_is_not() -> None:
    can = trimesh.creation.cylinder(0.03, 0.12, sections=64)
    surface = ObjectSurface.of(Mesh(np.array(can.vertices), np.array(can.faces)))
    R = se3.exp_so3(np.array([[0.0, 0, 0], [0.0, 0.0, 1.1], [np.pi, 0.0, 0.0], [0.4, 0.0, 0.0]]))
    still = Fixed(R, np.zeros((4, 3)), np.zeros(4), 3)
    np.testing.assert_array_equal(suppress_duplicates(still.poses(), np.arange(4.0), surface, keep=9), [0, 3])


def test_a_large_pan_with_its_handle_turned_is_no_duplicate() -> None:
    pan = SYNTHETIC_CATEGORIES["pan"]()
    surface = ObjectSurface.of(pan)
    R = se3.exp_so3(np.radians([[0.0, 0.0, a] for a in (0.0, 30.0, 60.0, 90.0, 180.0)]))
    vessel = np.array([pan.vertices[:, 0].min() + pan.vertices[:, 1].max(), 0.0, 0.0]) - pan.centre
    still = Fixed(R, vessel - R @ vessel, np.zeros(5), 3)
    assert len(suppress_duplicates(still.poses(), np.arange(5.0), surface, keep=9)) == 5


class Upright:
    """An energy with two minima along each axis, of which one is lower: an object that should stand upright."""

    name = "upright"

    def __call__(self, poses: PosesInCamera, bound: np.ndarray) -> Quadratic:
        B, N = poses.centre.shape[:2]
        up = poses.R @ np.array([0.0, 0.0, 1.0])
        z, tilt = up[..., 2], np.stack([up[..., 1], -up[..., 0]], axis=-1)
        g, H = np.zeros((B, N, 7)), np.tile(np.eye(7), (B, N, 1, 1))
        g[..., 3:5] = np.sign(z)[..., None] * tilt
        return Quadratic((1.0 - np.abs(z)) + 0.1 * (z < 0.0), g, H)


def test_rotated_hypotheses_reach_the_lower_of_two_minima() -> None:
    surface = ObjectSurface.of(box(0.1, 0.06, 0.04))
    initial = Fixed(
        se3.exp_so3(np.array([[np.pi - 0.3, 0.0, 0.0], [np.pi, 0.2, 0.0]])), np.zeros((2, 3)), np.zeros(2), 4
    )
    T = np.tile(np.eye(4), (4, 1, 1))
    stage = Stage("coarse", level=64, frames=4, iterations=5, keep=2)
    first = minimise(initial, [Upright()], T, iterations=10)
    assert first.energy.min() > 0.3
    for rounds in (0, 4):
        found = explore_rotations(first, [Upright()], T, surface, replace(stage, rounds=rounds))
        np.testing.assert_array_equal(found.energy[:2], first.energy)  # nothing is lost
        assert len(found.energy) == 2 if rounds == 0 else found.energy.min() < 0.01


def wedge(taper: float) -> Mesh:
    """A box of 10 x 6 x 4 cm that is narrower at +x by ``taper``: half a turn about y or z is seen, if at all."""
    mesh = trimesh.creation.box([0.1, 0.06, 0.04]).subdivide().subdivide().subdivide()
    vertices = np.array(mesh.vertices)
    vertices[:, 1:] *= 1.0 - taper * (0.5 + vertices[:, :1] / 0.1)
    return Mesh(vertices, np.array(mesh.faces))


def test_half_turns_are_those_that_nearly_leave_the_surface_as_it_is() -> None:
    assert len(box_surface().half_turns) == 0  # they leave it as it is
    assert len(ObjectSurface.of(SYNTHETIC_CATEGORIES["mug"]()).half_turns) == 0  # its handle is elsewhere then
    turns = ObjectSurface.of(wedge(0.1)).half_turns
    assert len(turns) == 2
    for turn in turns:
        np.testing.assert_allclose(turn @ turn, np.eye(3), atol=1e-9)
        assert turn[0, 0] < -0.99  # the narrow end goes to the other side


@pytest.mark.parametrize(("taper", "finds"), [(0.0, False), (0.1, True)])
def test_the_last_stage_finds_which_way_round_a_nearly_symmetric_object_is(taper: float, finds: bool) -> None:
    surface = ObjectSurface.of(wedge(taper))
    fine = tuple(Stage(name, 64, 4, iterations=5, keep=2, half_turns=name == "finest") for name in ("fine", "finest"))
    search = Search(np.tile(np.eye(4), (4, 1, 1)), surface, Schedule(fine=fine), lambda stage: None)
    upside_down = Fixed(se3.exp_so3(np.array([[np.pi, 0.0, 0.2]])), np.zeros((1, 3)), np.zeros(1), 4)
    found = search.fine(upside_down, lambda level, index: [Upright()])
    assert bool(found.energy[0] < 0.1) is finds
    assert len(found.energy) == 1  # the other way round has much more energy


def test_only_half_turns_that_can_be_seen_and_have_as_little_energy_are_other_solutions() -> None:
    surface = ObjectSurface.of(wedge(0.1))
    R = se3.exp_so3(np.array([[0.0, 0, 0], [0.0, 0.0, np.pi], [0.01, 0.0, np.pi], [np.pi, 0.0, 0.0], [0.0, 0.01, 0.0]]))
    poses = Fixed(R, np.zeros((5, 3)), np.zeros(5), 3).poses()
    for half_turns, factor, kept in ((False, 1.001, [0]), (True, 1.001, [0, 1]), (True, 1.1, [0])):
        assert suppress_duplicates(poses, factor ** np.arange(5.0), surface, 9, half_turns).tolist() == kept


def test_hypotheses_that_cannot_win_go_no_further() -> None:
    assert within_factor(np.array([2.0, 3.9, 6.1]), 3.0).tolist() == [True, True, False]
    assert within_factor(np.array([-2.0, 1.9, 2.1]), 3.0).tolist() == [
        True,
        True,
        False,
    ]  # some terms may be below zero
    assert within_factor(np.array([0.0, 1e9]), np.inf).all()


@pytest.mark.slow
def test_thin_objects_are_found_though_their_energy_falls_late() -> None:
    """Scissors: after the coarse stage the right pose had more than 3 times the least energy, and was lost."""
    clip, masks = scene("scissors", 7, replace(SMALL, frames=6))
    found = scores(reconstruct(clip, masks, Options(inits=30)), clip, masks)
    assert found["add_sym_mm"] < 5.0


@pytest.mark.slow
def test_the_longer_search_finds_no_worse_and_says_what_it_was() -> None:
    usual, longer = (
        reconstruct(*scene("mug", 2, SHORT), Options(inits=12, thorough=thorough)) for thorough in (False, True)
    )
    assert longer.energy["total"] < 1.01 * usual.energy["total"]
    assert (usual.options["thorough"], longer.options["thorough"]) == (False, True)


def test_the_longer_search_goes_through_the_same_stages_and_keeps_more() -> None:
    short, long = ([*schedule.coarse, *schedule.fine] for schedule in (DEFAULT_SCHEDULE, THOROUGH_SCHEDULE))
    for usual, longer in zip(short, long, strict=True):
        assert (usual.name, usual.level, usual.frames) == (longer.name, longer.level, longer.frames)
        assert longer.keep >= usual.keep
        assert longer.within >= usual.within
    assert sum(s.rounds * s.parents for s in long) > sum(s.rounds * s.parents for s in short)
    assert all(a.keep >= b.keep for a, b in pairwise(long))
