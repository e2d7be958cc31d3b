"""Masks propagated over a clip from key frames, and merged in between."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache, partial
from typing import NamedTuple

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy import ndarray

from getagrip.errors import UsageError
from getagrip.studio.masks import propagate_clip
from getagrip.studio.masks.graph_cut import ColourHistogram, colour_bins, remove_object_colours
from getagrip.studio.masks.propagate_clip import (
    _mark_lost,
    keyframe_spans,
    merge_masks,
    propagate_labels,
    propagate_sparsely,
)
from getagrip.studio.masks.propagate_frame import TrackedMask, place_in_window, signed_distance
from getagrip.studio.masks.small_frames import SmallFrame, SmallFrames
from getagrip.studio.store.labels import HAND_LABEL, OBJECT_LABEL, OCCLUDER_LABEL

SIZE = (240, 180)
LAST = 8


@pytest.fixture(scope="module", autouse=True)
def _smaller() -> Iterator[None]:
    """Masks are propagated at half the size, four times as fast; one test uses the full size."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(propagate_clip, "OBJECT_WORKING_SIZE_PX", 90.0)
        yield


def texture(seed: int, tint: tuple[float, float, float]) -> ndarray:
    """Blots of all sizes."""
    rng = np.random.default_rng(seed)
    layers = [cv2.resize(rng.random((n, n)), (512, 512), interpolation=cv2.INTER_CUBIC) for n in (8, 32, 128)]
    grey = np.clip(sum(layers) / 3.0, 0.0, 1.0)
    return np.asarray(np.clip(60 + 140 * grey[..., None] * np.array(tint), 0, 255), np.uint8)


THING, GROUND, BAR = texture(0, (1.3, 0.6, 0.5)), texture(1, (0.5, 0.8, 1.2)), texture(2, (0.5, 1.3, 0.5))


def pose(n: int) -> ndarray:
    """Where the thing is: it crosses the image, turns and grows, and the hand shakes."""
    angle, size = 4.0 * n, 1.0 + 0.02 * n
    turn = cv2.getRotationMatrix2D((256.0, 256.0), angle, size)
    turn[:, 2] += [68.0 + 9.0 * n + 3.0 * np.sin(2.1 * n) - 256.0, 88.0 + 4.0 * np.cos(1.7 * n) - 256.0]
    return turn


SHAPE = 256 + np.array([[-45, -30], [5, -48], [50, -10], [30, 45], [-10, 20], [-40, 40]], np.float32)


@cache
def drawn(n: int, offset: float = 0.0, bar: bool = False) -> tuple[ndarray, ndarray]:
    """An image and its label map; nothing may be changed in them."""
    T = pose(n)
    T[0, 2] += offset
    ground = GROUND[20 + n : 20 + n + SIZE[1], 30 : 30 + SIZE[0]]
    corners = SHAPE @ T[:, :2].T + T[:, 2]
    labels = np.zeros(SIZE[::-1], np.uint8)
    cv2.fillPoly(labels, [np.round(16 * corners).astype(np.int32)], OBJECT_LABEL, shift=4)
    thing = cv2.warpAffine(THING, T, SIZE)
    image = np.where(labels[..., None] == OBJECT_LABEL, thing, ground)
    if bar:
        labels[100:125] = OCCLUDER_LABEL
        image[100:125] = BAR[100:125, : SIZE[0]]
    noise = np.random.default_rng(n).normal(0.0, 3.0, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8), labels


def iou(a: ndarray, b: ndarray) -> float:
    return float((a & b).sum() / max((a | b).sum(), 1))


Draw = Callable[[int], tuple[ndarray, ndarray]]


class Scored(NamedTuple):
    labels: ndarray
    iou: float
    confidence: float


def propagated(keys: tuple[int, ...], draw: Draw = drawn, last: int = LAST) -> dict[int, Scored]:
    """What becomes of the true masks of some frames."""
    found = propagate_labels(lambda n: draw(n)[0], {n: draw(n)[1] for n in keys}, 0, last)
    return {
        n: Scored(labels, iou(labels == OBJECT_LABEL, draw(n)[1] == OBJECT_LABEL), sure) for n, labels, sure in found
    }


