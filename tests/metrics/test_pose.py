"""Errors of poses up to symmetries, and recalls over thresholds: known answers, laws and plain loops."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.geometry.mesh import Mesh
from getagrip.metrics.contact import signed_distance
from getagrip.metrics.pose import (
    ADD_SUCCESS_FRACTION,
    MSPD_THRESHOLDS_PX,
    MSSD_THRESHOLDS,
    VSD_TOLERANCES,
    VSD_VISIBILITY_TOLERANCE_M,
    ObjectTrack,
    PoseErrors,
    SymmetricErrors,
    all_symmetries,
    area_under_curve,
    best_symmetry,
    discrepancy,
    nearest_add,
    pose_errors,
    ray_lengths,
    recall_at_thresholds,
    vsd_recall,
)
from getagrip.metrics.symmetry import Symmetries, find_symmetries, surface_points
from getagrip.synthetic import objects

seeds = st.integers(0, 2**32 - 1)
MUG, BOTTLE, CAN, BOX = objects.mug(), objects.bottle(), objects.can(), objects.box()


@cache
def can_symmetries() -> Symmetries:
    return find_symmetries(CAN)


def poses(rng: np.random.Generator, frames: int = 4) -> np.ndarray:
    return se3.rigid(se3.exp_so3(rng.normal(size=(frames, 3))), rng.normal(scale=0.1, size=(frames, 3)))


def moved(mesh: Mesh, rng: np.random.Generator, scale: float = 1.0) -> Mesh:
    return Mesh(scale * se3.transform(poses(rng, 1)[0], mesh.vertices), mesh.faces)


@given(seeds, st.floats(0.5, 2.0))
def test_a_perfect_prediction_has_no_error(seed: int, scale: float) -> None:
    track = ObjectTrack(poses(np.random.default_rng(seed)), scale)
    errors = pose_errors(MUG, track, track)
    assert errors.add.max() < 1e-12
    assert errors.rotation.max() < 1e-6
    assert errors.success
    assert errors.diameter == pytest.approx(scale * MUG.diameter)


@given(seeds, st.floats(1e-4, 0.1))
def test_add_of_a_translation_is_its_length(seed: int, length: float) -> None:
    rng = np.random.default_rng(seed)
    T = poses(rng)
    step = rng.normal(size=3)
    there = se3.rigid(t=length * step / np.linalg.norm(step)) @ T
    errors = pose_errors(MUG, ObjectTrack(there, 1.0), ObjectTrack(T, 1.0))
    np.testing.assert_allclose(errors.add, length)
    np.testing.assert_allclose(errors.translation, length)
    assert errors.rotation.max() < 1e-6
    assert errors.success == (length < ADD_SUCCESS_FRACTION * MUG.diameter)


@given(seeds, st.floats(0.0, 3.1))
def test_a_turn_about_the_centre_is_a_rotation_error_only(seed: int, angle: float) -> None:
    rng = np.random.default_rng(seed)
    T, axis = poses(rng), rng.normal(size=3)
    turn = se3.rotation_about_line(MUG.centre, axis / np.linalg.norm(axis), np.asarray(angle))
    errors = pose_errors(MUG, ObjectTrack(T @ turn, 1.0), ObjectTrack(T, 1.0))
    np.testing.assert_allclose(errors.rotation, angle, atol=1e-6)
    assert errors.translation.max() < 1e-9


def test_a_wrong_scale_counts_in_add() -> None:
    true, large = ObjectTrack(np.eye(4)[None], 1.0), ObjectTrack(np.eye(4)[None], 1.5)
    errors = pose_errors(MUG, large, true)
    assert errors.add[0] == pytest.approx(0.5 * np.linalg.norm(MUG.vertices, axis=1).mean())
    assert errors.diameter == MUG.diameter


@given(seeds)
def test_the_hand_frame_does_not_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    P, Q, G = poses(rng), poses(rng), poses(rng, 1)
    here = pose_errors(BOX, ObjectTrack(P, 1.1), ObjectTrack(Q, 1.0))
    there = pose_errors(BOX, ObjectTrack(G @ P, 1.1), ObjectTrack(G @ Q, 1.0))
    for name in ("add", "rotation", "translation"):
        np.testing.assert_allclose(getattr(here, name), getattr(there, name), atol=1e-9)


def test_one_bad_frame_fails_a_frame_but_not_the_sequence() -> None:
    T = np.tile(np.eye(4), (10, 1, 1))
    off = T.copy()
    off[3, 0, 3] = 0.2 * MUG.diameter
    errors = pose_errors(MUG, ObjectTrack(off, 1.0), ObjectTrack(T, 1.0))
    assert errors.success
    assert errors.frame_success.mean() == pytest.approx(0.9)


@pytest.mark.parametrize(
    ("add", "success", "frames"),
    [
        ([0.0, 0.0, 0.0, 0.41], False, 0.75),  # most frames right, the mean is not
        ([0.0, 0.12, 0.12, 0.12], True, 0.25),  # most wrong, the mean right
        ([0.1, 0.1], False, 0.0),  # at the limit, which is no success
    ],
)
def test_success_is_by_the_mean_over_frames(add: list[float], success: bool, frames: float) -> None:
    """And by no other average: the frames' ADD is given in diameters."""
    n = len(add)
    errors = PoseErrors(np.array(add) * 0.5, np.zeros(n), np.zeros(n), diameter=0.5)
    assert errors.success == success
    assert errors.frame_success.mean() == frames


