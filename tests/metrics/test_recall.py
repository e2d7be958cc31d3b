"""AUC, MSSD and MSPD: known answers, and plain loops over all vertices and symmetries."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.geometry.mesh import Mesh
from getagrip.metrics.pose import (
    MSPD_THRESHOLDS_PX,
    MSSD_THRESHOLDS,
    ObjectTrack,
    SymmetricErrors,
    all_symmetries,
    area_under_curve,
    nearest_add,
    recall_at_thresholds,
)
from getagrip.metrics.symmetry import find_symmetries

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
