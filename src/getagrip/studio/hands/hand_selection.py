"""Select the hand that grasps the object, of all hands in a clip: one side, and in each frame one hand or none.

Sightings are linked from frame to frame into tracks. The hand is the track nearest to the object, if the object's place
is known in some frame, otherwise the track with the most frames; if others have about as many, the one whose shape
changes least, since grasping fingers hardly move. Tracks of the same side that fill its gaps are added. Of two tracks
of one hand, as a left and as a right one, the one with more frames is used, and its side is a guess.

The side of a track is decided by many of its sightings, from the network's probability and from the fingers in 3D,
which bend towards the palm. The network is less confident of left hands, and of hands whose palm is hidden. This bias
cancels out by comparison with a sighting in the mirror image, where the hand must be one of the other side. Frames of a
track in which the hand is seen as one of the other side are wrong (``find_mirrored_frames``). Two hands seen beside
each other have different sides (``choose_sides``).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, groupby, product
from operator import attrgetter
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from getagrip.clip.timeline import opposite_side
from getagrip.errors import UsageError
from getagrip.io.terminal import format_count, format_ranges
from getagrip.provenance import Source, assumed, estimated, measured
from getagrip.studio.hands.hand_tracking import Sighting, drop_outlier_sightings
from getagrip.studio.hands.networks import HAND_INPUT_PX, Nets, crop_of_landmarks

FINGER_BEND_SCALE_M = 0.01
"""Distance of the fingers from the plane of the palm with log odds of 1 [m]."""
MAX_CUE_LOG_ODDS = 4.0
"""Limit of the log odds of either cue in a frame, so that no single frame decides."""
HANDEDNESS_CERTAINTY_LIMITS = 4.0, 0.8
"""Mean log odds of a side, and fraction of frames that agree, below which a side is assumed. Of 83 hands in public
videos 15 look like the other side, 12 of them below these limits, as do 16 that look right."""
PAIR_ORDER_LOG_ODDS = 2.5
"""Log odds that of two hands with forearms from below the right one in the picture is the right hand. On 83 hands in
public videos, on which it was chosen, any from 2 on decides alike."""
MAX_PAIR_SIZE_RATIO, MIN_PAIR_DISTANCE = 2.0, 0.5
"""Largest ratio of the sizes of two hands that are taken for one person's, and smallest horizontal distance, in sizes,
at which one is the left one."""
MIN_RISE = 0.3
"""Sine of the angle above the horizontal, from wrist to knuckles, from which a forearm comes from below."""
MIN_MIRRORED_LOG_ODDS = 1.0
"""Mean log odds of the other side above which consecutive frames are mirrored."""
MAX_MIRRORED_FRACTION = 0.5
"""Fraction of a hand's frames above which mirrored frames show that its side is wrong."""
HANDEDNESS_WINDOW_FRAMES = 2
"""Number of frames before and after a frame that decide with it whether it is mirrored."""
MAX_LINK_GAP_FRAMES = 10
"""Longest gap over which a hand is linked, and later interpolated [frames]."""
MAX_PALM_STEP = 1.0
"""Largest motion of a palm between consecutive sightings, in palm sizes per frame."""
MAX_HAND_SIZE_RATIO, N_SIZE_SIGHTINGS = 2.5, 5
"""Largest factor of a hand's size from the median of its last sightings, and their number; 2.25 from one sighting to
the next in the blur of the kitchen clip."""
MIN_TRACK_FRAMES = 4
"""Minimum number of frames of a track; half the frames of a clip of fewer than eight."""
N_HANDEDNESS_FRAMES = 20
"""Number of frames of a track, evenly spaced, that decide on its side."""
SIMILAR_TRACK_FRACTION = 0.9
"""Fraction of the largest number of frames above which tracks have about as many: the steadiest of them is chosen."""
MAX_OBJECT_BOX_DISTANCE = 0.6
"""Distance from the object's box, in sizes of the hand, above which a note calls the hand far off."""
MIN_DETECTED_FRACTION = 0.5
"""Fraction of the hand's frames detected without redetection, below which a note lists them."""
MAX_STATIC_MOTION, MIN_STATIC_HAND_FRAMES = 0.1, 10
"""Largest motion of a static hand's middle, in sizes of the hand, and minimum number of its frames."""
SECOND_PERSON_FRACTION = 0.2
"""Fraction of frames with another hand of the same side above which a note names it."""
OBJECT_PART_NOTE = "what looks like a hand in the object's box does not move, and is taken for a part of the object"

