"""Fit a hand in every frame to a network's 2D landmarks: the fit to clicks, with the errors of networks.

A network makes similar errors in similar frames, so its landmarks are not independent: for the hand's shape and grasp,
all frames together count as one. Otherwise they would outweigh the prior on the hand's size, and the hand would shrink
to a few centimetres in front of the camera. The standard deviation of the errors is estimated from the residuals of a
first fit. The result is smoothed over time.

With masks, landmarks on pixels of neither hand nor object are ignored, and joints are kept off these pixels
(``hidden_joints``).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip import HandTrack
from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.hands import generic
from getagrip.hands.fit_joints import Chains, PosePrior, model_pose
from getagrip.hands.from_2d.clicks import (
    GRASP_POSE_SIGMA_RAD,
    MIN_CLICKED_JOINTS,
    ClickFit,
    ClickUnknowns,
    check_found,
    fit_clicked_hands,
    interpolate_key_hands,
)
from getagrip.hands.from_2d.rigid_pnp import CLICK_SIGMA_M, Clicks, OcclusionDistances
from getagrip.hands.model import Side, hand_track

LIFTED_HANDS_NOTE = "lifted to the generic hand"
"""Provenance of hands made of landmarks alone, which can be fitted to them again."""
LANDMARK_SIGMA_M = 0.009
"""Minimum standard deviation of a landmark, at the hand [m]; used in the first fit."""
SIGMA_PER_RESIDUAL = 3.0
"""Standard deviation of landmarks as a multiple of the first fit's median residual: residuals are smaller than errors.
With a smaller one, fingers and palm follow the errors, and the hand grows and comes nearer (docs/trials.md)."""
MAX_KEY_FRAMES = 24
"""Maximum number of frames fitted from scratch; the others start from interpolated poses."""
MIN_LANDMARK_CONFIDENCE = 0.05
"""Confidence below which a landmark is ignored."""
MAX_LANDMARK_GAP_FRAMES = 10
"""Maximum number of frames without landmarks that are interpolated."""
SMOOTHING_SIGMA_FRAMES = {"place": 2.0, "turn": 3.0, "depth": 4.0}
"""Standard deviations of the smoothing in time [frames]."""


@dataclass(frozen=True)
class LiftedHands:
    """A hand in all frames with landmarks, and in gaps of up to ``MAX_LANDMARK_GAP_FRAMES`` between them."""

    hand: HandTrack
    rows: tuple[int, ...]
    """The frames with a hand."""
    residuals: Float[ndarray, "n 21"]
    """Distance of each joint from its landmark [px]; NaN without one."""
    shape: Float[ndarray, "S"]


def hands_from_landmarks(
    points: Float[ndarray, "T 21 2"],
    confidence: Float[ndarray, "T 21"],
    K: Float[ndarray, "3 3"],
    side: Side,
    depth: Float[ndarray, "T 21"] | None = None,
    hiding: OcclusionDistances | None = None,
    looseness: float = GRASP_POSE_SIGMA_RAD,
) -> LiftedHands:
    """Fit the hand to landmarks [px], in this package's order.

    ``depth`` is the network's depth of each landmark along its ray, up to a plane over the image [m], NaN in frames
    without it; it has a low weight. ``hiding`` are the distances from pixels that can hide joints. ``looseness`` is the
    standard deviation of each pose parameter of the fingers from the mean pose's [rad].

    Raises ``UsageError`` if no frame has ``MIN_CLICKED_JOINTS`` landmarks, or no hand fits them.
    """
    seen = np.isfinite(points).all(axis=-1) & (confidence >= MIN_LANDMARK_CONFIDENCE)
    rows = np.flatnonzero(seen.sum(axis=1) >= MIN_CLICKED_JOINTS)
    if not len(rows):
        most = seen.sum(axis=1).max(initial=0)
        raise UsageError(f"landmarks must be {MIN_CLICKED_JOINTS} at least in some frame (got {most})")
    points_seen = np.where(seen[..., None], points, np.nan)[rows]
    depth_seen = np.full((len(rows), 21), np.nan) if depth is None else depth[rows]
    clicks = _landmarks_to_clicks(K, points_seen, confidence[rows], depth_seen)
    if hiding is not None:
        hiding = hiding.take(rows)
        clicks = _drop_unoccludable_landmarks(clicks, hiding)
    model = generic.load(side)
    chains, prior = Chains.of(model), PosePrior.of(model)

    def fit(some: Int[ndarray, "k"]) -> ClickFit:
        part = Clicks(K, *(each[some] for each in clicks[1:]))
        beside = None if hiding is None else hiding.take(some)
        return ClickFit(model, chains, prior, part, looseness, float(len(some)), beside)

    keys = _choose_key_frames(rows, confidence[rows].mean(axis=1))
    found = fit_clicked_hands(fit(keys))
    check_found(rows[keys].tolist(), found)
    off = float(np.nanmedian(fit(keys).residuals(found) / clicks.noise[keys]))
    clicks = clicks._replace(noise=clicks.noise * max(1.0, SIGMA_PER_RESIDUAL * off))
    found, _ = fit(keys).near(found)
    first, last = int(rows[0]), int(rows[-1])
    T, q = interpolate_key_hands(rows[keys].tolist(), found.T, found.q, first, last)
    start = ClickUnknowns(T[rows - first], q[rows - first], found.grasp, found.shape, chains.wrist)
    every = fit(np.arange(len(rows)))
    found, _ = every.near(start)
    check_found(rows.tolist(), found)
    T, q = interpolate_key_hands(rows.tolist(), *_smooth_hands(rows, found.T, found.q), first, last)
    kept = np.flatnonzero(_bridge_gaps(rows, last - first + 1))
    posed = model.with_shape(found.shape).with_pose(model_pose(q[kept]))
    hand = hand_track(posed, T[kept])
    return LiftedHands(hand, tuple((kept + first).tolist()), every.residuals(found), found.shape)


def _landmarks_to_clicks(
    K: Float[ndarray, "3 3"],
    points: Float[ndarray, "n 21 2"],
    confidence: Float[ndarray, "n 21"],
    depth: Float[ndarray, "n 21"],
) -> Clicks:
    """Convert landmarks to clicks with landmarks' noise, which decreases with confidence."""
    known = np.isfinite(depth).all(axis=1)
    depth = np.where(known[:, None], depth, 0.0)
    clicks, certain = Clicks.of(K, points), np.sqrt(np.clip(confidence, MIN_LANDMARK_CONFIDENCE, 1.0))
    noise = clicks.noise * (LANDMARK_SIGMA_M / CLICK_SIGMA_M) / certain
    return clicks._replace(noise=noise, depth=depth, depth_known=known)


