"""Hands followed and selected, and their side: networks that see synthetic hands."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from getagrip.errors import UsageError
from getagrip.hands import generic
from getagrip.hands.fit_joints import PosePrior
from getagrip.hands.from_2d.clicks import model_pose
from getagrip.provenance import is_assumed
from getagrip.studio.hands import Side, networks, unbiased_log_odds
from getagrip.studio.hands.hand_selection import Handedness, find_mirrored_frames, log_odds, select_hand
from getagrip.studio.hands.hand_tracking import Sighting, drop_outlier_sightings, track_hands
from getagrip.studio.hands.networks import HandCrop, HandNetOutput, Nets, Palm

BASES = ((60, 20), (30, -25), (5, -30), (-15, -25), (-40, -15))
FLAT = np.array([[0, 0], *([x * k / 4, -100 + y * k] for x, y in BASES for k in (1, 2, 3, 4))], dtype=float)
WORLD = np.column_stack([FLAT / 1000.0, np.zeros(21)])


def hand(u: float, v: float = 500.0, right: float = 0.1, confidence: float = 0.95) -> Sighting:
    return Sighting(FLAT + np.array([u, v]), WORLD, confidence, right)


def from_above(u: float, right: float = 0.1) -> Sighting:
    return Sighting(np.array([u, 500.0]) - FLAT, WORLD, 0.95, right)


class Seeing(Nets):
    """Networks that see given hands: palms in some frames only, landmarks where the square is near a hand."""

    def __init__(self, hands: Mapping[int, list[Sighting]], detected: set[int]) -> None:
        super().__init__(lambda image: [], lambda image: [], "")
        object.__setattr__(self, "hands", hands)
        object.__setattr__(self, "detected", detected)
        object.__setattr__(self, "asked", [])

    def palms(self, image: np.ndarray, fill: float = 1.0) -> list[Palm]:
        n = int(image[0, 0, 0])
        found = []
        for each in self.hands[n] if n in self.detected else []:  # type: ignore[attr-defined]
            points = np.tile(each.points[0], (7, 1))
            points[2] = each.points[9]
            low, high = each.points[[0, 5, 17]].min(axis=0), each.points[[0, 5, 17]].max(axis=0)
            found.append(Palm(np.concatenate([low, high]), points, 0.9))
        return found

    def landmarks(self, image: np.ndarray, crop: HandCrop) -> HandNetOutput:
        self.asked.append(crop)  # type: ignore[attr-defined]
        for each in self.hands[int(image[0, 0, 0])]:  # type: ignore[attr-defined]
            if np.linalg.norm(networks.crop_of_landmarks(each.points).middle - crop.middle) < 0.4 * crop.side:
                return HandNetOutput(*each)
        return HandNetOutput(FLAT, WORLD, 0.02, 0.5)


def image(n: int) -> np.ndarray:
    return np.full((4, 4, 3), n, np.uint8)


def test_a_hand_detected_once_is_followed_both_ways() -> None:
    hands = {n: [hand(300.0 + 15.0 * n)] for n in range(12)}
    seen = track_hands(image, 12, Seeing(hands, {6}))
    assert [len(each) for each in seen] == [1] * 12
    for n, (each,) in enumerate(seen):
        np.testing.assert_allclose(each.points, hands[n][0].points)


def test_a_hand_that_fills_the_image_is_detected_where_it_is_smaller() -> None:
    class Large(Seeing):
        """The detector misses hands that are large in its input."""

        def palms(self, image: np.ndarray, fill: float = 1.0) -> list[Palm]:
            asked.append((int(image[0, 0, 0]), fill))
            return super().palms(image) if fill < 1.0 else []

    asked: list[tuple[int, float]] = []
    seen = track_hands(image, 4, Large({n: [hand(300.0)] for n in range(4)}, set(range(4))))
    assert [len(each) for each in seen] == [1] * 4
    assert [n for n, fill in asked if fill < 1.0] == [0]  # it is followed from there


@pytest.mark.parametrize(("at", "seen_at"), [(400.0, 300.0), (3000.0, None)])
def test_a_small_hand_is_looked_for_about_the_object(at: float, seen_at: float | None) -> None:
    """Also where a hand elsewhere is seen at once, and until it is seen itself."""
    small, large = hand(300.0, 450.0), hand(900.0, 450.0)

    class Small(Seeing):
        """The detector sees the small hand only if a part of the image fills its input."""

        def palms(self, image: np.ndarray, fill: float = 1.0) -> list[Palm]:
            n = int(image[0, 0, 0])
            if len(image) == 1000:
                return Seeing({n: [large]}, {n}).palms(image)
            parts.append(n)
            shift = np.array([at - 330.0, 120.0])
            there = small._replace(points=small.points - shift)
            return Seeing({n: [there]}, {1}).palms(image)

    parts: list[int] = []
    frames = [np.full((1000, 1000, 3), n, np.uint8) for n in range(4)]
    nets = Small({n: [small, large] for n in range(4)}, set())
    seen = track_hands(frames.__getitem__, 4, nets, about=[HandCrop(np.array([at, 450.0]), 300.0, 0.0)])
    found = [sorted({float(each.points[0, 0]) for each in hands}) for hands in seen]
    assert found == [[900.0] if seen_at is None else [seen_at, 900.0]] * 4
    assert set(parts) == (set() if seen_at is None else {0, 1})


def test_a_hand_that_is_followed_and_detected_is_one() -> None:
    hands = {n: [hand(300.0)] for n in range(5)}
    nets = Seeing(hands, set(range(5)))
    assert [len(each) for each in track_hands(image, 5, nets)] == [1] * 5
    assert len(nets.asked) == 5  # type: ignore[attr-defined]


@pytest.mark.parametrize("mends", [True, False])
def test_a_hand_that_is_seen_mirrored_for_a_while_is_looked_for_again(mends: bool) -> None:
    """Where it is not seen as one of its own side then either, the frames are left out."""
    mirrored = range(11, 17)
    seen = [[hand(300.0, right=0.9 if n in mirrored else 0.2)] for n in range(20)]

    def again(hands: Mapping[int, Sighting], sides: Mapping[int, str]) -> dict[int, Sighting]:
        assert sides == dict.fromkeys(mirrored, "left")
        assert sorted(hands) == [n for n in range(20) if n not in mirrored]
        return dict(hands) | {n: hand(300.0, right=0.2 if mends else 0.8) for n in mirrored}

    found = select_hand(seen, again=again)
    assert found.rows == tuple(n for n in range(20) if mends or n not in mirrored)
    assert any("of the other side: 12 to 17" in note for note in found.notes) != mends


@pytest.mark.parametrize("count", [9, 11])
def test_a_hand_that_is_mostly_looked_for_again_is_said(count: int) -> None:
    seen = [[hand(300.0)] if n < count else [] for n in range(20)]
    found = select_hand(seen, counted_from=31, again=lambda hands, _: {n: hand(300.0) for n in range(20)})
    assert found.rows == tuple(range(20))
    said = [note for note in found.notes if "seen at once in the frames 31 to 39, in 11 frames only where" in note]
    assert bool(said) == (count == 9)


@pytest.mark.parametrize("right", [0.01, 0.3])
def test_frames_that_redetection_sees_mirrored_are_left_out_where_the_side_is_sure(right: float) -> None:
    seen = [[hand(300.0, right=right)] if n < 8 else [] for n in range(20)]
    beyond = {n: hand(300.0, right=0.99) for n in range(8, 20)}
    found = select_hand(seen, again=lambda hands, _: dict(hands) | beyond)
    assert found.rows == tuple(range(8 if right < 0.1 else 20))
    assert any("of the other side: 9 to 20" in note for note in found.notes) == (right < 0.1)


def test_no_hand_is_mirrored_in_half_of_its_frames_or_against_its_mirror_image() -> None:
    half = {n: hand(300.0, right=0.9 if n < 10 else 0.05) for n in range(20)}
    assert find_mirrored_frames(half, "left", lambda n, each: log_odds(each)) == []
    some = {n: hand(300.0, right=0.9 if n < 6 else 0.05) for n in range(20)}
    assert find_mirrored_frames(some, "left", lambda n, each: log_odds(each)) == list(range(6))
    assert find_mirrored_frames(some, "left", lambda n, each: -1.0) == []


def test_the_side_is_the_majoritys() -> None:
    left = hand(300.0, right=0.01)._replace(world=bent("left"))
    seen = [[hand(300.0, right=0.9) if n in (3, 4) else left] for n in range(20)]
    found = select_hand(seen)
    assert found.side == "left"
    assert str(found.side_source) == "left: it looks like a left hand in 18 of 20 frames"
    assert found.rows == tuple(range(20))
    with pytest.raises(UsageError, match="no right hand"):
        select_hand(seen, side="right")


def test_a_stated_side_overrules_all_frames_for_the_hand_at_the_object() -> None:
    seen = [[hand(300.0, right=0.2), hand(900.0, right=0.2)] for n in range(20)]
    box = {0: np.array([250.0, 450.0, 100.0, 100.0])}
    found = select_hand(seen, side="right", boxes=box)
    assert (found.side, found.rows) == ("right", tuple(range(20)))
    np.testing.assert_allclose(found.points[:, :, 0].mean(), select_hand(seen, boxes=box).points[:, :, 0].mean())
    assert any(note.startswith("a guess: it looks like a left hand in 20 of 20") for note in found.notes)


def test_a_stated_side_overrules_a_side_that_is_a_guess() -> None:
    seen = [[hand(300.0, right=0.9 if n % 3 == 0 else 0.1)] for n in range(20)]
    guessed = select_hand(seen)
    assert "--side right overrules this" in str(guessed.side_source)
    found = select_hand(seen, side="right")
    assert (found.side, found.rows) == ("right", tuple(range(20)))
    assert any(note.startswith("a guess: it looks like a left hand") for note in found.notes)


def sides(seen: list[list[Sighting]]) -> list[tuple[Side, bool]]:
    """Sides of the left and the right hand in the picture, and whether each is a guess."""
    boxes = [{0: np.array([u - 20.0, 400.0, 40.0, 40.0])} for u in (300.0, 900.0)]
    found = [select_hand(seen, boxes=box) for box in boxes]
    return [(each.side, is_assumed(each.side_source)) for each in found]


@pytest.mark.parametrize(("right", "guesses"), [(0.2, (True, True)), (0.01, (False, True)), (0.99, (True, False))])
def test_of_two_hands_of_the_cameras_wearer_the_right_one_is_the_right_hand(
    right: float, guesses: tuple[bool, bool]
) -> None:
    """Also where both look alike, and where one that looks otherwise comes later."""
    seen = [[hand(300.0, right=right), hand(900.0, right=right)] for n in range(20)]
    assert sides(seen) == [("left", guesses[0]), ("right", guesses[1])]
    later = [hands[:1] if n < 8 else hands for n, hands in enumerate(seen)]
    assert sides(later) == [("left", guesses[0]), ("right", guesses[1])]
    box = {0: np.array([880.0, 400.0, 40.0, 40.0])}
    found = select_hand(seen, "left", box)
    assert (found.side, np.nanmin(found.points[..., 0]) > 600.0) == ("left", True), "the hand at the object, as stated"
    if guesses[1]:
        assert "it is the right one of two hands from below" in str(select_hand(seen, boxes=box).side_source)


def test_hands_of_a_person_in_front_and_of_two_people_stay_as_they_look() -> None:
    def looks(left: Sighting, right: Sighting) -> list[Side]:
        return [side for side, _ in sides([[left, right] for _ in range(20)])]

    assert looks(hand(300.0, right=0.99), hand(900.0, right=0.01)) == ["right", "left"], "both are sure"
    assert looks(hand(300.0, right=0.97), hand(900.0, right=0.1)) == ["right", "left"]
    assert looks(hand(300.0, right=0.6), hand(900.0, right=0.3)) == ["left", "right"]
    assert looks(from_above(300.0, 0.3), from_above(900.0, 0.3)) == ["left", "left"], "forearms come from above"
    large = Sighting(3.0 * FLAT + [900.0, 500.0], WORLD, 0.95, 0.3)
    assert looks(hand(300.0, right=0.3), large) == ["left", "left"], "one is nearer by far"
    seen = [[hand(300.0, right=0.3)] + [hand(900.0, right=0.3)] * (n < 3) for n in range(20)]
    assert select_hand(seen).side == "left", "it is hardly seen beside another"


def test_no_hand_about_the_frame_of_the_box_is_said_where_the_side_is_the_other() -> None:
    seen = [[hand(300.0, right=0.01)] if n > 20 else [] for n in range(40)]
    box = {0: np.array([250.0, 450.0, 100.0, 100.0])}
    with pytest.raises(UsageError, match=r"none about the frame of the object's box .*begin --interval where one is"):
        select_hand(seen, side="right", boxes=box)


def test_a_fingertip_that_looks_like_a_small_hand_is_none() -> None:
    tip = FLAT[8] + np.array([300.0, 500.0])
    small = Sighting(tip + 0.2 * FLAT, WORLD, 0.95, 0.9)
    seen = [[small, *([] if 14 < n < 25 else [hand(300.0, confidence=0.7)])] for n in range(40)]
    found = select_hand(seen)
    assert found.side == "left"
    assert found.rows == (*range(15), *range(25, 40))
    assert not any("two hands" in note for note in found.notes)


def test_a_hand_that_is_seen_twice_is_one() -> None:
    seen = [[hand(300.0), *([hand(320.0, right=0.9)] if n > 5 else [])] for n in range(20)]
    assert not any("two hands" in note for note in select_hand(seen).notes)


@pytest.mark.parametrize(("count", "side"), [(14, "right"), (8, "left")])
def test_of_two_readings_of_a_hand_the_one_of_more_frames_is_taken_as_a_guess(count: int, side: str) -> None:
    """The other one is nearer to the object, which decides between hands only."""
    seen = [[*([hand(300.0)] if n < 12 else []), *([hand(320.0, right=0.9)] if n < count else [])] for n in range(20)]
    box = {3: np.array([150.0, 400.0, 80.0, 80.0])}
    found = select_hand(seen, boxes=box)
    other = "left" if side == "right" else "right"
    assert found.side == side
    assert is_assumed(found.side_source)
    assert f"also looks like a hand of the other side; --side {other}" in str(found.side_source)
    assert not any("two hands" in note for note in found.notes)
    assert not is_assumed(select_hand(seen, side="left", boxes=box).side_source)


def test_the_hand_nearest_to_the_object_is_taken() -> None:
    seen = [[hand(200.0, right=0.05)] + ([hand(900.0, right=0.95)] if n > 5 else []) for n in range(20)]
    assert select_hand(seen).side == "left"
    box = {12: np.array([950.0, 400.0, 80.0, 80.0])}
    found = select_hand(seen, boxes=box)
    assert found.side == "right"
    assert found.rows == tuple(range(6, 20))
    assert np.isnan(found.points[:6]).all()
    assert select_hand(seen, side="left", boxes=box).side == "left"


def test_of_two_hands_at_the_object_the_one_that_stays_is_taken() -> None:
    stays, leaves = [hand(300.0 + 20 * n) for n in range(20)], [hand(280.0 - 20 * n, right=0.95) for n in range(20)]
    seen = [[one, other] for one, other in zip(stays, leaves, strict=True)]
    box = np.array([200.0, 400.0, 80.0, 80.0])
    assert select_hand(seen, boxes={0: box}).side == "right"
    boxes = {n: box + np.array([20.0 * n, 0.0, 0.0, 0.0]) for n in range(20)}
    assert select_hand(seen, boxes=boxes).side == "left"
    later = [[one, hand(300.0 + 20 * n, right=0.95)] if n > 12 else [one] for n, one in enumerate(leaves)]
    assert select_hand(later, boxes=boxes).rows == tuple(range(20))  # one that comes later is not compared


def test_a_flip_is_left_out_and_said() -> None:
    seen = [[hand(300.0 + 5 * n)] for n in range(15)]
    seen[7] = [Sighting(np.array([335.0, 380.0]) - 0.8 * FLAT, WORLD, 0.9, 0.9)]
    found = select_hand(seen)
    assert 7 not in found.rows
    assert any("differ from the frames about them: 8" in note for note in found.notes)


def test_a_frame_alone_in_a_gap_counts_where_it_lies_between_both_ends() -> None:
    ends = {n: hand(300.0 + 5 * n) for n in (*range(10), *range(21, 31))}
    between, turned = hand(300.0 + 5 * 15), Sighting(np.array([375.0, 380.0]) - FLAT, WORLD, 0.9, 0.1)
    assert drop_outlier_sightings(ends | {15: between})[1] == []
    assert drop_outlier_sightings(ends | {14: turned, 15: turned}) == (ends, [14, 15])
    assert (
        drop_outlier_sightings({n: each for n, each in ends.items() if n < 10} | {15: turned})[1] == []
    )  # it may have moved since
    assert drop_outlier_sightings({n + 40 * (n > 15): each for n, each in ends.items()} | {15: turned})[1] == []


@pytest.mark.parametrize("step", [1, 2, 3])
def test_a_hand_that_is_seen_now_and_then_is_kept(step: int) -> None:
    lifted = {n: hand(300.0, 500.0 - 200.0 * float(np.sin(np.pi * (n - 10) / 40) ** 2)) for n in range(10, 51, step)}
    still = {n: hand(300.0) for n in (*range(10), *range(51, 60))}
    assert drop_outlier_sightings(still | lifted)[1] == []


def test_long_gaps_stay_gaps_and_two_people_are_said() -> None:
    seen = [[hand(300.0)] if n < 10 or n > 30 else [] for n in range(40)]
    found = select_hand(seen)
    assert found.rows == (*range(10), *range(31, 40))
    assert any("11 to 31" in note for note in found.notes)
    assert any("111 to 131" in note for note in select_hand(seen, counted_from=101).notes)
    for right, overrules in ((0.1, "--object-box overrules"), (0.9, "--object-box or --side overrules")):
        note = select_hand([[from_above(300.0), from_above(900.0, right)] for n in range(20)]).notes[-1]
        assert "two hands in 20 frames: chosen is the one at (301, 599)" in note, note
        assert "in frame 1, not that at (901, 599)" in note
        assert overrules in note
    seen = [[hand(300.0), hand(900.0, right=0.9)] for n in range(20)]
    boxed = select_hand(seen, boxes={0: np.array([280.0, 420.0, 60.0, 60.0])}).notes[-1]
    assert "; another --object-box or --side overrules this" in boxed, "the one that was stated does not"


@pytest.mark.parametrize(("size", "kept"), [(0.25, False), (0.7, True), (4.0, False)])
def test_a_hand_after_a_gap_is_the_same_one_where_it_is_about_as_large(size: float, kept: bool) -> None:
    later = Sighting(size * FLAT + np.array([700.0, 200.0]), WORLD, 0.95, 0.1)
    seen = [[hand(300.0)] if n < 12 else [later] if n >= 30 else [] for n in range(40)]
    assert select_hand(seen).rows == (*range(12), *(range(30, 40) if kept else ()))


def test_a_small_hand_far_away_does_not_follow_a_blurred_one() -> None:
    def sized(size: float) -> list[Sighting]:
        return [Sighting(size * FLAT + np.array([300.0, 500.0]), WORLD, 0.95, 0.1)]

    seen = [sized(1.0) if n < 11 else sized(0.6) if n == 11 else sized(0.3) if n >= 18 else [] for n in range(24)]
    assert select_hand(seen).rows == tuple(range(11))


def test_no_hand_says_what_was_tried() -> None:
    with pytest.raises(UsageError, match="no hand: palms were looked for in 5 frames"):
        select_hand([[] for _ in range(5)])


def test_of_hands_seen_as_often_the_steadier_one_is_taken() -> None:
    def waving(n: int) -> Sighting:
        each = hand(900.0)
        return each._replace(points=each.points + np.outer(np.arange(21) % 4, [8.0 * (n % 3), 0.0]))

    seen = [[waving(n)] + ([hand(300.0)] if n else []) for n in range(20)]
    assert np.nanmax(select_hand(seen).points[..., 0]) < 600.0
    assert np.nanmin(select_hand([hands[: 1 + (n > 4)] for n, hands in enumerate(seen)]).points[..., 0]) > 600.0


def test_a_palm_whose_square_shows_no_hand_is_looked_at_turned() -> None:
    class Turned(Seeing):
        def landmarks(self, image: np.ndarray, crop: HandCrop) -> HandNetOutput:
            found = super().landmarks(image, crop)
            return found if crop.angle > 0.5 or len(self.asked) > 2 else found._replace(confidence=0.3)  # type: ignore[attr-defined]

    (seen,) = track_hands(image, 1, Turned({0: [hand(300.0)]}, {0}))
    np.testing.assert_allclose(seen[0].points, hand(300.0).points)


@pytest.mark.parametrize("count", [1, 2, 5])
def test_a_short_clip_is_enough(count: int) -> None:
    assert select_hand([[hand(300.0)]] * count).rows == tuple(range(count))


@pytest.mark.parametrize(
    ("frame", "left", "words"),
    [(0, 280.0, "nearest to the object"), (0, 900.0, "is the object's box right?"), (30, 280.0, "box decides nothing")],
)
def test_a_box_elsewhere_is_said(frame: int, left: float, words: str) -> None:
    seen = [[hand(300.0)] if n < 10 else [] for n in range(40)]
    note = select_hand(seen, boxes={frame: np.array([left, 420.0, 60.0, 60.0])}).notes[0]
    assert words in note
    assert ("far off" in note) == (left > 800.0)


def test_a_hand_that_reaches_for_the_object_is_not_far_off() -> None:
    boxes = dict.fromkeys(range(40), np.array([280.0, 420.0, 60.0, 60.0]))
    reaching = [[hand(300.0 + 40.0 * max(0, 20 - n))] for n in range(40)]
    assert "far off" not in select_hand(reaching, boxes=boxes).notes[0]
    assert "far off" in select_hand(reaching[:1] * 40, boxes=boxes).notes[0]


def test_what_lies_in_the_objects_box_and_does_not_move_is_no_hand() -> None:
    """The trigger of a spray bottle that stands on the table."""
    box = {0: np.array([230.0, 270.0, 160.0, 250.0])}
    trigger = [[hand(300.0 + 2.0 * np.sin(n))] for n in range(20)]
    with pytest.raises(UsageError, match="does not move, and is taken for a part of the object"):
        select_hand(trigger, boxes=box)
    other = [[*each, hand(500.0 - 8.0 * n)] for n, each in enumerate(trigger)]
    found = select_hand(other, boxes=box)
    assert found.points[3, 0, 0] == 500.0 - 24.0
    assert any("left out: what looks like a hand in the object's box" in note for note in found.notes)
    moving = [[hand(300.0 + 3.0 * n)] for n in range(20)]
    assert select_hand(moving, boxes={0: np.array([230.0, 270.0, 260.0, 250.0])}).rows == tuple(range(20))
    assert select_hand(trigger, boxes={0: np.array([300.0, 430.0, 160.0, 140.0])}).rows == tuple(range(20))


MIRROR = np.array([-1.0, 1.0, 1.0])
BLANK = np.zeros((480, 640, 3), np.uint8)


def bent(side: Side) -> np.ndarray:
    """Joints of a posed in the middle of its poses [m]."""
    model = generic.load(side)
    joints = model.with_shape().with_pose(model_pose(PosePrior.of(model).mean[None])[0]).joints
    return np.asarray(joints - joints.mean(axis=0))


def posed(world: np.ndarray, right: float = 0.5) -> Sighting:
    return Sighting(world[:, :2] * 1000.0 + [300.0, 240.0], world, 0.9, right)


class Biased(Nets):
    """Networks that see the same posed in every image, and take it for a right one too often."""

    def __init__(self, there: Sighting, bias: float) -> None:
        super().__init__(lambda image: [], lambda image: [], "")
        object.__setattr__(self, "there", there)
        object.__setattr__(self, "bias", bias)

    def landmarks(self, image: np.ndarray, crop: HandCrop) -> HandNetOutput:
        there: Sighting = self.there  # type: ignore[attr-defined]
        return self._said(there, np.log(there.right / (1.0 - there.right)))

    def mirrored(self, image: np.ndarray, crop: HandCrop) -> HandNetOutput:
        there: Sighting = self.there  # type: ignore[attr-defined]
        return self._said(there._replace(world=there.world * MIRROR), -np.log(there.right / (1.0 - there.right)))

    def _said(self, there: Sighting, odds: float) -> HandNetOutput:
        right = 1.0 / (1.0 + np.exp(-(odds + self.bias)))  # type: ignore[attr-defined]
        return HandNetOutput(there.points, there.world, 0.9, float(right))


@pytest.mark.parametrize("side", ["left", "right"])
def test_fingers_bend_to_the_palm_from_every_view(side: Side) -> None:
    world = bent(side)
    sign = 1.0 if side == "right" else -1.0
    values = [log_odds(posed(R.apply(world))) for R in Rotation.random(20, random_state=0)]
    assert min(sign * np.array(values)) > 0.5
    np.testing.assert_allclose(values, values[0], atol=1e-9)


@pytest.mark.parametrize("right", [0.02, 0.3, 0.9])
def test_a_mirror_image_has_the_opposite_odds(right: float) -> None:
    one = posed(bent("left"), right)
    other = Sighting(one.points, one.world * MIRROR, 0.9, 1.0 - right)
    assert log_odds(other) == pytest.approx(-log_odds(one))


def test_the_mirror_image_of_a_square_is_the_square_of_the_mirror_image() -> None:
    image = np.random.default_rng(0).integers(0, 256, (90, 120, 3), dtype=np.uint8)
    square = HandCrop(np.array([41.3, 60.8]), 50.0, 0.4)
    over_there = square._replace(middle=np.array([120.0 - 41.3, 60.8]), angle=-0.4)
    shown: list[np.ndarray] = []

    def net(given: np.ndarray) -> list[np.ndarray]:
        shown.append(given)
        return [np.arange(63.0, dtype=np.float32), *np.full((2, 1), 0.5, np.float32), np.ones(63, np.float32)]

    nets = Nets(net, net, "")
    there, other = nets.mirrored(image, square), nets.landmarks(np.ascontiguousarray(image[:, ::-1]), over_there)
    assert np.abs(shown[0] - shown[1]).mean() < 0.01
    np.testing.assert_allclose(there.world, other.world)


@pytest.mark.parametrize("bias", [0.0, 2.0, -2.0])
def test_the_bias_of_the_networks_cancels_out(bias: float) -> None:
    flat = bent("left") * np.array([1.0, 1.0, 0.0])
    nets = Biased(posed(flat, 0.4), bias)
    seen = Sighting(*nets.landmarks(BLANK, HandCrop(posed(flat).points[0], 100.0, 0.0)))
    assert unbiased_log_odds(BLANK, seen, nets) == pytest.approx(np.log(0.4 / 0.6))


def test_what_hardly_agrees_is_an_assumption() -> None:
    assert Handedness((-5.0,) * 9 + (0.5,)).source.basis == "estimated"
    faint, mixed = ((-2.4, -2.5, -2.6), "3 of 3 frames, but hardly"), ((-9.0, 0.5, 0.5, -9.0), "2 of 4 frames only")
    for odds, how in (faint, mixed):
        source = Handedness(odds).source
        assert source.basis == "assumed"
        assert source.text.startswith("left, a guess")
        assert source.text.endswith(f"in {how}; --side right overrules this")


def test_the_side_of_hands_without_depths_is_decided_by_the_network_alone() -> None:
    assert log_odds(Sighting(np.zeros((21, 2)), np.full((21, 3), np.nan), 0.9, 0.25)) == pytest.approx(np.log(1 / 3))
