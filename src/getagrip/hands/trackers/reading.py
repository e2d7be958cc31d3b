"""Estimators' files to the hand of a clip, checked, with its provenance."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from getagrip.clip import HandTrack
from getagrip.clip.plausible import check_in_hand, check_poses
from getagrip.errors import InputError
from getagrip.hands.trackers.estimates import ONE_CAMERA, Estimate, Request
from getagrip.hands.trackers.hand import track
from getagrip.hands.trackers.records import listed
from getagrip.hands.trackers.tracker import Tracker

HELD = "hands_held"
"""Key of a clip's provenance: frames in which the hand is not known, and stands still."""


@dataclass(frozen=True)
class Hands:
    """The hand in the frames in which it was found, and where it comes from."""

    track: HandTrack
    found: tuple[int, ...]
    """These frames, rising, as indices into those of the ``Request``."""
    provenance: dict[str, str]

    def held_at_ends(self, frames: Sequence[str]) -> Hands:
        """The hand stands still, as a guess, before the first and after the last frame in which it was found.

        ``frames`` are the names of those of the ``Request``. Frames between two hands stay without one.
        """
        first, last = self.found[0], self.found[-1]
        ends = [end for end in (range(first), range(last + 1, len(frames))) if end]
        if not ends:
            return self
        rows = sorted({*self.found, *(row for end in ends for row in end)})
        nearest = np.searchsorted(self.found, np.clip(rows, first, last))
        where = " and ".join(f"{frames[end[0]]} to {frames[end[-1]]}" for end in ends)
        guess = f"a guess in the frames {where}, which have none: the hand of the nearest frame that has one"
        return Hands(self.track.take(nearest), tuple(rows), self.provenance | {HELD: guess})


def read(paths: Sequence[Path], tracker: Tracker, request: Request) -> Hands:
    """The hand of one side in some frames of a clip.

    ``paths`` are files, folders of them, or patterns (``out/*.npz``). Raises as ``Tracker.read`` does, and
    ``InputError`` where there is no such file or hand, two hands in a frame, or none that can be one.
    """
    paths = listed(paths)
    estimates = tracker.read(paths, request)
    if not estimates.hands:
        other = "left" if request.side == "right" else "right"
        given = f"no {request.side} hand in the clip's frames, in {len(paths)} files"
        raise InputError(paths[0], "", given, f"one; or is it the {other} hand that holds the object?")
    _check_each_once(estimates.hands, request)
    depths = "; ".join(dict.fromkeys(hand.depth for hand in estimates.hands))
    estimates = replace(estimates, hands=tuple(sorted(estimates.hands, key=lambda hand: hand.frame)))
    made, what = track(estimates, request.mano)
    first = estimates.hands[0]
    if first.mano is not None:  # a hand fitted to plain joints has a hand's size; whether it is in view, callers check
        check_in_hand(first.path, "betas", made.vertices, "a hand")
        check_poses(first.path, "T_cam_hand", made.T_cam_hand, made.vertices.mean(axis=1), "the hand")
    size = "MANO's shape parameters, as estimated" if request.mano else "the estimator's joints, or the mean hand"
    provenance = {
        "hands": f"{tracker.name}: {what}",
        "hands_focal": depths,
        "hands_scale": estimates.scale or f"{size}; {ONE_CAMERA}",
    }
    return Hands(made, tuple(hand.frame for hand in estimates.hands), provenance)


def _check_each_once(hands: Sequence[Estimate], request: Request) -> None:
    """Raise ``InputError`` for two hands in a frame."""
    twice = next((frame for frame, count in Counter(hand.frame for hand in hands).items() if count > 1), None)
    if twice is not None:
        last = next(hand for hand in reversed(hands) if hand.frame == twice)
        given = f"a second hand in frame {request.frames[twice]}"
        raise InputError(last.path, "", given, "one; leave out other people's")
