"""Laws of hand and object solved together: errors found, depth above all, mirrors, and evidence that is absent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy import ndarray

from getagrip.bench.inputs.simulated_evidence import true_joints
from getagrip.clip import Clip, Masks, with_masks
from getagrip.fitting.hand.hand_error_model import SolvedHand, interpolate_solved_hand
from getagrip.fitting.hand.joint_hand_object import solve_with_hand
from getagrip.fitting.methods.all_frames import soft_energy
from getagrip.fitting.motion import Fixed, Hinge, Soft, hand_object_transforms
from getagrip.fitting.options import Options
from getagrip.fitting.problem import Problem, prepare_problem
from getagrip.geometry import camera, se3
from getagrip.provenance import estimated, measured
from getagrip.reconstruct import reconstruct
from getagrip.synthetic.noise import Noise, noisy_hand
from getagrip.synthetic.scene import synthesise
from getagrip.synthetic.scene_options import SceneOptions

SCENE = SceneOptions(frames=6, size=(320, 240), focal=300.0, turn_deg=(0.0, 1.0), residual_deg=0.0, residual_mm=0.0)
OFF = Noise(hand_bias_deg=12.0, hand_bias_mm=8.0, hand_bias_depth_mm=20.0)
RIDGE = 1.5e6, 1e4


def made(side: str = "right", noise: Noise | None = OFF) -> Clip:
    """A clip with exact masks, and a hand with a constant error."""
    clip, masks = synthesise("mug", 0, replace(SCENE, side=side))
    masks = Masks(masks.object, masks.ignore, masks.ignore)
    clip = replace(clip, provenance=clip.provenance | {"hands": estimated("a test")})
    if noise is not None:
        clip = replace(clip, hand=noisy_hand(clip, noise, np.random.default_rng(6)))
    return with_masks(clip, masks)


def solved(clip: Clip) -> tuple[Problem, SolvedHand, ndarray]:
    """The problem, the hand, and ``T_hand_obj``, from the true object in the camera."""
    problem = prepare_problem(clip, Options(frames=6))
    assert clip.truth is not None
    start = se3.inverse(problem.clip.hand.T_cam_hand)[0] @ clip.truth.T_cam_obj[0]
    core = Fixed(start[None, :3, :3], se3.transform(start, clip.mesh.centre[None]), np.zeros(1), 6)
    hinge = Hinge.nearest(core, np.zeros((1, 6, 6)), True, np.zeros(3))
    hand, motion = solve_with_hand(problem, Soft(hinge, np.zeros((1, 6, 6)), RIDGE), soft_energy)
    return problem, hand, hand_object_transforms(motion.poses(), clip.mesh.centre)[0]


def errors(clip: Clip, T_cam_hand: ndarray) -> tuple[float, float]:
    """Mean angle to the true hand [degrees], and distance of its middle along the camera's ray [m]."""
    assert clip.truth is not None
    middle, true = clip.truth.hand_vertices.mean(axis=(0, 1))[None], clip.truth.T_cam_hand
    there, here = (se3.transform(T, middle)[:, 0] for T in (true, T_cam_hand))
    deeper = np.linalg.norm(here, axis=1) - np.linalg.norm(there, axis=1)
    return np.degrees(se3.angle_between(T_cam_hand[:, :3, :3], true[:, :3, :3])).mean(), float(abs(deeper.mean()))


def test_a_measured_hand_is_refined_less_and_not_solved_with_the_object() -> None:
    clip = made(noise=replace(OFF, hand_bias_deg=4.0))
    alone = prepare_problem(
        replace(clip, provenance=clip.provenance | {"hands": measured("a test")}), Options(frames=6)
    )
    together = prepare_problem(clip, Options(frames=6))
    assert alone.refinement is None
    assert together.refinement is not None
    T = clip.hand.T_cam_hand[:, :3, :3]
    turned = [se3.angle_between(each.clip.hand.T_cam_hand[:, :3, :3], T).mean() for each in (alone, together)]
    assert 0.0 < turned[0] < turned[1]


