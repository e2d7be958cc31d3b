"""Segmentation from clicks, strokes and boxes: strokes are obeyed, and a thing of two colours moves with its click."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy import ndarray

from getagrip.errors import UsageError
from getagrip.studio.masks import box_prompt, stroke_prompt
from getagrip.studio.masks.box_prompt import (
    Box,
    box_to_slices,
    empty_side,
    first_mask_finding,
    segment_box,
    segment_box_by_motion,
)
from getagrip.studio.masks.stroke_prompt import apply_strokes, click_motion_log_ratio, keyframe_label_maps
from getagrip.studio.store.labels import HAND_LABEL, OBJECT_LABEL, OCCLUDER_LABEL, FrameLabels, Labels

SIZE = (160, 120)
CENTRE, RADIUS = (80, 60), 30


def scene() -> tuple[ndarray, ndarray]:
    """A red disc on a grey ground, and its mask."""
    mask = np.zeros(SIZE[::-1], np.uint8)
    cv2.circle(mask, CENTRE, RADIUS, 1, -1)
    noise = np.random.default_rng(0).normal(0.0, 6.0, (*mask.shape, 3))
    image = np.where(mask[..., None] > 0, np.array([190, 60, 50]), np.array([90, 110, 120])) + noise
    return np.clip(image, 0, 255).astype(np.uint8), mask > 0


def iou(a: ndarray, b: ndarray) -> float:
    return float((a & b).sum() / max((a | b).sum(), 1))


NOTHING = np.zeros(SIZE[::-1], np.uint8)


def strokes(*lines: list[tuple[float, float]]) -> tuple[ndarray, ...]:
    return tuple(np.array(line, float) for line in lines)


def test_a_face_of_the_hands_colour_is_the_objects_where_no_finger_can_be() -> None:
    rng = np.random.default_rng(0)
    image = rng.normal((40.0, 45.0, 40.0), 8.0, (*SIZE[::-1], 3))
    thing, face, hand, fingers = (np.zeros(SIZE[::-1], np.uint8) for _ in range(4))
    cv2.fillConvexPoly(thing, np.array([[40, 50], [70, 22], [112, 46], [80, 84]]), 1)
    cv2.fillConvexPoly(face, np.array([[42, 52], [58, 38], [92, 62], [78, 82]]), 1)
    for arm, width in ((hand, 32), (fingers, 40)):
        cv2.line(arm, (92, 64), (130, 118), 1, width)
    image[thing > 0] = rng.normal((10.0, 80.0, 140.0), 8.0, (int(thing.sum()), 3))
    image[face > 0] = image[hand > 0] = 254.0  # overexposed
    shown, image = (thing > 0) & (hand == 0), np.clip(image, 0, 255).astype(np.uint8)
    box = (38, 20, 76, 66)
    assert iou(segment_box(image, box, hand > 0) == OBJECT_LABEL, shown) < 0.7
    assert iou(segment_box(image, box, hand > 0, fingers > 0) == OBJECT_LABEL, shown) > 0.9


@pytest.mark.parametrize(
    ("box", "cut"), [((46, 26, 68, 68), False), ((30, 10, 100, 99), False), ((65, 26, 60, 68), True)]
)
def test_a_mask_that_its_box_cuts_off_is_noticed(box: Box, cut: bool) -> None:
    image, mask = scene()
    labels = np.zeros_like(NOTHING)
    labels[box_to_slices(box, SIZE)] = mask[box_to_slices(box, SIZE)]
    assert ("does the object reach beyond it?" in first_mask_finding(image, labels, box)) == cut


def test_a_mask_that_lacks_a_part_is_noticed_unless_a_finger_can_be_there() -> None:
    image, mask = scene()
    labels = np.where(mask & (np.indices(mask.shape)[0] < 62), np.uint8(OBJECT_LABEL), np.uint8(0))
    box = (46.0, 26.0, 68.0, 68.0)
    assert "are they a part of the object?" in first_mask_finding(image, labels, box)
    assert first_mask_finding(image, labels, box, mask) == ""
    assert first_mask_finding(image, NOTHING, box) == ""


@pytest.mark.parametrize("line", [[(80.0, 60.0)], [(65.0, 60.0), (95.0, 62.0)]])
def test_a_click_or_a_stroke_finds_an_object_of_one_colour(line: list[tuple[float, float]]) -> None:
    image, mask = scene()
    assert iou(apply_strokes(image, NOTHING, FrameLabels(on=strokes(line))) == OBJECT_LABEL, mask) > 0.95


def test_a_box_finds_it_and_the_hand_is_not_the_object() -> None:
    image, mask = scene()
    hand = np.zeros(SIZE[::-1], bool)
    hand[55:65, :80] = True
    image[hand] = (220, 190, 160)
    found = segment_box(image, (46, 26, 68, 68), hand)
    assert iou(found == OBJECT_LABEL, mask & ~hand) > 0.93
    assert ((found == HAND_LABEL) == hand).all()
    for box in ((200, 0, 10, 10), (0, 0, 0, 5)):
        with pytest.raises(UsageError, match="160 x 120"):
            segment_box(image, box)


def test_a_box_finds_parts_that_the_hand_separates_and_what_of_the_hand_looks_like_them() -> None:
    """The found hand reaches between its fingers, too, where the object is seen."""
    image, mask = scene()
    hand, between = np.zeros(SIZE[::-1], bool), np.s_[58:62, 60:90]
    hand[45:75, :120] = True
    image[hand] = (220, 190, 160)
    image[between] = (190, 60, 50)
    found = segment_box(image, (46, 26, 68, 68), hand)
    assert iou(found == OBJECT_LABEL, mask & (~hand | (image == (190, 60, 50)).all(axis=-1))) > 0.9
    assert (found == OBJECT_LABEL)[between].mean() > 0.7
    assert (found == HAND_LABEL)[45:55, :40].all()


def test_a_label_that_was_taken_for_the_hand_is_the_objects_in_a_box() -> None:
    """Its colour is neither that of the rest of the object nor the hand's beyond the box."""
    image, mask = scene()
    hand, label = np.zeros(SIZE[::-1], bool), np.s_[48:72, 65:95]
    hand[55:65, :60] = True
    image[hand] = (220, 190, 160)
    image[label] = (200, 160, 40)
    hand[label] = True
    found = segment_box(image, (46, 26, 68, 68), hand)
    assert (found == OBJECT_LABEL)[label].mean() > 0.9
    assert (found == HAND_LABEL)[55:65, :45].all()
    assert iou(found == OBJECT_LABEL, mask & (image != (220, 190, 160)).any(axis=-1)) > 0.9


