"""One hand of a side in each frame, where an estimator found several: the same twice, or somebody else's.

Where the clip has the hand's masks, it is the one of which most is in the mask. Where these do not tell, it is the one
nearest in the image to the hand of the frame before, or of the frame after where none before is known; frames with one
hand are known. Where every frame has several, these are followed from the first frame on, and the one that is largest
in the images is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.hands import generic
from getagrip.hands.model import root_transform
from getagrip.hands.trackers.estimates import Estimate, Request
from getagrip.io.images import read_png
from getagrip.provenance import Source, assumed

COVERED = 0.1
"""So much more of a hand [its points] is in the mask than of any other, where the mask tells which it is."""


def one_each(hands: Sequence[Estimate], request: Request) -> tuple[list[Estimate], Source | None]:
    """Choose one hand in each frame, in the order of frames; also return how, None where there was no choice."""
    found: dict[int, list[Estimate]] = {}
    for hand in hands:
        found.setdefault(hand.frame, []).append(hand)
    frames = sorted(found)
    several = [frame for frame in frames if len(found[frame]) > 1]
    if not several:
        return [found[frame][0] for frame in frames], None
    seen = {frame: [_seen(hand, request) for hand in found[frame]] for frame in frames}
    known = {frame: 0 for frame in frames if len(found[frame]) == 1}
    by_mask = {frame: row for frame in several if (row := _in_mask(seen[frame], frame, request)) is not None}
    known |= by_mask
    reasons = [f"by the hand's mask in {len(by_mask)}"] if by_mask else []
    if len(by_mask) < len(several):
        near = "the nearest to the hand of the frame before or after"
        if not known:
            near = "the largest in the images, followed from frame to frame"
            tracks = [_followed(seen, {frames[0]: row}) for row in range(len(seen[frames[0]]))]
            known = max(tracks, key=lambda rows: float(np.mean([np.ptp(seen[n][rows[n]], axis=0) for n in frames])))
        known = _followed(seen, known)
        reasons.append(f"{near} in {len(several) - len(by_mask)}")
    chosen = f"several {request.side} hands in {len(several)} of {len(frames)} frames, one taken as a guess"
    return [found[frame][known[frame]] for frame in frames], assumed(f"{chosen}: {', '.join(reasons)}")


def _followed(seen: dict[int, list[Float[ndarray, "N 2"]]], known: dict[int, int]) -> dict[int, int]:
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


def _in_mask(seen: Sequence[Float[ndarray, "N 2"]], frame: int, request: Request) -> int | None:
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
    return int(np.argmax(shares)) if best - second > COVERED else None


def _seen(hand: Estimate, request: Request) -> Float[ndarray, "N 2"]:
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
