"""Ground that a key shows is known again; what comes into view later is not taken for ground."""

from __future__ import annotations

import cv2
import numpy as np

from getagrip.studio.masks.background_model import BackgroundModel
from getagrip.studio.masks.optical_flow import SmallFrames
from getagrip.studio.masks.stroke_prompt import refine_full_resolution

RNG = np.random.default_rng(0)
IMAGE = cv2.GaussianBlur(RNG.integers(0, 256, (80, 100, 3)).astype(np.uint8), (0, 0), 2.0)
IMAGE = np.clip(128 + 4.0 * (IMAGE.astype(float) - 128), 0, 255).astype(np.uint8)
LEFT = np.zeros(IMAGE.shape[:2], bool)
LEFT[:, :50] = True
PART = slice(0, 80), slice(0, 100)
X, Y = np.meshgrid(*(np.arange(n, dtype=np.float32) for n in IMAGE.shape[1::-1]))


def shares(own: float, other: float = 0.0) -> np.ndarray:
    return np.stack([np.full(LEFT.shape, share, np.float32) for share in (own, other)])


def test_the_same_speaks_for_the_ground_and_another_colour_of_the_objects_against_it() -> None:
    ground = BackgroundModel.of_key(IMAGE, LEFT)
    for image, share, sign in ((IMAGE, 0.0, -1), (255 - IMAGE, 0.1, 1)):
        unlike = ground.unlike(image, shares(share), LEFT)
        assert np.median(sign * unlike[LEFT]) > 1.0
        assert (unlike[~LEFT] == 0.0).all()


def test_a_new_colour_on_ground_that_is_else_unchanged_speaks_for_the_object() -> None:
    """It does not where all of the ground has changed, and less where others have that colour."""
    ground, there = BackgroundModel.of_key(IMAGE, LEFT), np.zeros_like(LEFT)
    there[30:50, 20:40] = True
    image = np.where(there[..., None], 255 - IMAGE, IMAGE)
    new, others = (np.median(ground.unlike(image, shares(0.0, each), LEFT & ~there)[there]) for each in (0.0, 0.1))
    assert new > 1.0
    assert others < 0.0
    assert abs(np.median(ground.unlike(255 - IMAGE, shares(0.0), LEFT)[there])) < 0.1


def test_what_comes_into_view_is_not_seen_ground() -> None:
    """The ground moves 5 px to the right: on its left something appears, and where it was unknown it stays so."""
    ground = BackgroundModel.of_key(IMAGE, LEFT)
    after = np.roll(IMAGE, 5, axis=1)
    moved = ground.moved(PART, (X - 5.0, Y))
    ground.renew(after, PART, moved, np.ones_like(LEFT))
    np.testing.assert_array_equal(ground.seen[:, :5], 0.0)
    np.testing.assert_array_equal(ground.seen[:, 5:55], 1.0)
    np.testing.assert_array_equal(ground.seen[:, 55:], 0.0)
    np.testing.assert_array_equal(ground.image[:, 5:55], after[:, 5:55])


def test_flow_is_the_same_in_both_directions_and_the_second_time() -> None:
    images = {n: np.roll(IMAGE, 2 * n, axis=1) for n in (3, 4)}
    frames = SmallFrames(images.__getitem__, (100, 80))
    there, back = frames.flows(3, 4, PART)
    back_again, there_again = frames.flows(4, 3, PART)
    for one, other in ((there, there_again), (back, back_again)):
        assert np.abs(one - other).mean() < 0.1  # it is kept at half the size
    assert abs(float(np.median(there[..., 0])) - 2.0) < 0.3


def test_a_border_is_drawn_where_colours_change() -> None:
    """It was 1 px of the smaller size off, which is 3 px of the image."""
    image = np.full((60, 90, 3), (200, 60, 40), np.uint8)
    image[:, 45:] = (40, 60, 200)
    off = np.broadcast_to((48.0 - np.arange(90.0)) / 3.0, (60, 90)).astype(np.float32)
    found = refine_full_resolution(image, off, 3.0)
    assert found[:, :44].all()
    assert not found[:, 46:].any()
