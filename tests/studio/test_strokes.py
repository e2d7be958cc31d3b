"""Strokes, clicks and boxes on a synthetic image whose true mask is known."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy import ndarray

from getagrip.errors import UsageError
from getagrip.studio.masks import stroke_prompt as strokes_of_annotate
from getagrip.studio.masks.box_prompt import empty_side, segment_box
from getagrip.studio.masks.stroke_prompt import apply_strokes
from getagrip.studio.store.labels import HAND_LABEL, OBJECT_LABEL, OCCLUDER_LABEL, FrameLabels

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
    found, starts = strokes_of_annotate._grabcut, []

    def all_at_first(small: ndarray, labels: ndarray, sure: ndarray, never: ndarray) -> ndarray:
        starts.append(labels)
        return ~never if len(starts) == 1 else found(small, labels, sure, never)

    monkeypatch.setattr(strokes_of_annotate, "_grabcut", all_at_first)
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
