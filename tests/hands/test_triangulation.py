"""Joints seen by several cameras: triangulated, without those of which a view is wrong, and a hand moved to them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy import ndarray

from getagrip.clip import HandTrack
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.hands import generic
from getagrip.hands.from_2d.triangulation import SeenJoints, align_hand, refit_fingers, triangulate_joints
from getagrip.hands.model import hand_track

N_FRAMES = 4
K = np.tile([[600.0, 0.0, 320.0], [0.0, 600.0, 240.0], [0.0, 0.0, 1.0]], (N_FRAMES, 1, 1))


@pytest.fixture(scope="module")
def hand() -> HandTrack:
    posed = generic.load("right").with_shape().with_pose(np.tile(0.2 * np.sin(np.arange(45)), (N_FRAMES, 1)))
    n = np.arange(N_FRAMES)[:, None]
    return hand_track(posed, se3.rigid(se3.exp_so3(0.1 * n + [0.4, 0.2, 0.0]), 0.01 * n + [0.0, 0.05, 0.8]))


def joints_of(hand: HandTrack) -> ndarray:
    assert hand.joints is not None
    return se3.transform(hand.T_cam_hand, hand.joints)


def seen_by(X: ndarray, angle: float, confidence: float = 0.9) -> SeenJoints:
    """From a camera that is turned about the hand's place."""
    R = se3.exp_so3(np.array([0.0, -angle, 0.0]))
    middle = np.array([0.0, 0.0, 0.8])
    T = np.tile(se3.rigid(R, middle - R @ middle), (N_FRAMES, 1, 1))
    return SeenJoints(project(K, se3.transform(se3.inverse(T), X)), np.full((N_FRAMES, 21), confidence), K, T)


def test_joints_are_where_their_rays_meet(hand: HandTrack) -> None:
    X = joints_of(hand)
    for angles in ((0.0, 1.2), (0.0, 1.2, -1.0)):
        np.testing.assert_allclose(triangulate_joints([seen_by(X, angle) for angle in angles]), X, atol=1e-9)


def test_what_one_view_does_not_see_or_guesses_wrongly_is_left_out(hand: HandTrack) -> None:
    X = joints_of(hand)
    one, two, three = (seen_by(X, angle) for angle in (0.0, 1.2, -1.0))
    unseen = replace(two, confidence=two.confidence.copy())
    unseen.confidence[1, 3] = 0.1
    known = np.isfinite(triangulate_joints([one, unseen])).all(axis=-1)
    assert np.argwhere(~known).tolist() == [[1, 3]]
    wrong = replace(three, points=three.points + 0.0)
    wrong.points[2, 5] += 80.0
    np.testing.assert_allclose(triangulate_joints([one, two, wrong]), X, atol=1e-9)
    wrong = replace(two, points=two.points + 0.0)
    wrong.points[0, 7, 1] += 80.0
    assert not np.isfinite(triangulate_joints([one, wrong])[0, 7]).any()


def test_cameras_that_look_along_one_line_tell_no_distance(hand: HandTrack) -> None:
    X = joints_of(hand)
    assert np.isnan(triangulate_joints([seen_by(X, 0.0), seen_by(X, 0.05)])).all()


def test_a_hand_of_a_wrong_size_and_distance_gets_the_true_ones(hand: HandTrack) -> None:
    """As one view sees it: smaller and nearer, turned a little; joints of the network are some millimetres off."""
    X, noise = joints_of(hand), np.random.default_rng(0).normal(0.0, 0.004, (N_FRAMES, 21, 3))
    assert hand.joints is not None
    T = hand.T_cam_hand.copy()
    T[:, :3, 3] *= 0.85
    T[:, :3, :3] = se3.exp_so3(np.array([0.15, 0.0, 0.1])) @ T[:, :3, :3]
    lifted = replace(hand, vertices=0.85 * hand.vertices, joints=0.85 * hand.joints, T_cam_hand=T)
    found = align_hand(lifted, X + noise)
    assert found is not None
    assert found.aligned.all()
    assert abs(0.85 * found.scale - 1.0) < 0.02
    assert np.linalg.norm(joints_of(found.hand) - X, axis=-1).max() < 0.006
    assert found.moved.min() > 0.05


def test_frames_with_few_joints_keep_the_hands_image(hand: HandTrack) -> None:
    X = 1.1 * joints_of(hand)
    X[2, 5:] = np.nan
    found = align_hand(hand, X)
    assert found is not None
    assert found.aligned.tolist() == [True, True, False, True]
    np.testing.assert_allclose(project(K, joints_of(found.hand)), project(K, joints_of(hand)), atol=1e-6)
    np.testing.assert_allclose(joints_of(found.hand), 1.1 * joints_of(hand), atol=1e-9)


def test_fingers_are_where_joints_were_triangulated(hand: HandTrack) -> None:
    """An open hand, as one view took it for, is bent as the true one; joints that are not known stay beside it."""
    X, flat = joints_of(hand), generic.load("right").with_shape().with_pose(np.zeros((N_FRAMES, 45)))
    aligned = align_hand(hand_track(flat, hand.T_cam_hand), X)
    assert aligned is not None
    seen = replace(aligned.hand, joints_2d=np.ones((N_FRAMES, 21, 2)), joints_2d_confidence=np.ones((N_FRAMES, 21)))
    before = np.linalg.norm(joints_of(seen) - X, axis=-1)
    X_seen = X.copy()
    X_seen[:, [8, 12]] = np.nan
    found = refit_fingers(seen, X_seen, "right")
    off = np.linalg.norm(joints_of(found) - X, axis=-1)
    assert np.delete(off, [8, 12], axis=1).mean() < 0.5 * np.delete(before, [8, 12], axis=1).mean()
    assert off.max() < 0.03
    np.testing.assert_array_equal(found.joints_2d, seen.joints_2d)


def test_no_hand_has_such_a_size(hand: HandTrack) -> None:
    X = joints_of(hand)
    assert align_hand(hand, 3.0 * X) is None
    assert align_hand(hand, np.full_like(X, np.nan)) is None
    assert align_hand(replace(hand, joints=None, joints_2d=None, joints_2d_confidence=None), X) is None