def test_surface_points_are_spread_by_area() -> None:
    points = surface_points(CAN, 4000)
    assert np.abs(signed_distance(points, CAN.vertices, CAN.faces)).max() < 1e-9
    corners = CAN.vertices[CAN.faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    above = area[corners.mean(axis=1)[:, 2] > 0.02].sum() / area.sum()
    assert np.mean(points[:, 2] > 0.02) == pytest.approx(above, abs=0.02)


@pytest.mark.parametrize(
    ("mesh", "expected"),
    [
        (MUG, "none"),
        (objects.cup(), "none"),
        (objects.pan(), "none"),
        (objects.kettle(), "none"),
        (objects.spoon(), "none"),
        (objects.ketchup(), "180 degrees"),
        (BOX, "180, 180, 180 degrees"),
        (BOTTLE, "continuous"),
        (objects.bowl(), "continuous"),
        (objects.plate(), "continuous"),
        (CAN, "continuous, flips"),
    ],
)
@pytest.mark.slow
def test_symmetries_of_known_objects(mesh: Mesh, expected: str) -> None:
    assert find_symmetries(mesh).describe() == expected
    assert find_symmetries(moved(mesh, np.random.default_rng(1), scale=0.7)).describe() == expected


@pytest.mark.slow
def test_a_cube_has_24_turns_and_a_ball_all() -> None:
    cube = trimesh.creation.box((0.05, 0.05, 0.05)).subdivide().subdivide()
    assert len(find_symmetries(Mesh(np.array(cube.vertices), np.array(cube.faces))).elements) == 24
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.04)
    found = find_symmetries(Mesh(np.array(ball.vertices), np.array(ball.faces)))
    assert found.describe() == "ball"
    assert len(found.axes) == 3


@pytest.mark.parametrize("height", [0.015, 0.12])
def test_a_square_box_has_8_turns_however_its_cad_is_turned(height: float) -> None:
    """Flat or long, two of its principal axes are not unique."""
    box = trimesh.creation.box((0.05, 0.05, height)).subdivide().subdivide()
    turn = se3.exp_so3(np.array([0.0, 0.0, 0.4]))
    found = find_symmetries(Mesh(np.array(box.vertices) @ turn.T, np.array(box.faces)))
    assert found.describe() == "90, 90, 180, 180, 180, 180, 180 degrees"


@pytest.mark.slow
def test_symmetries_map_the_surface_onto_itself() -> None:
    for mesh in (BOX, CAN, objects.ketchup()):
        symmetries = find_symmetries(mesh)
        turns = symmetries.about(np.full(len(symmetries.axes), 0.3)) @ symmetries.elements
        for T in turns:
            assert se3.is_rigid(T)
            distance = signed_distance(se3.transform(T, surface_points(mesh, 200)), mesh.vertices, mesh.faces)
            assert np.abs(distance).mean() < 0.015 * mesh.diameter


@settings(max_examples=10, deadline=None)
@given(seeds, st.floats(0.3, 2.8), st.floats(0.8, 1.2))
@pytest.mark.slow
def test_an_invisible_rotation_is_no_error(seed: int, angle: float, scale: float) -> None:
    symmetries = can_symmetries()
    T = poses(np.random.default_rng(seed))
    turn = symmetries.about(np.array([angle])) @ symmetries.elements[-1]
    turn[:3, 3] *= scale
    predicted, true = ObjectTrack(T @ turn, scale), ObjectTrack(T, scale)
    best = best_symmetry(CAN, predicted, true, symmetries)
    assert not pose_errors(CAN, predicted, true).success
    assert pose_errors(CAN, predicted, true, best).add.max() < 1e-4 * CAN.diameter
    assert pose_errors(CAN, predicted, true, best).rotation.max() < 1e-3


