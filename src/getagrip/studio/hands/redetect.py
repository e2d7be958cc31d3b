"""Detect a hand again in frames in which it was lost or flipped, starting from confident frames.

In blur the landmark network is as confident of a hand turned by half a turn as of the true one, depending on the crop.
So runs of frames in which the hand moves steadily are extended frame by frame, in both directions, with crops at the
expected place, of several sizes and angles; the detections that agree with the expected hand are averaged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.studio.hands.hand_selection import Side, log_odds
from getagrip.studio.hands.hand_tracking import (
    HIGH_HAND_CONFIDENCE,
    MIN_HAND_CONFIDENCE,
    RECOVERY_WINDOW_FRAMES,
    Image,
    Sighting,
)
from getagrip.studio.hands.networks import HAND_INPUT_PX, HandCrop, Nets, angle_difference, crop_of_landmarks

MIN_CONFIDENT_RUN_FRAMES = 6
"""Minimum number of frames of a confident run."""
SEARCH_CROP_SCALES, SEARCH_CROP_ANGLES_RAD = (1.0, 1.4), (-0.5, -0.25, 0.0, 0.25, 0.5)
"""Crops at the expected place: factors on the expected side, and differences from the expected angle [rad]."""
MAX_CROP_ANGLE_RAD, MAX_CROP_SHIFT, MAX_CROP_SCALE_RATIO = 0.6, 0.5, 1.5
"""Largest differences from the expected crop: angle [rad], shift in sides of the crop, and factor on its side."""
PALM_FLIP_THRESHOLD, PALM_FLIP_FRAMES = 0.4, 3
"""Change of the palm's area, over the square of its length, above which the palm flips; and number of frames within
which no hand does so."""
EXPECTED_SHAPE_SIGMA = 0.06
"""Standard deviation of landmarks from the expected ones, in sides of the crop (root mean square)."""
CROP_UPDATE_GAIN = 0.2
"""Fraction of a difference in angle and size that is applied to the crop."""
CROP_MOTION_DECAY = 0.5
"""Fraction of the motion from frame to frame that is expected to continue."""


def redetect_hand(
    image: Callable[[int], Image], hand: Mapping[int, Sighting], count: int, nets: Nets, sides: Mapping[int, Side]
) -> dict[int, Sighting]:
    """Detect a hand again in the frames outside confident runs; unchanged without a confident run.

    ``sides`` is the hand's side in frames in which it was seen mirrored: detections of this side count more there.
    """
    sure = [n for run in _drop_flipped_runs([*_confident_runs(hand)], hand) for n in run]
    if not sure:
        return dict(hand)
    out = {n: hand[n] for n in sure}
    found: list[dict[int, Sighting]] = []
    for step in (1, -1):
        ends = [n for n in sure if n + step not in out and 0 <= n + step < count]
        found.append({})
        for end in ends:
            found[-1] |= _extend_run(image, hand, out, end, step, count, nets, sides)
    for n in {*found[0], *found[1]}:
        out[n] = max((part[n] for part in found if n in part), key=lambda one: one.confidence)
    return dict(sorted(out.items()))


def _confident_runs(hand: Mapping[int, Sighting]) -> Iterator[list[int]]:
    """Yield the runs of consecutive frames in which the hand is confident and moves steadily."""
    run: list[int] = []
    for n in sorted(n for n, each in hand.items() if each.confidence >= HIGH_HAND_CONFIDENCE):
        before = hand[run[-1]].points if run else hand[n].points
        flips = any(_is_flipped(hand[n].points, hand[m].points) for m in run[-PALM_FLIP_FRAMES:])
        if run and (n > run[-1] + 1 or flips or not _is_as_expected(crop_of_landmarks(before), hand[n], before)):
            if len(run) >= MIN_CONFIDENT_RUN_FRAMES:
                yield run
            run = []
        run.append(n)
    if len(run) >= MIN_CONFIDENT_RUN_FRAMES:
        yield run


def _drop_flipped_runs(runs: list[list[int]], hand: Mapping[int, Sighting]) -> list[list[int]]:
    """Drop the shorter of two adjacent runs if the palm flips between them: the hand was seen mirrored in it."""
    for run in sorted(runs, key=len):
        pairs = [pair for other in runs if len(other) >= len(run) for pair in ((run, other), (other, run))]
        ends = [(a[-1], b[0]) for a, b in pairs if 0 < b[0] - a[-1] <= PALM_FLIP_FRAMES]
        if any(_is_flipped(hand[a].points, hand[b].points) for a, b in ends):
            runs = [one for one in runs if one is not run]
    return runs


def _is_flipped(one: Float[ndarray, "21 2"], other: Float[ndarray, "21 2"]) -> bool:
    return abs(_signed_palm_area(one) - _signed_palm_area(other)) > PALM_FLIP_THRESHOLD


def _signed_palm_area(points: Float[ndarray, "21 2"]) -> float:
    """Measure the area of the palm over the square of its length, below 0 for the mirror image."""
    index, little = points[5] - points[0], points[17] - points[0]
    area = float(index[0] * little[1] - index[1] * little[0])
    return area / max(float(index @ index), float(little @ little), 1e-9)


def _is_as_expected(crop: HandCrop, hand: Sighting, points: Float[ndarray, "21 2"]) -> bool:
    """Return whether a hand agrees with the expected crop, and its palm with that of ``points``."""
    own = crop_of_landmarks(hand.points)
    turned = abs(angle_difference(own.angle, crop.angle))
    apart = float(np.linalg.norm(own.middle - crop.middle)) / crop.side
    alike = 1.0 / MAX_CROP_SCALE_RATIO < own.side / crop.side < MAX_CROP_SCALE_RATIO
    same_palm = abs(_signed_palm_area(hand.points) - _signed_palm_area(points)) < PALM_FLIP_THRESHOLD
    return turned < MAX_CROP_ANGLE_RAD and apart < MAX_CROP_SHIFT and alike and same_palm


def _extend_run(
    image: Callable[[int], Image],
    hand: Mapping[int, Sighting],
    known: Mapping[int, Sighting],
    end: int,
    step: int,
    count: int,
    nets: Nets,
    sides: Mapping[int, Side],
) -> dict[int, Sighting]:
    """Track the hand from the end of a run to the next run, or until it is lost for ``RECOVERY_WINDOW_FRAMES``."""
    ending = [known[n].points for n in range(end - (PALM_FLIP_FRAMES - 1) * step, end + step, step) if n in known]
    path = [crop_of_landmarks(points) for points in ending]
    shape = np.median([crop.from_image(points) for crop, points in zip(path, ending, strict=True)], axis=0)
    motion = np.zeros(2) if len(path) < 2 else path[-1].middle - path[-2].middle
    crop, lost, out, n = path[-1], 0, dict[int, Sighting](), end + step
    while 0 <= n < count and n not in known and lost < RECOVERY_WINDOW_FRAMES:
        crop = crop._replace(middle=crop.middle + motion)
        as_expected = n in hand and _is_as_expected(crop, hand[n], shape)
        seen = hand[n] if as_expected else _detect_expected(image(n), crop, shape, nets, sides.get(n))
        if seen is None:
            motion, lost = np.zeros(2), lost + 1
        else:
            own = crop_of_landmarks(seen.points)
            motion, lost = CROP_MOTION_DECAY * (motion + own.middle - crop.middle), 0
            side = crop.side ** (1.0 - CROP_UPDATE_GAIN) * own.side**CROP_UPDATE_GAIN
            angle = crop.angle + CROP_UPDATE_GAIN * angle_difference(own.angle, crop.angle)
            crop = HandCrop(own.middle, float(side), float(angle))
            shape += CROP_UPDATE_GAIN * (crop.from_image(seen.points) - shape)
            out[n] = seen
        n += step
    return out


def _detect_expected(
    image: Image, crop: HandCrop, shape: Float[ndarray, "21 2"], nets: Nets, side: Side | None
) -> Sighting | None:
    """Detect a hand expected in a crop, with landmarks ``shape`` [px of the crop]; average agreeing detections.

    None without any.
    """
    turns = [(size, angle) for size in SEARCH_CROP_SCALES for angle in SEARCH_CROP_ANGLES_RAD]
    crops = [crop._replace(side=size * crop.side, angle=crop.angle + turn) for size, turn in turns]
    looks = [Sighting(*nets.landmarks(image, each)) for each in crops]
    looks = [each for each in looks if each.confidence >= MIN_HAND_CONFIDENCE and _is_as_expected(crop, each, shape)]
    if not looks:
        return None
    points = np.array([each.points for each in looks])
    in_crop = crop.from_image(points)
    bent = in_crop - in_crop.mean(axis=1, keepdims=True) - (shape - shape.mean(axis=0))
    off = np.sqrt(np.mean(np.sum(bent**2, axis=-1), axis=-1)) / HAND_INPUT_PX
    confidence = np.array([each.confidence for each in looks])
    weights = confidence * np.exp(-0.5 * (off / EXPECTED_SHAPE_SIGMA) ** 2) + 1e-9
    if side is not None:
        odds = np.array([log_odds(each) for each in looks]) * (1.0 if side == "right" else -1.0)
        weights /= 1.0 + np.exp(-odds)
    mean = [np.average([getattr(each, key) for each in looks], axis=0, weights=weights) for key in ("points", "world")]
    right = float(np.average([each.right for each in looks], weights=weights))
    return Sighting(mean[0], mean[1], float(np.average(confidence, weights=weights)), right)
