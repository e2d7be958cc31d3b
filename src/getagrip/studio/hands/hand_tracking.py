"""Hands in every frame of a clip: detected in each, and followed from the frames before and after.

A detector misses hands that hold something; a tracker lags behind fast hands and loses blurred ones. If both find a
hand, the sighting of higher network confidence is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from getagrip.studio.hands import palms as hands_palms
from getagrip.studio.hands.networks import Nets
from getagrip.studio.hands.palms import HandCrop

MIN_HAND_CONFIDENCE = 0.5
"""Confidence of a hand."""
HIGH_HAND_CONFIDENCE = 0.75
"""Confidence of a hand tracked from the frame before, below which it is also searched for at detections and from the
frame after."""
RECOVERY_WINDOW_FRAMES = 10
"""Number of frames for which a lost hand is searched for where it was last seen."""
SEARCH_REGION_SCALE, MIN_SEARCH_REGION_FRACTION = 0.9, 0.33
"""Half the side of that search region, in sides of the hand's square, and its least value as a share of the image's
shorter side."""
DETECTOR_FILL_FRACTION = 0.5
"""Share of the detector's input that an image without a palm fills next: it misses hands that fill its input."""
PALM_CROP_TURNS_RAD = (-0.8, 0.8)
"""Angles by which the square about a palm is turned, if no hand is seen in it [rad]."""
DUPLICATE_HAND_DISTANCE = 0.4
"""Distance, in palm sizes, below which two sightings are the same hand."""
MAX_PART_SIZE_RATIO = 0.5
"""Size of what is taken for a hand, as a share of the hand that it is within, below which it is a part of that."""
MAX_LANDMARK_DEVIATION, MAX_GAP_LANDMARK_DEVIATION = 0.25, 0.5
"""Largest distance of landmarks from the median of neighbouring frames, in hand sizes (root mean square), and of those
of a few frames alone in a gap from the straight line between its ends."""
MEDIAN_WINDOW_FRAMES = 3
"""Number of frames before and after for that median, and of the few frames; those so near to each other are no gap."""
MAX_INTERPOLATION_GAP_FRAMES = 30
"""Length of a gap, in frames, beyond which the hand may have been anywhere in it."""
PALM_LANDMARKS = [0, 5, 9, 13, 17]
"""Wrist and knuckles."""

Image = UInt8[ndarray, "H W 3"]


class Sighting(NamedTuple):
    """A hand in a frame."""

    points: Float[ndarray, "21 2"]
    """Wrist, then thumb, index, middle, ring, pinky, each from the palm to the tip [px]."""
    world: Float[ndarray, "21 3"]
    """Landmarks about the hand's middle, along the camera's axes, of a hand of about mean size [m]."""
    confidence: float
    right: float
    """Probability that it is a right hand."""

    @property
    def middle(self) -> Float[ndarray, "2"]:
        """Middle of the palm [px]."""
        return np.asarray(self.points[PALM_LANDMARKS].mean(axis=0))

    @property
    def size(self) -> float:
        """From the wrist to the fingers' middle joints, or across the palm where that is more [px]."""
        across = np.linalg.norm(self.points[5] - self.points[17])
        return max(float(np.linalg.norm(self.points[10] - self.points[0])), 2.0 * float(across), 1.0)

    def same(self, other: Sighting) -> bool:
        """Return whether both are of one hand."""
        return bool(np.linalg.norm(self.middle - other.middle) < DUPLICATE_HAND_DISTANCE * max(self.size, other.size))

    def covers(self, other: Sighting) -> bool:
        """Return whether at least half of the smaller of both outlines is within the other."""
        import cv2

        a, b = (cv2.convexHull(each.points.astype(np.float32)) for each in (self, other))
        return cv2.intersectConvexConvex(a, b)[0] > 0.5 * min(cv2.contourArea(a), cv2.contourArea(b))

    def apart(self, other: Sighting) -> bool:
        """Return whether these are two hands."""
        return not (self.same(other) or self.covers(other))

    def part_of(self, other: Sighting) -> bool:
        """Return whether this is less than half as large as another hand, and within it."""
        low, high = other.points.min(axis=0), other.points.max(axis=0)
        inside = np.all((low <= self.middle) & (self.middle <= high))
        return bool(inside) and self.size < MAX_PART_SIZE_RATIO * other.size


