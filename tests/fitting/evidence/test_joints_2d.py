"""2D joints as evidence: they stay with the hand, wrong ones are recognised, right ones turn a wrong hand back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from getagrip.bench.inputs.simulated_evidence import (
    JOINT_ERROR_LEVELS,
    SimulatedJointErrors,
    SimulatedJoints,
    simulate_joints_2d,
    true_joints,
)
from getagrip.checks import Evidence, input_checks, run_checks
from getagrip.clip import Clip, Masks, other_evidence, with_masks
from getagrip.fitting.evidence.joints_2d import HandJoints2D
from getagrip.fitting.hand.joint_reprojection import MAX_OUTSIDE_MASK_FRACTION, SeenJoints, outside_mask_fraction
from getagrip.fitting.hand.refine_hand import refine_hand
from getagrip.fitting.options import Options
from getagrip.fitting.problem import prepare_problem
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.synthetic.noise import NOISE_PRESETS, perturbed
from helpers.scenes import SHORT, scene


@pytest.fixture(scope="module")
def made() -> tuple[Clip, Masks]:
    return scene("mug", 2, SHORT)


def test_true_joints_are_those_of_the_true_hand_whatever_the_input_hand(made: tuple[Clip, Masks]) -> None:
    clip, masks = made
    assert clip.hand.joints is not None
    exact = se3.transform(clip.hand.T_cam_hand, clip.hand.joints)
    np.testing.assert_allclose(true_joints(clip), exact, atol=1e-6)
    bent, _ = perturbed(clip, masks, NOISE_PRESETS["moderate"], 3)
    assert np.abs(se3.transform(bent.hand.T_cam_hand, bent.hand.joints) - exact).max() > 1e-2
    np.testing.assert_allclose(true_joints(bent), exact, atol=6e-3)  # bent skin goes with joints only nearly


def test_simulated_joints_have_the_errors_of_their_level(made: tuple[Clip, Masks]) -> None:
    clip, masks = made
    exact = project(clip.K, true_joints(clip))
    size = np.ptp(exact, axis=1).max(axis=-1)[:, None, None]
    off = np.stack(
        [
            (
                simulate_joints_2d(
                    clip, masks, SimulatedJointErrors(0.03, 0.02, hidden=1.0), np.random.default_rng(seed)
                )
                - exact
            )
            / size
            for seed in range(60)
        ]
    )
    lasting = off.mean(axis=1)
    assert np.std(off - lasting[:, None]) == pytest.approx(0.03 * np.sqrt(1.0 - 1.0 / len(clip)), rel=0.05)
    assert np.std(lasting) == pytest.approx(np.hypot(0.02, 0.03 / np.sqrt(len(clip))), rel=0.1)


def test_joints_go_with_the_hand_and_make_no_other_evidence(made: tuple[Clip, Masks]) -> None:
    clip, masks = SimulatedJoints("lab")(*made, 0)
    modality, some = HandJoints2D(), np.array([2, 0])
    seen = modality.of(clip)
    assert seen is not None
    assert len(seen) == len(clip)
    assert modality.of(clip.take(some)) == seen.take(some)
    moved = perturbed(clip, masks, NOISE_PRESETS["strong"], 1)[0]
    assert modality.of(moved) == seen
    assert modality.of(made[0]) is None
    assert other_evidence(clip) == []


@pytest.mark.parametrize("level", [*JOINT_ERROR_LEVELS])
def test_joints_of_something_else_are_recognised_and_left_out(made: tuple[Clip, Masks], level: str) -> None:
    clip, masks = SimulatedJoints(level)(*made, 0)
    wrong = JOINT_ERROR_LEVELS[level].mistake != ""
    refined, _ = refine_hand(clip, masks)
    assert (refined is None or refined.joints is None) == wrong
    if (
        outside_mask_fraction(clip, masks) > MAX_OUTSIDE_MASK_FRACTION
    ) == wrong:  # of a shifted camera most may still be on hand and object
        assert (SeenJoints.of(clip, masks) is None) == wrong
        _, findings = run_checks(input_checks(), Evidence(clip, masks))
        assert ("joints-elsewhere" in {one.check for one in findings}) == wrong


FINGERS_EXCHANGED = {
    "thumb and index": np.r_[0, 5:9, 1:5, 9:21],
    "little finger first": np.r_[0, 17:21, 13:17, 9:13, 5:9, 1:5],
    "MANO's order": np.r_[0, 5:8, 9:12, 17:20, 13:16, 1:4, 4, 8, 12, 16, 20],
}


@pytest.mark.parametrize("order", FINGERS_EXCHANGED.values(), ids=FINGERS_EXCHANGED)
def test_joints_in_another_order_are_left_out_though_they_lie_on_the_hand(
    made: tuple[Clip, Masks], order: np.ndarray
) -> None:
    clip, masks = SimulatedJoints("lab")(*made, 0)
    assert clip.hand.joints_2d is not None
    assert SeenJoints.of(clip, masks) is not None
    other = replace(clip, hand=replace(clip.hand, joints_2d=clip.hand.joints_2d[:, order]))
    assert outside_mask_fraction(other, masks) < MAX_OUTSIDE_MASK_FRACTION
    assert SeenJoints.of(other, masks) is None


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ("order", "contradict its pixels or its skeleton"),
        ("nowhere", "contradict its pixels or its skeleton"),
        ("unsure", "confidence above 0 in less than two frames"),
        ("skeleton", "have no joints in 3D"),
        ("elsewhere", ""),
        ("none", ""),
    ],
)
def test_a_hand_that_is_refined_without_its_joints_says_why(made: tuple[Clip, Masks], fault: str, words: str) -> None:
    clip, masks = SimulatedJoints("lab")(*perturbed(*made, NOISE_PRESETS["moderate"], 3), 0)
    hand = clip.hand
    assert hand.joints_2d is not None
    assert hand.joints_2d_confidence is not None
    changed = {
        "order": {"joints_2d": hand.joints_2d[:, FINGERS_EXCHANGED["MANO's order"]]},
        "nowhere": {"joints_2d": 1e300 * hand.joints_2d},
        "unsure": {"joints_2d_confidence": 0.0 * hand.joints_2d_confidence},
        "skeleton": {"joints": None},
        "elsewhere": {"joints_2d": hand.joints_2d / np.array(clip.size)},
        "none": {},
    }
    clip = with_masks(replace(clip, hand=replace(hand, **changed[fault])), masks)
    problem = prepare_problem(clip, Options(frames=4, inits=2))
    found = Evidence(problem.clip, problem.input_masks, joints_left_out=problem.trust.joints_left_out)
    _, findings = run_checks(HandJoints2D.result_checks, found)
    assert [one.check for one in findings] == (["joints-left-out"] if words else [])
    assert all(words in one.message for one in findings)


def test_masks_that_show_no_hand_tell_nothing_of_joints(made: tuple[Clip, Masks]) -> None:
    clip, masks = SimulatedJoints("other hand")(*made, 0)
    assert np.isnan(outside_mask_fraction(clip, Masks(masks.object, np.zeros_like(masks.ignore))))


def test_a_hand_that_is_turned_is_turned_back(made: tuple[Clip, Masks]) -> None:
    clip, masks = SimulatedJoints("lab")(*made, 0)
    T, middle = clip.hand.T_cam_hand, clip.hand.vertices.mean(axis=(0, 1))
    R = se3.exp_so3(np.array([0.25, -0.2, 0.15]))
    turned = clip.with_hand_at(T @ se3.rigid(R, middle - R @ middle))
    off = []
    for hand in (replace(turned.hand, joints_2d=None, joints_2d_confidence=None), turned.hand):
        refined, _ = refine_hand(replace(turned, hand=hand), masks)
        assert refined is not None
        off.append(se3.angle_between(refined.T_cam_hand[:, :3, :3], T[:, :3, :3]).mean())
    assert off[1] < 0.03
    assert off[1] < off[0]
