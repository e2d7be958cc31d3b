"""Lift a detected hand again when a grasp's masks are known: fingers hardly move, and no joint lies on the background.

At first only landmarks are known, and landmarks of hidden fingers are guesses: often the hand is open beside the
object. With the masks, landmarks on the background are left out, landmarks on the object count less, and joints stay
within the masks that hide or show them (``hidden_joints``). If many landmarks are on the background or outside the
image, the latter and the network's depths are left out, too.

A left hand and its mirror image in depth, a right hand, have nearly the same landmarks. If the side is a guess, the
object decides: joints hidden by it are farther from the camera than visible ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray

from getagrip.clip import HandTrack
from getagrip.clip.read_arrays import read_hand
from getagrip.clip.timeline import opposite_side
from getagrip.clip.write import write_hand
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.hands.from_2d.clicks import MIN_CLICKED_JOINTS
from getagrip.hands.from_2d.landmarks import hands_from_landmarks
from getagrip.hands.from_2d.rigid_pnp import MAX_DISTANCE_IMAGE_PX, OcclusionDistances
from getagrip.hands.model import Side
from getagrip.io import arrays
from getagrip.io.terminal import format_count, print_note
from getagrip.provenance import (
    Source,
    assumed,
    is_assumed,
    is_provenance_key,
    measured,
    provenance_from_arrays,
    provenance_to_arrays,
)
from getagrip.studio.store.labels import HAND_LABEL, OBJECT_LABEL

JOINTS_DEPTH_KEY = "joints_depth"
"""Key, in files of detected hands, of each joint's depth by the network (``DetectedHands.depth``)."""
OCCLUDED_CONFIDENCE_FACTOR = 0.25
"""Factor on the confidence of landmarks on the visible object, which the network guesses."""
MAX_GUESSED_FRACTION = 0.4
"""Fraction of landmarks on the background or outside the image above which a frame's hand is mostly guessed."""
MIN_DEPTH_ORDER_M = 0.01
"""Minimum distance by which hidden joints are farther than visible ones for the true side, and nearer for the other
[m]."""
MIN_BORDER_DISTANCE = 0.02
"""Minimum distance of these joints from the border of their mask, in sizes of the hand."""
MIN_SIDE_FRAMES, MIN_SIDE_JOINTS = 5, 2
"""Minimum number of frames that decide on a side, and of hidden and of visible joints in each of them."""


class LabelMaps:
    """The label maps of a grasp's frames, at a reduced size."""

    def __init__(self, size: tuple[int, int]) -> None:
        self.size = size
        self.zoom = min(1.0, MAX_DISTANCE_IMAGE_PX / max(size))
        self.small = max(2, round(size[0] * self.zoom)), max(2, round(size[1] * self.zoom))
        self.frames: dict[int, UInt8[ndarray, "h w"]] = {}

    def add(self, frame: int, drawn: UInt8[ndarray, "H W"]) -> None:
        """Add the map of a frame, from 0."""
        import cv2

        reduced = cv2.resize(drawn, self.small, interpolation=cv2.INTER_NEAREST)
        self.frames[frame] = np.asarray(reduced, np.uint8)

    def at(self, frames: Int[ndarray, "n"]) -> UInt8[ndarray, "n h w"]:
        """Return the maps of some frames; frames without a map get an empty one."""
        none = np.zeros(self.small[::-1], np.uint8)
        return np.array([self.frames.get(int(frame), none) for frame in frames])


def relift_hand(
    hand: HandTrack,
    frames: Int[ndarray, "n"],
    K: Float[ndarray, "3 3"],
    side: Side,
    maps: LabelMaps,
    mirrored: bool = False,
    depth_seen: Float[ndarray, "n 21"] | None = None,
) -> tuple[HandTrack, Int[ndarray, "k"]]:
    """Fit a grasp's hand again to its ``joints_2d``; also return the rows of ``frames`` with a hand.

    ``frames`` rise. Depths of joints are the network's ``depth_seen``, else those of ``hand``; ``mirrored`` negates
    them, for a hand of the other side. Raises ``UsageError`` as ``hands_from_landmarks`` does, and for a hand without
    ``joints_2d``.
    """
    if hand.joints is None or hand.joints_2d is None or hand.joints_2d_confidence is None:
        raise UsageError("missing joints_2d: the landmarks")
    at, every = frames - frames[0], np.arange(frames[0], frames[-1] + 1)
    points, depth = np.full((len(every), 21, 2), np.nan), np.full((len(every), 21), np.nan)
    points[at] = hand.joints_2d
    depth_seen = se3.transform(hand.T_cam_hand, hand.joints)[..., 2] if depth_seen is None else depth_seen
    depth[at] = -depth_seen if mirrored else depth_seen
    drawn = maps.at(every)
    hidden = OcclusionDistances.of(drawn != OBJECT_LABEL, maps.zoom).at(points)[0] > 0.0
    hiding = OcclusionDistances.of(drawn > 0, maps.zoom)
    beside = ((points < 0.0) | (points > np.array(maps.size))).any(axis=-1)
    guessed = (beside | (hiding.at(points)[0] > 0.0)).mean(axis=1) > MAX_GUESSED_FRACTION
    depth[guessed] = np.nan
    enough = (~beside).sum(axis=1) >= MIN_CLICKED_JOINTS
    left_out = beside & (guessed & enough)[:, None]
    confidence = np.zeros((len(every), 21))
    confidence[at] = (hand.joints_2d_confidence * np.where(hidden, OCCLUDED_CONFIDENCE_FACTOR, 1.0)[at]) * ~left_out[at]
    found = hands_from_landmarks(points, confidence, K, side, depth, hiding)
    kept = np.isin(found.rows, at)
    rows = np.searchsorted(at, np.array(found.rows)[kept])
    lifted = found.hand.take(np.flatnonzero(kept))
    seen, sure = hand.joints_2d[rows], hand.joints_2d_confidence[rows]
    return replace(lifted, joints_2d=seen, joints_2d_confidence=sure), rows


