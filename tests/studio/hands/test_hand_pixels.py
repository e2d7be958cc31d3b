"""The mask of a hand is where its colour is, near its landmarks."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from getagrip.studio.hands import hand_mask
from getagrip.studio.hands.hand_pixels import LANDMARK_BONES, skin_colour
from helpers.labelled_scene import POINTS

SHAPE = (480, 640)
HAND = 2.0 * POINTS
RNG = np.random.default_rng(0)


def fingers(x: float, y: float, tip: float) -> list[tuple[float, float]]:
    """The joints of a stretched finger, from its knuckle upwards."""
    return [(x + 0.1 * n * (x - 320.0), y + (tip - y) * n / 3.0) for n in range(4)]


THUMB = [(265.0, 365.0), (235.0, 335.0), (215.0, 305.0), (200.0, 280.0)]
KNUCKLES = (270.0, 280.0, 160.0), (305.0, 270.0, 140.0), (340.0, 275.0, 150.0), (372.0, 290.0, 190.0)
OPEN = np.array([(320.0, 400.0), *THUMB, *(joint for each in KNUCKLES for joint in fingers(*each))])
"""A hand whose palm is seen."""


def drawn(hand: np.ndarray = HAND) -> tuple[np.ndarray, np.ndarray]:
    """An image of a hand before a table, and where the hand is."""
    mask = np.zeros(SHAPE, np.uint8)
    at = np.round(hand).astype(int)
    for a, b in LANDMARK_BONES:
        cv2.line(mask, tuple(at[a].tolist()), tuple(at[b].tolist()), 1, 18)
    cv2.fillConvexPoly(mask, cv2.convexHull(at[[0, 1, 5, 9, 13, 17]].astype(np.int32)), 1)
    image = np.where(mask[..., None] > 0, [205, 150, 120], [70, 90, 110]) + RNG.normal(0.0, 6.0, (*SHAPE, 3))
    return image.clip(0, 255).astype(np.uint8), mask > 0


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / (a | b).sum())


def test_the_hand_is_found_where_it_is() -> None:
    image, truth = drawn()
    assert iou(hand_mask(image, HAND), truth) > 0.9


def test_what_hides_a_finger_is_not_the_hand() -> None:
    image, truth = drawn()
    tip = HAND[12]
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]] + 0.5
    cup = np.hypot(u - tip[0], v - tip[1]) < 30.0
    image[cup] = np.array([30, 120, 40], np.uint8)
    assert iou(hand_mask(image, HAND), truth & ~cup) > 0.85
    assert not (hand_mask(image, HAND, cup) & cup).any()


@pytest.mark.parametrize("rows", [SHAPE[0], 385])
def test_an_object_before_the_palm_is_not_the_hand_where_thumb_and_wrist_show_the_skin(rows: int) -> None:
    """Or thumb and fingers, where the wrist is out of view."""
    image, truth = drawn(OPEN)
    arm = np.zeros(SHAPE, np.uint8)
    cv2.line(arm, (320, 400), (320, 470), 1, 60)
    image[(arm > 0) & ~truth] = image[truth][0]
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]] + 0.5
    can = np.hypot(u - 325.0, v - 315.0) < 50.0
    image[can] = np.array([40, 60, 150], np.uint8)
    image, truth, can = image[:rows], truth[:rows], can[:rows]
    found = hand_mask(image, OPEN)
    assert (found & can).sum() < 0.1 * can.sum()
    assert (found & truth & ~can).sum() > 0.8 * (truth & ~can).sum()


def test_an_object_before_thumb_and_fingertips_is_not_the_hand_where_the_wrist_is_out_of_view() -> None:
    image, truth = drawn(OPEN)
    can = np.zeros(SHAPE, np.uint8)
    for line in ([1, 2, 3, 4], [7, 8], [11, 12], [15, 16], [19, 20]):
        cv2.polylines(can, [OPEN[line].round().astype(np.int32)], False, 1, 50)
    image[can > 0] = np.array([40, 60, 150], np.uint8)
    image, truth, hides = image[:385], truth[:385], can[:385] > 0
    found = hand_mask(image, OPEN)
    assert (found & hides).sum() < 0.1 * hides.sum()
    assert (found & truth & ~hides).sum() > 0.8 * (truth & ~hides).sum()


def test_a_finger_in_shadow_is_the_hands_and_what_is_grey_is_not() -> None:
    image, truth = drawn()
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]] + 0.5
    tip = truth & (np.hypot(u - HAND[12][0], v - HAND[12][1]) < 30.0)
    dark, grey = image.copy(), image.copy()
    dark[tip] = (0.66 * dark[tip]).astype(np.uint8)
    grey[tip] = dark[tip].mean(axis=-1, keepdims=True).astype(np.uint8)
    assert (hand_mask(dark, HAND) & tip).sum() > 0.8 * tip.sum()
    assert (hand_mask(grey, HAND) & tip).sum() < 0.3 * tip.sum()


def test_paper_among_the_fingers_is_not_the_hand_and_overexposed_skin_is() -> None:
    image, truth = drawn(OPEN)
    image = (image + RNG.normal(0.0, 12.0, (*SHAPE, 3))).clip(0, 255).astype(np.uint8)  # as varied as in a video
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]] + 0.5
    among = np.hypot(u - 325.0, v - 225.0) < 45.0
    light = 1.0 + np.clip(2.0 - np.hypot(u - 300.0, v - 300.0) / 20.0, 0.0, 1.0)
    spot, paper = truth & (light > 1.5), image.copy()
    paper[among] = (np.array([168, 157, 150]) + RNG.normal(0.0, 6.0, (among.sum(), 3))).astype(np.uint8)
    lit = (image * np.where(truth, light, 1.0)[..., None]).clip(0, 255).astype(np.uint8)
    assert (hand_mask(paper, OPEN) & among).sum() < 0.1 * among.sum()
    assert (hand_mask(lit, OPEN) & spot).sum() > 0.8 * spot.sum()


def test_in_a_video_of_hardly_any_colour_pale_pixels_may_be_the_hand() -> None:
    image, truth = drawn()
    grey = image.mean(axis=-1, keepdims=True)
    dull = grey + 0.1 * (image - grey) + RNG.normal(0.0, 6.0, image.shape)
    assert iou(hand_mask(dull.clip(0, 255).astype(np.uint8), HAND), truth) > 0.94


def test_a_hand_beside_the_image_has_no_mask() -> None:
    image, _ = drawn()
    assert not hand_mask(image, HAND + 5000.0).any()


def test_a_palm_seen_from_its_side_is_thick() -> None:
    hand = 0.5 * OPEN
    hand[:, 0] = 160.0 + 0.3 * (hand[:, 0] - 160.0)
    image, _ = drawn(hand)
    palm = np.zeros(SHAPE, np.uint8)
    for knuckle in (5, 9, 13, 17):
        cv2.line(palm, *(np.round(hand[n]).astype(int).tolist() for n in (0, knuckle)), 1, 34)
    skin = (np.array([205, 150, 120]) + RNG.normal(0.0, 6.0, (*SHAPE, 3))).clip(0, 255).astype(np.uint8)
    image[palm > 0] = skin[palm > 0]
    found = hand_mask(image, hand)
    assert (found & (palm > 0)).sum() > 0.95 * (palm > 0).sum()
    assert not (found & ~cv2.dilate(palm, np.ones((9, 9), np.uint8)).astype(bool))[170:].any()


def test_a_red_cup_before_palm_and_thumb_is_not_the_hand_where_other_frames_show_the_skin() -> None:
    image, truth = drawn()
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]] + 0.5
    hidden = HAND[[0, 1, 2, 3, 4, 5, 9, 13, 17]]
    low, high = hidden.min(axis=0) - 12.0, hidden.max(axis=0) + 12.0
    cup = (u > low[0]) & (u < high[0]) & (v > low[1]) & (v < high[1])
    held = image.copy()
    held[cup] = np.array([210, 25, 40], np.uint8)
    frames = {0: held, 1: image, 2: image}
    skin = skin_colour(frames.__getitem__, dict.fromkeys(frames, HAND))
    assert skin is not None
    assert iou(hand_mask(held, HAND), truth & ~cup) < 0.2, "the frame alone shows the cup's colour"
    assert iou(hand_mask(held, HAND, skin=skin), truth & ~cup) > 0.7
    assert iou(hand_mask(image, HAND, skin=skin), truth) > 0.9


def test_grey_or_blue_parts_are_not_the_skin() -> None:
    image, _ = drawn()
    blue = np.full_like(image, [60, 80, 200])
    assert skin_colour({0: blue}.__getitem__, {0: HAND}) is None
    frames = {0: blue, 1: blue, 2: image}
    np.testing.assert_allclose(
        skin_colour(frames.__getitem__, dict.fromkeys(frames, HAND)), skin_colour({0: image}.__getitem__, {0: HAND})
    )
    assert skin_colour(frames.__getitem__, {}) is None
