"""Landmarks in every frame become hands: distances and joints are recovered though networks err alike in all frames."""

from __future__ import annotations

import numpy as np
import pytest

from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.hands import generic
from getagrip.hands.fit_joints import Chains, PosePrior, joints_and_jacobian
from getagrip.hands.from_2d.landmarks import MAX_LANDMARK_GAP_FRAMES, LiftedHands, hands_from_landmarks
from getagrip.hands.model import Side

K = np.array([[1000.0, 0.0, 360.0], [0.0, 1000.0, 640.0], [0.0, 0.0, 1.0]])
T = 24


def moving(side: Side, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Joints before the camera [m] of a hand that turns and comes nearer, and T_cam_hand."""
    rng = np.random.default_rng(seed)
    model = generic.load(side)
    prior = PosePrior.of(model)
    grasp = prior.mean.copy()
    grasp[1:] += 0.4 * prior.axes[1:, :, 1]
    s = np.linspace(0.0, 1.0, T)[:, None]
    R = se3.exp_so3(s * rng.normal(0.0, 0.4, 3)) @ se3.exp_so3(rng.normal(0.0, 1.0, 3))
    t = np.concatenate([0.06 * (s - 0.5), 0.04 * s, 0.5 - 0.1 * s], axis=1)
    X, _ = joints_and_jacobian(Chains.of(model), np.tile(grasp, (T, 1, 1, 1)), np.zeros(len(model.shape_names)))
    pose = se3.rigid(R, t)
    return se3.transform(pose, X), pose


def landmarks(X: np.ndarray, seed: int) -> np.ndarray:
    """What a network makes of them: mostly wrong in the same way in every frame, some noise beside."""
    rng = np.random.default_rng(seed)
    return project(K, X) + rng.normal(0.0, 8.0, (21, 2)) + rng.normal(0.0, 2.0, (T, 21, 2))


def lifted_joints(found: LiftedHands) -> np.ndarray:
    assert found.hand.joints is not None
    return se3.transform(found.hand.T_cam_hand, found.hand.joints)


@pytest.mark.slow
@pytest.mark.parametrize(("side", "seed"), [("left", 0), ("right", 1)])
def test_distance_and_joints_are_recovered(side: Side, seed: int) -> None:
    X, _ = moving(side, seed)
    world = X - X.mean(axis=1, keepdims=True)
    found = hands_from_landmarks(landmarks(X, seed), np.ones((T, 21)), K, side, world[..., 2])
    assert found.rows == tuple(range(T))
    joints = lifted_joints(found)
    assert np.abs(joints[..., 2].mean(axis=1) / X[..., 2].mean(axis=1) - 1.0).max() < 0.1
    apart = np.linalg.norm(project(K, joints) - project(K, X), axis=-1)
    assert np.median(apart) < 12.0
    relative = joints - joints.mean(axis=1, keepdims=True) - world
    assert np.median(np.linalg.norm(relative, axis=-1)) < 0.012
    assert np.nanmedian(found.residuals) < 12.0


@pytest.mark.slow
def test_many_frames_do_not_outvote_the_hands_size() -> None:
    X, _ = moving("left", 0)
    found = hands_from_landmarks(landmarks(X, 5), np.ones((T, 21)), K, "left")
    assert np.abs(found.shape[0]) < 0.5
    z = found.hand.T_cam_hand[:, 2, 3]
    assert z.min() > 0.3
    assert np.abs(np.diff(np.log(z))).max() < 0.03


@pytest.mark.slow
def test_errors_of_landmarks_bring_the_hand_no_nearer() -> None:
    """They make it larger in the image, and the more so, the more fingers and palm follow them."""
    nearer = []
    for seed in range(6):
        X, rng = moving("left", seed)[0][::4], np.random.default_rng(seed)
        seen, size = project(K, X), float(np.ptp(project(K, X[0]), axis=0).max())
        errors = rng.normal(0.0, 0.06, (21, 2)) + rng.normal(0.0, 0.04, (len(X), 21, 2))
        fits = [hands_from_landmarks(seen + by * errors, np.ones((len(X), 21)), K, "left") for by in (0.0, size)]
        exact, off = (lifted_joints(fit)[..., 2].mean() for fit in fits)
        nearer.append(np.log(exact / off))
    assert np.mean(nearer) < 0.03


@pytest.mark.slow
def test_fingers_without_landmarks_bend_as_in_grasps() -> None:
    """Most at their middle joints: between knuckle and fingertip they are as long as in DexYCB's grasps, on average."""
    X, _ = moving("right", 1)
    confidence = np.zeros((T, 21))
    confidence[:, [0, 1, 2, 5, 9, 13, 17]] = 1.0
    joints = lifted_joints(hands_from_landmarks(landmarks(X, 1), confidence, K, "right"))
    chains = joints[:, 5:].reshape(T, 4, 4, 3)
    whole = np.linalg.norm(np.diff(chains, axis=2), axis=-1).sum(axis=2)
    share = np.linalg.norm(chains[:, :, 3] - chains[:, :, 0], axis=-1) / whole
    assert share.mean() == pytest.approx(0.908, abs=0.02)


@pytest.mark.slow
def test_short_gaps_are_filled_and_long_ones_stay() -> None:
    X, _ = moving("right", 1)
    points, confidence = landmarks(X, 1), np.ones((T, 21))
    confidence[4:8] = 0.0
    points[4:8] = np.nan
    confidence[10 : 10 + MAX_LANDMARK_GAP_FRAMES + 2] = 0.0
    found = hands_from_landmarks(points, confidence, K, "right")
    assert found.rows == (*range(10), *range(10 + MAX_LANDMARK_GAP_FRAMES + 2, T))


def test_too_few_landmarks_are_refused() -> None:
    with pytest.raises(UsageError, match="landmarks must be 6"):
        hands_from_landmarks(np.zeros((3, 21, 2)), np.zeros((3, 21)), K, "left")
