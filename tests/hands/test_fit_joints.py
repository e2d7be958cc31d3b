"""Fitting hands to joints: Jacobians, round trips, invariances, real joints."""

from __future__ import annotations

import numpy as np
import pytest

from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.hands import generic, umetrack
from getagrip.hands.fit_joints import (
    JOINT_ORDERS,
    Chains,
    JointFitUnknowns,
    PosePrior,
    fit_joints,
    joints_and_jacobian,
)
from getagrip.hands.generic import MANO_WRIST_M
from getagrip.hands.model import KNUCKLES, HandModel, Side, mirrored, mirrored_model
from getagrip.hands.umetrack import T_world_hand, UmeTrackHand
from helpers.environment import DATA, needs

DEXYCB = DATA / "dexycb" / "left_hand_sequences.npz"
HOT3D = DATA / "hot3d"


def likely_hands(side: Side, T: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """T_cam_hand and joints in the camera frame of hands drawn from the prior, within its limits."""
    rng = np.random.default_rng(seed)
    model, prior = generic.load(side), PosePrior.of(generic.load(side))
    own = np.stack([rng.normal(scale=0.3 * prior.spread) for _ in range(T)])
    q = prior.mean + np.einsum("fkab,tfka->tfkb", prior.axes, own)
    shape = rng.normal(scale=0.5 * model.shape_spread)
    X, _ = joints_and_jacobian(Chains.of(model), q, shape)
    T_cam_hand = se3.rigid(se3.exp_so3(rng.normal(size=(T, 3))), rng.normal([0.0, 0.0, 0.6], 0.1, size=(T, 3)))
    return T_cam_hand, se3.transform(T_cam_hand, X)


def skinned(hand: UmeTrackHand, side: Side) -> HandModel:
    """A UmeTrack hand with MANO's joint tree, in the package's hand frame; ``size`` is its only shape parameter.

    The two hinges at the root of a finger, a few millimetres apart, become one ball joint at the second.
    """
    if side == "right":
        return mirrored_model(skinned(hand, "left"))
    T_hand_wrist = se3.inverse(T_world_hand("left", np.eye(4)))
    vertices, tips = (se3.transform(T_hand_wrist, X) for X in (hand.rest.vertices, hand.tips))
    pivots = se3.transform(T_hand_wrist, hand.pivots).reshape(5, 4, 3)
    joints, weights = np.zeros((16, 3)), np.zeros((len(vertices), 16))
    joints[0], weights[:, 0] = mirrored(MANO_WRIST_M), hand.weights[:, :2].sum(axis=1)
    for n, knuckle in enumerate(KNUCKLES):
        joints[knuckle : knuckle + 3] = pivots[n, 1:]
        weights[:, knuckle : knuckle + 3] = hand.weights[:, 2 + 3 * n : 5 + 3 * n]
    return HandModel(
        name="umetrack",
        side="left",
        template=vertices,
        faces=hand.rest.faces,
        joints=joints,
        weights=weights,
        tips=np.argmin(np.linalg.norm(vertices - tips[:, None], axis=2), axis=1),
        regions=hand.regions,
        shape_names=("size",),
        shape_directions=(vertices - joints[0])[..., None],
        joint_directions=(joints - joints[0])[..., None],
        shape_spread=np.array([0.1]),
    )


def test_jacobian_against_differences() -> None:
    rng = np.random.default_rng(0)
    model = generic.load("left")
    chains, S = Chains.of(model), len(model.shape_names)
    state = JointFitUnknowns(
        np.tile(np.eye(4), (2, 1, 1)), rng.normal(scale=0.5, size=(2, 5, 3, 3)), 0.1 * rng.normal(size=S), chains.wrist
    )
    _, J = joints_and_jacobian(chains, state.q, state.shape)

    def joints(step: np.ndarray) -> np.ndarray:
        new = state.retract(np.tile(step[:51], (2, 1)), step[51:])
        return se3.transform(new.T, joints_and_jacobian(chains, new.q, new.shape)[0])

    for k, e in enumerate(1e-6 * np.eye(51 + S)):
        np.testing.assert_allclose(J[..., k], (joints(e) - joints(-e)) / 2e-6, atol=1e-8)


def test_right_jacobian_against_differences() -> None:
    rng = np.random.default_rng(1)
    for w in (rng.normal(size=3), 1e-4 * rng.normal(size=3), np.zeros(3), np.array([0.0, 3.0, 0.0])):
        for k, e in enumerate(1e-6 * np.eye(3)):
            numeric = se3.log_so3(se3.exp_so3(w).T @ se3.exp_so3(w + e)) / 1e-6
            np.testing.assert_allclose(se3.right_jacobian(w)[:, k], numeric, atol=1e-5)


def test_prior_jacobian_against_differences() -> None:
    prior = PosePrior.of(generic.load("right"))
    q = prior.mean + np.random.default_rng(2).normal(scale=1.0, size=(1, 5, 3, 3))
    _, J = prior.residuals(q)
    for k, e in enumerate(1e-6 * np.eye(45)):
        plus, minus = (prior.residuals(q + sign * e.reshape(5, 3, 3))[0] for sign in (1, -1))
        np.testing.assert_allclose(J[0, :, k], (plus - minus)[0] / 2e-6, atol=1e-6)


def test_prior_prefers_bending_to_twisting_on_either_side() -> None:
    right, left = (PosePrior.of(generic.load(side)) for side in ("right", "left"))
    for prior in (right, left):
        bend, twist = (prior.mean + 0.5 * prior.axes[:, :, a] for a in (1, 0))
        assert np.sum(prior.residuals(bend[None])[0] ** 2) < np.sum(prior.residuals(twist[None])[0] ** 2)
    np.testing.assert_allclose(left.mean, right.mean * [1.0, -1.0, -1.0], atol=1e-12)


@pytest.mark.parametrize("side", ["right", "left"])
def test_own_joints_are_found_again(side: Side) -> None:
    T_cam_hand, Y = likely_hands(side, 12, seed=3)
    fit = fit_joints(generic.load(side), Y, "openpose")
    assert fit.converged
    assert fit.residuals.mean() < 5e-4
    assert fit.residuals.max() < 4e-3  # the thumb's saddle joint counts little
    assert np.degrees(se3.angle_between(fit.hand.T_cam_hand[:, :3, :3], T_cam_hand[:, :3, :3])).max() < 3.0
    assert fit.hand.joints is not None
    found = np.linalg.norm(se3.transform(fit.hand.T_cam_hand, fit.hand.joints) - Y, axis=-1)
    np.testing.assert_allclose(found, fit.residuals, atol=1e-12)


def test_orders_name_the_same_joints() -> None:
    _, Y = likely_hands("right", 3, seed=4)
    ho3d = np.empty_like(Y)
    ho3d[:, JOINT_ORDERS["ho3d"]] = Y
    a = fit_joints(generic.load("right"), Y, "openpose")
    b = fit_joints(generic.load("right"), ho3d, "ho3d")
    np.testing.assert_array_equal(a.hand.vertices, b.hand.vertices)
    # HO-3D: index 1-3, middle 4-6, pinky 7-9, ring 10-12, thumb 13-15, tips 16 thumb, 17 index, 18, 19 ring, 20 pinky
    assert JOINT_ORDERS["ho3d"] == [0, 13, 14, 15, 16, 1, 2, 3, 17, 4, 5, 6, 18, 10, 11, 12, 19, 7, 8, 9, 20]


def test_moving_the_camera_moves_the_hand_only() -> None:
    _, Y = likely_hands("right", 5, seed=5)
    model, T = generic.load("right"), se3.rigid(se3.exp_so3(np.array([0.3, -1.0, 2.0])), np.array([0.1, 0.2, 0.3]))
    a, b = fit_joints(model, Y, "openpose"), fit_joints(model, se3.transform(T, Y), "openpose")
    np.testing.assert_allclose(b.hand.vertices, a.hand.vertices, atol=1e-6)
    np.testing.assert_allclose(b.hand.T_cam_hand, T @ a.hand.T_cam_hand, atol=1e-6)


def test_a_mirrored_hand_is_fitted_by_the_other_model() -> None:
    _, Y = likely_hands("right", 5, seed=6)
    right = fit_joints(generic.load("right"), Y, "openpose")
    left = fit_joints(generic.load("left"), mirrored(Y), "openpose")
    np.testing.assert_allclose(left.hand.vertices, mirrored(right.hand.vertices), atol=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda Y: Y[:, :20], "shape"),
        (lambda Y: Y[:0], "shape"),
        (lambda Y: np.where(np.arange(3) == 1, np.nan, Y), "NaN"),
        (lambda Y: 1e3 * Y, "metre"),
        (lambda Y: 0.0 * Y, "metre"),
    ],
)
def test_bad_joints_are_refused(change, message) -> None:  # type: ignore[no-untyped-def]
    _, Y = likely_hands("right", 2, seed=7)
    with pytest.raises(UsageError, match=message):
        fit_joints(generic.load("right"), change(Y), "openpose")
    with pytest.raises(UsageError, match="order"):
        fit_joints(generic.load("right"), Y, "mediapipe")  # type: ignore[arg-type]


