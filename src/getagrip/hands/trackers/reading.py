"""Estimators' files to the hand of a clip, checked, with its provenance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import HandTrack
from getagrip.clip.plausible import check_in_hand, check_poses
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.hands import generic
from getagrip.hands.model import root_transform
from getagrip.hands.trackers.estimates import ONE_CAMERA_NOTE, Estimate, Estimates, Request
from getagrip.hands.trackers.hand import estimates_to_track
from getagrip.hands.trackers.joint_checks import MAX_JOINT_MISFIT_M
from getagrip.hands.trackers.records import list_record_files
from getagrip.hands.trackers.tracker import Tracker
from getagrip.io import numbers
from getagrip.io.images import read_png
from getagrip.provenance import Provenance, Source, assumed, estimated, join_sources

EXTRAPOLATED_HANDS_KEY = "hands_held"
"""Key of a clip's provenance: frames in which the hand is not known, and stands still."""
CHOSEN_HANDS_KEY = "hands_chosen"
"""Key of a clip's provenance: which hand was taken where there were several."""
MIN_HAND_MASK_MARGIN = 0.1
"""So much more of a hand [its points] is in the mask than of any other, where the mask tells which it is."""


@dataclass(frozen=True)
class TrackedHands:
    """The hand in the frames in which it was found, and where it comes from."""

    track: HandTrack
    found: tuple[int, ...]
    """These frames, rising, as indices into those of the ``Request``."""
    provenance: Provenance
    warnings: tuple[str, ...] = ()
    """Warnings about it, in words."""

    def extrapolate_to_ends(self, frames: Sequence[str]) -> TrackedHands:
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
        known = self.provenance | {EXTRAPOLATED_HANDS_KEY: assumed(guess)}
        return replace(self, track=self.track.take(nearest), found=tuple(rows), provenance=known)


def read_tracked_hands(paths: Sequence[Path], tracker: Tracker, request: Request) -> TrackedHands:
    """Read the hand of one side in some frames of a clip.

    ``paths`` are files, folders of them, or patterns (``out/*.npz``). Raises as ``Tracker.read`` does, and
    ``InputError`` where there is no such file or hand, or none that can be one.
    """
    paths = list_record_files(paths, tracker.layouts)
    with numbers.convert_to_input_errors(paths[0]):
        return _read_estimates(paths, tracker, request)


def _read_estimates(paths: Sequence[Path], tracker: Tracker, request: Request) -> TrackedHands:
    estimates = tracker.read(paths, request)
    if not estimates.hands:
        other = "left" if request.side == "right" else "right"
        got = f"no {request.side} hand in the clip's frames, in {len(paths)} files"
        raise InputError(paths[0], "", got, f"one; or is it the {other} hand that holds the object?")
    hands, chosen = choose_frame_hands(estimates.hands, request)
    depths = join_sources(hand.depth for hand in hands)
    estimates = replace(estimates, hands=tuple(hands))
    made, what = estimates_to_track(estimates, request.mano)
    if any(hand.seen is not None for hand in hands):
        seen = np.array([np.zeros((21, 3)) if hand.seen is None else hand.seen for hand in hands])
        made = replace(made, joints_2d=seen[..., :2], joints_2d_confidence=seen[..., 2])
    first = estimates.hands[0]
    if first.mano is not None:  # a hand fitted to plain joints has a hand's size; whether it is in view, callers check
        check_in_hand(first.path, "betas", made.vertices, "a hand")
        check_poses(first.path, "T_cam_hand", made.T_cam_hand, made.vertices.mean(axis=1), "the hand")
    size = "MANO's shape parameters, as estimated" if request.mano else "the estimator's joints, or the mean hand"
    size_of = assumed if estimates.scale_assumed else estimated
    provenance: Provenance = {
        "hands": estimated(f"{tracker.name}: {what}"),
        "hands_focal": depths,
        "hands_scale": size_of(estimates.scale or f"{size}; {ONE_CAMERA_NOTE}"),
    }
    if chosen:
        provenance[CHOSEN_HANDS_KEY] = chosen
    warnings = tuple(filter(None, [estimates.warning, _joint_misfit_warning(estimates, made)]))
    return TrackedHands(made, tuple(hand.frame for hand in estimates.hands), provenance, warnings)


def _joint_misfit_warning(estimates: Estimates, made: HandTrack) -> str:
    """Words for joints that are far from those of the hand that was fitted to them; empty where they are not."""
    value = [hand.joints for hand in estimates.hands if hand.joints is not None]
    if len(value) < len(estimates.hands) or made.joints is None:
        return ""
    apart = se3.transform(made.T_cam_hand, made.joints) - np.array(value)
    off = float(np.sqrt(np.mean(np.sum(apart**2, axis=-1))))
    causes = "noise, another order, another skeleton, or depths that are not in metres"
    return (
        ""
        if off <= MAX_JOINT_MISFIT_M
        else f"joints {1e3 * off:.1f} mm off every pose of a hand (root mean square): {causes}"
    )