def worst(found: dict[int, Scored]) -> tuple[float, float]:
    """The smallest IOU and the smallest confidence."""
    return min(each.iou for each in found.values()), min(each.confidence for each in found.values())


def test_a_thing_that_jumps_is_found_where_the_hand_has_moved_to() -> None:
    """Its flow is lost, as in a hammer's blow before a wall; the hand beside it is seen in every frame."""

    def jumped(n: int) -> tuple[ndarray, ndarray]:
        image, labels = drawn(0, 100.0 * (n > 1))
        wall = np.random.default_rng(n).normal(200.0, 3.0, image.shape)
        image = np.where(labels[..., None] == OBJECT_LABEL, image, wall).astype(np.uint8)
        return cv2.blur(image, (15, 1)) if n > 1 else image, labels

    def hand(step: int, n: int) -> ndarray:
        seen = np.zeros(SIZE[::-1], bool)
        seen[10:40, 10 + step * (n > 1) : 30 + step * (n > 1)] = True
        return seen

    for step, least, most in ((100, 0.9, 1.0), (210, 0.0, 0.5), (0, 0.0, 0.5)):
        found = [*propagate_labels(lambda n: jumped(n)[0], {0: jumped(0)[1]}, 0, 3, hand=partial(hand, step))]
        scores = [iou(each.labels == OBJECT_LABEL, jumped(each.frame)[1] == OBJECT_LABEL) for each in found]
        assert min(scores[:2]) > 0.9
        assert least <= min(scores[2:]) <= max(scores[2:]) <= most
        assert all((each.confidence > 0.3) == (step == 100) for each in found[2:])


@pytest.mark.parametrize(
    ("left", "sides", "lost"),
    [
        (50, (40, 30, 20, 8, 4, 0), [3, 4, 5, 6]),  # it vanishes, from where it has shrunk
        (50, (40, 30, 20, 25, 40, 40), []),  # it is seen edge-on
        (0, (40, 30, 20, 8, 4, 0), []),  # it leaves the image
    ],
)
def test_an_object_is_lost_where_it_vanishes_within_the_image(
    left: int, sides: tuple[int, ...], lost: list[int]
) -> None:
    """What something in front hides is remembered: it does not vanish."""
    key = np.zeros(SIZE[::-1], np.uint8)
    key[20:60, left : left + 40] = OBJECT_LABEL

    def each(n: int, side: int) -> TrackedMask:
        inside = np.full((3, 40, 40), -1.0, np.float32)
        inside[0, :side, :side] = 1.0
        return TrackedMask(n, (left, 20), inside, np.ones((40, 40), np.float32), 0.9, np.zeros((40, 40), np.float32))

    frames = SmallFrames(lambda n: drawn(n)[0], SIZE)
    found = [*_mark_lost([each(n, side) for n, side in enumerate(sides, start=1)], key, frames)]
    assert [one.frame for one in found] == [1, 2, 3, 4, 5, 6]
    assert [one.frame for one in found if one.trust == 0.0] == lost


def test_a_side_that_comes_into_view_before_known_ground_is_the_objects() -> None:
    """It turns beside a thumb, and shows more of itself in each frame."""

    def turned(n: int) -> tuple[ndarray, ndarray]:
        labels = np.zeros(SIZE[::-1], np.uint8)
        labels[50:130, 60 : 110 + 7 * n] = OBJECT_LABEL
        image = np.where(labels[..., None] == OBJECT_LABEL, THING[: SIZE[1], : SIZE[0]], GROUND[: SIZE[1], : SIZE[0]])
        noise = np.random.default_rng(n).normal(0.0, 3.0, image.shape)
        return np.clip(image + noise, 0, 255).astype(np.uint8), labels

    assert worst(propagated((0,), turned))[0] > 0.9


@pytest.mark.slow
def test_a_moving_thing_is_kept_between_two_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(propagate_clip, "OBJECT_WORKING_SIZE_PX", 200.0)
    found = propagated((0, LAST))
    assert list(found) == list(range(LAST + 1))
    score, confidence = worst(found)
    assert score > 0.9
    assert confidence > 0.8
    for key in (0, LAST):
        np.testing.assert_array_equal(found[key].labels, drawn(key)[1])
        assert found[key].confidence == 1.0