@pytest.mark.slow
def test_a_half_turn_of_a_box_is_forgiven_and_of_a_mug_is_not() -> None:
    T, half = poses(np.random.default_rng(0)), np.diag([-1.0, -1.0, 1.0, 1.0])
    for mesh, forgiven in ((BOX, True), (MUG, False)):
        predicted, true = ObjectTrack(T @ half, 1.0), ObjectTrack(T, 1.0)
        best = best_symmetry(mesh, predicted, true, find_symmetries(mesh))
        assert not pose_errors(mesh, predicted, true).success
        assert pose_errors(mesh, predicted, true, best).success == forgiven


def test_one_symmetry_serves_all_frames() -> None:
    """A bottle that spins in the hand while it should be still is an error, though no single frame shows it."""
    T = poses(np.random.default_rng(0), 8)
    symmetries = find_symmetries(BOTTLE)
    spinning = T @ symmetries.about(np.linspace(0.0, 3.0, 8)[:, None])
    best = best_symmetry(BOTTLE, ObjectTrack(spinning, 1.0), ObjectTrack(T, 1.0), symmetries)
    errors = pose_errors(BOTTLE, ObjectTrack(spinning, 1.0), ObjectTrack(T, 1.0), best)
    assert np.ptp(errors.rotation) > 1.0
    assert errors.add.mean() > 0.01
    still = pose_errors(BOTTLE, ObjectTrack(spinning[:1], 1.0), ObjectTrack(T[:1], 1.0))
    assert still.add[0] < 1e-6


@pytest.mark.slow
def test_the_turn_of_a_ball_is_never_an_error() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.04)
    mesh = Mesh(ball.vertices + np.array([0.01, 0.0, 0.0]), np.array(ball.faces))
    T = poses(np.random.default_rng(2))
    turn = se3.rotation_about_line(mesh.centre, np.array([0.6, 0.0, 0.8]), np.asarray(1.234))
    predicted, true = ObjectTrack(T @ turn, 1.0), ObjectTrack(T, 1.0)
    best = best_symmetry(mesh, predicted, true, find_symmetries(mesh))
    assert pose_errors(mesh, predicted, true, best).add.max() < 1e-3 * mesh.diameter


K = np.tile(np.array([[600.0, 0.0, 320.0], [0.0, 600.0, 240.0], [0.0, 0.0, 1.0]]), (3, 1, 1))


def box() -> Mesh:
    made = trimesh.creation.box((0.04, 0.06, 0.1)).subdivide()
    return Mesh(np.asarray(made.vertices), np.asarray(made.faces, np.int64))


def track(seed: int) -> ObjectTrack:
    rng = np.random.default_rng(seed)
    shift = np.array([0.0, 0.0, 0.6]) + rng.normal(0.0, 0.03, (3, 3))
    return ObjectTrack(se3.rigid(se3.exp_so3(rng.normal(size=(3, 3))), shift), 1.1)


@pytest.mark.parametrize("seed", range(3))
def test_symmetric_errors_are_those_of_plain_loops(seed: int) -> None:
    mesh, predicted, true = box(), track(seed), track(seed + 10)
    errors = SymmetricErrors.of(mesh, predicted, true, find_symmetries(mesh))
    assert len(errors.symmetries) == 4
    in_space, in_image = [], []
    for n in range(3):
        P = se3.transform(predicted.T_ref_obj[n], 1.1 * mesh.vertices)
        each = [se3.transform(true.T_ref_obj[n], 1.1 * se3.transform(S, mesh.vertices)) for S in errors.symmetries]
        in_space.append(min(np.linalg.norm(P - Q, axis=1).max() for Q in each))
        in_image.append(min(np.linalg.norm(project(K[n], P) - project(K[n], Q), axis=1).max() for Q in each))
    np.testing.assert_allclose(errors.mssd(), in_space)
    np.testing.assert_allclose(errors.mspd(K), in_image)


def test_a_symmetry_is_no_error() -> None:
    mesh, true = box(), track(1)
    for S in find_symmetries(mesh).elements:
        errors = SymmetricErrors.of(mesh, ObjectTrack(true.T_ref_obj @ _scaled(S), 1.1), true, find_symmetries(mesh))
        assert errors.mssd().max() < 1e-6


def _scaled(S: np.ndarray) -> np.ndarray:
    out = S.copy()
    out[:3, 3] *= 1.1
    return out


def test_a_cylinder_may_turn_about_its_axis_by_less_than_the_step_of_angles() -> None:
    made = trimesh.creation.cylinder(0.03, 0.1, sections=64)
    mesh, true = Mesh(np.asarray(made.vertices), np.asarray(made.faces, np.int64)), track(2)
    found = find_symmetries(mesh)
    turned = ObjectTrack(true.T_ref_obj @ se3.rigid(se3.exp_so3(np.array([0.0, 0.0, 1.234]))), 1.1)
    assert len(all_symmetries(found)) == 2 * 72
    assert SymmetricErrors.of(mesh, turned, true, found).mssd().max() < 1.1 * 0.03 * np.radians(2.5) + 1e-4


