"""The side of a hand: the bias cancels out in mirror images, and fingers bend to the palm from every view."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from getagrip.hands import generic
from getagrip.hands.fit_joints import PosePrior
from getagrip.hands.from_2d.clicks import model_pose
from getagrip.studio.hands import Side, Sighting, unbiased_log_odds
from getagrip.studio.hands.hand_selection import Handedness, log_odds
from getagrip.studio.hands.networks import HandNetOutput, Nets
from getagrip.studio.hands.palms import HandCrop

MIRROR = np.array([-1.0, 1.0, 1.0])
IMAGE = np.zeros((480, 640, 3), np.uint8)


def bent(side: Side) -> np.ndarray:
    """Joints of a hand in the middle of its poses [m]."""
    model = generic.load(side)
    joints = model.with_shape().with_pose(model_pose(PosePrior.of(model).mean[None])[0]).joints
    return np.asarray(joints - joints.mean(axis=0))


def hand(world: np.ndarray, right: float = 0.5) -> Sighting:
    return Sighting(world[:, :2] * 1000.0 + [300.0, 240.0], world, 0.9, right)


class Biased(Nets):
    """Networks that see the same hand in every image, and take it for a right one too often."""

    def __init__(self, there: Sighting, bias: float) -> None:
        super().__init__(lambda image: [], lambda image: [], "")
        object.__setattr__(self, "there", there)
        object.__setattr__(self, "bias", bias)

    def landmarks(self, image: np.ndarray, crop: HandCrop) -> HandNetOutput:
        there: Sighting = self.there  # type: ignore[attr-defined]
        return self._said(there, np.log(there.right / (1.0 - there.right)))

    def mirrored(self, image: np.ndarray, crop: HandCrop) -> HandNetOutput:
        there: Sighting = self.there  # type: ignore[attr-defined]
        return self._said(there._replace(world=there.world * MIRROR), -np.log(there.right / (1.0 - there.right)))

    def _said(self, there: Sighting, odds: float) -> HandNetOutput:
        right = 1.0 / (1.0 + np.exp(-(odds + self.bias)))  # type: ignore[attr-defined]
        return HandNetOutput(there.points, there.world, 0.9, float(right))


@pytest.mark.parametrize("side", ["left", "right"])
def test_fingers_bend_to_the_palm_from_every_view(side: Side) -> None:
    world = bent(side)
    sign = 1.0 if side == "right" else -1.0
    values = [log_odds(hand(R.apply(world))) for R in Rotation.random(20, random_state=0)]
    assert min(sign * np.array(values)) > 0.5
    np.testing.assert_allclose(values, values[0], atol=1e-9)


@pytest.mark.parametrize("right", [0.02, 0.3, 0.9])
def test_a_mirror_image_has_the_opposite_odds(right: float) -> None:
    one = hand(bent("left"), right)
    other = Sighting(one.points, one.world * MIRROR, 0.9, 1.0 - right)
    assert log_odds(other) == pytest.approx(-log_odds(one))


def test_the_mirror_image_of_a_square_is_the_square_of_the_mirror_image() -> None:
    image = np.random.default_rng(0).integers(0, 256, (90, 120, 3), dtype=np.uint8)
    square = HandCrop(np.array([41.3, 60.8]), 50.0, 0.4)
    over_there = square._replace(middle=np.array([120.0 - 41.3, 60.8]), angle=-0.4)
    shown: list[np.ndarray] = []

    def net(given: np.ndarray) -> list[np.ndarray]:
        shown.append(given)
        return [np.arange(63.0, dtype=np.float32), *np.full((2, 1), 0.5, np.float32), np.ones(63, np.float32)]

    nets = Nets(net, net, "")
    there, other = nets.mirrored(image, square), nets.landmarks(np.ascontiguousarray(image[:, ::-1]), over_there)
    assert np.abs(shown[0] - shown[1]).mean() < 0.01
    np.testing.assert_allclose(there.world, other.world)


@pytest.mark.parametrize("bias", [0.0, 2.0, -2.0])
def test_the_bias_of_the_networks_cancels_out(bias: float) -> None:
    flat = bent("left") * np.array([1.0, 1.0, 0.0])
    nets = Biased(hand(flat, 0.4), bias)
    seen = Sighting(*nets.landmarks(IMAGE, HandCrop(hand(flat).points[0], 100.0, 0.0)))
    assert unbiased_log_odds(IMAGE, seen, nets) == pytest.approx(np.log(0.4 / 0.6))


def test_what_hardly_agrees_is_an_assumption() -> None:
    assert Handedness((-4.0,) * 9 + (0.5,)).source.basis == "estimated"
    faint, mixed = ((-2.4, -2.5, -2.6), "3 of 3 frames, but hardly"), ((-9.0, 0.5, 0.5, -9.0), "2 of 4 frames only")
    for odds, how in (faint, mixed):
        source = Handedness(odds).source
        assert source.basis == "assumed"
        assert source.text.startswith("left, a guess")
        assert source.text.endswith(f"in {how}; --side right overrules this")


def test_hands_without_depths_are_judged_by_the_network_alone() -> None:
    assert log_odds(Sighting(np.zeros((21, 2)), np.full((21, 3), np.nan), 0.9, 0.25)) == pytest.approx(np.log(1 / 3))
