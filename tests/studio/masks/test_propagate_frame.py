"""One step of a mask's propagation: colours, motion, and the background behind the object."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy import ndarray

from getagrip.provenance import measured
from getagrip.readers.footage import Footage
from getagrip.studio.hands import HandLandmarks, Sighting
from getagrip.studio.hands.detect_hands import find_landmarks
from getagrip.studio.hands.networks import Nets
from getagrip.studio.masks.box_prompt import Box, track_box
from getagrip.studio.masks.graph_cut import (
    COLOUR_PSEUDO_COUNT,
    KEYFRAME_COLOUR_WEIGHT,
    N_COLOUR_BINS,
    N_IMAGE_CELLS,
    ColourHistogram,
    LocalColourHistogram,
    colour_bins,
    colour_log_ratio,
)
from getagrip.studio.masks.optical_flow import hand_displacement
from getagrip.studio.masks.propagate_clip import refine_full_resolution
from getagrip.studio.masks.propagate_frame import BackgroundModel, Images
from getagrip.studio.masks.small_frames import SmallFrames

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


def bin_of(lab: tuple[int, int, int]) -> tuple[int, int, int]:
    """The three bins of a colour of Lab that is one of RGB."""
    rgb = cv2.cvtColor(np.array([[lab]], np.uint8), cv2.COLOR_LAB2RGB)
    found = int(colour_bins(rgb)[0, 0])
    return found // N_COLOUR_BINS**2, found // N_COLOUR_BINS % N_COLOUR_BINS, found % N_COLOUR_BINS


@given(light=st.integers(90, 190), a=st.integers(108, 148), b=st.integers(108, 148), more=st.integers(0, 20))
def test_bins_rise_with_each_colour(light: int, a: int, b: int, more: int) -> None:
    low, high = bin_of((light, a, b)), bin_of((light, a, b + more))
    assert low[2] <= high[2]
    assert all(0 <= each < N_COLOUR_BINS for each in (*low, *high))


def test_colours_beside_grey_are_told_apart() -> None:
    """Skin, white cardboard and a beige floor are within a tenth of the range."""
    assert bin_of((160, 128, 122))[2] < bin_of((160, 128, 128))[2] < bin_of((160, 128, 134))[2]


@given(seed=st.integers(0, 99))
def test_what_places_say_of_a_colour_changes_steadily_and_in_a_cell_is_its_own(seed: int) -> None:
    rng = np.random.default_rng(seed)
    at, inside = rng.integers(0, 4, (80, 80)).astype(np.int32), rng.random((80, 80)) < 0.5
    keys, places = (
        ColourHistogram(np.zeros((2, N_COLOUR_BINS**3), np.float32)),
        LocalColourHistogram.of(at, inside, np.ones((80, 80), bool)),
    )
    x, y = np.meshgrid(np.arange(0.0, 80.0, 0.1, dtype=np.float32), np.float32([34.5, 44.5]))
    said = colour_log_ratio(np.zeros(x.shape, np.int32), keys, places, (x, y))
    assert np.abs(np.diff(said)).max() < 0.1
    middle = (np.arange(N_IMAGE_CELLS) + 0.5) * 80.0 / N_IMAGE_CELLS - 0.5
    counts = (
        places.counts[:, (3 * N_IMAGE_CELLS + np.arange(N_IMAGE_CELLS)) * N_COLOUR_BINS**3]
        + COLOUR_PSEUDO_COUNT * KEYFRAME_COLOUR_WEIGHT / N_COLOUR_BINS
    )
    np.testing.assert_allclose(np.interp(middle, x[0], said[0]), np.log(counts[0] / counts[1]), atol=0.01)


def test_nearby_colours_are_read_bilinearly_and_from_within_the_image_wherever_a_pixel_came_from() -> None:
    rng = np.random.default_rng(0)
    bins, cells = N_COLOUR_BINS**3, N_IMAGE_CELLS**2
    counts = rng.uniform(1.0, 9.0, (2, cells * bins)).astype(np.float32)
    at = rng.integers(0, bins, (5, 6)).astype(np.int32)
    came = [rng.uniform(-20.0, 180.0, at.shape).astype(np.float32) for _ in range(2)]
    came[0][0, :3] = np.nan, 1e30, -1e30
    keys = ColourHistogram(np.zeros((2, bins), np.float32))
    found = colour_log_ratio(at, keys, LocalColourHistogram((160, 120), counts), (came[0], came[1]))
    u, v = (
        np.clip(np.nan_to_num(each) * N_IMAGE_CELLS / n, 0.5, N_IMAGE_CELLS - 0.501) - 0.5
        for each, n in zip([each.astype(float) + 0.5 for each in came], (160, 120), strict=True)
    )
    grid = counts.reshape(2, N_IMAGE_CELLS, N_IMAGE_CELLS, bins)
    (i, j), own = (np.floor(v).astype(int), np.floor(u).astype(int)), np.zeros((2, *at.shape))
    for down in (0, 1):
        for right in (0, 1):
            share = np.abs(1 - down - (v - i)) * np.abs(1 - right - (u - j))
            own += share * grid[:, i + down, j + right, at]
    own += COLOUR_PSEUDO_COUNT * KEYFRAME_COLOUR_WEIGHT / N_COLOUR_BINS
    np.testing.assert_allclose(found, np.log(own[0] / own[1]), atol=1e-3)


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


def test_what_comes_into_view_is_no_known_background() -> None:
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