def test_the_area_is_that_of_the_curve_of_recall() -> None:
    error = np.random.default_rng(0).uniform(0.0, 0.2, 50)
    thresholds = (np.arange(20000) + 0.5) / 20000 * 0.1
    curve = np.mean(error[:, None] < thresholds)
    assert area_under_curve(error).mean() == pytest.approx(curve, abs=1e-4)


def test_add_s_is_the_mean_distance_to_the_nearest() -> None:
    P, Q = np.random.default_rng(1).normal(size=(2, 3, 40, 3))
    apart = np.linalg.norm(Q[:, :, None] - P[:, None], axis=-1).min(axis=2).mean(axis=1)
    np.testing.assert_allclose(nearest_add(P, Q), apart)


def test_recall_counts_thresholds() -> None:
    np.testing.assert_allclose(recall_at_thresholds(np.array([0.0, 0.12, 9.0]), np.array([0.1, 0.2])), [1.0, 0.5, 0.0])


def test_thresholds_are_bops() -> None:
    """Ten each, evenly up to half the diameter and 50 px; the last is no success."""
    for thresholds, last in ((MSSD_THRESHOLDS, 0.5), (MSPD_THRESHOLDS_PX, 50.0)):
        expected = [1.0, 0.8, 0.1, 0.0]
        np.testing.assert_allclose(recall_at_thresholds(last * np.array([0.0, 0.24, 0.94, 1.0]), thresholds), expected)


TOLERANCES = VSD_TOLERANCES * 0.1


def plain(predicted: np.ndarray, true: np.ndarray, scene: np.ndarray, tolerance: float) -> float:
    """BOP's definition, one pixel after the other."""
    cost = count = 0
    for p, t, s in zip(predicted.flat, true.flat, scene.flat, strict=True):
        visible_true = t > 0 and (s == 0 or t - s <= VSD_VISIBILITY_TOLERANCE_M)
        visible = p > 0 and (s == 0 or p - s <= VSD_VISIBILITY_TOLERANCE_M or visible_true)
        count += visible or visible_true
        cost += (visible or visible_true) and not (visible and visible_true and abs(p - t) < tolerance)
    return cost / count if count else 1.0


@pytest.mark.parametrize("seed", range(5))
def test_it_is_the_plain_definition(seed: int) -> None:
    rng = np.random.default_rng(seed)
    true = 0.5 + 0.01 * rng.normal(size=(6, 8))
    predicted, scene = true + 0.03 * rng.normal(size=true.shape), true + 0.02 * rng.normal(size=true.shape)
    for image in (true, predicted, scene):
        image[rng.random(true.shape) < 0.3] = 0.0
    expected = [plain(predicted, true, scene, tolerance) for tolerance in TOLERANCES]
    np.testing.assert_allclose(discrepancy(predicted, true, scene, TOLERANCES), expected)


def test_the_true_pose_has_none_and_one_elsewhere_is_all_wrong() -> None:
    true, elsewhere, scene = np.zeros((3, 4, 6))
    true[:, :2], elsewhere[:, 4:] = 0.5, 0.5
    assert vsd_recall(discrepancy(true, true, scene, TOLERANCES)) == 1.0
    assert vsd_recall(discrepancy(elsewhere, true, scene, TOLERANCES)) == 0.0
    np.testing.assert_array_equal(discrepancy(np.zeros((4, 6)), np.zeros((4, 6)), scene, TOLERANCES), 1.0)


def test_what_is_behind_the_scene_does_not_count() -> None:
    true, predicted, scene = np.full((2, 2), 0.5), np.full((2, 2), 0.5), np.zeros((2, 2))
    predicted[0], scene[0] = 0.6, 0.3  # wrong, behind a hand
    assert discrepancy(predicted, true, scene, TOLERANCES).max() == 0.0


def test_rays_are_as_long_as_points_of_depth_one_are_far() -> None:
    K = np.array([[50.0, 0.0, 3.0], [0.0, 60.0, 2.5], [0.0, 0.0, 1.0]])
    u, v = np.meshgrid(np.arange(4) + 0.5, np.arange(5) + 0.5)
    points = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(K).T
    np.testing.assert_allclose(ray_lengths(K, (4, 5)), np.linalg.norm(points, axis=-1))


def test_recall_is_over_bops_tolerances_and_thresholds() -> None:
    np.testing.assert_allclose(VSD_TOLERANCES, np.linspace(0.05, 0.5, 10))
    assert vsd_recall(np.array([0.0, 0.12, 0.47, 0.5])) == pytest.approx((1.0 + 0.8 + 0.1) / 4)