@pytest.mark.slow
def test_before_the_first_and_after_the_last_key_it_is_followed_and_trusted_less_and_less() -> None:
    found = propagated((5,))
    assert worst(found)[0] > 0.93
    sure = [found[n].confidence for n in range(LAST + 1)]
    assert sure[:6] == sorted(sure[:6])
    assert sure[5:] == sorted(sure[5:], reverse=True)


@pytest.mark.slow
def test_backwards_is_the_same_as_forwards() -> None:
    there, back = propagated((0, 4), last=4), propagated((0, 4), lambda n: drawn(4 - n), last=4)
    for n, each in there.items():
        assert iou(each.labels == OBJECT_LABEL, back[4 - n].labels == OBJECT_LABEL) > 0.98


@pytest.mark.slow
def test_what_is_in_front_stays_in_front() -> None:
    for each in (found := propagated((0, 5), lambda n: drawn(n, bar=True), last=5)).values():
        assert (each.labels[105:120, 40:200] == OCCLUDER_LABEL).mean() > 0.95
    assert worst(found)[0] > 0.9


def held(n: int) -> tuple[ndarray, ndarray]:
    """A hand that covers half of the thing at first, and leaves it."""
    image, labels = (each.copy() for each in drawn(n))
    edge = max(0, 80 - 10 * n)
    image[:, :edge], labels[:, :edge] = BAR[: SIZE[1], :edge], HAND_LABEL
    return image, labels


def hand_of(n: int) -> ndarray:
    return np.asarray(held(n)[1] == HAND_LABEL)


@pytest.mark.slow
@pytest.mark.parametrize("backwards", [False, True])
def test_what_a_hand_uncovers_is_the_objects_if_its_colour_is(backwards: bool) -> None:
    """In either direction of time: what was never seen is unknown, what was hidden meanwhile is remembered."""

    def order(n: int) -> int:
        return LAST - n if backwards else n

    keys = {order(0): np.where(held(0)[1] == OBJECT_LABEL, OBJECT_LABEL, 0).astype(np.uint8)}
    masks = {
        n: (labels, sure)
        for n, labels, sure in propagate_labels(
            lambda n: held(order(n))[0], keys, 0, LAST, hand=lambda n: hand_of(order(n))
        )
    }
    last = masks[order(LAST)][0]
    assert iou(last == OBJECT_LABEL, held(LAST)[1] == OBJECT_LABEL) > 0.85
    for n, (labels, _) in masks.items():
        assert not (hand_of(order(n)) & (labels == OBJECT_LABEL)).any()


@pytest.mark.slow
def test_a_found_hand_loses_pixels_of_unlikely_colours_at_its_border_and_has_no_holes_of_them() -> None:
    """Bin 0 is the hand's colour, 1 hardly likelier on the object, 2 the object's."""
    hand, at = np.zeros((40, 40), bool), np.ones((40, 40), np.int32)
    hand[5:35, 5:35], at[5:35, 5:35] = True, 0
    at[5:12, 15:25], at[18:22, 8:14], at[18:22, 24:32] = 1, 1, 2
    own, skin = np.float32([[0.0, 0.0004, 0.1]] * 2), np.float32([[0.1, 0.0, 0.0]] * 2)
    found = remove_object_colours(hand, at, ColourHistogram(own), ColourHistogram(skin))
    assert not found[~hand].any()
    assert not found[6:11, 17:23].any()
    assert not found[19:21, 26:30].any()
    assert found[18:22, 8:14].all()


def test_a_found_hand_of_the_objects_colours_stays_whole() -> None:
    """An overexposed hand before a white box: colours tell nothing of most of it."""
    hand, at = np.zeros((40, 40), bool), np.ones((40, 40), np.int32)
    hand[5:35, 5:35], at[5:28, 5:35] = True, 2
    own, skin = np.float32([[0.0, 0.0004, 0.1]] * 2), np.float32([[0.1, 0.1, 0.0]] * 2)
    colours = ColourHistogram(own), ColourHistogram(skin)
    np.testing.assert_array_equal(remove_object_colours(hand, at, *colours), hand)
    at[10:28, 5:35] = 1
    assert 0.5 < remove_object_colours(hand, at, *colours).sum() / hand.sum() < 0.9, "a part of it is the object's"