def joint_depth_order(
    hand: HandTrack, frames: Int[ndarray, "n"], K: Float[ndarray, "3 3"], maps: LabelMaps
) -> tuple[float, int]:
    """Measure how much farther joints hidden by the object are than visible ones [m].

    Returns the mean over the frames with both kinds, and the number of these frames.
    """
    assert hand.joints is not None
    joints, drawn = se3.transform(hand.T_cam_hand, hand.joints), maps.at(frames)
    points = project(K, joints)
    least = MIN_BORDER_DISTANCE * np.ptp(points, axis=1).max(axis=1)[:, None]
    hidden, seen = (
        OcclusionDistances.of(drawn != of, maps.zoom).at(points)[0] > least for of in (OBJECT_LABEL, HAND_LABEL)
    )
    both = np.minimum(hidden.sum(axis=1), seen.sum(axis=1)) >= MIN_SIDE_JOINTS
    if not both.any():
        return 0.0, 0
    behind, before = (np.average(joints[both, :, 2], axis=1, weights=some[both]) for some in (hidden, seen))
    return float(np.mean(behind - before)), int(both.sum())


def decides_side(order: float, frames: int) -> bool:
    """Return whether the result of ``joint_depth_order`` decides on a hand's side."""
    return frames >= MIN_SIDE_FRAMES and abs(order) >= MIN_DEPTH_ORDER_M


def relift_other_side(
    hand: HandTrack,
    frames: Int[ndarray, "n"],
    K: Float[ndarray, "3 3"],
    side: Side,
    maps: LabelMaps,
    off: tuple[float, int],
    depth: Float[ndarray, "n 21"] | None = None,
) -> tuple[HandTrack, Int[ndarray, "k"], Side, Source] | None:
    """Lift a hand as one of the other side, if only that agrees with the joints hidden by the object.

    ``off`` is the hand's ``joint_depth_order``. Returns hand, rows, side and the side's source; None to keep the side.
    """
    if not (decides_side(*off) and off[0] < 0.0):
        return None
    other = opposite_side(side)
    try:
        lifted, rows = relift_hand(hand, frames, K, other, maps, True, depth)
    except UsageError:  # no hand of the other side fits the landmarks
        return None
    better, count = joint_depth_order(lifted, frames[rows], K, maps)
    if not (decides_side(better, count) and better > 0.0):
        return None
    order = f"{1e3 * better:.0f} mm behind its visible joints, those of a {side} hand {-1e3 * off[0]:.0f} mm before"
    reason = f"joints of a {other} hand hidden by the object are {order}, in {format_count(count, 'frame')}"
    source = assumed(f"{other}, a guess, since {reason}; it looks like a {side} one: --side {side} overrules this")
    return lifted, rows, other, source


def write_relifted_hands(found: Path, out: Path, side: Side, numbers: Mapping[int, int], maps: LabelMaps) -> None:
    """Write the hands of a file ``found`` to ``out``, lifted again.

    ``numbers`` are the frame numbers of ``out`` by index from 0; ``found`` counts frames from 1. If the file's side is
    a guess and only the other side agrees with the joints hidden by the object, the hand becomes one of that side.
    Hands of an estimator, and hands that cannot be lifted, stay unchanged. Both are printed as notes. Raises
    ``InputError`` for a malformed file, ``UsageError`` for unchanged hands of another side than ``side``.
    """
    content = arrays.read(found, lambda key: key in {"frames", "K", "side", JOINTS_DEPTH_KEY} or is_provenance_key(key))
    places = arrays.frame_numbers(found, content)
    if places is None:
        raise InputError(found, "frames", "no such key", "the numbers of the hand's frames")
    frames, known = np.array(places) - 1, provenance_from_arrays(found, content)
    depth = arrays.floats(found, content, JOINTS_DEPTH_KEY, (len(places), 21)) if JOINTS_DEPTH_KEY in content else None
    rows = np.flatnonzero(np.isin(frames, [*numbers]))
    hand, frames = read_hand(found, len(places)).take(rows), frames[rows]
    depth = None if depth is None else depth[rows]
    overruled = str(content.get("side", side)) != side
    if overruled:
        known = known | {"hands_side": measured(f"{side}, as stated")}
    try:
        if not is_assumed(known.get("hands_scale")):
            raise UsageError("an estimator's are not lifted again")
        K = arrays.floats(found, content, "K", (3, 3))
        lifted, kept = relift_hand(hand, frames, K, side, maps, overruled, depth)
        off, turned = joint_depth_order(lifted, frames[kept], K, maps), None
        if is_assumed(known.get("hands_side")):
            turned = relift_other_side(hand, frames, K, side, maps, off, depth)
        if turned is not None:
            lifted, kept, side, source = turned
            known = known | {"hands_side": source}
            print_note(f"hands_side: {source}")
        hand, frames = lifted, frames[kept]
    except UsageError as error:
        if overruled:
            raise UsageError(f"the detected hands are not {side} hands: draft again with --side {side}") from error
        print_note(f"hands: unchanged: {error}")
    named = {"frames": np.array([numbers[n] for n in frames.tolist()]), "side": np.array(side)}
    extra = {key: value for key, value in content.items() if key != JOINTS_DEPTH_KEY}
    write_hand(hand, out, extra | provenance_to_arrays(known) | named)
