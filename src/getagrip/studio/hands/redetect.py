"""A second look at the frames in which a hand was lost or seen otherwise than before, from those that are sure.

In blur the landmark network is as certain of a hand that is turned by half as of the right one, and which of them it
sees depends on the square that it is shown. So runs of frames in which the hand moves steadily are extended frame by
frame, in both directions, by squares where it is expected: of several sizes and angles, of which those are averaged
that show the hand as it was expected.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray

from getagrip.studio.hands import palms
from getagrip.studio.hands.hand_selection import Side, log_odds
from getagrip.studio.hands.hand_tracking import (
    HIGH_HAND_CONFIDENCE,
    MIN_HAND_CONFIDENCE,
    RECOVERY_WINDOW_FRAMES,
    Sighting,
)
from getagrip.studio.hands.networks import Nets
from getagrip.studio.hands.palms import HandCrop

MIN_CONFIDENT_RUN_FRAMES = 6
"""Fewest frames of a run that is sure."""
SEARCH_CROP_SCALES, SEARCH_CROP_ANGLES_RAD = (1.0, 1.4), (-0.5, -0.25, 0.0, 0.25, 0.5)
"""Squares to be looked at: factors of the expected side, and differences from the expected angle [rad]."""
MAX_CROP_ANGLE_RAD, MAX_CROP_SHIFT, MAX_CROP_SCALE_RATIO = 0.6, 0.5, 1.5
"""Largest differences from what is expected: angle [rad], distance in sides of the square, and factor of its side."""
PALM_FLIP_THRESHOLD, PALM_FLIP_FRAMES = 0.4, 3
"""A palm turns over where its area, over the square of its length, changes by more than the first; no hand does so
within as many frames as the second."""
EXPECTED_SHAPE_SIGMA = 0.06
"""Standard deviation of landmarks from those that are expected, in sides of the square (root mean square)."""
CROP_UPDATE_GAIN = 0.2
"""Share of a difference in angle and size that is believed."""
CROP_MOTION_DECAY = 0.5
"""Share of the motion from frame to frame that is expected to go on."""

Image = UInt8[ndarray, "H W 3"]


def redetect_hand(
    image: Callable[[int], Image], hand: Mapping[int, Sighting], count: int, nets: Nets, sides: Mapping[int, Side]
) -> dict[int, Sighting]:
    """Return a hand's sightings in ``count`` frames, those in sure runs as they are; all, if there is no sure run.

    ``sides``: its side in frames in which it was seen as one of the other side. What shows its side counts more there.
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
    for n in sorted({*found[0], *found[1]}):
        each = [part[n] for part in found if n in part]
        out[n] = max(each, key=lambda one: one.confidence)
    return dict(sorted(out.items()))


def _confident_runs(hand: Mapping[int, Sighting]) -> Iterator[list[int]]:
    """Yield the runs of successive frames in which the hand is sure and moves steadily."""
    run: list[int] = []
    for n in sorted(n for n, each in hand.items() if each.confidence >= HIGH_HAND_CONFIDENCE):
        before = hand[run[-1]].points if run else hand[n].points
        turned = any(
            abs(_signed_palm_area(hand[n].points) - _signed_palm_area(hand[m].points)) > PALM_FLIP_THRESHOLD
            for m in run[-PALM_FLIP_FRAMES:]
        )
        if run and (n > run[-1] + 1 or turned or not _is_as_expected(palms.crop_of_landmarks(before), hand[n], before)):
            if len(run) >= MIN_CONFIDENT_RUN_FRAMES:
                yield run
            run = []
        run.append(n)
    if len(run) >= MIN_CONFIDENT_RUN_FRAMES:
        yield run


def _drop_flipped_runs(runs: list[list[int]], hand: Mapping[int, Sighting]) -> list[list[int]]:
    """Leave out the shorter of two neighbouring runs if the palm turns over between them: it sees the hand mirrored."""
    for run in sorted(runs, key=len):
        beside = [other for other in runs if other is not run and len(other) >= len(run)]
        ends = [
            (a[-1], b[0])
            for other in beside
            for a, b in ((run, other), (other, run))
            if 0 < b[0] - a[-1] <= PALM_FLIP_FRAMES
        ]
        if any(
            abs(_signed_palm_area(hand[a].points) - _signed_palm_area(hand[b].points)) > PALM_FLIP_THRESHOLD
            for a, b in ends
        ):
            runs = [one for one in runs if one is not run]
    return runs


