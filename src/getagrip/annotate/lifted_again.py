"""Found hands, lifted again once a grasp's masks are known: fingers hardly move, and none is before the background.

At first nothing is known but landmarks, and those of fingers that the object hides are guesses: often the hand is open
beside the object. With the masks, landmarks on the background are left out, those on the object count less, and joints
are kept where something hides or shows them (``hidden_joints``).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray

from getagrip.annotate.labels import OBJECT
from getagrip.clip import HandTrack
from getagrip.clip.reading_arrays import read_hand
from getagrip.clip.writing import write_hand
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.hands.hidden_joints import SIDE, Hiding
from getagrip.hands.lifted_hands import LIFTED, hands_from_landmarks
from getagrip.hands.model import Side
from getagrip.io import arrays
from getagrip.io.terminal import report
from getagrip.provenance import from_arrays, of_provenance

LOOSENESS = 0.08
"""Standard deviation of each number of the fingers' pose from that of the grasp [rad]."""
HIDDEN = 0.25
"""Factor on the confidence of landmarks that lie on the visible object: the network guesses them."""


class LabelMaps:
    """The label maps of a grasp's frames, reduced, as they are made one by one."""

    def __init__(self, size: tuple[int, int]) -> None:
        self.zoom = min(1.0, SIDE / max(size))
        self.small = max(2, round(size[0] * self.zoom)), max(2, round(size[1] * self.zoom))
        self.frames: dict[int, UInt8[ndarray, "h w"]] = {}

    def add(self, frame: int, drawn: UInt8[ndarray, "H W"]) -> None:
        """Keep the map of a frame, from 0."""
        import cv2

        reduced = cv2.resize(drawn, self.small, interpolation=cv2.INTER_NEAREST)
        self.frames[frame] = np.asarray(reduced, np.uint8)

    def at(self, frames: Int[ndarray, "n"]) -> UInt8[ndarray, "n h w"]:
        """Return the maps of some frames; one without a map is empty."""
        none = np.zeros(self.small[::-1], np.uint8)
        return np.array([self.frames.get(int(frame), none) for frame in frames])


def lifted_again(
    hand: HandTrack, frames: Int[ndarray, "n"], K: Float[ndarray, "3 3"], side: Side, maps: LabelMaps
) -> tuple[HandTrack, Int[ndarray, "k"]]:
    """Fit a grasp's hand, of rising ``frames``, to its ``joints_2d`` again; also return the rows that have one.

    Raises ``UsageError`` as ``hands_from_landmarks`` does, and for a hand without ``joints_2d``.
    """
    if hand.joints is None or hand.joints_2d is None or hand.joints_2d_confidence is None:
        raise UsageError("missing joints_2d: the landmarks")
    at, every = frames - frames[0], np.arange(frames[0], frames[-1] + 1)
    points, world = np.full((len(every), 21, 2), np.nan), np.full((len(every), 21, 3), np.nan)
    points[at], world[at] = hand.joints_2d, se3.transform(hand.T_cam_hand, hand.joints)
    drawn = maps.at(every)
    hidden = Hiding.of(drawn != OBJECT, maps.zoom).at(points)[0] > 0.0
    confidence = np.zeros((len(every), 21))
    confidence[at] = hand.joints_2d_confidence * np.where(hidden[at], HIDDEN, 1.0)
    hiding = Hiding.of(drawn > 0, maps.zoom)
    found = hands_from_landmarks(points, confidence, K, side, world, hiding, LOOSENESS)
    kept = np.isin(found.rows, at)
    rows = np.searchsorted(at, np.array(found.rows)[kept])
    lifted = found.hand.take(np.flatnonzero(kept))
    seen, sure = hand.joints_2d[rows], hand.joints_2d_confidence[rows]
    return replace(lifted, joints_2d=seen, joints_2d_confidence=sure), rows


def write_lifted_again(found: Path, out: Path, side: Side, first: int, last: int, maps: LabelMaps) -> None:
    """Write a found hand file to ``out``, its hands lifted again in the frames ``first`` to ``last``, from 0.

    Where they cannot be, they stay as they are, and it is said; an estimator's own hands stay, too. Raises
    ``InputError`` for a malformed file.
    """
    content = arrays.read(found, lambda key: key in {"frames", "K", "side"} or of_provenance(key))
    numbers = arrays.frame_numbers(found, content)
    if numbers is None:
        raise InputError(found, "frames", "no such key", "the numbers of its frames")
    frames = np.array(numbers) - 1
    rows = np.flatnonzero((first <= frames) & (frames <= last))
    hand, frames = read_hand(found, len(numbers)).take(rows), frames[rows]
    try:
        if LIFTED not in str(from_arrays(found, content).get("hands")):
            raise UsageError("they are an estimator's")
        hand, kept = lifted_again(hand, frames, arrays.floats(found, content, "K", (3, 3)), side, maps)
        frames = frames[kept]
    except UsageError as error:
        report(f"hands: as they were found: {error}")
    write_hand(hand, out, content | {"frames": frames + 1})