Side = Literal["left", "right"]
Odds = Callable[[int, Sighting], float]
"""The log odds that the hand of a sighting in a frame is a right one."""


class Handedness(NamedTuple):
    """The evidence of some frames on a hand's side."""

    odds: tuple[float, ...]
    """Log odds of a right hand, in each frame."""

    @property
    def mean(self) -> float:
        return float(np.mean(self.odds))

    @property
    def alike(self) -> int:
        """Number of frames that agree with the side."""
        return sum((each >= 0.0) == (self.mean >= 0.0) for each in self.odds)

    @property
    def side(self) -> Side:
        return "right" if self.mean >= 0.0 else "left"

    @property
    def words(self) -> str:
        return f"it looks like a {self.side} hand in {self.alike} of {format_count(len(self.odds), 'frame')}"

    @property
    def sure(self) -> bool:
        """True if odds and agreement of the frames exceed ``HANDEDNESS_CERTAINTY_LIMITS``."""
        least, share = HANDEDNESS_CERTAINTY_LIMITS
        return abs(self.mean) >= least and self.alike >= share * len(self.odds)

    @property
    def source(self) -> Source:
        """Source of the side: estimated, or assumed where the frames hardly agree."""
        if self.sure:
            return estimated(f"{self.side}: {self.words}")
        return guessed_side(self.side, f"{self.words}{' only' if self.alike < len(self.odds) else ', but hardly'}")


def guessed_side(side: Side, reason: str) -> Source:
    """Return the source of an assumed side, with the reason."""
    return assumed(f"{side}, a guess, since {reason}; --side {opposite_side(side)} overrules this")


UNKNOWN_HANDEDNESS = Handedness(())


def log_odds(hand: Sighting) -> float:
    """Compute the log odds that a sighting is a right hand, before the bias is removed."""
    p = np.clip(hand.right, 1e-9, 1.0 - 1e-9)
    wrist, index, pinky = hand.world[[0, 5, 17]]
    normal = np.cross(index - wrist, pinky - wrist)  # out of the palm of a right hand, in axes with z ahead
    fingers = hand.world[5:].reshape(4, 4, 3)
    ahead = (fingers[:, 1:] - fingers[:, :1]).mean(axis=(0, 1)) @ normal / max(float(np.linalg.norm(normal)), 1e-9)
    cues = np.array([np.log(p / (1.0 - p)), np.nan_to_num(ahead) / FINGER_BEND_SCALE_M])
    return float(np.clip(cues, -MAX_CUE_LOG_ODDS, MAX_CUE_LOG_ODDS).sum())


def unbiased_log_odds(image: UInt8[ndarray, "H W 3"], hand: Sighting, nets: Nets) -> float:
    """Compute the log odds that a hand in an image is a right one, from the image and its mirror image."""
    return 0.5 * (log_odds(hand) - log_odds(Sighting(*nets.mirrored(image, crop_of_landmarks(hand.points)))))


def find_mirrored_frames(
    hand: Mapping[int, Sighting], side: Side, odds: Odds, most: float = MAX_MIRRORED_FRACTION
) -> list[int]:
    """Return the frames in which a hand is seen as one of the other side; none if they are ``most`` of all or more.

    In an edge-on view a hand resembles its mirror image, with the thumb in the little finger's place.
    """
    right, frames, half = (1.0 if side == "right" else -1.0), sorted(hand), HANDEDNESS_WINDOW_FRAMES
    raw = [right * log_odds(hand[n]) for n in frames]
    unlike = [float(np.median(raw[max(0, i - half) : i + half + 1])) < 0.0 for i in range(len(raw))]
    out: list[int] = []
    for other, run in groupby(zip(unlike, frames, strict=True), key=lambda each: each[0]):
        some = [n for _, n in run]
        if other and np.mean([right * odds(n, hand[n]) for n in some]) < -MIN_MIRRORED_LOG_ODDS:
            out += some
    return out if len(out) < most * len(frames) else []


