"""Track all hands over a clip: detect them in each frame, and follow them from the frames before and after.

Detectors miss hands with objects; tracking lags behind fast hands and loses blurred ones. If both find a hand, the
sighting of higher confidence is kept.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from getagrip.studio.hands.networks import HAND_INPUT_PX, HandCrop, Nets, crop_of_landmarks, crop_of_palm

MIN_HAND_CONFIDENCE = 0.5
HIGH_HAND_CONFIDENCE = 0.75
"""Confidence of a hand tracked from the frame before, below which it is also searched for at detections and from the
frame after."""
RECOVERY_WINDOW_FRAMES = 10
"""Number of frames for which a lost hand is searched for at its last place."""
SEARCH_REGION_SCALE, MIN_SEARCH_REGION_FRACTION = 0.9, 0.33
"""Half the side of the search region, in sides of the hand's crop, and its minimum as a fraction of the image's shorter
side."""
DETECTOR_FILL_FRACTION = 0.5
"""Fraction of the detector's input that an image without a palm fills in a second attempt, for hands that fill it."""
PALM_CROP_TURNS_RAD = (-0.8, 0.8)
"""Angles by which the crop around a palm is turned, if it shows no hand [rad]."""
DUPLICATE_HAND_DISTANCE = 0.4
"""Distance, in palm sizes, below which two sightings are the same hand."""
MAX_PART_SIZE_RATIO = 0.5
"""Size of a sighting within another hand, as a fraction of that hand's, below which it is a part of the hand."""
MAX_LANDMARK_DEVIATION, MAX_GAP_LANDMARK_DEVIATION = 0.25, 0.5
"""Largest distance of landmarks from the median of adjacent frames, in hand sizes (root mean square), and of isolated
frames in a gap from the line between the gap's ends."""
MEDIAN_WINDOW_FRAMES = 3
"""Number of frames before and after for the median, maximum number of isolated frames, and maximum distance of frames
of one run."""
MAX_INTERPOLATION_GAP_FRAMES = 30
"""Longest gap whose isolated frames are compared with the line [frames]."""
PALM_LANDMARKS = [0, 5, 9, 13, 17]
"""Wrist and knuckles."""

Image = UInt8[ndarray, "H W 3"]


class Sighting(NamedTuple):
    """A hand in a frame."""

    points: Float[ndarray, "21 2"]
    """Wrist, then thumb, index, middle, ring, pinky, each from the palm to the tip [px]."""
    world: Float[ndarray, "21 3"]
    """Landmarks relative to the hand's middle, in the camera's axes, for a hand of mean size [m]."""
    confidence: float
    right: float
    """Probability of a right hand."""

    @property
    def middle(self) -> Float[ndarray, "2"]:
        """Middle of the palm [px]."""
        return np.asarray(self.points[PALM_LANDMARKS].mean(axis=0))

    @property
    def size(self) -> float:
        """Distance from the wrist to the middle finger's middle joint, or twice the palm's width if larger [px]."""
        across = np.linalg.norm(self.points[5] - self.points[17])
        return max(float(np.linalg.norm(self.points[10] - self.points[0])), 2.0 * float(across), 1.0)

    def same(self, other: Sighting) -> bool:
        """Return whether both are sightings of one hand."""
        return bool(np.linalg.norm(self.middle - other.middle) < DUPLICATE_HAND_DISTANCE * max(self.size, other.size))

    def covers(self, other: Sighting) -> bool:
        """Return whether half or more of the smaller outline is within the other."""
        import cv2

        a, b = (cv2.convexHull(each.points.astype(np.float32)) for each in (self, other))
        return cv2.intersectConvexConvex(a, b)[0] > 0.5 * min(cv2.contourArea(a), cv2.contourArea(b))

    def apart(self, other: Sighting) -> bool:
        """Return whether both are sightings of different hands."""
        return not (self.same(other) or self.covers(other))

    def part_of(self, other: Sighting) -> bool:
        """Return whether this sighting is within another one, and less than half as large."""
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
    """Track the hands over ``count`` frames; return the sightings of each frame, by falling confidence.

    ``on_frame`` is called before each frame. Small hands are searched for around the crops ``about`` until a hand is
    seen there.
    """
    seen: list[list[Sighting]] = []
    for n in range(count):
        on_frame(n)
        now = image(n)
        expected = _crops_of_hands(seen[-1]) if seen else []
        followed = _detect_in_crops(now, expected, nets)
        known = [crop for crop, hand in zip(expected, followed, strict=True) if hand.confidence >= HIGH_HAND_CONFIDENCE]
        palms = nets.palms(now) or ([] if known else nets.palms(now, DETECTOR_FILL_FRACTION))
        detected = [crop for crop in map(crop_of_palm, palms) if not any(map(crop.near, known))]
        before: list[Sighting] = next((hands for hands in reversed(seen[-RECOVERY_WINDOW_FRAMES:]) if hands), [])
        lost = [crop for crop in _crops_of_hands(before) if not any(map(crop.near, [*known, *detected]))]
        around = [_detect_turned(now, crop, nets) for crop in detected]
        recovered = _detect_in_crops(now, _detect_palms_nearby(now, lost, nets), nets)
        hands = suppress_duplicate_hands([*followed, *around, *recovered])
        about = [each for each in about if not any(_is_seen_at(hand, each) for hand in hands)]
        small = [_detect_turned(now, crop, nets) for crop in _detect_palms_nearby(now, about, nets)]
        seen.append(suppress_duplicate_hands([*hands, *small]))
    for n in range(count - 2, -1, -1):
        known_hands = [hand for hand in seen[n] if hand.confidence >= HIGH_HAND_CONFIDENCE]
        again = [each for each in seen[n + 1] if not any(map(each.same, known_hands))]
        if again:
            now, where = image(n), _crops_of_hands(again)
            earlier = _detect_in_crops(now, [*where, *_detect_palms_nearby(now, where, nets)], nets)
            seen[n] = suppress_duplicate_hands([*seen[n], *earlier])
    return seen


