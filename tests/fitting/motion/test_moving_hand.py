"""A hand solved with its object: Jacobian, prior, the fixed hand, and hand and object found together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy import ndarray

from getagrip.clip import HandTrack, with_masks
from getagrip.fitting.energy import HandInCamera, InHand, ObjectWithHand, OnHand, Term
from getagrip.fitting.energy.contact_consistency import ContactConsistencyTerm
from getagrip.fitting.energy.homan_terms import ReprojectionTerm
from getagrip.fitting.motion import Fixed, Frozen, HandPrior, Hinge, MovingHand, PosesInHand, Soft
from getagrip.fitting.objective import mask_energy
from getagrip.fitting.options import Options
from getagrip.fitting.problem import prepare_problem
from getagrip.fitting.solver.solve import evaluate, jacobian_in_camera, minimise, poses_in_camera
from getagrip.geometry import camera, se3
from getagrip.hands import generic
from getagrip.hands.model import hand_track
from getagrip.least_squares import DampingRules
from getagrip.synthetic.noise import Noise, noisy_hand
from getagrip.synthetic.scene import synthesise
from getagrip.synthetic.scene_options import SceneOptions
from helpers.terms import some_term

B, N = 2, 4
CONSTANT, OWN = np.repeat([0.02, 0.3, 0.03, 0.1], [3, 3, 1, 1]), np.repeat([0.01, 0.1, 0.01], [3, 3, 1])


def hand_before_the_camera(rng: np.random.Generator) -> HandTrack:
    T = se3.rigid(se3.exp_so3(rng.normal(size=(N, 3))), np.array([0.0, 0.0, 0.5]) + rng.normal(0.0, 0.02, (N, 3)))
    model = generic.load("right")
    return hand_track(model.with_shape(np.zeros(len(model.shape_names))).with_pose(np.zeros(45)), T)


def soft_hinge(rng: np.random.Generator) -> Soft[Hinge]:
    direction = rng.normal(size=(B, 3))
    hinge = Hinge(
        R=se3.exp_so3(rng.normal(size=(B, 3))),
        centre=rng.normal(0.0, 0.05, (B, 3)),
        log_scale=rng.normal(0.0, 0.1, B),
        point=rng.normal(0.0, 0.05, (B, 3)),
        direction=direction / np.linalg.norm(direction, axis=1, keepdims=True),
        angle=rng.normal(0.0, 0.5, (B, N)),
        free_scale=True,
        ridge=2.0,
    )
    return Soft(hinge, rng.normal(0.0, 0.1, (B, N, 6)), (3.0, 5.0))


def moving(
    rng: np.random.Generator, constant: ndarray = CONSTANT, own: ndarray = OWN, memory: float = 0.0
) -> tuple[MovingHand[Soft[Hinge]], ndarray]:
    """A soft hinge in a hand with random errors, and the given hand's poses."""
    hand = hand_before_the_camera(rng)
    assumed = HandPrior.of(hand, constant, own, 30.0, memory)
    still = MovingHand.around(soft_hinge(rng), assumed)
    errors = rng.normal(size=(B, len(constant))) * constant, rng.normal(size=(B, N, len(own))) * own
    return replace(still, constant=errors[0], own=errors[1]), hand.T_cam_hand


def step_between(here: ObjectWithHand, there: ObjectWithHand) -> ndarray:
    """The local vectors (B, N, 21) that take one to the other."""
    parts = []
    for a, b in ((here, there), (here.hand, there.hand), (here.in_hand, there.in_hand)):
        scale = np.broadcast_to(np.log(b.scale / a.scale)[:, None, None], (B, N, 1))
        parts += [b.centre - a.centre, se3.log_so3(b.R @ np.swapaxes(a.R, -1, -2)), scale]
    return np.concatenate(parts, axis=-1)


def placed(motion: MovingHand[Soft[Hinge]], T_cam_hand: ndarray) -> ObjectWithHand:
    poses = poses_in_camera(motion, T_cam_hand)
    assert isinstance(poses, ObjectWithHand)
    return poses


