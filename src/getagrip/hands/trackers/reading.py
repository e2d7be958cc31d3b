"""Estimators' files to the hand of a clip, checked, with its provenance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

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
    ``InputError`` where there is no such file or hand, two hands in every frame, or none that can be one.
    """
    paths = listed(paths)
    estimates = tracker.read(paths, request)
    if not estimates.hands:
        other = "left" if request.side == "right" else "right"
        given = f"no {request.side} hand in the clip's frames, in {len(paths)} files"
        raise InputError(paths[0], "", given, f"one; or is it the {other} hand that holds the object?")
    once, several = _each_once(estimates.hands, request)
    depths = "; ".join(dict.fromkeys(hand.depth for hand in once))
    estimates = replace(estimates, hands=tuple(once))
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
    if several:
        provenance["hands_chosen"] = (
            f"{several} frames have several {request.side} hands: a guess, the nearest to the hand of the nearest frame"
        )
    return Hands(made, tuple(hand.frame for hand in estimates.hands), provenance)


def _each_once(hands: Sequence[Estimate], request: Request) -> tuple[list[Estimate], int]:
    """One hand in each frame, and in how many frames it was chosen: the nearest to the hand of the nearest frame.

    Frames with one hand come first, then those next to them. Raises ``InputError`` where no frame has just one.
    """
    found: dict[int, list[Estimate]] = {}
    for hand in hands:
        found.setdefault(hand.frame, []).append(hand)
    chosen = {frame: several[0] for frame, several in found.items() if len(several) == 1}
    open_frames = [frame for frame in found if frame not in chosen]
    if not chosen:
        last = found[open_frames[0]][-1]
        given = f"a second hand in frame {request.frames[last.frame]}, and no frame with one"
        raise InputError(last.path, "", given, "one; leave out other people's")
    while left := [frame for frame in open_frames if frame not in chosen]:
        known = np.array(sorted(chosen))
        frame = min(left, key=lambda at: int(np.abs(known - at).min()))
        near = _place(chosen[int(known[np.argmin(np.abs(known - frame))])])
        chosen[frame] = min(found[frame], key=lambda hand: float(np.linalg.norm(_place(hand) - near)))
    return [chosen[frame] for frame in sorted(chosen)], len(open_frames)


def _place(hand: Estimate) -> Float[ndarray, "3"]:
    """Where a hand is before the camera [m]."""
    points = hand.joints if hand.joints is not None else hand.vertices
    if points is not None:
        return np.asarray(points.mean(axis=0))
    return hand.mano.t if hand.mano is not None else np.zeros(3)
