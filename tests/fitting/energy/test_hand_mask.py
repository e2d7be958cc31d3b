"""E_mask of the hand, as a term on a hand that is unknown as well."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from getagrip.clip import with_masks
from getagrip.fitting.energy import HandInCamera, ObjectWithHand, PosesInCamera, no_bound
from getagrip.fitting.hand.hand_silhouette import HandSilhouette
from getagrip.fitting.objective import hand_evidence_energy
from getagrip.fitting.options import Options
from getagrip.fitting.problem import Problem, prepare_problem
from getagrip.geometry import se3
from helpers.scenes import SHORT, scene


@pytest.fixture(scope="module")
def problem() -> Problem:
    clip, masks = scene("mug", 2, SHORT)
    return prepare_problem(with_masks(clip, masks), Options(hands="as-given", frames=4))


def hands(problem: Problem, shift: np.ndarray, scale: float = 1.0) -> HandInCamera:
    """The given hand, shifted."""
    T = problem.clip.hand.T_cam_hand
    middle = problem.clip.hand.vertices.mean(axis=(0, 1))
    centre = se3.transform(T, middle[None])[:, 0] + shift
    return HandInCamera(T[None, :, :3, :3], centre[None], np.array([scale]), middle)


def with_object(hand: HandInCamera) -> ObjectWithHand:
    body = PosesInCamera(hand.R, hand.centre, np.ones(len(hand.scale)))
    return ObjectWithHand(*vars(body).values(), hand, body)


def test_it_is_least_where_the_hand_is(problem: Problem) -> None:
    (term,) = hand_evidence_energy(problem)(128, np.arange(4))
    assert term.name == "hand-mask"
    here = with_object(hands(problem, np.zeros(3)))
    value = term(here, no_bound(here)).value
    for shift in np.concatenate([0.02 * np.eye(3)[:2], -0.02 * np.eye(3)[:2]]):
        aside = with_object(hands(problem, shift))
        found = term(aside, no_bound(aside))
        assert np.all(found.value > value)
        assert np.all(found.g[0, :, 7:10] @ shift > 0.0), "it draws the hand back"
        assert not found.g[..., :7].any(), "it says nothing of the object"


def test_its_derivatives_are_those_of_the_silhouette_by_its_errors(problem: Problem) -> None:
    """At no error, turns and shifts by the errors are those of the local vector, in the hand's frame."""
    (term,) = hand_evidence_energy(problem)(128, np.arange(4))
    seen = HandSilhouette.of(problem.clip, problem.input_masks).with_field
    T = problem.clip.hand.T_cam_hand
    value, g, H = seen(np.zeros((4, 7)))
    poses = with_object(hands(problem, np.zeros(3)))
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
    hand = hands(problem, np.array([5.0, 0.0, 0.0]))
    return replace(hand, R=hand.R[:, 2:3], centre=hand.centre[:, 2:3])


def test_a_held_hand_has_no_such_energy(problem: Problem) -> None:
    (term,) = hand_evidence_energy(problem)(128, np.arange(4))
    hand = hands(problem, np.zeros(3))
    poses = PosesInCamera(hand.R, hand.centre, hand.scale)
    assert not term(poses, no_bound(poses)).value.any()


def test_there_is_none_without_masks_of_the_hand(problem: Problem) -> None:
    unknown = replace(problem.clip, evidence={**problem.clip.evidence, "hand-masks": None})
    assert not hand_evidence_energy(replace(problem, clip=unknown))(128, np.arange(4))
