"""Terms on a hand whose pose is unknown: its mask and its 2D joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from getagrip.clip import Clip, with_masks
from getagrip.fitting.energy import HandInCamera, HandTerm, ObjectWithHand, PosesInCamera, no_bound
from getagrip.fitting.energy.term import OnHand
from getagrip.fitting.hand.hand_silhouette import HandSilhouette
from getagrip.fitting.hand.joint_reprojection import SeenJoints
from getagrip.fitting.objective import hand_evidence_energy
from getagrip.fitting.options import Options
from getagrip.fitting.problem import Problem, prepare_problem
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from helpers.scenes import SHORT, scene


@pytest.fixture(scope="module")
def problem() -> Problem:
    clip, masks = scene("mug", 2, SHORT)
    return prepare_problem(with_masks(clip, masks), Options(hands="as-given", frames=4))


def shifted(problem: Problem, shift: np.ndarray) -> HandInCamera:
    """The input hand, shifted."""
    return hands(problem, np.concatenate([shift, np.zeros(4)])[None])


def with_object(hand: HandInCamera) -> ObjectWithHand:
    body = PosesInCamera(hand.R, hand.centre, np.ones(len(hand.scale)))
    return ObjectWithHand(*vars(body).values(), hand, body)


def test_the_hands_mask_term_is_least_at_the_hand(problem: Problem) -> None:
    (term,) = hand_evidence_energy(problem)(128, np.arange(4))
    assert term.name == "hand-mask"
    here = with_object(shifted(problem, np.zeros(3)))
    value = term(here, no_bound(here)).value
    for shift in np.concatenate([0.02 * np.eye(3)[:2], -0.02 * np.eye(3)[:2]]):
        aside = with_object(shifted(problem, shift))
        found = term(aside, no_bound(aside))
        assert np.all(found.value > value)
        assert np.all(found.g[0, :, 7:10] @ shift > 0.0), "it draws the hand back"
        assert not found.g[..., :7].any(), "it says nothing of the object"


def test_the_mask_terms_derivatives_are_the_silhouettes_by_its_errors(problem: Problem) -> None:
    """At no error, turns and shifts by the errors are those of the local vector, in the hand's frame."""
    (term,) = hand_evidence_energy(problem)(128, np.arange(4))
    seen = HandSilhouette.of(problem.clip, problem.input_masks).with_field
    T = problem.clip.hand.T_cam_hand
    value, g, H = seen(np.zeros((4, 7)))
    poses = with_object(shifted(problem, np.zeros(3)))
    found = term(poses, no_bound(poses))
    by_error = np.zeros((4, 21, 7))
    by_error[:, 7:10, 3:6], by_error[:, 10:13, :3], by_error[:, 13, 6] = T[:, :3, :3], T[:, :3, :3], 1.0
    weight = found.value[0] / value
    np.testing.assert_allclose((found.g[0, :, None] @ by_error)[:, 0], weight[:, None] * g, rtol=1e-9, atol=1e-9)
    Jt = np.swapaxes(by_error, 1, 2)
    np.testing.assert_allclose(Jt @ found.H[0] @ by_error, weight[:, None, None] * H, rtol=1e-9, atol=1e-7)


def test_a_pixel_of_the_image_counts_as_much_as_one_of_the_object(problem: Problem) -> None:
    (term,) = hand_evidence_energy(problem)(128, np.array([2]))
    seen = HandSilhouette.of(problem.clip, problem.input_masks).take(np.array([2]))
    far = with_object(far_hand(problem))
    missed = term(far, no_bound(far)).value[0, 0]
    zoom = seen.mask.K[0, 0] / problem.clip.K[2, 0, 0]
    object_zoom = problem.observation.K[2, 0] / problem.clip.K[2, 0, 0]
    assert missed == pytest.approx(seen.mask.pixels / zoom**2 * object_zoom**2)


def far_hand(problem: Problem) -> HandInCamera:
    """The hand of a frame, outside of the image."""
    hand = shifted(problem, np.array([5.0, 0.0, 0.0]))
    return replace(hand, R=hand.R[:, 2:3], centre=hand.centre[:, 2:3])


def test_a_fixed_hand_has_no_energy(problem: Problem) -> None:
    (term,) = hand_evidence_energy(problem)(128, np.arange(4))
    hand = shifted(problem, np.zeros(3))
    poses = PosesInCamera(hand.R, hand.centre, hand.scale)
    assert not term(poses, no_bound(poses)).value.any()


def test_without_hand_masks_there_is_no_term(problem: Problem) -> None:
    unknown = replace(problem.clip, evidence={**problem.clip.evidence, "hand-masks": None})
    assert not hand_evidence_energy(replace(problem, clip=unknown))(128, np.arange(4))


def seen_in(clip: Clip, px: float = 0.0) -> Clip:
    """The clip with its joints where they are seen, off by ``px``."""
    assert clip.hand.joints is not None
    points = project(clip.K, se3.transform(clip.hand.T_cam_hand, clip.hand.joints))
    points = points + px * np.random.default_rng(0).normal(size=points.shape)
    confidence = np.ones(points.shape[:2])
    confidence[:, 3] = 0.0
    return replace(clip, hand=replace(clip.hand, joints_2d=points, joints_2d_confidence=confidence))


@pytest.fixture(scope="module")
def problem_with_joints() -> Problem:
    clip, masks = scene("mug", 2, SHORT)
    return prepare_problem(with_masks(seen_in(clip, 3.0), masks), Options(hands="as-given", frames=4))


