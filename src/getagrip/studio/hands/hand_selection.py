"""Selection of the hand that holds the object, of all hands in a clip: one side, in each frame one hand or none.

Sightings are linked from frame to frame into tracks. The hand is the track nearest to the object, if the object's place
is known in some frame, otherwise the track with the most frames; if others have about as many, the one whose shape
changes least, since fingers that hold something hardly move. Tracks of its side that fill its gaps are added. The
side of a track is decided by many of its frames (``handedness``). Of two tracks of one hand, as a left and a right one,
that with more frames is taken, and its side is a guess.

The side of a hand, left or right, by some of its sightings, and those of their mirror images.

The network is less sure of left hands than of right ones, and of hands whose palm an object hides. Its bias cancels
out, since each sighting is compared with one in the mirror image, where the hand must be one of the other side. What it
says of the side is supported by how it sees the fingers in 3D: they bend towards the palm.

Where the side is known, frames in which the hand is seen as one of the other side are wrong (``find_mirrored_frames``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from getagrip.errors import UsageError
from getagrip.io.terminal import format_count, format_ranges
from getagrip.provenance import Source, assumed, estimated, measured
from getagrip.studio.hands import palms
from getagrip.studio.hands.hand_tracking import Sighting, drop_outlier_sightings
from getagrip.studio.hands.networks import Nets
from getagrip.studio.hands.palms import HAND_INPUT_PX, crop_of_landmarks

FINGER_BEND_SCALE_M = 0.01
"""Distance of the fingers from the plane of the palm that counts as much as odds of 1 : e [m]."""
MAX_CUE_LOG_ODDS = 4.0
"""Largest log odds of either cue in a frame, so that no single frame decides."""
HANDEDNESS_CERTAINTY_LIMITS = 3.0, 0.8
"""Mean log odds of a side, and share of frames that look like it, below which a side is assumed. Of eight grasps in
public videos the two whose side was wrong had 2.1 and 2.3, the others 2.2 to 7.4."""
MIN_MIRRORED_LOG_ODDS = 1.0
"""Mean log odds of the other side from which on frames in a row are seen mirrored."""
MAX_MIRRORED_FRACTION = 0.5
"""Share of a hand's frames that may be seen mirrored: else its side is the wrong one."""
HANDEDNESS_WINDOW_FRAMES = 2
"""Number of frames before and after that decide with a frame whether it is seen mirrored."""

Side = Literal["left", "right"]
Odds = Callable[[int, Sighting], float]
"""The log odds that a hand in a frame is a right one."""


class Handedness(NamedTuple):
    """The evidence of some frames on a hand's side."""

    odds: tuple[float, ...]
    """Log odds of a right hand, in each of them."""

    @property
    def mean(self) -> float:
        return float(np.mean(self.odds))

    @property
    def alike(self) -> int:
        """Number of frames that look like this side."""
        return sum((each >= 0.0) == (self.mean >= 0.0) for each in self.odds)

    @property
    def side(self) -> Side:
        return "right" if self.mean >= 0.0 else "left"

    @property
    def words(self) -> str:
        return f"it looks like a {self.side} hand in {self.alike} of {format_count(len(self.odds), 'frame')}"

    @property
    def sure(self) -> bool:
        """True if the frames agree."""
        least, share = HANDEDNESS_CERTAINTY_LIMITS
        return abs(self.mean) >= least and self.alike >= share * len(self.odds)

    @property
    def source(self) -> Source:
        """Source of the side: assumed, where the frames hardly agree."""
        if self.sure:
            return estimated(f"{self.side}: {self.words}")
        return self.guess(f"{self.words}{' only' if self.alike < len(self.odds) else ', but hardly'}")

    def guess(self, reason: str) -> Source:
        """Return the source of a side that is assumed, for a reason."""
        other = "left" if self.side == "right" else "right"
        return assumed(f"{self.side}, a guess, since {reason}; --side {other} overrules this")


