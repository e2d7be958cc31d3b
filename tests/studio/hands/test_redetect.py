"""Frames in which a hand was lost, or seen turned, are seen again from the frames that are sure."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from getagrip.studio.hands import networks
from getagrip.studio.hands.hand_tracking import Sighting
from getagrip.studio.hands.networks import HandCrop, HandNetOutput, Nets
from getagrip.studio.hands.redetect import redetect_hand

BASES = ((60, 20), (30, -25), (5, -30), (-15, -25), (-40, -15))
FLAT = np.array([[0, 0], *([x * k / 4, -100 + y * k] for x, y in BASES for k in (1, 2, 3, 4))], dtype=float)
WORLD = np.column_stack([FLAT / 1000.0, np.zeros(21)])
COUNT = 30


def hand(n: int, confidence: float = 0.95) -> Sighting:
    return Sighting(FLAT + np.array([300.0 + 8.0 * n, 500.0]), WORLD, confidence, 0.1)


def turned(n: int) -> Sighting:
    """The same, by half a turn, as sure."""
    there = hand(n)
    return there._replace(points=2.0 * there.points.mean(axis=0) - there.points)


class TurnedNets(Nets):
    """A network that sees the hand as it is in upright squares about it, and turned, and surer, in others."""

    def __init__(self) -> None:
        super().__init__(lambda image: [], lambda image: [], "")

    def landmarks(self, image: np.ndarray, crop: HandCrop) -> HandNetOutput:
        n = int(image[0, 0, 0])
        own = networks.crop_of_landmarks(hand(n).points)
        if np.linalg.norm(own.middle - crop.middle) > 0.5 * own.side:
            return HandNetOutput(FLAT, WORLD, 0.02, 0.5)
        return HandNetOutput(*(hand(n, 0.7) if abs(crop.angle - own.angle) < 0.5 else turned(n)))


def image(n: int) -> np.ndarray:
    return np.full((4, 4, 3), n, np.uint8)


@pytest.mark.parametrize("there", [None, turned], ids=["lost", "turned"])
def test_what_was_lost_or_turned_is_seen_again(there: object) -> None:
    doubtful = range(10, 15)
    seen = {n: hand(n) for n in range(COUNT) if n not in doubtful}
    if callable(there):
        seen |= {n: there(n) for n in doubtful}
    found = redetect_hand(image, seen, COUNT, TurnedNets(), {})
    assert sorted(found) == list(range(COUNT))
    for n, each in found.items():
        np.testing.assert_allclose(each.points, hand(n).points, atol=1e-6)
        assert each.confidence == pytest.approx(0.7 if n in doubtful else 0.95)


def broad(n: int, width: float = 4.0) -> Sighting:
    """A hand whose palm is seen; with a negative width, from its other side."""
    there = hand(n)
    return there._replace(points=there.points[0] + (there.points - there.points[0]) * [width, 1.0])


def mirrored(n: int) -> Sighting:
    return broad(n, -4.0)


@pytest.mark.parametrize("flipped", [range(12), range(22, COUNT), range(10, 13)], ids=["first", "last", "few"])
@pytest.mark.parametrize("again", [broad, mirrored], ids=["seen", "mirrored"])
def test_a_palm_does_not_turn_over_at_once(flipped: range, again: Callable[[int], Sighting]) -> None:
    """The longer run counts, however sure the other is; what is mirrored again is left out."""

    class Same(TurnedNets):
        def landmarks(self, image: np.ndarray, crop: HandCrop) -> HandNetOutput:
            return HandNetOutput(*again(int(image[0, 0, 0])))

    seen = {n: mirrored(n) if n in flipped else broad(n) for n in range(COUNT)}
    found = redetect_hand(image, seen, COUNT, Same(), {})
    assert [*found] == [n for n in range(COUNT) if again is broad or n not in flipped]
    for n, each in found.items():
        np.testing.assert_allclose(each.points, broad(n).points, atol=1e-6)


def test_nor_does_it_turn_over_within_a_few_frames() -> None:
    class Same(TurnedNets):
        def landmarks(self, image: np.ndarray, crop: HandCrop) -> HandNetOutput:
            return HandNetOutput(*broad(int(image[0, 0, 0]), 2.0))

    before, last = COUNT - 2, COUNT - 1
    turning = {before: broad(before, 0.5), last: broad(last, -1.5)}  # each step alone is possible
    found = redetect_hand(image, {n: broad(n, 2.0) for n in range(COUNT)} | turning, COUNT, Same(), {})
    np.testing.assert_allclose(found[before].points, turning[before].points)
    np.testing.assert_allclose(found[last].points, broad(last, 2.0).points, atol=1e-6)


def test_without_a_sure_run_nothing_changes() -> None:
    seen = {n: hand(n, 0.6) for n in range(COUNT)}
    assert redetect_hand(image, seen, COUNT, TurnedNets(), {}) == seen


def test_a_hand_that_has_gone_stays_gone() -> None:
    class Nothing(TurnedNets):
        def landmarks(self, image: np.ndarray, crop: HandCrop) -> HandNetOutput:
            return HandNetOutput(FLAT, WORLD, 0.02, 0.5)

    seen = {n: hand(n) for n in range(10)}
    assert sorted(redetect_hand(image, seen, COUNT, Nothing(), {})) == list(range(10))


def test_of_two_views_the_one_of_the_hands_own_side_counts() -> None:
    """Squares turned to one side show the hand, those to the other its mirror image, as alike and as sure."""

    class TwoNets(TurnedNets):
        def landmarks(self, image: np.ndarray, crop: HandCrop) -> HandNetOutput:
            there = hand(int(image[0, 0, 0]))
            own = networks.crop_of_landmarks(there.points)
            right = 0.999 if crop.angle > own.angle else 0.001
            return HandNetOutput(*there._replace(right=right, points=there.points + 30.0 * (right > 0.5)))

    seen = {n: hand(n) for n in range(COUNT) if n not in range(10, 15)}
    for side, shift in (("left", 0.0), ("right", 30.0)):
        sides = dict.fromkeys(range(10, 15), side)
        found = redetect_hand(image, seen, COUNT, TwoNets(), sides)  # type: ignore[arg-type]
        for n in range(10, 15):
            np.testing.assert_allclose(found[n].points, hand(n).points + shift, atol=1.0)
