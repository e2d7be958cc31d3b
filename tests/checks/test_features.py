"""Features of a result: their direction, their scale, and what must not matter to them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from getagrip.checks import SolvedEvidence
from getagrip.checks.calibration import CALIBRATIONS, ESTIMATED_CALIBRATIONS
from getagrip.checks.features import (
    FEATURES,
    LIFTED_FEATURES,
    compute_features,
    contact_gap,
    depth_source_level,
    energy_gap,
    joint_error,
    mean_penetration,
    seen_size,
    solution_spread,
)
from getagrip.clip.depth import Depth, DepthSource
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.metrics.symmetry import find_symmetries
from getagrip.result import Axis, Candidates
from getagrip.synthetic.scene import synthesise
from getagrip.synthetic.scene_options import SceneOptions

unit = st.floats(-10.0, 10.0)


@cache
def mug() -> SolvedEvidence:
    """The true solution, and one that is a quarter turn away at 1.5 times the energy."""
    clip, masks = synthesise("mug", 2, SceneOptions(frames=4, size=(160, 120), focal=150.0))
    T = se3.inverse(clip.truth.T_cam_hand) @ clip.truth.T_cam_obj
    away = T @ se3.rigid(se3.exp_so3(np.array([0.5 * np.pi, 0.0, 0.0])), np.zeros(3))
    candidates = Candidates(np.stack([T, away]), np.ones(2), np.array([100.0, 150.0]))
    given = clip.hand.T_cam_hand
    iou = np.full(4, 0.9)
    return SolvedEvidence(
        clip,
        masks,
        T,
        1.0,
        iou,
        candidates=candidates,
        axis=None,
        T_cam_hand_input=given,
        misfit=1.0,
        hand_spread=0.0,
        spread=0.05,
        deformed=0.0,
        distance_spread=0.2,
    )


def gap_of(energy: float, apart: int = 1) -> float:
    """The energy gap where the other solution has some energy."""
    it = mug()
    T = it.candidates.T_hand_obj[[0, apart]]
    return energy_gap(replace(it, candidates=Candidates(T, np.ones(2), np.array([100.0, energy]))))


@given(st.sampled_from(FEATURES), unit, unit)
def test_a_sign_counts_in_its_direction(sign, a: float, b: float) -> None:
    low, high = sorted((a, b))
    less, more = (CALIBRATIONS["soft-hinge", "hand"].probability(USUAL | {sign.name: value}) for value in (low, high))
    assert sign.direction * (more.value - less.value) >= 0.0
    assert 0.0 <= less.value <= 1.0


@pytest.mark.slow
def test_more_energy_elsewhere_is_a_larger_gap() -> None:
    gaps = [gap_of(energy) for energy in (100.0, 101.0, 120.0, 150.0, 190.0)]
    assert gaps == sorted(gaps)
    assert gaps[0] == 0.0
    assert gaps[1] < gaps[-1]


def test_a_probable_solution_elsewhere_spreads_them() -> None:
    it = mug()
    energies = [100.0, 101.0, 105.0, 1e6]
    spreads = [
        solution_spread(replace(it, candidates=replace(it.candidates, energy=np.array([100.0, e])))) for e in energies
    ]
    assert spreads == sorted(spreads, reverse=True)
    assert np.exp(spreads[0]) == pytest.approx(0.5 * min(it.vertices_apart(1), 0.5) + 3e-3)
    assert np.exp(spreads[-1]) == pytest.approx(3e-3)


def test_solutions_are_apart_vertex_by_vertex_up_to_symmetries() -> None:
    it = mug()
    can, _ = synthesise("can", 0, SceneOptions(frames=4, size=(160, 120), focal=150.0))
    symmetries = find_symmetries(can.mesh)
    shifted = se3.rigid(None, 0.1 * can.mesh.diameter * symmetries.axes[0])
    moves = (symmetries.about(np.array([1.0])), 0.0), (symmetries.elements[-1], 0.0), (shifted, 0.1)
    for moved, far in moves:
        candidates = Candidates(np.stack([it.poses, it.poses @ moved]), np.ones(2), np.array([100.0, 101.0]))
        of_can = replace(it, clip=replace(it.clip, mesh=can.mesh), candidates=candidates)
        assert of_can.vertices_apart(1) == pytest.approx(far, abs=0.01)


def test_signs_of_the_evidence_on_a_hand_count_what_there_is() -> None:
    it = mug()
    errors = [joint_error(replace(it, joint_error=error)) for error in (0.01, 0.05, 0.1, np.nan)]
    assert errors == sorted(errors), "no joints are worse than bad ones"
    assert depth_source_level(it) == 0.0
    z, corner, stride = np.ones((4, 8, 8)), np.zeros((4, 2), dtype=int), np.ones(4, dtype=int)
    for made_by, value in (("network", 1.0), ("sensor", 2.0)):
        depth = Depth(z, corner, stride, it.clip.size, DepthSource("metric", made_by))
        with_depth = replace(it.clip, evidence={**it.clip.evidence, "depth": depth})
        assert depth_source_level(replace(it, clip=with_depth)) == value


def test_penetration_is_that_of_the_deepest_point_in_diameters() -> None:
    it = mug()
    apart, into = (replace(it, T_hand_obj=se3.rigid(None, shift) @ it.poses) for shift in np.diag([1.0, 0.02, 0.0])[:2])
    assert mean_penetration(apart) == pytest.approx(np.log(0.01))
    for one in (it, into):
        deepest = np.exp(mean_penetration(one)) - 0.01
        assert deepest == pytest.approx(np.maximum(-one.to_object.min(axis=1), 0.0).mean() / it.diameter)


def test_the_same_solution_twice_is_no_other_one() -> None:
    assert gap_of(100.0, apart=0) == gap_of(1e9)


def test_signs_of_the_truth_and_of_what_is_wrong() -> None:
    it = mug()
    away = replace(it, T_hand_obj=se3.rigid(None, np.array([0.0, 0.0, 0.1])) @ it.poses)
    assert contact_gap(it) < contact_gap(away)
    signs, worse = compute_features(it), compute_features(replace(it, misfit=2.0, spread=0.1))
    assert signs["mask-misfit"] < worse["mask-misfit"]
    assert signs["pose-spread"] < worse["pose-spread"]
    assert "pose-spread" not in compute_features(replace(it, spread=np.nan))
    shaken = it.poses @ se3.rigid(
        se3.exp_so3(0.3 * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])), np.zeros(3)
    )
    assert signs["off-axis-turn"] < compute_features(replace(it, T_hand_obj=shaken))["off-axis-turn"]


def test_what_is_seen_is_a_share_of_the_object_at_any_distance_and_size() -> None:
    """A scene of twice the size, twice as far away, looks the same; a hand before half of the mask hides it."""
    it = mug()
    T = it.clip.hand.T_cam_hand.copy()
    T[:, :3, 3] *= 2.0
    hand = replace(it.clip.hand, T_cam_hand=T, vertices=2.0 * it.clip.hand.vertices)
    mesh = Mesh(2.0 * it.clip.mesh.vertices, it.clip.mesh.faces)
    assert seen_size(replace(it, clip=replace(it.clip, hand=hand, mesh=mesh))) == pytest.approx(seen_size(it))
    half = it.masks.object & (np.cumsum(it.masks.object, axis=2) % 2 == 0)
    hidden = replace(it, masks=replace(it.masks, object=half))
    assert np.exp(seen_size(hidden)) - 0.02 == pytest.approx((np.exp(seen_size(it)) - 0.02) / np.sqrt(2.0), rel=0.05)


def test_a_rotation_about_the_axis_is_no_turn_besides_it() -> None:
    it, angle = mug(), np.linspace(0.0, 1.0, 4)
    axis = Axis(np.zeros(3), np.array([0.0, 0.6, 0.8]), angle)
    turned = se3.rotation_about_line(axis.point, axis.direction, angle) @ it.poses[:1]
    assert replace(it, T_hand_obj=turned, axis=axis).off_axis == pytest.approx(0.0, abs=1e-6)
    assert replace(it, T_hand_obj=turned).off_axis > 0.1


def test_every_sign_of_a_whole_result_is_known() -> None:
    assert compute_features(mug()).keys() == {sign.name for sign in (*FEATURES, *LIFTED_FEATURES)}


def test_signs_do_not_depend_on_where_the_camera_is() -> None:
    it = mug()
    T = se3.rigid(se3.exp_so3(np.array([0.3, -0.2, 0.1])), np.array([0.1, 0.2, 0.3]))
    moved = replace(
        it, clip=it.clip.with_hand_at(T @ it.clip.hand.T_cam_hand), T_cam_hand_input=T @ it.T_cam_hand_input
    )
    of_poses = DIRECTION.keys() - {"depth-order", "seen-size"}  # which the masks show, where the camera was
    one, other = ({name: signs[name] for name in of_poses} for signs in (compute_features(moved), compute_features(it)))
    assert one == pytest.approx(other, abs=1e-6)


def test_a_hand_that_was_corrected_far_is_a_sign() -> None:
    it, by = mug(), se3.rigid(se3.exp_so3(np.array([0.0, 0.2, 0.0])), np.array([0.01, 0.0, 0.0]))
    off = replace(it, T_cam_hand_input=it.T_cam_hand_input @ by)
    assert off.hand_turn == pytest.approx(0.2)
    assert it.hand_shift == it.hand_turn == 0.0
    assert compute_features(off)["hand-turn"] > compute_features(it)["hand-turn"]
    assert compute_features(off)["hand-shift"] > compute_features(it)["hand-shift"]


def test_an_uncertain_distance_is_a_sign() -> None:
    it = mug()
    near, far = (compute_features(replace(it, distance_spread=spread))["distance-spread"] for spread in (0.1, 0.3))
    assert near < compute_features(it)["distance-spread"] < far
    assert "distance-spread" not in compute_features(replace(it, distance_spread=np.nan))


def test_estimated_hands_without_joints_are_no_extrapolation() -> None:
    without = joint_error(mug())
    for calibration in ESTIMATED_CALIBRATIONS.values():
        assert not calibration.weights["joint-error"].beyond(without), "a limit is rounded in its file"
        assert calibration.weights["joint-error"].beyond(without + 0.01)


DIRECTION = {sign.name: sign.direction for sign in FEATURES}
USUAL = {name: 0.5 * (weight.low + weight.high) for name, weight in CALIBRATIONS["soft-hinge", "hand"].weights.items()}