def test_a_constant_error_is_found_and_its_depth_by_the_object() -> None:
    clip = made()
    problem, hand, T_hand_obj = solved(clip)
    given, refined, found = (
        errors(clip, T) for T in (clip.hand.T_cam_hand, problem.clip.hand.T_cam_hand, hand.T_cam_hand)
    )
    assert given[0] > 10.0
    assert found[0] < 0.4 * given[0]
    assert refined[1] > 0.012  # a silhouette does not tell it
    assert found[1] < 0.5 * refined[1]
    assert clip.truth is not None
    right = se3.inverse(clip.truth.T_cam_hand) @ clip.truth.T_cam_obj
    before = se3.inverse(problem.clip.hand.T_cam_hand) @ clip.truth.T_cam_obj
    x = clip.mesh.vertices

    def off(T: ndarray) -> float:
        return float(np.linalg.norm(se3.transform(T, x) - se3.transform(right, x), axis=-1).mean())

    assert off(T_hand_obj) < 0.6 * off(before)


def test_what_moved_it_and_how_well_it_is_known() -> None:
    hand = solved(made())[1]
    assert hand.energy.keys() == {"hand-mask"}
    np.testing.assert_allclose(hand.covariance, hand.covariance.T, atol=1e-9)
    assert np.linalg.eigvalsh(hand.covariance).min() > 0.0
    assert 0.0 < np.sqrt(np.trace(hand.covariance[:3, :3])) < 0.03
    assert 0.0 < np.sqrt(np.trace(hand.covariance[3:, 3:])) < 0.3
    assert "hand-mask" in str(hand)


def test_a_left_hand_is_a_right_hand_in_a_mirror() -> None:
    right, left = made(noise=None), made("left", noise=None)
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    assert right.truth is not None
    middle = right.hand.vertices.mean(axis=(0, 1))
    R = se3.exp_so3(np.array([0.12, -0.1, 0.08]))
    off = se3.rigid(R, middle + np.array([0.003, -0.004, 0.015]) - R @ middle)
    right = right.with_hand_at(right.hand.T_cam_hand @ off)
    left = left.with_hand_at(left.hand.T_cam_hand @ (mirror @ off @ mirror))
    a, b = solved(right)[1], solved(left)[1]
    mirrored = mirror @ a.T_cam_hand @ mirror  # the masks' pixels are not, quite
    assert np.degrees(se3.angle_between(b.T_cam_hand[:, :3, :3], mirrored[:, :3, :3])).mean() < 1.5
    assert np.linalg.norm(b.T_cam_hand[:, :3, 3] - mirrored[:, :3, 3], axis=1).mean() < 2e-3


def test_an_exact_hand_stays_and_so_does_every_bit() -> None:
    clip = made(noise=None)
    options = Options(inits=5, every_frame=False)
    a, b = (reconstruct(clip, options=replace(options, hands=hands)) for hands in ("corrected", "as-given"))
    assert a.T_cam_hand is not None
    np.testing.assert_array_equal(a.T_cam_hand, clip.hand.T_cam_hand[clip.index_of(a.frames)])
    assert a.hand_covariance is None
    assert not a.hand_energy
    np.testing.assert_array_equal(a.candidates.T_hand_obj, b.candidates.T_hand_obj)
    np.testing.assert_array_equal(a.candidates.energy, b.candidates.energy)


def test_a_hand_whose_pixels_are_another_hands_stays() -> None:
    clip = made()
    masks = clip.evidence["object-masks"]
    assert isinstance(masks, Masks)
    elsewhere = np.roll(masks.ignore, 120, axis=2) & ~masks.object
    assert (
        prepare_problem(with_masks(clip, Masks(masks.object, masks.ignore, elsewhere)), Options(frames=6)).refinement
        is None
    )