def _signed_palm_area(points: Float[ndarray, "21 2"]) -> float:
    """Measure how much of the palm is seen: its area over the square of its length, below 0 from the other side."""
    index, little = points[5] - points[0], points[17] - points[0]
    area = float(index[0] * little[1] - index[1] * little[0])
    return area / max(float(index @ index), float(little @ little), 1e-9)


def _is_as_expected(crop: HandCrop, hand: Sighting, points: Float[ndarray, "21 2"]) -> bool:
    """Return whether a hand is about where and as it is expected, its palm as that of ``points``."""
    own = palms.crop_of_landmarks(hand.points)
    turned = abs((own.angle - crop.angle + np.pi) % (2.0 * np.pi) - np.pi)
    apart = float(np.linalg.norm(own.middle - crop.middle)) / crop.side
    alike = (
        1.0 / MAX_CROP_SCALE_RATIO < own.side / crop.side < MAX_CROP_SCALE_RATIO
        and abs(_signed_palm_area(hand.points) - _signed_palm_area(points)) < PALM_FLIP_THRESHOLD
    )
    return turned < MAX_CROP_ANGLE_RAD and apart < MAX_CROP_SHIFT and alike


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
    """Follow the hand from the end of a run to the next run, or until it is lost for long."""
    ending = [known[n].points for n in range(end - (PALM_FLIP_FRAMES - 1) * step, end + step, step) if n in known]
    path = [palms.crop_of_landmarks(points) for points in ending]
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
            own = palms.crop_of_landmarks(seen.points)
            motion, lost = CROP_MOTION_DECAY * (motion + own.middle - crop.middle), 0
            turned = (own.angle - crop.angle + np.pi) % (2.0 * np.pi) - np.pi
            side, angle = (
                crop.side ** (1.0 - CROP_UPDATE_GAIN) * own.side**CROP_UPDATE_GAIN,
                crop.angle + CROP_UPDATE_GAIN * turned,
            )
            crop = HandCrop(own.middle, float(side), float(angle))
            shape += CROP_UPDATE_GAIN * (crop.from_image(seen.points) - shape)
            out[n] = seen
        n += step
    return out


def _detect_expected(
    image: Image, crop: HandCrop, shape: Float[ndarray, "21 2"], nets: Nets, side: Side | None
) -> Sighting | None:
    """Look where a hand is expected, in a ``shape`` [px of the square]; average what is alike, None without any."""
    squares = [
        crop._replace(side=size * crop.side, angle=crop.angle + turn)
        for size in SEARCH_CROP_SCALES
        for turn in SEARCH_CROP_ANGLES_RAD
    ]
    looks = [Sighting(*nets.landmarks(image, square)) for square in squares]
    looks = [each for each in looks if each.confidence >= MIN_HAND_CONFIDENCE and _is_as_expected(crop, each, shape)]
    if not looks:
        return None
    points = np.array([each.points for each in looks])
    in_square = crop.from_image(points)
    bent = in_square - in_square.mean(axis=1, keepdims=True) - (shape - shape.mean(axis=0))
    off = np.sqrt(np.mean(np.sum(bent**2, axis=-1), axis=-1)) / palms.HAND_INPUT_PX
    confidence = np.array([each.confidence for each in looks])
    weights = confidence * np.exp(-0.5 * (off / EXPECTED_SHAPE_SIGMA) ** 2) + 1e-9
    if side is not None:
        odds = np.array([log_odds(each) for each in looks]) * (1.0 if side == "right" else -1.0)
        weights /= 1.0 + np.exp(-odds)
    mean = [np.average([getattr(each, key) for each in looks], axis=0, weights=weights) for key in ("points", "world")]
    right = float(np.average([each.right for each in looks], weights=weights))
    return Sighting(mean[0], mean[1], float(np.average(confidence, weights=weights)), right)