UNKNOWN_HANDEDNESS = Handedness(())


def log_odds(hand: Sighting) -> float:
    """Compute how much a sighting speaks for a right hand, before the bias is removed."""
    p = np.clip(hand.right, 1e-9, 1.0 - 1e-9)
    wrist, index, pinky = hand.world[[0, 5, 17]]
    normal = np.cross(index - wrist, pinky - wrist)  # out of the palm of a right hand, in axes with z ahead
    fingers = hand.world[5:].reshape(4, 4, 3)
    ahead = (fingers[:, 1:] - fingers[:, :1]).mean(axis=(0, 1)) @ normal / max(float(np.linalg.norm(normal)), 1e-9)
    cues = np.array([np.log(p / (1.0 - p)), np.nan_to_num(ahead) / FINGER_BEND_SCALE_M])
    return float(np.clip(cues, -MAX_CUE_LOG_ODDS, MAX_CUE_LOG_ODDS).sum())


def unbiased_log_odds(image: UInt8[ndarray, "H W 3"], hand: Sighting, nets: Nets) -> float:
    """Compute the log odds that a hand in an image is a right one, from the image and its mirror image."""
    return 0.5 * (log_odds(hand) - log_odds(Sighting(*nets.mirrored(image, palms.crop_of_landmarks(hand.points)))))


def find_mirrored_frames(
    hand: Mapping[int, Sighting], side: Side, odds: Odds, most: float = MAX_MIRRORED_FRACTION
) -> list[int]:
    """Return the frames in which a hand is seen as one of the other side: some in a row, less than ``most`` of all.

    Seen from its edge a hand looks like its mirror image, with the thumb where the little finger is.
    """
    right, frames = (1.0 if side == "right" else -1.0), sorted(hand)
    raw = [right * log_odds(hand[n]) for n in frames]
    unlike = [
        float(np.median(raw[max(0, i - HANDEDNESS_WINDOW_FRAMES) : i + HANDEDNESS_WINDOW_FRAMES + 1])) < 0.0
        for i in range(len(raw))
    ]
    out: list[int] = []
    for other, run in groupby(zip(unlike, frames, strict=True), key=lambda each: each[0]):
        some = [n for _, n in run]
        if other and np.mean([right * odds(n, hand[n]) for n in some]) < -MIN_MIRRORED_LOG_ODDS:
            out += some
    return out if len(out) < most * len(frames) else []


MAX_LINK_GAP_FRAMES = 10
"""Longest gap [frames] over which a hand is linked and later interpolated; longer gaps remain."""
MAX_PALM_STEP = 1.0
"""Largest motion of a palm between successive frames that have it, in palm sizes."""
MAX_HAND_SIZE_RATIO = 2.5
"""Factor by which a hand's size changes less from one sighting to the next; 2.25 in the blur of the kitchen clip."""
MIN_TRACK_FRAMES = 4
"""Least number of frames of a track; half the frames of a clip of fewer than eight."""
N_HANDEDNESS_FRAMES = 20
"""Number of frames of a track, spread evenly, that decide on its side."""
SIMILAR_TRACK_FRACTION = 0.9
"""Tracks of at least this share of the largest number of frames have about as many: the steadiest of them is chosen."""
MAX_OBJECT_BOX_DISTANCE = 0.6
"""Distance from the object's box, in sizes of the hand, above which the hand is far from it."""
MIN_DETECTED_FRACTION = 0.5
"""Share of the hand's frames in which it is seen without a second look, below which this is said."""
MAX_STATIC_MOTION, MIN_STATIC_HAND_FRAMES = 0.1, 10
"""A hand does not move whose middle stays within this share of its size, in at least this number of frames."""
SECOND_PERSON_FRACTION = 0.2
"""Share of frames with another hand of the same side from which on two people are assumed."""
OBJECT_PART_NOTE = "what looks like a hand in the object's box does not move, and is taken for a part of the object"