@dataclass(frozen=True)
class HandLandmarks:
    """The landmarks of one hand over a clip.

    Attributes:
        side: ``left`` or ``right``.
        points: (T, 21, 2) wrist, then thumb, index, middle, ring, pinky, each from the palm to the tip [px]; NaN in
            frames without a hand.
        confidence: (T, 21) from 0 to 1; 0 in frames without a hand.
        world: (T, 21, 3) landmarks relative to the hand's middle, in the camera's axes, for a hand of mean size [m];
            NaN in frames without a hand.
        side_source: source of the side.
        notes: decisions and omissions, as text.
    """

    side: Side
    points: Float[ndarray, "T 21 2"]
    confidence: Float[ndarray, "T 21"]
    world: Float[ndarray, "T 21 3"]
    side_source: Source
    notes: tuple[str, ...] = ()

    @property
    def rows(self) -> tuple[int, ...]:
        """Frames with a hand."""
        return tuple(np.flatnonzero(self.confidence.any(axis=1)).tolist())


@dataclass
class HandTracklet:
    """Sightings linked from frame to frame."""

    seen: dict[int, Sighting]
    handedness: Handedness = UNKNOWN_HANDEDNESS
    paired: Side | None = None
    """Side as one of two hands; None: as it looks."""

    @property
    def last(self) -> int:
        return max(self.seen)

    @property
    def last_size(self) -> float:
        """Median size of the last sightings [px]: by a single one, another person's small hand might follow a blur."""
        return float(np.median([each.size for each in [*self.seen.values()][-N_SIZE_SIGHTINGS:]]))

    @property
    def side(self) -> Side:
        return self.paired or self.handedness.side

    @property
    def source(self) -> Source:
        """Source of the side."""
        if self.side == self.handedness.side:
            return self.handedness.source
        reason = f"it is the {self.side} one of two hands from below, though {self.handedness.words}"
        return guessed_side(self.side, reason)

    @property
    def from_below(self) -> bool:
        """True if the forearm comes from below in the picture."""
        along = np.mean([each.points[9] - each.points[0] for each in self.seen.values()], axis=0)
        return bool(-along[1] >= MIN_RISE * np.linalg.norm(along))

    @property
    def confidence(self) -> float:
        """Sum over all frames: the number of confident frames."""
        return sum(each.confidence for each in self.seen.values())

    @property
    def bending(self) -> float:
        """Change of the hand's shape in its crop, in sides of the crop: the median over frames."""
        hands = [each.points for each in self.seen.values()]
        own = np.array([crop_of_landmarks(points).from_image(points) / HAND_INPUT_PX for points in hands])
        own -= own.mean(axis=1, keepdims=True)
        off = np.linalg.norm(own - np.median(own, axis=0), axis=-1)
        return float(np.median(np.sqrt(np.mean(off**2, axis=-1))))

    def beside(self, other: HandTracklet) -> list[int]:
        """List the frames with both hands, apart and about as large; none if they are few of either's."""
        most = MAX_PAIR_SIZE_RATIO
        both = [(n, each, other.seen[n]) for n, each in self.seen.items() if n in other.seen]
        frames = [n for n, a, b in both if a.apart(b) and 1.0 / most < a.size / b.size < most]
        return frames if len(frames) >= max(MIN_TRACK_FRAMES, 0.5 * min(len(self.seen), len(other.seen))) else []

    def as_large_as(self, hand: Mapping[int, Sighting]) -> bool:
        """Return whether each end is about as large as the nearest of a hand's sightings."""
        for n in (min(self.seen), self.last):
            near = sorted(hand, key=lambda m: abs(m - n))[:N_SIZE_SIGHTINGS]
            ratio = self.seen[n].size / float(np.median([hand[m].size for m in near]))
            if not 1.0 / MAX_HAND_SIZE_RATIO < ratio < MAX_HAND_SIZE_RATIO:
                return False
        return True

    def part_of(self, other: HandTracklet) -> bool:
        """Return whether this is a finger or knuckle of another hand that the networks mistake for a hand."""
        both = [(self.seen[n], other.seen[n]) for n in self.seen.keys() & other.seen.keys()]
        return bool(both) and float(np.mean([each.part_of(whole) for each, whole in both])) > 0.5

    def belongs_to_object(self, boxes: Mapping[int, Float[ndarray, "4"]]) -> bool:
        """Return whether the hand lies in the object's first box and does not move: a hand-like part of the object."""
        if not boxes or len(self.seen) < MIN_STATIC_HAND_FRAMES:
            return False
        x, y, w, h = boxes[min(boxes)]
        points = np.array([each.points for each in self.seen.values()])
        inside = ((points >= [x, y]) & (points <= [x + w, y + h])).all(axis=-1).mean()
        middle = points.mean(axis=1)
        moved = np.linalg.norm(middle - np.median(middle, axis=0), axis=-1).max()
        return bool(inside > 0.9 and moved < MAX_STATIC_MOTION * np.median([each.size for each in self.seen.values()]))

    def read_otherwise(self, other: HandTracklet) -> int:
        """Count the frames in which another track shows this hand as one of the other side; 0 if it mostly does not."""
        common = self.seen.keys() & other.seen.keys()
        covered = sum(self.seen[n].covers(other.seen[n]) for n in common)
        return covered if self.side != other.side and covered > max(MIN_TRACK_FRAMES, 0.5 * len(common)) else 0

    def distance(self, boxes: Mapping[int, Float[ndarray, "4"]]) -> float:
        """Measure the mean distance of the landmarks from the object's boxes, in sizes of the hand.

        Infinite without sightings near the frame of the first box.
        """
        apart = []
        for n, (x, y, w, h) in sorted(boxes.items()):
            near = min(self.seen, key=lambda m: abs(m - n))
            if abs(near - n) <= MAX_LINK_GAP_FRAMES:
                points = self.seen[near].points
                off = points - np.clip(points, [x, y], [x + w, y + h])
                apart.append(float(np.linalg.norm(off, axis=1).mean()) / self.seen[near].size)
            elif not apart:
                break
        return float(np.mean(apart)) if apart else np.inf


