"""Motion of an object between frames: a box that is followed, a hand's step, flow beside a known step."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import cv2
import numpy as np
import pytest
from numpy import ndarray

from getagrip.provenance import measured
from getagrip.readers.footage import Footage
from getagrip.studio.hands import HandLandmarks, Sighting
from getagrip.studio.hands.detect_hands import find_landmarks
from getagrip.studio.hands.networks import Nets
from getagrip.studio.masks.box_prompt import Box, track_box
from getagrip.studio.masks.optical_flow import SmallFrames, hand_displacement
from getagrip.studio.masks.propagate_frame import Images

SIZE, STEP = (160, 120), (9.0, 4.0)
BOX = (30.0, 25.0, 40.0, 30.0)


def texture(seed: int, height: int, width: int) -> ndarray:
    rng = np.random.default_rng(seed)
    return np.asarray(cv2.resize(rng.integers(0, 255, (height // 5, width // 5, 3), np.uint8), (width, height)))


GROUND, THING = texture(0, *SIZE[::-1]), texture(1, 30, 40)


def image(n: int) -> ndarray:
    """A textured thing that crosses a textured ground."""
    out, (x, y) = GROUND.copy(), place(n)
    out[y : y + 30, x : x + 40] = THING
    return out


def place(n: int) -> tuple[int, int]:
    return round(BOX[0] + STEP[0] * n), round(BOX[1] + STEP[1] * n)


def followed_box(images: Images, box: Box, first: int, to: int) -> Box:
    *_, (last, _) = track_box(images, box, first, to)
    return last


def test_a_box_stays_where_all_looks_alike() -> None:
    assert followed_box(lambda _: np.full((60, 80, 3), 90, np.uint8), (30.5, 20.0, 15.0, 12.0), 0, 2) == (
        30.5,
        20.0,
        15.0,
        12.0,
    )


def test_a_box_is_followed() -> None:
    assert followed_box(image, BOX, 2, 2) == BOX
    there = followed_box(image, BOX, 0, 6)
    assert np.abs(np.subtract(there[:2], place(6))).max() <= 3.0
    assert there[2:] == BOX[2:]
    assert followed_box(image, BOX, 0, 6) == there


def test_the_box_is_followed_in_reduced_images_of_the_search_for_hands(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is passed on by frame, in pixels of the images: the hand that stays at the object is chosen by them."""
    given: list[dict[int, ndarray]] = []

    def select(seen: object, side: object, boxes: dict[int, ndarray], *_: object) -> HandLandmarks:
        given.append(boxes)
        return HandLandmarks("left", np.zeros((1, 21, 2)), np.zeros((1, 21)), np.zeros((1, 21, 3)), measured(""))

    def follow(image: Images, count: int, *_: object) -> list[list[Sighting]]:
        for n in range(count):
            image(n)
        return []

    monkeypatch.setattr("getagrip.studio.hands.detect_hands.select_hand", select)
    monkeypatch.setattr("getagrip.studio.hands.detect_hands.track_hands", follow)
    footage = cast(
        Footage, SimpleNamespace(image=lambda n: cv2.resize(image(n - 3), None, fx=4, fy=4), size=(640, 480))
    )
    box = 4.0 * np.array(BOX)
    find_landmarks(footage, (3, 9), Nets(lambda _: [], lambda _: [], ""), box=box)
    np.testing.assert_array_equal(given[0][0], box)
    assert np.abs(given[0][6][:2] - 4.0 * np.array(place(6))).max() <= 20.0
    find_landmarks(footage, (3, 9), Nets(lambda _: [], lambda _: [], ""), box=np.array([120.0, 100.0, 160.0, 9.0]))
    assert given[1].keys() == {0}  # too thin to be followed


def test_a_box_about_a_plain_thing_leaves_the_ground_behind() -> None:
    """Most of the texture in the box is the ground's, which stays."""

    def image(n: int) -> ndarray:
        out, corner = GROUND.copy(), (40 + 15 * n, 35 + 8 * n)
        cv2.rectangle(out, corner, (corner[0] + 24, corner[1] + 18), (60, 200, 90), -1)
        return out

    assert np.abs(np.subtract(followed_box(image, (36.0, 31.0, 32.0, 26.0), 0, 1)[:2], (51, 39))).max() <= 2.0


@pytest.mark.parametrize("frames", [(0, 1), (1, 0)])
def test_flow_beside_a_known_step_is_that_step_where_the_thing_is(frames: tuple[int, int]) -> None:
    step = (40, -20)
    apart = {0: image(0), 1: np.roll(image(0), step[::-1], (0, 1))}
    signed = step if frames == (0, 1) else (-step[0], -step[1])
    part = slice(0, SIZE[1]), slice(0, SIZE[0])
    x, y = (100, 60) if signed[0] < 0 else (50, 60)
    there, back = SmallFrames(apart.__getitem__, SIZE).flows(*frames, part, signed)
    np.testing.assert_allclose(there[y, x], signed, atol=0.5)
    np.testing.assert_allclose(back[y + signed[1], x + signed[0]], np.negative(signed), atol=0.5)


def test_a_step_of_a_hand_needs_both_masks() -> None:
    one = np.zeros((20, 30), bool)
    one[5:9, 3:9] = True
    assert hand_displacement(one, np.roll(one, (6, 11), (0, 1))) == (11, 6)
    assert (
        hand_displacement(one, None)
        == hand_displacement(None, one)
        == hand_displacement(one, np.zeros_like(one))
        == (0, 0)
    )
