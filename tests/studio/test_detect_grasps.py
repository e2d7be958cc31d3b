"""The reach for an object at rest, and the release, are told from a grasp by what moves over the ground."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from getagrip.studio.detect_grasps import find_arrival, track_visible_box, trim_reach
from getagrip.studio.store.labels import FrameLabels, Labels
from helpers.labelled_scene import joints

FRAMES, ARRIVES, LIFTS = 40, 12, 20
SIZE = 48.0
HAND = np.array(joints(0))
TABLE = cv2.GaussianBlur(np.random.default_rng(0).integers(60, 220, (400, 500, 3)).astype(np.uint8), (0, 0), 2)
CLOTH = np.random.default_rng(1).integers(0, 255, (48, 48, 3)).astype(np.uint8)


class Shot:
    """A square on a table that a hand comes to and lifts; the camera moves all the while."""

    def __init__(self, arrives: int = ARRIVES, lifts: int = LIFTS) -> None:
        self.arrives, self.lifts = arrives, lifts

    def middle(self, n: int) -> np.ndarray:
        lifted = 3.0 * max(0, n - self.lifts) * np.array([0.3, -1.0])
        return np.array([200.0, 170.0]) - self.camera(n) + lifted

    @staticmethod
    def camera(n: int) -> np.ndarray:
        return np.array([1.0, 0.5]) * n

    def image(self, n: int) -> np.ndarray:
        x, y = self.camera(n).round().astype(int) + 30
        image = TABLE[y : y + 240, x : x + 320].copy()
        left, top = (self.middle(n) - SIZE / 2).round().astype(int)
        image[top : top + 48, left : left + 48] = CLOTH
        return image

    def joints(self, n: int) -> np.ndarray:
        away = 5.0 * max(0, self.arrives - n) * np.array([-1.0, 0.2])
        return HAND - HAND.mean(axis=0) + self.middle(n) + [-60.0, 10.0] + away

    def box(self, n: int) -> tuple[float, float, float, float]:
        return (*(self.middle(n) - SIZE / 2).tolist(), SIZE, SIZE)


def found(shot: Shot, frames: int = FRAMES) -> int | None:
    boxes = track_visible_box(shot.image, shot.box(0), 0, frames - 1)
    return find_arrival(shot.image, boxes, {n: shot.joints(n) for n in range(frames)}, frames - 1)


def test_a_reach_ends_where_the_hand_has_come_to_the_object() -> None:
    first = found(Shot())
    assert first is not None
    assert abs(first - ARRIVES) <= 3


@pytest.mark.parametrize("shot", [Shot(arrives=0), Shot(arrives=0, lifts=0)])
def test_what_is_find_arrival_the_start_is_taken_whole(shot: Shot) -> None:
    assert found(shot) is None


def test_an_object_that_never_moves_tells_nothing() -> None:
    assert found(Shot(), LIFTS - 2) is None


def square(shot: Shot, n: int) -> FrameLabels:
    x, y, w, h = shot.box(n)
    return FrameLabels(object=(np.array([[x, y], [x + w, y], [x + w, y + h], [x, y + h]]),))


def test_reach_and_release_are_left_out_by_masks_and_a_key_is_propagated() -> None:
    shot = Shot()
    known = {n: shot.joints(n) for n in range(FRAMES)}
    there = Labels("it", (320, 240), "left", 30.0, 0, FRAMES - 1, {n: square(shot, n) for n in range(FRAMES)})
    grasp = trim_reach(there, shot.image, known, lambda _: None)
    assert grasp.extents[0][1] == FRAMES - 1
    assert abs(grasp.extents[0][0] - ARRIVES) <= 3
    assert "reaches for it before; --all-frames uses all" in grasp.said
    back = Labels("it", (320, 240), "left", 30.0, 0, FRAMES - 1, {n: square(shot, FRAMES - 1 - n) for n in known})
    turned = {FRAMES - 1 - n: each for n, each in known.items()}
    grasp = trim_reach(back, lambda n: shot.image(FRAMES - 1 - n), turned, lambda _: None)
    assert grasp.extents[0][0] == 0
    assert abs(grasp.extents[0][1] - (FRAMES - 1 - ARRIVES)) <= 3
    assert "leaves it after" in grasp.said


@pytest.mark.slow
def test_the_first_mask_is_propagated_to_the_grasp() -> None:
    shot = Shot(arrives=8, lifts=12)
    known = {n: shot.joints(n) for n in range(20)}
    one = Labels("it", (320, 240), "left", 30.0, 0, 19, {0: square(shot, 0)})
    grasp = trim_reach(one, shot.image, known, lambda _: None, (0, shot.box(0)))
    (first, _) = grasp.extents[0]
    assert [*grasp.labels.frames] == [0, first]
    shape = np.concatenate(grasp.labels.frames[first].object or ())
    assert np.abs((shape.min(axis=0) + shape.max(axis=0)) / 2 - shot.middle(first)).max() < 3.0


@pytest.mark.slow
def test_a_release_is_left_out_by_the_first_mask_alone() -> None:
    shot, frames = Shot(arrives=8, lifts=12), 24
    known = {frames - 1 - n: shot.joints(n) for n in range(frames)}
    one = Labels("it", (320, 240), "left", 30.0, 0, frames - 1, {0: square(shot, frames - 1)})
    grasp = trim_reach(one, lambda n: shot.image(frames - 1 - n), known, lambda _: None)
    (first, last) = grasp.extents[0]
    assert first == 0
    assert abs(last - (frames - 1 - 8)) <= 3
    assert "leaves it after" in grasp.said
    assert [*grasp.labels.frames] == [0]