def link_tracks(seen: Sequence[Sequence[Sighting]]) -> list[HandTracklet]:
    """Link sightings from frame to frame, the nearest first, without short tracks and parts of hands."""
    out: list[HandTracklet] = []
    for n, hands in enumerate(seen):
        open_ones = [track for track in out if n - track.last <= MAX_LINK_GAP_FRAMES]
        pairs = sorted(
            (float(np.linalg.norm(hand.middle - track.seen[track.last].middle)) / hand.size / (n - track.last), k, i)
            for (k, track), (i, hand) in product(enumerate(open_ones), enumerate(hands))
        )
        used: set[int] = set()
        taken: set[int] = set()
        for apart, k, i in pairs:
            before = open_ones[k].last_size
            alike = 1.0 / MAX_HAND_SIZE_RATIO < hands[i].size / before < MAX_HAND_SIZE_RATIO
            if apart < MAX_PALM_STEP and alike and k not in used and i not in taken:
                open_ones[k].seen[n] = hands[i]
                used.add(k)
                taken.add(i)
        out += [HandTracklet({n: hand}) for i, hand in enumerate(hands) if i not in taken]
    out = [track for track in out if len(track.seen) >= min(MIN_TRACK_FRAMES, (len(seen) + 1) // 2)]
    return [track for track in out if not any(map(track.part_of, out))]


def choose_sides(found: Sequence[HandTracklet], odds: Odds) -> None:
    """Choose the side of each hand by how it looks, and by a hand seen beside it.

    If both have forearms from below, they are taken for those of the camera's wearer: the left one in the picture is
    the left hand. They are not if they are sure of different sides, or look the other way round by more than
    ``PAIR_ORDER_LOG_ODDS``, as the hands of a person in front do.
    """
    looks = sorted((n, k) for k, track in enumerate(found) for n in _handedness_frames(track))  # in order of frames
    all_odds = [(k, odds(n, found[k].seen[n])) for n, k in looks]
    for k, track in enumerate(found):
        track.handedness = Handedness(tuple(value for of, value in all_odds if of == k))
    pairs = [(one.beside(other), one, other) for one, other in combinations(found, 2)]
    for frames, one, other in sorted(pairs, key=lambda pair: len(pair[0])):  # the longest overrules
        a, b = one.handedness, other.handedness
        differ = a.sure and b.sure and a.side != b.side
        if frames and not differ and one.from_below and other.from_below:
            apart = np.mean([(one.seen[n].middle - other.seen[n].middle)[0] / one.seen[n].size for n in frames])
            if abs(apart) > MIN_PAIR_DISTANCE:
                right = 0.5 * (a.mean - b.mean) + PAIR_ORDER_LOG_ODDS * np.sign(apart) >= 0.0
                one.paired, other.paired = ("right", "left") if right else ("left", "right")


def select_hand(
    seen: Sequence[Sequence[Sighting]],
    side: Side | None = None,
    boxes: Mapping[int, Float[ndarray, "4"]] | None = None,
    counted_from: int = 1,
    again: Callable[[Mapping[int, Sighting], Mapping[int, Side]], dict[int, Sighting]] = lambda hand, _: dict(hand),
    odds: Odds = lambda _, hand: log_odds(hand),
) -> HandLandmarks:
    """Select the hand that grasps the object.

    Args:
        seen: the sightings in each frame.
        side: overrules the majority. If no hand looks like this side, a hand is selected whose own side is a guess or,
            with boxes, the hand near the object; a note names this.
        boxes: boxes of the object in some frames (left, top, width, height) [px].
        counted_from: number of the first frame in notes.
        again: detects the hand again where it is not confident or mirrored (``redetect_hand``); the second argument is
            its side in mirrored frames.
        odds: the log odds of a right hand.

    Raises:
        UsageError: where no hand fits.
    """
    boxes, boxed, another = boxes or {}, boxes is not None, "another " * bool(boxes)
    found = link_tracks(seen)
    hands = [track for track in found if not track.belongs_to_object(boxes)]
    notes = [f"left out: {OBJECT_PART_NOTE}"] if len(found) > len(hands) else []
    choose_sides(hands, odds)
    found = _candidate_tracks(hands, side, boxes)
    if not found:
        raise UsageError(f"no hand: {OBJECT_PART_NOTE}" if notes else _explain_no_hand(seen, side, boxed))
    often = SIMILAR_TRACK_FRACTION * max(track.confidence for track in found)
    first = min(found, key=lambda track: (track.distance(boxes), track.confidence < often, track.bending))
    first = max([first, *filter(first.read_otherwise, found)], key=attrgetter("confidence"))
    otherwise = max(map(first.read_otherwise, found))
    majority, as_stated = side or first.side, side in (None, first.side)
    as_seen = majority == first.handedness.side
    hand, others = _fill_gaps_from_tracks(first, found)
    mirrored = find_mirrored_frames(hand, majority, odds) if as_seen else []
    before = {n: each for n, each in hand.items() if n not in mirrored}
    hand = again(before, dict.fromkeys(mirrored, first.side))
    sure = first.handedness.sure and not otherwise
    still = find_mirrored_frames(hand, majority, odds, 1.0 if sure else MAX_MIRRORED_FRACTION) if as_seen else []
    most = len(still) >= MAX_MIRRORED_FRACTION * len(hand)  # then those of redetection are left out
    mirrored = sorted({*still} - {*before} if most else {*still} & {*mirrored})
    hand, flickering = drop_outlier_sightings({n: each for n, each in hand.items() if n not in mirrored})

    def listed(frames: Iterable[int]) -> str:
        return format_ranges(sorted(frames), counted_from)

    if not as_stated:
        notes.append(f"a guess: {first.handedness.words}, but the side is stated")
    if boxed:
        notes.append(_note_on_distance(first, boxes))
    if flickering:
        notes.append(f"left out, since they differ from the frames about them: {listed(flickering)}")
    if len(before) < MIN_DETECTED_FRACTION * len(hand):
        rest = f"in {format_count(len({*hand} - {*before}), 'frame')} only where it was expected: check those"
        notes.append(f"seen at once in the frames {listed(before)}, {rest}")
    if mirrored:
        notes.append(f"left out, since they look like a hand of the other side: {listed(mirrored)}")
    if gaps := listed({*range(len(seen))} - {*hand}):
        notes.append(f"no hand in the frames {gaps} (counted from 1)")
    opposite = [track for track in found if track.side != first.side]
    for beside, option in ((others, "--object-box"), (opposite, "--object-box or --side")):
        also = {n: [each for track in beside if (each := track.seen.get(n)) and each.apart(hand[n])] for n in hand}
        twice = [n for n in hand if also[n]]
        if len(twice) > SECOND_PERSON_FRACTION * len(hand):
            one, other = ("at ({:.0f}, {:.0f})".format(*each.middle) for each in (hand[twice[0]], also[twice[0]][0]))
            which = f"chosen is the one {one} in frame {twice[0] + counted_from}, not that {other}"
            notes.append(f"two hands in {format_count(len(twice), 'frame')}: {which}; {another}{option} overrules this")
    source = measured(f"{side}, as stated") if side else first.source
    if otherwise:
        where = f"in {format_count(otherwise, 'frame')}"
        source = guessed_side(first.side, f"{where} it also looks like a hand of the other side")
    return HandLandmarks(majority, *_sightings_to_arrays(hand, len(seen)), source, tuple(notes))


def _note_on_distance(hand: HandTracklet, boxes: Mapping[int, Float[ndarray, "4"]]) -> str:
    """Return the note on a hand's distance from the object, whose box is stated in the first frame of ``boxes``.

    A hand may reach for the object: it is far off where it never comes near.
    """
    if not np.isfinite(hand.distance(dict(sorted(boxes.items())[:1]))):
        return "the object's box decides nothing: there is no hand about that frame"
    near = "of the hands that were seen, the one nearest to the object"
    least = min(hand.distance({n: box}) for n, box in boxes.items())
    return f"{near}, but it is far off: is the object's box right?" if least > MAX_OBJECT_BOX_DISTANCE else near


def _candidate_tracks(
    found: list[HandTracklet], side: Side | None, boxes: Mapping[int, Float[ndarray, "4"]]
) -> list[HandTracklet]:
    """Return the tracks of a stated side; without a side or such tracks, those that may be the hand."""
    stated = [track for track in found if side in (None, track.side) or (boxes and track.paired)]
    # The networks may mistake the side of a hand seen from behind the object.
    at_object = [track for track in found if np.isfinite(track.distance(boxes))]
    return stated or at_object or [track for track in found if not track.handedness.sure]


def _handedness_frames(track: HandTracklet) -> list[int]:
    """Choose the frames that decide on a track's side."""
    frames = sorted(track.seen)
    return sorted({frames[i] for i in np.linspace(0, len(frames) - 1, N_HANDEDNESS_FRAMES).round().astype(int)})


def _fill_gaps_from_tracks(
    first: HandTracklet, found: Sequence[HandTracklet]
) -> tuple[dict[int, Sighting], list[HandTracklet]]:
    """Add tracks of a track's side that fill its gaps, the longest first; also return those that overlap it.

    Tracks much larger or smaller than the hand's nearest sightings are of another person, and are left out.
    """
    hand, beside = dict(first.seen), []
    same_side = [track for track in found if track is not first and track.side == first.side]
    for track in sorted(same_side, key=attrgetter("confidence"), reverse=True):
        if any(n in hand for n in track.seen):
            beside.append(track)
        elif track.as_large_as(hand):
            hand |= track.seen
    return dict(sorted(hand.items())), beside


def _explain_no_hand(seen: Sequence[Sequence[Sighting]], side: Side | None, boxed: bool) -> str:
    some = sum(bool(hands) for hands in seen)
    where = f"{format_count(len(seen), 'frame')}{', also enlarged about the object' if boxed else ''}"
    tried = f"palms were looked for in {where}, and hands were followed in both directions"
    if side is not None and some:
        box = "begin --interval where one is" if boxed else "mark the object by --object-box"
        none = ", none about the frame of the object's box" if boxed else ""
        remedy = f"leave out --side {side}, or {box}: the hand at it is taken for a {side} one"
        return f"no {side} hand: {tried}; there are hands in {some}, of the other side{none} ({remedy})"
    advice = "" if boxed else "Mark the object by --object-box: then small hands are looked for about it. "
    advice += "Click joints in getagrip annotate; or use an estimator: --hands FILE"
    return f"no hand: {tried}; found in {some}. Is there a glove, blur, or a hand half out of view? {advice}"


def _sightings_to_arrays(
    hand: Mapping[int, Sighting], count: int
) -> tuple[Float[ndarray, "T 21 2"], Float[ndarray, "T 21"], Float[ndarray, "T 21 3"]]:
    points, world = np.full((count, 21, 2), np.nan), np.full((count, 21, 3), np.nan)
    confidence = np.zeros((count, 21))
    for n, each in hand.items():
        points[n], world[n], confidence[n] = each.points, each.world, each.confidence
    return points, confidence, world
