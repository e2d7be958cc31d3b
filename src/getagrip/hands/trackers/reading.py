"""Estimators' files to the hand of a clip, checked, with its provenance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from getagrip.clip import HandTrack
from getagrip.clip.plausible import check_in_hand, check_poses
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.hands.trackers.choosing import one_each
from getagrip.hands.trackers.estimates import ONE_CAMERA, Estimates, Request
from getagrip.hands.trackers.hand import track
from getagrip.hands.trackers.joint_checks import MISFIT
from getagrip.hands.trackers.records import listed
from getagrip.hands.trackers.tracker import Tracker
from getagrip.provenance import Provenance, assumed, estimated, joined

EXTRAPOLATED = "hands_held"
"""Key of a clip's provenance: frames in which the hand is not known, and stands still."""
CHOSEN = "hands_chosen"
"""Key of a clip's provenance: which hand was taken where there were several."""


@dataclass(frozen=True)
class Hands:
    """The hand in the frames in which it was found, and where it comes from."""

    track: HandTrack
    found: tuple[int, ...]
    """These frames, rising, as indices into those of the ``Request``."""
    provenance: Provenance
    warnings: tuple[str, ...] = ()
    """Warnings about it, in words."""

    def extrapolate_to_ends(self, frames: Sequence[str]) -> Hands:
        """Keep the hand still, as an assumption, before the first and after the last frame in which it was found.

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
        known = self.provenance | {EXTRAPOLATED: assumed(guess)}
        return replace(self, track=self.track.take(nearest), found=tuple(rows), provenance=known)


def read(paths: Sequence[Path], tracker: Tracker, request: Request) -> Hands:
    """Read the hand of one side in some frames of a clip.

    ``paths`` are files, folders of them, or patterns (``out/*.npz``). Raises as ``Tracker.read`` does, and
    ``InputError`` where there is no such file or hand, or none that can be one.
    """
    paths = listed(paths)
    estimates = tracker.read(paths, request)
    if not estimates.hands:
        other = "left" if request.side == "right" else "right"
        got = f"no {request.side} hand in the clip's frames, in {len(paths)} files"
        raise InputError(paths[0], "", got, f"one; or is it the {other} hand that holds the object?")
    hands, chosen = one_each(estimates.hands, request)
    depths = joined(hand.depth for hand in hands)
    estimates = replace(estimates, hands=tuple(hands))
    made, what = track(estimates, request.mano)
    if any(hand.seen is not None for hand in hands):
        seen = np.array([np.zeros((21, 3)) if hand.seen is None else hand.seen for hand in hands])
        made = replace(made, joints_2d=seen[..., :2], joints_2d_confidence=seen[..., 2])
    first = estimates.hands[0]
    if first.mano is not None:  # a hand fitted to plain joints has a hand's size; whether it is in view, callers check
        check_in_hand(first.path, "betas", made.vertices, "a hand")
        check_poses(first.path, "T_cam_hand", made.T_cam_hand, made.vertices.mean(axis=1), "the hand")
    size = "MANO's shape parameters, as estimated" if request.mano else "the estimator's joints, or the mean hand"
    provenance: Provenance = {
        "hands": estimated(f"{tracker.name}: {what}"),
        "hands_focal": depths,
        "hands_scale": estimated(estimates.scale or f"{size}; {ONE_CAMERA}"),
    }
    if chosen:
        provenance[CHOSEN] = chosen
    warnings = tuple(filter(None, [estimates.warning, _misfit(estimates, made)]))
    return Hands(made, tuple(hand.frame for hand in estimates.hands), provenance, warnings)


def _misfit(estimates: Estimates, made: HandTrack) -> str:
    """Words for joints that are far from those of the hand that was fitted to them; empty where they are not."""
    value = [hand.joints for hand in estimates.hands if hand.joints is not None]
    if len(value) < len(estimates.hands) or made.joints is None:
        return ""
    apart = se3.transform(made.T_cam_hand, made.joints) - np.array(value)
    off = float(np.sqrt(np.mean(np.sum(apart**2, axis=-1))))
    causes = "noise, another order, another skeleton, or depths that are not in metres"
    return "" if off <= MISFIT else f"joints {1e3 * off:.1f} mm off every pose of a hand (root mean square): {causes}"