@pytest.mark.parametrize("held", [False, True])
def test_the_jacobian_is_that_of_object_and_hand(held: bool) -> None:
    """With every error free, and with shifts of the constant part and turns of the frames' own held."""
    constant, own = CONSTANT.copy(), OWN.copy()
    if held:
        constant[:3], own[3:6] = 0.0, 0.0
    motion, T = moving(np.random.default_rng(1), constant, own)
    J = jacobian_in_camera(*motion.jacobian(), T)
    S, L = (len(lengths) for lengths in motion.lengths())
    assert J.shape[-1] == S + L == 11 + 7 + len(OWN) + len(CONSTANT) - 6 * held
    for k in range(S + L):
        step, h = np.zeros(S + L), 1e-6
        step[k] = h
        ends = [placed(motion.retract(np.tile(s[:S], (B, 1)), np.tile(s[S:], (B, N, 1))), T) for s in (step, -step)]
        here = placed(motion, T)
        expected = (step_between(here, ends[0]) - step_between(here, ends[1])) / (2.0 * h)
        np.testing.assert_allclose(J[..., k], expected, atol=1e-7)


@pytest.mark.parametrize("memory", [0.0, 3.0])
def test_the_gradient_of_the_whole_energy(memory: float) -> None:
    rng = np.random.default_rng(2)
    motion, T = moving(rng, memory=memory)
    terms: list[Term] = [
        some_term("smoothness", rng),
        InHand(some_term("consistency", rng)),
        InHand(some_term("interaction", rng)),
        OnHand(some_term("reprojection", rng)),
    ]
    at, prior, bound = evaluate(motion, terms, T, np.full(B, np.inf)), motion.prior(), np.full(B, np.inf)
    J = jacobian_in_camera(*motion.jacobian(), T)
    S, L = (len(lengths) for lengths in motion.lengths())
    g = (np.swapaxes(J, -1, -2) @ at.local.g[..., None])[..., 0]
    assert prior.g_shared is not None
    shared, own = g[..., :S].sum(axis=1) + prior.g_shared, g[..., S:] + prior.g
    h = 1e-6

    def difference(shared: ndarray, own: ndarray) -> ndarray:
        costs = [evaluate(motion.retract(s * shared, s * own), terms, T, bound).cost for s in (h, -h)]
        return np.asarray((costs[0] - costs[1]) / (2.0 * h))

    for k in range(S):
        step = np.tile(np.eye(S)[k], (B, 1))
        np.testing.assert_allclose(
            shared[:, k], difference(step, np.zeros((B, N, L))), rtol=1e-4, atol=1e-5 * np.abs(shared).max()
        )
    for k in range(L):
        one = np.zeros((B, N, L))
        one[:, 1, k] = 1.0
        np.testing.assert_allclose(
            own[:, 1, k], difference(np.zeros((B, S)), one), rtol=1e-4, atol=1e-5 * np.abs(own).max()
        )


def test_a_hand_and_its_object_may_move_together() -> None:
    """Contact sees nothing of it, unless the hand grows: then the object is as good as smaller."""
    rng = np.random.default_rng(7)
    motion, T = moving(rng)
    still = replace(motion, constant=np.zeros_like(motion.constant), own=np.zeros_like(motion.own))
    alone, size = poses_in_camera(motion.core, T), np.exp(motion.constant[:, -1])
    for at, grown in ((still, np.ones(B)), (motion, size)):
        in_hand = placed(at, T).in_hand
        np.testing.assert_allclose(in_hand.R, alone.R, atol=1e-12)
        np.testing.assert_allclose(in_hand.scale * grown, alone.scale)
        middle = se3.transform(T, motion.assumed.middle[None])[:, 0]
        np.testing.assert_allclose((in_hand.centre - middle) * grown[:, None, None], alone.centre - middle, atol=1e-12)
    poses = placed(motion, T)
    apart = se3.inverse(poses.hand.T_cam_hand) @ se3.rigid(poses.R, poses.centre)
    held = motion.core.poses()
    np.testing.assert_allclose(apart, se3.rigid(held.R, held.centre), atol=1e-12)