def test_the_other_frames_go_with_their_neighbours() -> None:
    rng = np.random.default_rng(0)
    given, off = se3.rigid(se3.exp_so3(rng.normal(size=(5, 3))), rng.normal(size=(5, 3))), se3.exp_so3(np.full(3, 0.1))
    at = np.array([0, 2, 4])
    found = interpolate_solved_hand(given, (given @ se3.rigid(off, np.full(3, 0.01)))[at], at)
    np.testing.assert_allclose(found, given @ se3.rigid(off, np.full(3, 0.01)), atol=1e-9)


def test_alternatives_move_the_object_alike_first_where_the_hand_is_known_least() -> None:
    rng = np.random.default_rng(0)
    sizes = np.repeat([0.004, 0.05], 3)
    covariance = np.cov(rng.normal(size=(6, 30))) * sizes * sizes[:, None]
    hand = SolvedHand(np.eye(4)[None], covariance, {}, 0.1)
    points, middle, apart = 0.05 * rng.normal(size=(200, 3)) + [0.0, 0.0, 0.08], np.array([0.01, 0.02, 0.03]), 1e-4
    found = hand.alternatives(points, middle, apart)
    moved = se3.transform(found, points[None] + middle) - points - middle
    assert np.sqrt((moved**2).sum(axis=-1).mean(axis=1)) == pytest.approx(np.full(6, apart), rel=0.01)
    np.testing.assert_allclose(moved[::2], -moved[1::2], atol=0.01 * apart)
    shift = se3.transform(found, middle[None])[:, 0] - middle
    turn = np.stack([found[:, 2, 1], found[:, 0, 2], found[:, 1, 0]], axis=1)
    x = np.concatenate([shift, turn], axis=1)
    unlikely = np.einsum("mi,ij,mj->m", x, np.linalg.inv(covariance), x)[::2]
    assert (np.diff(unlikely) > 0.0).all()
    # None that moves it as far is more probable than the first.
    others = rng.multivariate_normal(np.zeros(6), covariance, 500)
    far = others[:, None, :3] + np.cross(others[:, None, 3:], points)
    others *= apart / np.sqrt((far**2).sum(axis=-1).mean(axis=1))[:, None]
    assert np.einsum("mi,ij,mj->m", others, np.linalg.inv(covariance), others).min() >= 0.99 * unlikely[0]


@pytest.mark.slow
def test_the_result_says_what_moved_the_hand() -> None:
    clip = made()
    result = reconstruct(clip, options=Options(inits=20))
    assert result.hand_covariance is not None
    assert result.hand_energy.keys() == {"hand-mask"}
    assert result.T_cam_hand is not None
    assert result.hand_alternatives is not None
    assert len(result.in_hand) == 1 + len(result.hand_alternatives)
    np.testing.assert_array_equal(result.in_hand[0], result.T_hand_obj)
    T_cam_obj = result.T_cam_hand @ result.hand_alternatives[0] @ result.in_hand[1]
    np.testing.assert_allclose(T_cam_obj, result.T_cam_hand @ result.T_hand_obj, atol=1e-12)
    assert any("solved together" in note for note in result.notes)
    assert errors(clip, result.T_cam_hand)[0] < 0.5 * errors(clip, clip.hand.T_cam_hand)[0]


def test_joints_alone_tell_of_a_hand_without_pixels() -> None:
    clip = made()
    masks = clip.evidence["object-masks"]
    assert isinstance(masks, Masks)
    points = true_joints(clip)
    hand = replace(clip.hand, joints_2d=camera.project(clip.K, points), joints_2d_confidence=np.ones((6, 21)))
    clip = with_masks(replace(clip, hand=hand), Masks(masks.object, np.zeros_like(masks.object)))
    problem, solution, _ = solved(clip)
    assert problem.refinement is not None
    assert str(problem.refinement).count("pixels") == 0
    assert np.isnan(solution.differing)
    assert solution.energy.keys() >= {"joints-2d"}
    assert errors(clip, solution.T_cam_hand)[0] < 0.3 * errors(clip, clip.hand.T_cam_hand)[0]
