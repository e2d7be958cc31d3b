"""The side of a hand, left or right, by some of its sightings, and those of their mirror images.

The network is less sure of left hands than of right ones, and of hands whose palm an object hides. Its bias cancels
out, since each sighting is compared with one in the mirror image, where the hand must be one of the other side. What it
says of the side is supported by how it sees the fingers in 3D: they bend towards the palm.

Where the side is known, frames in which the hand is seen as one of the other side are wrong (``find_mirrored_frames``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import groupby
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray

from getagrip.io.terminal import format_count
from getagrip.landmarks import crops
from getagrip.landmarks.following import Sighting
from getagrip.landmarks.nets import Nets
from getagrip.provenance import Source, assumed, estimated

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
    return 0.5 * (log_odds(hand) - log_odds(Sighting(*nets.mirrored(image, crops.crop_of_landmarks(hand.points)))))


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