@needs(DEXYCB)
@pytest.mark.slow
def test_real_joints_are_met_within_millimetres() -> None:
    with np.load(DEXYCB, allow_pickle=False) as data:
        joints, valid, offset = data["joints"].astype(float), data["hand_valid"], data["offset"]
    for n in (0, 40, 80, 120):
        frames = np.arange(offset[n], offset[n + 1])
        fit = fit_joints(generic.load("left"), joints[frames[valid[frames]]], "ho3d")
        assert fit.converged
        assert fit.residuals.mean() < 0.003
        assert np.abs(fit.shape).max() < 0.6


@needs(HOT3D)
@pytest.mark.parametrize("side", ["right", "left"])
def test_umetrack_hands_fit_like_any_other(side: Side) -> None:
    for profile in HOT3D.rglob("umetrack_hand_user_profile.json"):
        hand = umetrack.load(profile)
        model = skinned(hand, side)
        rest, flat = hand.with_pose(side, np.zeros(22)), model.with_shape().with_pose()
        np.testing.assert_allclose(flat.vertices, rest.vertices, atol=1e-9)
        np.testing.assert_allclose(flat.joints, rest.joints, atol=1e-9)
        angles = np.zeros((4, 22))
        angles[:, [2, 3, 6, 7, 10, 11, 14, 15, 18, 19]] = np.linspace(0.1, 0.9, 4)[:, None]
        bent = hand.with_pose(side, angles)
        fit = fit_joints(model, bent.joints + np.array([0.0, 0.0, 0.5]), "openpose")
        assert fit.residuals.mean() < 0.002
        assert np.linalg.norm(fit.hand.vertices - bent.vertices, axis=-1).mean() < 0.004
