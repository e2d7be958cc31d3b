"""A click on a thing of two colours that a hand moves over a textured ground."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy import ndarray

from getagrip.annotate.boxes import boxed, moving_in_box
from getagrip.annotate.click_motion import moves_with_click
from getagrip.annotate.labels import OBJECT, FrameLabels, Labels
from getagrip.annotate.strokes import key_masks, stroked

SIZE, LAST = (240, 180), 16
CLICK = FrameLabels(on=(np.array([[110.0, 80.0]]),))


def texture(seed: int, colour: tuple[int, int, int]) -> ndarray:
    rng = np.random.default_rng(seed)
    grey = sum(cv2.resize(rng.normal(0.0, 18.0, (n, n)), (512, 512), interpolation=cv2.INTER_CUBIC) for n in (32, 128))
    return np.asarray(np.clip(np.array(colour) + grey[..., None], 0, 255), np.uint8)


GROUND, SKIN = texture(0, (150, 130, 100)), texture(1, (200, 150, 130))
RED, BLUE = texture(2, (170, 60, 50)), texture(3, (50, 70, 170))


def scene(n: int, speed: float = 2.5) -> tuple[ndarray, ndarray, ndarray]:
    """An image, where the thing is, and where the hand is."""
    x = round(speed * (n - LAST // 2))
    image, thing, hand = GROUND[: SIZE[1], : SIZE[0]].copy(), np.zeros(SIZE[::-1], bool), np.zeros(SIZE[::-1], bool)
    for mask, pattern, (left, right, top, bottom) in (
        (thing, RED, (90, 130, 60, 100)),
        (thing, BLUE, (90, 130, 100, 130)),
        (hand, SKIN, (60, 90, 70, 180)),
    ):
        part = slice(top, bottom), slice(left + x, right + x)
        image[part], mask[part] = pattern[top:bottom, left:right], True
    return image, thing, hand


def moves(speed: float, order: int = 1) -> ndarray | None:
    click = np.zeros(SIZE[::-1], bool)
    click[80, 110] = True

    def image(n: int) -> ndarray:
        return scene(LAST // 2 + order * (n - LAST // 2), speed)[0]

    return moves_with_click(image, LAST // 2, (0, LAST), click, scene(LAST // 2)[2])


@pytest.mark.slow
def test_what_moves_with_the_click_and_the_hand_is_above_0_and_the_ground_below() -> None:
    found = moves(2.5)
    _, thing, hand = scene(LAST // 2)
    assert found is not None
    assert (found[thing] > 0.15).mean() > 0.95
    far = cv2.dilate((thing | hand).astype(np.uint8), np.ones((31, 31))) == 0
    assert (found[far] < -0.5).mean() > 0.95
    back = moves(2.5, -1)
    assert back is not None
    assert np.corrcoef(found.ravel(), back.ravel())[0, 1] > 0.95  # time has no direction


def test_where_nothing_moves_nothing_is_known() -> None:
    assert moves(0.0) is None


@pytest.mark.slow
def test_a_click_on_one_colour_finds_the_other_that_moves_with_it() -> None:
    n = LAST // 2
    image, thing, hand = scene(n)
    labels = Labels("video", SIZE, "left", 30.0, 0, LAST, {n: CLICK})

    def overlap(found: ndarray) -> float:
        return float((found & thing).sum() / (found | thing).sum())

    assert overlap(key_masks(labels, lambda n: scene(n)[0], lambda _: hand)[n] == OBJECT) > 0.9
    assert overlap(stroked(image, np.zeros(SIZE[::-1], np.uint8), CLICK, hand) == OBJECT) < 0.7  # by colours alone


@pytest.mark.slow
def test_what_stays_with_the_ground_while_the_object_moves_is_not_the_object_in_a_box() -> None:
    """A sleeve behind it, say, whose colour is one of the object's and nowhere beside the box."""
    n, box = LAST // 2, (90.0, 60.0, 70.0, 70.0)
    _, thing, hand = scene(n)

    def image(at: int) -> ndarray:
        seen, front, holding = scene(at)
        behind = np.zeros(SIZE[::-1], bool)
        behind[90:130, 130:160] = True
        return np.where((behind & ~front & ~holding)[..., None], BLUE[: SIZE[1], : SIZE[0]], seen)

    def overlap(labels: ndarray) -> float:
        return float(((labels == OBJECT) & thing).sum() / ((labels == OBJECT) | thing).sum())

    assert overlap(boxed(image(n), box, hand)) < 0.75
    assert overlap(moving_in_box(image, n, (0, LAST), box, hand)) > 0.9
    np.testing.assert_array_equal(moving_in_box(image, n, (n, n), box, hand), boxed(image(n), box, hand))