def test_own_errors_are_correlated_in_time() -> None:
    motion, _ = moving(np.random.default_rng(3), memory=5.0)
    frames = np.array([0, 1, 3, 9])
    expected = np.exp(-np.abs(frames[:, None] - frames) / 5.0)
    np.testing.assert_allclose(np.linalg.inv(motion.assumed.at(frames).coupling), expected, atol=1e-12)
    prior = motion.prior()
    assert prior.cross is not None
    dense = prior.cross.copy()
    dense[range(N), :, range(N), :] += prior.H
    one = dense[:, -1, :, -1] / 30.0 * OWN[-1] ** 2
    np.testing.assert_allclose(np.linalg.inv(one), np.exp(-np.abs(np.subtract.outer(range(N), range(N))) / 5.0))


def test_a_fixed_hand_is_the_motion_alone() -> None:
    """With nothing to move the hand, and nearly so where the prior is as stiff as can be."""
    rng = np.random.default_rng(4)
    hand, core = hand_before_the_camera(rng), soft_hinge(rng)
    points = rng.normal(0.0, 0.03, (N, 5, 3))
    consistency = some_term("consistency", rng)
    assert isinstance(consistency, ContactConsistencyTerm)
    exact = replace(consistency, exact=True)  # bounds on ties between frames lead to the same end by other steps
    inside: list[Term] = [some_term("reprojection", rng), exact, some_term("interaction", rng)]
    K = np.tile([560.0, 570.0, 128.0, 120.0], (N, 1))
    pull = OnHand(ReprojectionTerm(points, K, rng.uniform(0.0, 256.0, (N, 5, 2)), 3.0))
    terms: list[Term] = [inside[0], *map(InHand, inside[1:]), pull]
    alone = minimise(core, inside, hand.T_cam_hand, 8)
    for sd, tolerance in ((0.0, 1e-12), (1e-9, 1e-5)):
        assumed = HandPrior.of(hand, np.full(8, sd), np.full(7, sd), 1.0)
        found = minimise(MovingHand.around(core, assumed), terms, hand.T_cam_hand, 8).motion
        np.testing.assert_allclose(found.core.poses().R, alone.motion.poses().R, atol=tolerance)
        np.testing.assert_allclose(found.core.poses().centre, alone.motion.poses().centre, atol=tolerance)
        np.testing.assert_allclose(found.constant, 0.0, atol=1e-6)
        np.testing.assert_allclose(found.own, 0.0, atol=1e-6)


def test_hypotheses_and_frames_are_taken_with_the_hand() -> None:
    motion, _ = moving(np.random.default_rng(5))
    twice = motion.concatenate(motion.take(np.array([1])))
    np.testing.assert_array_equal(twice.poses().take(np.array([1])).R, twice.poses().take(np.array([2])).R)
    frames = np.array([0, 2])
    some = motion.resampled(np.arange(N), frames).poses()
    np.testing.assert_allclose(some.R, motion.poses().R[:, frames], atol=1e-9)
    assert some.hand is not None
    np.testing.assert_array_equal(some.hand.centre, motion.poses().hand.centre[:, frames])
    R = se3.exp_so3(np.tile([0.1, 0.2, 0.3], (B, 1)))
    np.testing.assert_allclose(motion.rotated(R).poses().R, motion.poses().R @ R[:, None], atol=1e-12)
    frozen = Frozen(motion)
    assert frozen.prior().g_shared is None
    assert frozen.jacobian()[0].shape[-1] == 0