def test_a_found_hand_that_is_coloured_as_the_object_is_not_taken_for_it_far_from_it() -> None:
    """A hand reaches over a banana, say; then its other side is lit, and yellow."""

    def lit(n: int) -> tuple[ndarray, ndarray]:
        image, labels = drawn(n)
        hand = np.zeros(SIZE[::-1], bool)
        hand[110:125, 60:230] = True
        bright = hand & (np.arange(SIZE[0]) > 170) & (n > 0)
        image = np.where(hand[..., None], BAR[: SIZE[1], : SIZE[0]], image)
        return np.where(bright[..., None], THING[: SIZE[1], : SIZE[0]], image), np.where(
            hand, np.uint8(HAND_LABEL), labels
        )

    keys = {0: np.where(lit(0)[1] == OBJECT_LABEL, np.uint8(OBJECT_LABEL), np.uint8(0))}
    found = propagate_labels(lambda n: lit(n)[0], keys, 0, 4, hand=lambda n: lit(n)[1] == HAND_LABEL)
    assert all((labels[112:123, 175:225] == HAND_LABEL).mean() > 0.95 for _, labels, _ in found)


def test_a_hand_drawn_on_a_key_replaces_the_one_that_was_found() -> None:
    found = propagate_labels(lambda n: held(n)[0], {0: held(0)[1]}, 0, 2, hand=lambda n: np.zeros(SIZE[::-1], bool))
    assert all(iou(labels == HAND_LABEL, hand_of(n)) > 0.8 for n, labels, _ in found)


@pytest.mark.slow
def test_blurred_and_empty_images_are_trusted_less() -> None:
    def lost(n: int) -> tuple[ndarray, ndarray]:
        image, labels = drawn(n)
        return (np.full_like(image, 127) if 3 <= n <= 5 else image), labels

    assert worst(propagated((0, LAST), lost))[1] < worst(propagated((0, LAST)))[1]


@pytest.mark.slow
def test_what_enters_the_image_comes_from_the_key_that_shows_it() -> None:
    def entering(n: int) -> tuple[ndarray, ndarray]:
        return drawn(n, offset=-72.0)

    assert (entering(0)[1][:, 0] == OBJECT_LABEL).any()
    assert not (entering(10)[1][:, 0] == OBJECT_LABEL).any()
    assert worst(propagated((0, 10), entering, last=10))[0] > 0.85


@pytest.mark.slow
def test_a_cut_lowers_the_confidence() -> None:
    def cut(n: int) -> tuple[ndarray, ndarray]:
        image, labels = drawn(n)
        return (image, labels) if n < 5 else (image[:, ::-1].copy(), labels[:, ::-1].copy())

    assert worst(propagated((0, LAST), cut))[1] < 0.5


@pytest.mark.slow
def test_nothing_stays_nothing() -> None:
    keys = {0: drawn(0)[1], 6: np.zeros(SIZE[::-1], np.uint8), LAST: np.zeros(SIZE[::-1], np.uint8)}
    found = {n: (labels, sure) for n, labels, sure in propagate_labels(lambda n: drawn(n)[0], keys, 0, LAST)}
    assert all(not found[n][0].any() and found[n][1] == 1.0 for n in range(6, LAST + 1))


@pytest.mark.slow
def test_images_may_be_smaller_than_masks() -> None:
    """As footage is that is shown smaller than it is."""

    def large(n: int) -> tuple[ndarray, ndarray]:
        image, labels = drawn(n)
        return image, np.kron(labels, np.ones((3, 3), np.uint8))

    assert worst(propagated((0, 5), large, last=5))[0] > 0.95


@given(keys=st.sets(st.integers(3, 12), min_size=1), ends=st.tuples(st.integers(0, 3), st.integers(12, 15)))
def test_every_frame_is_in_one_stretch_with_the_keys_about_it(keys: set[int], ends: tuple[int, int]) -> None:
    found = list(keyframe_spans(keys, *ends))
    assert [n for one in found for n in range(one.first, one.last + 1)] == list(range(ends[0], ends[1] + 1))
    for one in found:
        for n in range(one.first, one.last + 1):
            about = [max(k for k in keys if k <= n)] if min(keys) <= n else []
            about += [min(k for k in keys if k >= n)] if max(keys) >= n else []
            assert {*one.keys} == {*about}