def test_where_most_of_a_box_is_taken_its_own_colours_are_the_object(monkeypatch: pytest.MonkeyPatch) -> None:
    """GrabCut may take all of a box for the object where that is thin: its colours begin with all of it."""
    image, mask = scene()
    found, starts = stroke_prompt._grabcut, []

    def all_at_first(small: ndarray, labels: ndarray, sure: ndarray, never: ndarray) -> ndarray:
        starts.append(labels)
        return ~never if len(starts) == 1 else found(small, labels, sure, never)

    monkeypatch.setattr(stroke_prompt, "_grabcut", all_at_first)
    assert iou(segment_box(image, (5, 15, 150, 90)) == OBJECT_LABEL, mask) > 0.95
    assert len(starts) == 2


@pytest.mark.parametrize(
    ("side", "part", "share"),
    [
        ("left", np.s_[:, :25], 0.3),
        ("top", np.s_[:30], 0.25),
        ("right", np.s_[:, 45:], 0.3),
        ("bottom", np.s_[50:], 0.25),
    ],
)
def test_the_side_at_which_a_box_is_empty_is_named(side: str, part: tuple[slice, slice], share: float) -> None:
    box, labels = (10.0, 20.0, 50.0, 40.0), NOTHING.copy()
    assert empty_side(labels, box) is None
    labels[20:60, 15:55] = OBJECT_LABEL  # a tenth is empty
    assert empty_side(labels, box) is None
    labels[20:60, 10:60] = OBJECT_LABEL
    assert empty_side(labels, box) is None
    labels[part] = 0
    assert empty_side(labels, box) == (side, pytest.approx(share))
    labels[part] = HAND_LABEL  # it hides the object there
    assert empty_side(labels, box) is None


def test_a_box_that_reaches_out_of_the_image_is_not_empty_there() -> None:
    labels = NOTHING.copy()
    labels[40:80, 120:157] = OBJECT_LABEL
    assert empty_side(labels, (120.0, 40.0, 44.0, 40.0)) is None


@pytest.mark.parametrize("seed", range(4))
def test_an_object_whose_colours_are_those_of_its_ground_is_not_lost(seed: int) -> None:
    _, mask = scene()
    blots = np.random.default_rng(seed).integers(0, 256, (2, 12, 16, 3)).astype(np.uint8)
    ground, thing = (cv2.resize(each, SIZE, interpolation=cv2.INTER_NEAREST) for each in blots)
    found = segment_box(np.where(mask[..., None], thing, ground).astype(np.uint8), (46, 26, 68, 68)) == OBJECT_LABEL
    assert (found & mask).sum() > 0.5 * mask.sum()


@given(
    on=st.lists(st.tuples(st.integers(5, 154), st.integers(5, 114)), min_size=1, max_size=3),
    off=st.tuples(st.integers(5, 154), st.integers(5, 114)),
    drawn=st.booleans(),
)
@settings(max_examples=15, deadline=None)
def test_strokes_are_obeyed_exactly(on: list[tuple[int, int]], off: tuple[int, int], drawn: bool) -> None:
    image, mask = scene()
    start = np.where(mask, OBJECT_LABEL, 0).astype(np.uint8) if drawn else NOTHING
    found = apply_strokes(
        image, start, FrameLabels(on=strokes([(x + 0.5, y + 0.5) for x, y in on]), off=strokes([off]))
    )
    assert all(found[y, x] == OBJECT_LABEL for x, y in on)
    if min(abs(x - off[0]) + abs(y - off[1]) for x, y in on) > 8 and len(on) == 1:
        assert found[off[1], off[0]] != OBJECT_LABEL