@pytest.mark.parametrize("jitter", [False, True])
def test_hand_and_object_are_found_together(jitter: bool) -> None:
    """A hand that is 10 degrees and 15 mm off, seen by its joints, and an object that only its mask shows.

    Held, the hand leaves the object right in the camera and wrong in the hand.
    """
    options = SceneOptions(
        frames=6, size=(320, 240), focal=300.0, turn_deg=(0.0, 1.0), residual_deg=0.0, residual_mm=0.0
    )
    true, masks = synthesise("mug", 0, options)
    assert true.truth is not None
    noise = Noise(hand_bias_deg=10.0, hand_bias_mm=15.0, hand_jitter_deg=2.0 * jitter, hand_jitter_mm=3.0 * jitter)
    clip = replace(true, hand=noisy_hand(true, noise, np.random.default_rng(6)))
    problem = prepare_problem(with_masks(clip, masks), Options(frames=6, hands="as-given"))
    given, T_true, frames = clip.hand, true.truth.T_cam_hand, np.arange(6)
    assert given.joints is not None
    start = se3.inverse(given.T_cam_hand)[0] @ true.truth.T_cam_obj[0]
    core = Fixed(start[None, :3, :3], se3.transform(start, clip.mesh.centre[None]), np.zeros(1), 6)
    soft = Soft(core, np.zeros((1, 6, 6)), (1.5e6, 1e4))
    middle = given.vertices.mean(axis=(0, 1))
    K, crop = problem.observation.K, np.zeros((6, 3, 3))
    crop[:, [0, 1, 0, 1, 2], [0, 1, 2, 2, 2]] = np.concatenate([K, np.ones((6, 1))], axis=1)
    target = camera.project(crop, se3.transform(T_true, given.joints))
    seen = OnHand(ReprojectionTerm(given.joints - middle, K, target, 20.0))
    terms = [*mask_energy(problem)(256, frames), seen]
    assumed = HandPrior.of(
        given, np.array([*[0.015] * 3, *[0.28] * 3, 0.015, 0.0]), np.repeat([0.005, 0.05, 0.005], [3, 3, 1]), 30.0
    )
    found = minimise(MovingHand.around(soft, assumed), terms, given.T_cam_hand, 30, DampingRules(tolerance=1e-6))
    poses = poses_in_camera(found.motion, given.T_cam_hand)
    assert isinstance(poses, ObjectWithHand)
    hand: HandInCamera = poses.hand
    turned = np.degrees(se3.angle_between(hand.R[0], T_true[:, :3, :3]))
    shifted = np.linalg.norm(hand.centre[0] - se3.transform(T_true, middle[None])[:, 0], axis=1)
    in_hand: PosesInHand = found.motion.core.poses()
    T_hand_obj = se3.inverse(T_true) @ true.truth.T_cam_obj
    right = se3.transform(T_hand_obj, clip.mesh.centre[None])[:, 0]
    assert np.degrees(se3.angle_between(start[:3, :3], T_hand_obj[0, :3, :3])) > 8.0
    assert turned.max() < 1.0
    assert shifted.max() < 2e-3
    assert np.degrees(se3.angle_between(in_hand.R[0], T_hand_obj[:, :3, :3])).max() < 4.0
    assert np.linalg.norm(in_hand.centre[0] - right, axis=1).max() < 8e-3


def test_a_widened_prior_pulls_as_students_t_and_never_more_than_before() -> None:
    rng, freedom = np.random.default_rng(7), 2.0
    hand = hand_before_the_camera(rng)
    assumed = HandPrior.of(hand, np.repeat([0.01, 0.2, 0.02, 0.1], [3, 3, 1, 1]), np.repeat([0.004, 0.05], [3, 4]), 1.0)
    far, near = 3.0 * rng.choice([-1.0, 1.0], (N, 7)), 0.5 * rng.uniform(-1.0, 1.0, (N, 7))
    wide = assumed.widened(0.01 * np.ones(8), far * assumed.own, freedom)
    for part in (slice(0, 3), slice(3, 6), slice(6, 7)):
        x, s = (far * assumed.own)[:, part], assumed.own[part]
        pull = (freedom + x.size) * x / s**2 / (freedom + np.sum((x / s) ** 2))
        np.testing.assert_allclose(x / wide.own[part] ** 2, pull)
    assert wide.constant[7] == assumed.constant[7]
    same = assumed.widened(np.zeros(8), near * assumed.own, freedom)
    np.testing.assert_array_equal(same.own, assumed.own)
    np.testing.assert_array_equal(same.constant, assumed.constant)
