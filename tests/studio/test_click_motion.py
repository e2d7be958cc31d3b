"""A click on a thing of two colours that a hand moves over a textured ground."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy import ndarray

from getagrip.studio.masks import box_prompt
from getagrip.studio.masks.box_prompt import Box, segment_box, segment_box_by_motion
from getagrip.studio.masks.click_prompt import click_motion_log_ratio
from getagrip.studio.masks.stroke_prompt import apply_strokes, keyframe_label_maps
from getagrip.studio.store.labels import OBJECT_LABEL, FrameLabels, Labels

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

    return click_motion_log_ratio(image, LAST // 2, (0, LAST), click, scene(LAST // 2)[2])


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

    assert overlap(keyframe_label_maps(labels, lambda n: scene(n)[0], lambda _: hand)[n] == OBJECT_LABEL) > 0.9
    assert (
        overlap(apply_strokes(image, np.zeros(SIZE[::-1], np.uint8), CLICK, hand) == OBJECT_LABEL) < 0.7
    )  # by colours alone


@pytest.mark.slow
def test_what_stays_with_the_ground_while_the_object_moves_is_not_the_object_in_a_box() -> None:
    """A sleeve behind it, say, whose colour is one of the object's and nowhere beside the box."""
    n, box = LAST // 2, (90.0, 60.0, 58.0, 70.0)
    _, thing, hand = scene(n)

    def image(at: int) -> ndarray:
        seen, front, holding = scene(at)
        behind = np.zeros(SIZE[::-1], bool)
        behind[100:130, 130:148] = True
        return np.where((behind & ~front & ~holding)[..., None], BLUE[: SIZE[1], : SIZE[0]], seen)

    def overlap(labels: ndarray) -> float:
        return float(((labels == OBJECT_LABEL) & thing).sum() / ((labels == OBJECT_LABEL) | thing).sum())

    assert overlap(segment_box(image(n), box, hand)) < 0.85
    assert overlap(segment_box_by_motion(image, n, (0, LAST), box, hand)) > 0.95
    np.testing.assert_array_equal(segment_box_by_motion(image, n, (n, n), box, hand), segment_box(image(n), box, hand))


def resting(n: int) -> tuple[ndarray, ndarray, ndarray]:
    """A small thing lies still, while a hand about it goes away."""
    v, u = np.mgrid[:180, :320]
    thing, down = (abs(u - 158) < 8) & (abs(v - 88) < 8), v - n
    hand = (abs(u - 158) < 38) & (down > 74) & (down < 170) & ~((abs(u - 158) < 8) & (down < 96))
    image = np.where(hand[..., None], np.roll(SKIN, n, 0)[:180, :320], GROUND[:180, :320])
    return np.where(thing[..., None], RED[:180, :320], image), thing & ~hand, hand


def glass(n: int) -> tuple[ndarray, ndarray, ndarray]:
    """The ground is seen through a thing that moves with a hand."""
    v, u = np.mgrid[:180, :320]
    x = 2 * (n - 20)
    thing, hand = (abs(u - 170 - x) < 30) & (abs(v - 80) < 40), (abs(u - 126 - x) < 16) & (v > 60)
    inner = (abs(u - 170 - x) < 24) & (v > 46) & (v < 99)
    image = np.where(thing[..., None], np.roll(BLUE, x, 1)[:180, :320], GROUND[:180, :320])
    seen_through = 0.8 * GROUND[:180, :320] + 0.2 * np.array([200.0, 215.0, 225.0])
    image = np.where(inner[..., None], seen_through, image).astype(np.uint8)
    return np.where(hand[..., None], np.roll(SKIN, x, 1)[:180, :320], image), thing & ~hand, hand


@pytest.mark.slow
@pytest.mark.parametrize(
    ("drawn", "n", "box"), [(resting, 0, (150.0, 80.0, 17.0, 17.0)), (glass, 20, (138.0, 38.0, 64.0, 84.0))]
)
def test_an_object_in_a_box_that_lies_still_or_is_of_glass_is_kept(
    drawn: Callable[[int], tuple[ndarray, ndarray, ndarray]], n: int, box: Box, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, thing, hand = drawn(n)

    def overlap() -> float:
        found = segment_box_by_motion(lambda at: drawn(at)[0], n, (0, 40), box, hand) == OBJECT_LABEL
        return float((found & thing).sum() / (found | thing).sum())

    assert overlap() > 0.9
    monkeypatch.setattr(box_prompt, "MAX_STATIC_FRACTION", 1.0)
    assert overlap() < 0.75, "but for the limit it would be lost"