@pytest.mark.slow
def test_a_changed_key_changes_the_frames_up_to_its_neighbours_only() -> None:
    """The others need not be made again."""
    keys = {n: drawn(n)[1] for n in (1, 4, 6)}
    before = {n: (labels, sure) for n, labels, sure in propagate_labels(lambda n: drawn(n)[0], keys, 0, LAST)}
    keys[6] = np.where(drawn(6)[1] == OBJECT_LABEL, 0, OCCLUDER_LABEL).astype(np.uint8)
    after = {n: (labels, sure) for n, labels, sure in propagate_labels(lambda n: drawn(n)[0], keys, 0, LAST)}
    same = {n for n, (labels, sure) in after.items() if np.array_equal(before[n][0], labels) and before[n][1] == sure}
    assert after.keys() - same == {*range(5, LAST + 1)}
    again = {n: labels for n, labels, _ in propagate_labels(lambda n: drawn(n)[0], keys, 0, LAST, range(5))}
    assert again.keys() == {*range(5, LAST + 1)}
    assert all(np.array_equal(after[n][0], labels) for n, labels in again.items())


def test_a_first_look_has_masks_of_a_few_frames_spread_evenly_and_of_the_keys() -> None:
    keys = {0: drawn(0)[1], 5: drawn(5)[1]}
    read = list[int]()

    def image(n: int) -> ndarray:
        read.append(n)
        return drawn(n)[0]

    made = [*propagate_sparsely(image, keys, 0, LAST, 3, lambda _: None)]
    assert [one.frame for one in made] == [0, 4, 5, LAST]
    assert {*read} == {0, 4, 5, LAST}
    assert [one.confidence == 1.0 for one in made] == [True, False, True, False]
    for one in made:
        assert iou(one.labels == OBJECT_LABEL, drawn(one.frame)[1] == OBJECT_LABEL) > 0.9


def test_what_cannot_be_propagated_is_refused() -> None:
    for keys, words in (
        ({}, "missing polygons"),
        ({0: np.zeros((4, 4), np.uint8)}, "missing polygons"),
        ({99: drawn(0)[1]}, "frame 99"),
        ({0: drawn(0)[1], 1: np.zeros((4, 4), np.uint8)}, "sizes"),
    ):
        with pytest.raises(UsageError, match=words):
            list(propagate_labels(lambda n: drawn(n)[0], keys, 0, LAST))


def test_a_small_part_that_comes_off_is_something_else_unless_a_key_shows_it_apart() -> None:
    """A disc of the thing's texture is drawn with it on the key; from there on it moves away, or with the thing."""

    def beside(gap: float, away: float, n: int) -> tuple[ndarray, ndarray]:
        image, labels = drawn(n)
        step = np.array([[1.0, 0.0, gap + away * n], [0.0, 1.0, 0.0]])
        thing = cv2.warpAffine(cv2.warpAffine(THING, pose(n), SIZE, borderMode=cv2.BORDER_REFLECT), step, SIZE)
        here = disc(gap + away * n, n) & (labels == 0)
        return np.where(here[..., None], thing, image), np.where(here & (n == 0), np.uint8(OBJECT_LABEL), labels)

    def disc(offset: float, n: int) -> ndarray:
        at = pose(n) @ np.array([256.0 + 50.0, 256.0, 1.0]) + [offset, 0.0]
        return cv2.circle(np.zeros(SIZE[::-1], np.uint8), np.round(at).astype(int).tolist(), 9, 1, -1) > 0

    for gap, away, least, most in ((0.0, 3.0, 0.0, 0.0), (24.0, 0.0, 0.5, 1.0)):
        shown = propagated((0,), partial(beside, gap, away))[LAST].labels == OBJECT_LABEL
        there = disc(gap + away * LAST, LAST) & (drawn(LAST)[1] == 0)
        assert least <= shown[there].mean() <= most


