"""The study: grasps with known answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from getagrip.geometry import se3
from getagrip.readers.datasets.dexycb.dexycb_clips import DexYcb
from getagrip.stable_grasps.axis import mean_rotation, rotation_hinge
from getagrip.stable_grasps.definition import Definition
from getagrip.stable_grasps.find import PairwiseIou
from getagrip.stable_grasps.study import (
    NORMALISED_TIMES,
    STUDY_MEASURES,
    Spread,
    fingertip_motion,
    mean_contact_iou,
    mean_curves,
    study,
)
from helpers.environment import DATA, needs
from helpers.scenes import turning, unit

DEFINITION = Definition(tau=0.3, contact=0.005, shortest=10)


@pytest.mark.slow
def test_a_grasp_with_known_answers() -> None:
    (found,) = study(turning(), DEFINITION)
    assert (found.clip, found.start, found.end) == ("turning", 0, 29)
    assert found.duration == pytest.approx(1.0)
    angle = np.linspace(-0.1, 0.1, 50)[:30]
    # The chordal mean of turns about one axis is the mean angle's turn, all but exactly.
    assert found.inside["static_rotation"] == pytest.approx(np.abs(angle - angle.mean()).mean(), rel=1e-3)
    assert found.turned == pytest.approx(np.ptp(angle), rel=1e-6)
    assert found.inside["contact_iou"] > 0.3
    for name in ("one_dof_rotation", "free_rotation", "free_place", "at_hand_rotation", "at_hand_place"):
        assert found.inside[name] < 1e-6
        assert found.outside[name] > 0.05
    assert found.outside["contact_iou"] == 0.0
    assert abs(found.hinge.direction[0]) == pytest.approx(1.0)
    assert found.inside["fingers_moved"] < 1e-9
    assert found.outside["fingers_turned"] < 1e-9
    curve = found.curves["static_rotation"]
    assert np.isnan(curve[NORMALISED_TIMES < 0.0]).all()
    assert np.isfinite(curve[NORMALISED_TIMES >= 0.0]).all()
    assert curve[np.argmin(np.abs(NORMALISED_TIMES - 1.0))] == pytest.approx(abs(angle[-1] - angle.mean()), rel=1e-3)


@pytest.mark.slow
def test_moving_hand_and_object_together_changes_nothing() -> None:
    clip = turning()
    rng = np.random.default_rng(1)
    G = se3.rigid(se3.exp_so3(rng.normal(size=(50, 3))), rng.normal(size=(50, 3)))
    moved = replace(clip.truth, T_cam_hand=G @ clip.truth.T_cam_hand, T_cam_obj=G @ clip.truth.T_cam_obj)
    (one,), (other,) = study(clip, DEFINITION), study(replace(clip, truth=moved), DEFINITION)
    for name in STUDY_MEASURES:
        assert one.inside[name] == pytest.approx(other.inside[name], abs=1e-5)


def test_fingers_that_turn_and_move_by_known_amounts() -> None:
    rng = np.random.default_rng(2)
    points = 0.01 * rng.normal(size=(12, 3))
    points -= points.mean(axis=0)
    angle = np.array([0.0, 0.0, 0.0, 0.3, -0.5])
    T = se3.rigid(se3.exp_so3(angle[:, None] * unit(rng)), np.array([0.0, 0.0, 0.0, 0.02, 0.03])[:, None] * unit(rng))
    vertices = se3.transform(T, points)
    turned, moved = fingertip_motion(vertices, [np.arange(12)] * 5, slice(0, 3))
    np.testing.assert_allclose(turned, np.abs(angle), atol=1e-6)
    np.testing.assert_allclose(moved, [0.0, 0.0, 0.0, 0.02, 0.03], atol=1e-9)
    turned, moved = fingertip_motion(vertices, [np.arange(12), np.arange(2)], slice(0, 3))
    assert np.isnan(turned).all()
    assert np.isfinite(moved).all()


def test_contact_is_compared_with_all_other_frames_of_the_grasp() -> None:
    contact = np.random.default_rng(3).random((9, 20)) < 0.4
    found = mean_contact_iou(PairwiseIou.of(contact), slice(1, 9), slice(3, 7))
    for n, value in zip(range(1, 9), found, strict=True):
        others = [k for k in range(3, 7) if k != n]
        ious = [np.sum(contact[n] & contact[k]) / np.sum(contact[n] | contact[k]) for k in others]
        assert value == pytest.approx(np.mean(ious))
    assert np.isnan(mean_contact_iou(np.eye(2), slice(0, 1), slice(0, 1))).all()


@pytest.mark.slow
def test_spread_leaves_out_what_has_no_value() -> None:
    assert Spread.of([1.0, np.nan, 3.0]) == Spread(2.0, 1.0, 1.5, 2.0, 2.5, 2)
    assert Spread.of([np.nan]).grasps == 0
    grasps = study(turning(), DEFINITION)
    curves = mean_curves([*grasps, *grasps])
    assert {spread.grasps for spread in curves["contact_iou"]} == {0, 2}
    assert len(curves["contact_iou"]) == len(NORMALISED_TIMES)


@needs(DATA / "dexycb")
@pytest.mark.slow
def test_a_real_sequence() -> None:
    source = DexYcb(root=DATA / "dexycb", meshes=DATA / "ycb", whole=True).sources()[0]
    (track,) = source.read(lambda _: None)
    assert len(track) > 40
    assert np.all(np.diff(track.numbers) == 1)
    R = (se3.inverse(track.hand.T_cam_hand) @ track.T_cam_obj)[-25:, :3, :3]
    hinge = rotation_hinge(R, np.zeros((25, 3)))
    off = se3.angle_between(hinge.nearest(R, np.zeros((25, 3)))[0], R).mean()
    assert 0.0 < off < se3.angle_between(mean_rotation(R), R).mean()