def _drop_unoccludable_landmarks(clicks: Clicks, hiding: OcclusionDistances) -> Clicks:
    """Drop landmarks away from all pixels that could hide them, except in frames that would have too few left."""
    there = clicks.there & (hiding.at(clicks.y)[0] <= clicks.noise)
    enough = there.sum(axis=1) >= MIN_CLICKED_JOINTS
    return clicks._replace(there=np.where(enough[:, None], there, clicks.there))


def _choose_key_frames(rows: Int[ndarray, "n"], confidence: Float[ndarray, "n"]) -> Int[ndarray, "k"]:
    """Return the frame of highest confidence in each of ``MAX_KEY_FRAMES`` equal parts."""
    parts = np.array_split(np.arange(len(rows)), min(MAX_KEY_FRAMES, len(rows)))
    return np.array([part[np.argmax(confidence[part])] for part in parts])


def _bridge_gaps(rows: Int[ndarray, "n"], count: int) -> Bool[ndarray, "T"]:
    """Return which frames from the first to the last row are a row, or in a short gap between two."""
    kept = np.zeros(count, dtype=bool)
    at = rows - rows[0]
    kept[at] = True
    for a, b in pairwise(at):
        if b - a <= MAX_LANDMARK_GAP_FRAMES + 1:
            kept[a:b] = True
    return kept


def _smooth_hands(
    rows: Int[ndarray, "n"], T: Float[ndarray, "n 4 4"], q: Float[ndarray, "n 5 3 3"]
) -> tuple[Float[ndarray, "n 4 4"], Float[ndarray, "n 5 3 3"]]:
    """Smooth by robust local lines with weights that decrease with time: a wrong frame moves no other."""
    t = T[:, :3, 3]
    place = _fit_local_lines(rows, t[:, :2] / t[:, 2:], SMOOTHING_SIGMA_FRAMES["place"])
    z = np.exp(_fit_local_lines(rows, np.log(t[:, 2:]), SMOOTHING_SIGMA_FRAMES["depth"]))
    turn = se3.nearest_rotation(
        _fit_local_lines(rows, T[:, :3, :3].reshape(-1, 9), SMOOTHING_SIGMA_FRAMES["turn"]).reshape(-1, 3, 3)
    )
    bent = _fit_local_lines(rows, q.reshape(len(q), 45), SMOOTHING_SIGMA_FRAMES["turn"]).reshape(q.shape)
    return se3.rigid(turn, np.concatenate([place * z, z], axis=1)), bent


def _fit_local_lines(rows: Int[ndarray, "n"], values: Float[ndarray, "n d"], width: float) -> Float[ndarray, "n d"]:
    """Fit a line around each row, twice, with lower weights for outliers; return the lines' values at the rows."""
    out = values
    apart = (rows[:, None] - rows).astype(float)
    for _ in range(2):
        off = np.linalg.norm(values - out, axis=1)
        robust = 1.0 / (1.0 + (off / max(2.0 * float(np.median(off)), 1e-9)) ** 2)
        w = np.exp(-0.5 * (apart / width) ** 2) * robust
        s0, s1, s2 = w.sum(axis=1), (w * apart).sum(axis=1), (w * apart**2).sum(axis=1)
        line = w * (s2[:, None] - apart * s1[:, None]) / np.maximum(s0 * s2 - s1**2, 1e-12)[:, None]
        alone = s0 * s2 - s1**2 < 1e-6 * s0
        line[alone] = np.eye(len(rows))[alone]
        out = line @ values
    return out