def _crops_of_hands(hands: Sequence[Sighting]) -> list[HandCrop]:
    return [crop_of_landmarks(each.points) for each in hands]


def _detect_palms_nearby(image: Image, where: Sequence[HandCrop], nets: Nets) -> list[HandCrop]:
    """Detect palms around crops, in enlarged parts of an image: the detector's input has only 192 x 192 pixels."""
    out = []
    for crop in where:
        half = max(SEARCH_REGION_SCALE * crop.side, MIN_SEARCH_REGION_FRACTION * min(image.shape[:2]))
        low = np.maximum(np.floor(crop.middle - half), 0).astype(int)
        high = np.minimum(np.ceil(crop.middle + half), image.shape[1::-1]).astype(int)
        if (high - low).min() > HAND_INPUT_PX // 4:
            for palm in nets.palms(np.ascontiguousarray(image[low[1] : high[1], low[0] : high[0]])):
                out.append(crop_of_palm(palm._replace(box=palm.box + np.tile(low, 2), points=palm.points + low)))
    return out


def _is_seen_at(hand: Sighting, crop: HandCrop) -> bool:
    """Return whether a hand is seen confidently in a crop, or outside it by at most the hand's size."""
    apart = float(np.abs(hand.middle - crop.middle).max())
    return hand.confidence >= HIGH_HAND_CONFIDENCE and apart < 0.5 * crop.side + hand.size


def _detect_in_crops(image: Image, where: Sequence[HandCrop], nets: Nets) -> list[Sighting]:
    return [Sighting(*nets.landmarks(image, crop)) for crop in where]


def _detect_turned(image: Image, crop: HandCrop, nets: Nets) -> Sighting:
    """Detect the hand in the crop around a palm; without a hand, in the turned crop: palms' angles may be wrong."""
    hand = Sighting(*nets.landmarks(image, crop))
    if hand.confidence >= MIN_HAND_CONFIDENCE:
        return hand
    turned = (Sighting(*nets.landmarks(image, crop._replace(angle=crop.angle + turn))) for turn in PALM_CROP_TURNS_RAD)
    return max([hand, *turned], key=lambda each: each.confidence)


def suppress_duplicate_hands(hands: Sequence[Sighting]) -> list[Sighting]:
    """Return the most confident sighting of each hand, by falling confidence."""
    out: list[Sighting] = []
    for each in sorted(hands, key=lambda hand: -hand.confidence):
        if each.confidence >= MIN_HAND_CONFIDENCE and not any(each.same(other) for other in out):
            out.append(each)
    return out


def drop_outlier_sightings(hand: Mapping[int, Sighting]) -> tuple[dict[int, Sighting], list[int]]:
    """Drop sightings that differ from those in adjacent frames; also return the frames of the dropped ones."""
    frames = np.array(sorted(hand), int)
    runs = np.split(frames, np.flatnonzero(np.diff(frames) > MEDIAN_WINDOW_FRAMES) + 1)
    runs = [run for run in runs if len(run) > MEDIAN_WINDOW_FRAMES]
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