def joints_term(problem: Problem, level: int) -> HandTerm:
    """The term of the hand's joints."""
    terms = {term.name: term for term in hand_evidence_energy(problem)(level, np.arange(4))}
    term = terms["joints-2d"]
    assert isinstance(term, OnHand)
    return term.term


def hands(problem: Problem, x: np.ndarray) -> HandInCamera:
    """The hand of each row of x: its local vector, the same in all frames."""
    T, middle = problem.clip.hand.T_cam_hand, problem.clip.hand.vertices.mean(axis=(0, 1))
    R = se3.exp_so3(x[:, None, 3:6]) @ T[:, :3, :3]
    centre = se3.transform(T, middle[None])[:, 0] + x[:, None, :3]
    return HandInCamera(R, centre, np.exp(x[:, 6]), middle)


def test_the_joints_gradient_is_that_of_finite_differences(problem_with_joints: Problem) -> None:
    term = joints_term(problem_with_joints, 128)
    rng, step = np.random.default_rng(1), 1e-5
    at = rng.normal(size=7) * np.repeat([0.01, 0.2, 0.1], [3, 3, 1])
    start = hands(problem_with_joints, at[None])
    found = term(start, no_bound(start))
    for k in range(7):
        # A turn is in the camera frame, about the middle, from where the hand is.
        sides = []
        for sign in (-1.0, 1.0):
            move = sign * step * np.eye(7)[k]
            turned, scale = se3.exp_so3(move[3:6]) @ start.R, start.scale * np.exp(move[6])
            poses = HandInCamera(turned, start.centre + move[:3], scale, start.middle)
            sides.append(term(poses, no_bound(poses)).value[0])
        slope = (sides[1] - sides[0]) / (2.0 * step)
        np.testing.assert_allclose(found.g[0, :, k], slope, rtol=2e-3, atol=1e-3 * np.abs(found.g[0, :, k]).max())
    assert np.linalg.eigvalsh(found.H[0]).min() > -1e-6 * np.abs(found.H).max()


def test_the_joints_gradient_by_the_hands_errors_is_that_of_finite_differences(problem_with_joints: Problem) -> None:
    seen = SeenJoints.of(problem_with_joints.clip, problem_with_joints.input_masks)
    assert seen is not None
    x = np.random.default_rng(2).normal(size=(4, 27)) * np.repeat([0.1, 0.005, 0.1, 0.2], [3, 3, 1, 20])
    _, g, H = seen(x)
    for k in range(27):
        step = 1e-5 * np.eye(27)[k]
        slope = (seen(x + step)[0] - seen(x - step)[0]) / 2e-5
        np.testing.assert_allclose(g[:, k], slope, rtol=2e-3, atol=1e-4 * np.abs(g).max())
    assert np.linalg.eigvalsh(H).min() > -1e-6 * np.abs(H).max()
    np.testing.assert_allclose(seen.rigid(x[:, :7])[1], seen(np.pad(x[:, :7], ((0, 0), (0, 20))))[1][:, :7])


def test_the_joints_term_is_least_at_the_2d_joints(problem_with_joints: Problem) -> None:
    exact = replace(problem_with_joints, clip=seen_in(problem_with_joints.clip))
    term = joints_term(exact, 64)
    x = np.concatenate([np.zeros((1, 7)), 0.02 * np.eye(7)])
    value = term(hands(exact, x), np.full(8, np.inf)).value.sum(axis=1)
    assert np.all(value[1:] > value[0] + 1e-9)


def test_joints_behind_the_camera_cost_infinitely_much(problem_with_joints: Problem) -> None:
    term = joints_term(problem_with_joints, 64)
    behind = hands(problem_with_joints, np.eye(7)[None, 2] * -5.0)
    assert np.isinf(term(behind, no_bound(behind)).value).all()


@pytest.mark.parametrize(("own", "lasting"), [(0.02, 0.004), (0.02, 0.03), (0.05, 0.05)])
def test_the_size_of_errors_is_estimated_from_the_clip(own: float, lasting: float) -> None:
    clip, _ = scene("mug", 2)
    exact = seen_in(clip).hand.joints_2d
    assert exact is not None
    found = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        box = np.ptp(exact, axis=1).max(axis=-1)[:, None, None]
        off = own * rng.normal(size=exact.shape) + lasting * rng.normal(size=exact.shape[1:])
        # Some joints are elsewhere altogether.
        off[rng.random(off.shape[:2]) < 0.05] += 0.5
        hand = replace(clip.hand, joints_2d=exact + box * off, joints_2d_confidence=np.ones(off.shape[:2]))
        seen = SeenJoints.of(replace(clip, hand=hand), None)
        assert seen is not None
        found.append((seen.own, seen.lasting))
    mean_own, mean_lasting = np.mean(found, axis=0)
    assert own / 1.4 < mean_own < 1.4 * own
    assert lasting / 2.0 < mean_lasting < max(2.0 * lasting, 0.012)


def test_a_clip_without_joints_has_no_joints_term() -> None:
    clip, masks = scene("mug", 2, SHORT)
    assert SeenJoints.of(clip, masks) is None
    plain = prepare_problem(with_masks(clip, masks), Options(hands="as-given", frames=4))
    assert [term.name for term in hand_evidence_energy(plain)(64, np.arange(4))] == ["hand-mask"]