@dataclass(frozen=True)
class HandLandmarks:
    """The landmarks of one hand over a clip.

    Attributes:
        side: ``left`` or ``right``.
        points: (T, 21, 2) wrist, then thumb, index, middle, ring, pinky, each from the palm to the tip [px]; NaN in
            frames without.
        confidence: (T, 21) from 0 to 1; 0 where there are none.
        world: (T, 21, 3) the same about the hand's middle, in the camera's axes, of a hand of about mean size [m]; NaN
            in frames without.
        side_source: how the side is known.
        notes: what was decided and what was left out, in words.
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
    """A hand that was linked from frame to frame."""

    seen: dict[int, Sighting] = field(default_factory=dict)
    handedness: Handedness = UNKNOWN_HANDEDNESS

    @property
    def last(self) -> int:
        return max(self.seen)

    @property
    def side(self) -> Side:
        return self.handedness.side

    @property
    def bending(self) -> float:
        """How much the hand changes its shape, as it is seen: in its own square, of side 1, the median over frames."""
        hands = [each.points for each in self.seen.values()]
        own = np.array([crop_of_landmarks(points).from_image(points) / HAND_INPUT_PX for points in hands])
        own -= own.mean(axis=1, keepdims=True)
        off = np.linalg.norm(own - np.median(own, axis=0), axis=-1)
        return float(np.median(np.sqrt(np.mean(off**2, axis=-1))))

    def part_of(self, other: HandTracklet) -> bool:
        """Return whether this is a finger or knuckle of another hand that the networks take for a hand of its own."""
        both = [(self.seen[n], other.seen[n]) for n in self.seen.keys() & other.seen.keys()]
        return bool(both) and float(np.mean([each.part_of(whole) for each, whole in both])) > 0.5

    def belongs_to_object(self, boxes: Mapping[int, Float[ndarray, "4"]]) -> bool:
        """Return whether it lies in the object's first box and does not move: a part of it that looks like a hand."""
        if not boxes or len(self.seen) < MIN_STATIC_HAND_FRAMES:
            return False
        x, y, w, h = boxes[min(boxes)]
        points = np.array([each.points for each in self.seen.values()])
        inside = ((points >= [x, y]) & (points <= [x + w, y + h])).all(axis=-1).mean()
        middle = points.mean(axis=1)
        moved = np.linalg.norm(middle - np.median(middle, axis=0), axis=-1).max()
        return bool(inside > 0.9 and moved < MAX_STATIC_MOTION * np.median([each.size for each in self.seen.values()]))

    def read_otherwise(self, other: HandTracklet) -> int:
        """Count the frames in which another track shows this hand as one of the other side, if it mostly does."""
        common = self.seen.keys() & other.seen.keys()
        covered = sum(self.seen[n].covers(other.seen[n]) for n in common)
        return covered if self.side != other.side and covered > max(MIN_TRACK_FRAMES, 0.5 * len(common)) else 0

    def distance(self, boxes: Mapping[int, Float[ndarray, "4"]]) -> float:
        """Measure the mean distance of the landmarks from the object's boxes, in sizes of the hand.

        Infinite for a hand that is not seen about the frame of the first box.
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
    """Link sightings from frame to frame, the nearest first. Those of a few frames, and parts of hands are left out."""
    out: list[HandTracklet] = []
    for n, hands in enumerate(seen):
        open_ones = [track for track in out if n - track.last <= MAX_LINK_GAP_FRAMES]
        pairs = sorted(
            (float(np.linalg.norm(hand.middle - track.seen[track.last].middle)) / hand.size / (n - track.last), k, i)
            for k, track in enumerate(open_ones)
            for i, hand in enumerate(hands)
        )
        used: set[int] = set()
        taken: set[int] = set()
        for apart, k, i in pairs:
            before = open_ones[k].seen[open_ones[k].last].size
            alike = 1.0 / MAX_HAND_SIZE_RATIO < hands[i].size / before < MAX_HAND_SIZE_RATIO
            if apart < MAX_PALM_STEP and alike and k not in used and i not in taken:
                open_ones[k].seen[n] = hands[i]
                used.add(k)
                taken.add(i)
        out += [HandTracklet({n: hand}) for i, hand in enumerate(hands) if i not in taken]
    out = [track for track in out if len(track.seen) >= min(MIN_TRACK_FRAMES, (len(seen) + 1) // 2)]
    return [track for track in out if not any(map(track.part_of, out))]


def select_hand(
    seen: Sequence[Sequence[Sighting]],
    side: Side | None = None,
    boxes: Mapping[int, Float[ndarray, "4"]] | None = None,
    counted_from: int = 1,
    again: Callable[[Mapping[int, Sighting], Mapping[int, Side]], dict[int, Sighting]] = lambda hand, _: dict(hand),
    odds: Odds = lambda _, hand: log_odds(hand),
) -> HandLandmarks:
    """Select the hand that holds the object.

    ``again`` looks for it once more where it is not sure (``second_look``), or is seen as one of the other side: its
    side in such frames is the second argument.
    ``odds`` are the log odds that a hand in a frame is a right one.

    ``side`` overrules the majority; ``boxes`` (left, top, width, height) [px] are where the object is in some frames.
    Where no hand looks like that side, one is taken whose own side is a guess or, with both, the hand near the object;
    this is said. Notes give the first frame the number ``counted_from``.

    Raises ``UsageError`` where there is no such hand.
    """
    found = link_tracks(seen)
    looks = sorted(
        (n, k) for k, track in enumerate(found) for n in _handedness_frames(track)
    )  # footage is read forwards
    all_odds = [(k, odds(n, found[k].seen[n])) for n, k in looks]
    for k, track in enumerate(found):
        track.handedness = Handedness(tuple(value for of, value in all_odds if of == k))
    hands = [track for track in found if not track.belongs_to_object(boxes or {})]
    parts = len(found) > len(hands)
    found = _candidate_tracks(hands, side, boxes or {})
    if not found:
        raise UsageError(f"no hand: {OBJECT_PART_NOTE}" if parts else _explain_no_hand(seen, side, boxes is not None))
    often = SIMILAR_TRACK_FRACTION * max(map(_track_confidence, found))
    first = min(found, key=lambda track: (track.distance(boxes or {}), _track_confidence(track) < often, track.bending))
    first = max([first, *filter(first.read_otherwise, found)], key=_track_confidence)
    otherwise = max(map(first.read_otherwise, found))
    majority = side or first.side
    hand, others = _fill_gaps_from_tracks(
        first, _tracks_of_side([track for track in found if track is not first], first.side)
    )
    as_stated = side in (None, first.side)
    mirrored = find_mirrored_frames(hand, majority, odds) if as_stated else []
    before = {n: each for n, each in hand.items() if n not in mirrored}
    hand = again(before, dict.fromkeys(mirrored, first.side))
    sure = first.handedness.sure and not otherwise
    still = find_mirrored_frames(hand, majority, odds, 1.0 if sure else MAX_MIRRORED_FRACTION) if as_stated else []
    most = len(still) >= MAX_MIRRORED_FRACTION * len(
        hand
    )  # a few are of more use than none, where nothing else speaks against them
    mirrored = sorted({*still} - {*before} if most else {*still} & {*mirrored})
    hand, flickering = drop_outlier_sightings({n: each for n, each in hand.items() if n not in mirrored})
    notes = [f"left out: {OBJECT_PART_NOTE}"] * parts + [
        f"a guess: {first.handedness.words}, but the side is stated"
    ] * (not as_stated)
    if boxes is not None:
        apart = first.distance(dict(sorted(boxes.items())[:1]))  # where the object is stated to be
        near = "of the hands that were seen, the one nearest to the object"
        far = f"{near}, but it is far off: is the object's box right?" if apart > MAX_OBJECT_BOX_DISTANCE else near
        notes.append(
            far if np.isfinite(apart) else "the object's box decides nothing: there is no hand about that frame"
        )
    if flickering:
        notes.append(
            f"left out, since they differ from the frames about them: {format_ranges(flickering, counted_from)}"
        )
    if len(before) < MIN_DETECTED_FRACTION * len(hand):
        rest = f"in {format_count(len({*hand} - {*before}), 'frame')} only where it was expected: check those"
        notes.append(f"seen at once in the frames {format_ranges(sorted(before), counted_from)}, {rest}")
    if mirrored:
        notes.append(
            f"left out, since they look like a hand of the other side: {format_ranges(mirrored, counted_from)}"
        )
    if gaps := format_ranges(sorted({*range(len(seen))} - {*hand}), counted_from):
        notes.append(f"no hand in the frames {gaps} (counted from 1)")
    opposite = [track for track in found if track.side != first.side]
    for beside, overrules in ((others, "--object-box"), (opposite, "--object-box or --side")):
        also = {n: [each for track in beside if (each := track.seen.get(n)) and each.apart(hand[n])] for n in hand}
        twice = [n for n in hand if also[n]]
        if len(twice) > SECOND_PERSON_FRACTION * len(hand):
            n, it = twice[0], also[twice[0]][0]
            which = f"chosen is the one {_format_position(hand[n])} in frame {n + counted_from}, not that {_format_position(it)}"
            notes.append(f"two hands in {format_count(len(twice), 'frame')}: {which}; {overrules} overrules this")
    source = measured(f"{side}, as stated") if side else first.handedness.source
    if otherwise:
        source = first.handedness.guess(
            f"in {format_count(otherwise, 'frame')} it also looks like a hand of the other side"
        )
    return HandLandmarks(majority, *_sightings_to_arrays(hand, len(seen)), source, tuple(notes))


def _candidate_tracks(
    found: list[HandTracklet], side: Side | None, boxes: Mapping[int, Float[ndarray, "4"]]
) -> list[HandTracklet]:
    """Return the tracks of a stated side; without one, or of no such side, those that may be the hand."""
    stated = found if side is None else _tracks_of_side(found, side)
    if stated:
        return stated
    # The networks may take a hand seen from behind the object for the other one.
    at_object = [track for track in found if np.isfinite(track.distance(boxes))]
    return at_object or [track for track in found if not track.handedness.sure]


def _handedness_frames(track: HandTracklet) -> list[int]:
    """Choose the frames that decide on a track's side."""
    frames = sorted(track.seen)
    return sorted({frames[i] for i in np.linspace(0, len(frames) - 1, N_HANDEDNESS_FRAMES).round().astype(int)})


def _format_position(hand: Sighting) -> str:
    """Say where a hand is."""
    return "at ({:.0f}, {:.0f})".format(*hand.middle)


def _track_confidence(track: HandTracklet) -> float:
    return sum(each.confidence for each in track.seen.values())


def _tracks_of_side(found: Sequence[HandTracklet], side: Side) -> list[HandTracklet]:
    return [track for track in found if track.side == side]


def _fill_gaps_from_tracks(
    first: HandTracklet, same_side: Sequence[HandTracklet]
) -> tuple[dict[int, Sighting], list[HandTracklet]]:
    """Add tracks that fill the gaps of a track, the longest first; also return the tracks that overlap it."""
    hand, beside = dict(first.seen), []
    for track in sorted(same_side, key=_track_confidence, reverse=True):
        if any(n in hand for n in track.seen):
            beside.append(track)
        else:
            hand |= track.seen
    return dict(sorted(hand.items())), beside


def _explain_no_hand(seen: Sequence[Sequence[Sighting]], side: Side | None, boxed: bool) -> str:
    """Why there is no hand."""
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