def choose_frame_hands(hands: Sequence[Estimate], request: Request) -> tuple[list[Estimate], Source | None]:
    """Choose one hand in each frame, in the order of frames; also return how, None where there was no choice.

    An estimator may find the same hand twice, or somebody else's.

    Where the clip has the hand's masks, it is the one of which most is in the mask. Where these do not tell, it is the
    one nearest in the image to the hand of the frame before, or of the frame after where none before is known; frames
    with one hand are known. Where every frame has several, these are followed from the first frame on, and the one that
    is largest in the images is taken.
    """
    found: dict[int, list[Estimate]] = {}
    for hand in hands:
        found.setdefault(hand.frame, []).append(hand)
    frames = sorted(found)
    several = [frame for frame in frames if len(found[frame]) > 1]
    if not several:
        return [found[frame][0] for frame in frames], None
    seen = {frame: [_project_hand(hand, request) for hand in found[frame]] for frame in frames}
    known = {frame: 0 for frame in frames if len(found[frame]) == 1}
    by_mask = {frame: row for frame in several if (row := _choose_by_mask(seen[frame], frame, request)) is not None}
    known |= by_mask
    reasons = [f"by the hand's mask in {len(by_mask)}"] if by_mask else []
    if len(by_mask) < len(several):
        near = "the nearest to the hand of the frame before or after"
        if not known:
            near = "the largest in the images, followed from frame to frame"
            tracks = [_propagate_choice(seen, {frames[0]: row}) for row in range(len(seen[frames[0]]))]
            known = max(tracks, key=lambda rows: float(np.mean([np.ptp(seen[n][rows[n]], axis=0) for n in frames])))
        known = _propagate_choice(seen, known)
        reasons.append(f"{near} in {len(several) - len(by_mask)}")
    chosen = f"several {request.side} hands in {len(several)} of {len(frames)} frames, one taken as a guess"
    return [found[frame][known[frame]] for frame in frames], assumed(f"{chosen}: {', '.join(reasons)}")


def _propagate_choice(seen: dict[int, list[Float[ndarray, "N 2"]]], known: dict[int, int]) -> dict[int, int]:
    """Which hand it is in each frame, from the frames in which it is ``known``: on to later ones, then to earlier."""
    rows, frames = dict(known), sorted(seen)
    first = next(n for n, frame in enumerate(frames) if frame in known)
    onwards, back = range(first + 1, len(frames)), range(first - 1, -1, -1)
    for n, step in chain(((n, -1) for n in onwards), ((n, 1) for n in back)):
        frame, beside = frames[n], frames[n + step]
        if frame not in rows:
            at = seen[beside][rows[beside]].mean(axis=0)
            rows[frame] = int(np.argmin([np.linalg.norm(points.mean(axis=0) - at) for points in seen[frame]]))
    return rows


def _choose_by_mask(seen: Sequence[Float[ndarray, "N 2"]], frame: int, request: Request) -> int | None:
    """Return the hand with the largest part in the hand's mask; None where there is no mask, or it does not decide."""
    path = request.hand_masks[frame] if request.hand_masks else None
    if path is None:
        return None
    mask = read_png(path, request.size) != 0
    shares = []
    for points in seen:
        u, v = np.floor(points).astype(int).T
        inside = (u >= 0) & (v >= 0) & (u < request.size[0]) & (v < request.size[1])
        shares.append(float(np.mean(inside & mask[np.where(inside, v, 0), np.where(inside, u, 0)])))
    second, best = sorted(shares)[-2:]
    return int(np.argmax(shares)) if best - second > MIN_HAND_MASK_MARGIN else None


def _project_hand(hand: Estimate, request: Request) -> Float[ndarray, "N 2"]:
    """Project points of a hand to the image [px]: its joints, its surface, or the generic hand's joints."""
    if hand.joints is not None or hand.vertices is not None:
        points = hand.vertices if hand.joints is None else hand.joints
    else:
        assert hand.mano is not None
        shaped = generic.load(request.side).with_shape()
        moved = root_transform(hand.mano.R, hand.mano.t, shaped.joints[0])
        points = se3.transform(moved, shaped.with_pose(hand.mano.pose).joints)
    assert points is not None
    before = np.where(points[:, 2:] > 0, points, [0.0, 0.0, 1.0])
    return np.clip(project(request.K[hand.frame], before), -1e6, 1e6)