def test_a_polygon_holds_far_from_strokes_and_is_corrected_near_to_them() -> None:
    image, mask = scene()
    start = np.where(mask, OBJECT_LABEL, 0).astype(np.uint8)
    start[:, :60] = 0  # too small at the left, and too large far away at the right
    start[58:62, 80:140] = OBJECT_LABEL
    found = apply_strokes(image, start, FrameLabels(on=strokes([(58.0, 60.0)]))) == OBJECT_LABEL
    assert found[60, 54]
    assert found[60, 135]


def test_what_is_in_front_stays_in_front() -> None:
    image, _ = scene()
    start = NOTHING.copy()
    start[:, 90:] = OCCLUDER_LABEL
    found = apply_strokes(image, start, FrameLabels(on=strokes([(70.0, 60.0)])))
    assert (found[:, 92:] == OCCLUDER_LABEL).all()
    assert (found == OBJECT_LABEL).any()


MOVING_SIZE, LAST = (240, 180), 16
CLICK = FrameLabels(on=(np.array([[110.0, 80.0]]),))


def texture(seed: int, colour: tuple[int, int, int]) -> ndarray:
    rng = np.random.default_rng(seed)
    grey = sum(cv2.resize(rng.normal(0.0, 18.0, (n, n)), (512, 512), interpolation=cv2.INTER_CUBIC) for n in (32, 128))
    return np.asarray(np.clip(np.array(colour) + grey[..., None], 0, 255), np.uint8)


GROUND, SKIN = texture(0, (150, 130, 100)), texture(1, (200, 150, 130))
RED, BLUE = texture(2, (170, 60, 50)), texture(3, (50, 70, 170))


def moving_scene(n: int, speed: float = 2.5) -> tuple[ndarray, ndarray, ndarray]:
    """An image, where the thing is, and where the hand is."""
    x = round(speed * (n - LAST // 2))
    image, thing, hand = (
        GROUND[: MOVING_SIZE[1], : MOVING_SIZE[0]].copy(),
        np.zeros(MOVING_SIZE[::-1], bool),
        np.zeros(MOVING_SIZE[::-1], bool),
    )
    for mask, pattern, (left, right, top, bottom) in (
        (thing, RED, (90, 130, 60, 100)),
        (thing, BLUE, (90, 130, 100, 130)),
        (hand, SKIN, (60, 90, 70, 180)),
    ):
        part = slice(top, bottom), slice(left + x, right + x)
        image[part], mask[part] = pattern[top:bottom, left:right], True
    return image, thing, hand


def moves(speed: float, order: int = 1) -> ndarray | None:
    click = np.zeros(MOVING_SIZE[::-1], bool)
    click[80, 110] = True

    def image(n: int) -> ndarray:
        return moving_scene(LAST // 2 + order * (n - LAST // 2), speed)[0]

    return click_motion_log_ratio(image, LAST // 2, (0, LAST), click, moving_scene(LAST // 2)[2])


@pytest.mark.slow
def test_what_moves_with_the_click_and_the_hand_is_above_0_and_the_ground_below() -> None:
    found = moves(2.5)
    _, thing, hand = moving_scene(LAST // 2)
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
    image, thing, hand = moving_scene(n)
    labels = Labels("video", MOVING_SIZE, "left", 30.0, 0, LAST, {n: CLICK})

    def overlap(found: ndarray) -> float:
        return float((found & thing).sum() / (found | thing).sum())

    assert overlap(keyframe_label_maps(labels, lambda n: moving_scene(n)[0], lambda _: hand)[n] == OBJECT_LABEL) > 0.9
    assert (
        overlap(apply_strokes(image, np.zeros(MOVING_SIZE[::-1], np.uint8), CLICK, hand) == OBJECT_LABEL) < 0.7
    )  # by colours alone


@pytest.mark.slow
def test_what_stays_with_the_ground_while_the_object_moves_is_not_the_object_in_a_box() -> None:
    """A sleeve behind it, say, whose colour is one of the object's and nowhere beside the box."""
    n, box = LAST // 2, (90.0, 60.0, 58.0, 70.0)
    _, thing, hand = moving_scene(n)

    def image(at: int) -> ndarray:
        seen, front, holding = moving_scene(at)
        behind = np.zeros(MOVING_SIZE[::-1], bool)
        behind[100:130, 130:148] = True
        return np.where((behind & ~front & ~holding)[..., None], BLUE[: MOVING_SIZE[1], : MOVING_SIZE[0]], seen)

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