def test_a_handle_that_is_joined_beyond_the_image_is_kept() -> None:
    def leaving(n: int) -> tuple[ndarray, ndarray]:
        labels, top = np.zeros((SIZE[1] + 80, SIZE[0]), np.uint8), 8 * n
        labels[60:180, 40:120] = labels[60:140, 150:160] = labels[45:60, 40:160] = OBJECT_LABEL
        image = np.where(
            labels[..., None] == OBJECT_LABEL, THING[: labels.shape[0], : SIZE[0]], GROUND[: labels.shape[0], : SIZE[0]]
        )
        return image[top : top + SIZE[1]], labels[top : top + SIZE[1]]

    found = propagated((0,), leaving)[LAST]
    assert (found.labels == OBJECT_LABEL)[:70, 152:158].mean() > 0.9


WINDOW_SIZE = (120, 100)


def box(left: int, top: int, right: int, bottom: int) -> ndarray:
    out = np.zeros(WINDOW_SIZE[::-1], bool)
    out[top:bottom, left:right] = True
    return out


OUTSIDE, INSIDE, BESIDE = box(40, 40, 80, 80), box(40, 25, 80, 40), box(80, 40, 95, 80)
IMAGE = np.full((*WINDOW_SIZE[::-1], 3), (150, 110, 70), np.uint8)
IMAGE[OUTSIDE], IMAGE[INSIDE] = (30, 90, 50), (160, 160, 165)
FRAME = SmallFrame(IMAGE, colour_bins(IMAGE), IMAGE)
COLOURS = [ColourHistogram.of(IMAGE, OUTSIDE | INSIDE, np.ones(WINDOW_SIZE[::-1], bool))]


def tracked(mask: ndarray, trust: float = 1.0) -> TrackedMask:
    nothing = np.full((2, *mask.shape), -24.0, np.float32)
    inside = np.concatenate([signed_distance(mask)[None], nothing])
    return TrackedMask(5, (0, 0), inside, np.ones(mask.shape, np.float32), trust, np.zeros(mask.shape, np.float32))


@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
def test_where_two_masks_differ_the_keys_colours_decide(share: float) -> None:
    """What one of them has lost is the object's; what the other has of the ground is not, however near its key is."""
    true = OUTSIDE | INSIDE
    for one, other in ((true, OUTSIDE), (OUTSIDE, true), (true, true | BESIDE), (OUTSIDE | BESIDE, true)):
        both, confidence = merge_masks(tracked(one), tracked(other), share, FRAME, COLOURS)
        found = place_in_window(both, (0, 0), WINDOW_SIZE)[0][OBJECT_LABEL - 1] > 0
        assert (found & true).sum() / (found | true).sum() > 0.95
        apart = 1.0 - (one & other).sum() / (one | other).sum()
        assert confidence == pytest.approx(1.0 - 4.0 * share * (1.0 - share) * apart**2)


@pytest.mark.parametrize("share", [0.1, 0.9])
def test_what_is_in_front_comes_from_the_side_that_has_not_lost_its_way(share: float) -> None:
    hand = box(70, 40, 95, 80)
    sees, lost = tracked(OUTSIDE | INSIDE), tracked(OUTSIDE | BESIDE, trust=0.01)
    sees.inside[OCCLUDER_LABEL - 1], sees.known[hand] = signed_distance(hand), 0.0
    both, _ = merge_masks(sees, lost, share, FRAME, COLOURS)
    found = place_in_window(both, (0, 0), WINDOW_SIZE)[0][OCCLUDER_LABEL - 1] > 0
    assert (found == hand).mean() > 0.99


def test_what_lies_beyond_a_cut_does_not_count() -> None:
    """There is one side only, then; its trust is all that is known."""
    for trusts in ((0.0, 0.7), (0.7, 0.0), (0.0, 0.0)):
        one, other = (tracked(OUTSIDE, trust) for trust in trusts)
        assert merge_masks(one, other, 0.5, FRAME, COLOURS)[1] == max(trusts)


def test_two_empty_masks_are_an_empty_one() -> None:
    empty = np.zeros((0, 0), np.float32)
    nothing = TrackedMask(5, (3, 4), np.zeros((3, 0, 0), np.float32), empty, 1.0, empty)
    both, confidence = merge_masks(nothing, nothing, 0.5, FRAME, COLOURS)
    assert not both.inside.size
    assert confidence == 1.0