def track_hands(
    image: Callable[[int], Image],
    count: int,
    nets: Nets,
    on_frame: Callable[[int], None] = lambda n: None,
    about: Sequence[HandCrop] = (),
) -> list[list[Sighting]]:
    """Follow the hands over ``count`` frames; return each frame's, the most certain first.

    ``on_frame`` is called before each frame. Small hands are looked for around the squares ``about``, where they are
    expected, until a hand is seen there.
    """
    seen: list[list[Sighting]] = []
    for n in range(count):
        on_frame(n)
        now = image(n)
        expected = _crops_of_hands(seen[-1]) if seen else []
        followed = _detect_in_crops(now, expected, nets)
        known = [crop for crop, hand in zip(expected, followed, strict=True) if hand.confidence >= HIGH_HAND_CONFIDENCE]
        palms = nets.palms(now) or ([] if known else nets.palms(now, DETECTOR_FILL_FRACTION))
        detected = [crop for crop in map(hands_palms.crop_of_palm, palms) if not any(map(crop.near, known))]
        before: list[Sighting] = next((hands for hands in reversed(seen[-RECOVERY_WINDOW_FRAMES:]) if hands), [])
        lost = [crop for crop in _crops_of_hands(before) if not any(map(crop.near, [*known, *detected]))]
        around = [_detect_turned(now, crop, nets) for crop in detected]
        hands = suppress_duplicate_hands(
            [*followed, *around, *_detect_in_crops(now, _detect_palms_nearby(now, lost, nets), nets)]
        )
        about = [each for each in about if not any(_is_seen_at(hand, each) for hand in hands)]
        seen.append(
            suppress_duplicate_hands(
                [*hands, *(_detect_turned(now, crop, nets) for crop in _detect_palms_nearby(now, about, nets))]
            )
        )
    for n in range(count - 2, -1, -1):
        again = [
            each
            for each in seen[n + 1]
            if not any(each.same(old) and old.confidence >= HIGH_HAND_CONFIDENCE for old in seen[n])
        ]
        if again:
            now, where = image(n), _crops_of_hands(again)
            seen[n] = suppress_duplicate_hands(
                [*seen[n], *_detect_in_crops(now, [*where, *_detect_palms_nearby(now, where, nets)], nets)]
            )
    return seen


def _crops_of_hands(hands: Sequence[Sighting]) -> list[HandCrop]:
    return [hands_palms.crop_of_landmarks(each.points) for each in hands]


def _detect_palms_nearby(image: Image, where: Sequence[HandCrop], nets: Nets) -> list[HandCrop]:
    """Detect palms in enlarged parts of an image: the detector sees a whole image at only 192 pixels."""
    out = []
    for crop in where:
        half = max(SEARCH_REGION_SCALE * crop.side, MIN_SEARCH_REGION_FRACTION * min(image.shape[:2]))
        low = np.maximum(np.floor(crop.middle - half), 0).astype(int)
        high = np.minimum(np.ceil(crop.middle + half), image.shape[1::-1]).astype(int)
        if (high - low).min() > hands_palms.HAND_INPUT_PX // 4:
            part = np.ascontiguousarray(image[low[1] : high[1], low[0] : high[0]])
            found = (
                palm._replace(box=palm.box + np.tile(low, 2), points=palm.points + low) for palm in nets.palms(part)
            )
            out += [hands_palms.crop_of_palm(palm) for palm in found]
    return out


def _is_seen_at(hand: Sighting, crop: HandCrop) -> bool:
    """Return whether a hand is surely seen at a square, at most its own size beside it."""
    apart = float(np.abs(hand.middle - crop.middle).max())
    return hand.confidence >= HIGH_HAND_CONFIDENCE and apart < 0.5 * crop.side + hand.size


def _detect_in_crops(image: Image, where: Sequence[HandCrop], nets: Nets) -> list[Sighting]:
    """Find the hands in some squares of an image."""
    return [Sighting(*nets.landmarks(image, crop)) for crop in where]


def _detect_turned(image: Image, crop: HandCrop, nets: Nets) -> Sighting:
    """Find the hand in the square about a palm; where there is none, in that square turned: the detector errs."""
    hand = Sighting(*nets.landmarks(image, crop))
    if hand.confidence >= MIN_HAND_CONFIDENCE:
        return hand
    turned = (Sighting(*nets.landmarks(image, crop._replace(angle=crop.angle + turn))) for turn in PALM_CROP_TURNS_RAD)
    return max([hand, *turned], key=lambda each: each.confidence)


def suppress_duplicate_hands(hands: Sequence[Sighting]) -> list[Sighting]:
    """Choose the most certain sighting of each hand, the most certain first."""
    out: list[Sighting] = []
    for each in sorted(hands, key=lambda hand: -hand.confidence):
        if each.confidence >= MIN_HAND_CONFIDENCE and not any(each.same(other) for other in out):
            out.append(each)
    return out


def drop_outlier_sightings(hand: Mapping[int, Sighting]) -> tuple[dict[int, Sighting], list[int]]:
    """Drop sightings that differ from those about them; also return the frames of the dropped ones."""
    frames = np.array(sorted(hand), int)
    runs = [
        run
        for run in np.split(frames, np.flatnonzero(np.diff(frames) > MEDIAN_WINDOW_FRAMES) + 1)
        if len(run) > MEDIAN_WINDOW_FRAMES
    ]
    within = {n for run in runs for n in run.tolist()}
    kept, out = {}, []
    for n, each in hand.items():
        about = [hand[m].points for m in range(n - MEDIAN_WINDOW_FRAMES, n + MEDIAN_WINDOW_FRAMES + 1) if m in hand]
        before, after = [run[-1] for run in runs if run[-1] < n], [run[0] for run in runs if run[0] > n]
        expected, most = each.points, MAX_LANDMARK_DEVIATION
        if len(about) > MEDIAN_WINDOW_FRAMES:
            expected = np.median(about, axis=0)
        elif n not in within and before and after and after[0] - before[-1] <= MAX_INTERPOLATION_GAP_FRAMES:
            share, most = (n - before[-1]) / (after[0] - before[-1]), MAX_GAP_LANDMARK_DEVIATION
            expected = (1.0 - share) * hand[before[-1]].points + share * hand[after[0]].points
        if float(np.sqrt(np.mean(np.sum((each.points - expected) ** 2, axis=1)))) > most * each.size:
            out.append(n)
        else:
            kept[n] = each
    return kept, out
