"""Joints of a hand triangulated from several calibrated cameras, and a lifted hand moved and scaled to them.

A network sees a joint in each image, and guesses those that are hidden: of the pairs of views of a joint, the one
counts with which most views agree. One view tells neither the size of a hand nor its distance, which triangulated
joints do: the hand gets the median of the frames' best sizes, and in each frame the best pose at this size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.clip import HandTrack
from getagrip.geometry import se3
from getagrip.geometry.camera import backproject, project
from getagrip.hands import generic
from getagrip.hands.fit_joints import fit_joints
from getagrip.hands.model import Side

AGREEMENT_M = 0.02
"""Distance at the hand up to which a view agrees with a triangulated joint [m]."""
MIN_RAY_ANGLE_DEG = 5.0
"""Least angle between the rays of two views that tell a distance."""
MIN_CONFIDENCE = 0.3
"""Confidence of a joint in an image below which the view does not count for it."""
MIN_ALIGNED_JOINTS = 6
"""Least number of triangulated joints to which the hand is moved in a frame."""
HAND_SIZE_RANGE = 0.6, 1.6
"""Range of the factor on the size of a mean hand; others are errors of the cameras."""
N_ALIGNMENTS, ROBUST_SIGMA_M = 5, 0.012
"""Number of alignments, each with lower weights for joints that are off, and the distance at which they halve [m]."""


@dataclass(frozen=True)
class SeenJoints:
    """The joints of the hand in the images of one camera, in T frames.

    Attributes:
        points: (T, 21, 2) joints [px].
        confidence: (T, 21) from 0 (not seen) to 1.
        K: (T, 3, 3) intrinsics [px].
        T_cam: (T, 4, 4) pose of the camera in the common frame [m].
    """

    points: Float[ndarray, "T 21 2"]
    confidence: Float[ndarray, "T 21"]
    K: Float[ndarray, "T 3 3"]
    T_cam: Float[ndarray, "T 4 4"]

    @property
    def counted(self) -> Bool[ndarray, "T 21"]:
        """True for the joints that are seen well enough to count."""
        return (self.confidence >= MIN_CONFIDENCE) & np.isfinite(self.points).all(axis=-1)

    @property
    def rays(self) -> Float[ndarray, "T 21 3"]:
        """Unit directions of the joints from the camera, in the common frame."""
        along = backproject(self.K, self.points) @ np.swapaxes(self.T_cam[:, :3, :3], 1, 2)
        return np.asarray(along / np.linalg.norm(along, axis=-1, keepdims=True))

    def agrees(self, X: Float[ndarray, "T 21 3"]) -> Bool[ndarray, "T 21"]:
        """Return where points in the common frame [m] are where the camera sees the joints."""
        seen = se3.transform(se3.inverse(self.T_cam), np.nan_to_num(X))
        z = seen[..., 2]
        before = z > 0.0
        seen[~before] = [0.0, 0.0, 1.0]
        off = np.linalg.norm(project(self.K, seen) - self.points, axis=-1) / self.K[:, None, 0, 0] * z
        return np.asarray(self.counted & before & np.isfinite(X).all(axis=-1) & (off < AGREEMENT_M))


def triangulate_joints(views: Sequence[SeenJoints]) -> Float[ndarray, "T 21 3"]:
    """Return the joints in the common frame [m]; NaN where no two views agree on one."""
    shape = views[0].confidence.shape
    best, most = np.full((*shape, 3), np.nan), np.zeros(shape)
    for pair in combinations(views, 2):
        apart = np.degrees(np.arccos(np.clip(np.sum(pair[0].rays * pair[1].rays, axis=-1), -1.0, 1.0)))
        usable = pair[0].counted & pair[1].counted & (np.minimum(apart, 180.0 - apart) > MIN_RAY_ANGLE_DEG)
        X = _nearest_points(pair, np.array([usable, usable]))
        agreeing = np.array([one.agrees(X) for one in views])
        enough = usable & (agreeing.sum(axis=0) >= 2)
        count = np.where(enough, (agreeing * [one.confidence for one in views]).sum(axis=0), 0.0)
        X = _nearest_points(views, agreeing & enough)
        better = count > most
        best[better], most = X[better], np.maximum(most, count)
    return best


def _nearest_points(views: Sequence[SeenJoints], of: Bool[ndarray, "C T 21"]) -> Float[ndarray, "T 21 3"]:
    """Return the points nearest to the rays of some views, by their confidence; NaN of fewer than two."""
    A, b = np.zeros((*of.shape[1:], 3, 3)), np.zeros((*of.shape[1:], 3))
    for view, some in zip(views, of, strict=True):
        rays = np.nan_to_num(view.rays)
        across = np.eye(3) - rays[..., None] * rays[..., None, :]
        weight = np.where(some, view.confidence, 0.0)[..., None, None]
        A += weight * across
        b += (weight * across @ view.T_cam[:, None, :3, 3:])[..., 0]
    known = of.sum(axis=0) >= 2
    A[~known] = np.eye(3)
    X = np.linalg.solve(A, b[..., None])[..., 0]
    X[~known] = np.nan
    return X


@dataclass(frozen=True)
class AlignedHand:
    """A hand, moved and scaled to triangulated joints.

    Attributes:
        hand: the hand.
        scale: the factor on its size.
        aligned: (T,) frames with enough joints; in the others, only its size and distance change.
        moved: (T,) how far its middle moved [m].
    """

    hand: HandTrack
    scale: float
    aligned: Bool[ndarray, "T"]
    moved: Float[ndarray, "T"]


def align_hand(hand: HandTrack, X: Float[ndarray, "T 21 3"]) -> AlignedHand | None:
    """Move and scale a hand to joints in the camera frame [m], NaN where unknown; None without enough of them.

    In a frame with few joints the hand is scaled about the camera, so that its image stays.
    """
    if hand.joints is None:
        return None
    known = np.isfinite(X).all(axis=-1)
    aligned = known.sum(axis=1) >= MIN_ALIGNED_JOINTS
    if not aligned.any():
        return None
    fits = {n: _best_similarity(hand.joints[n, known[n]], X[n, known[n]]) for n in np.flatnonzero(aligned)}
    scale = float(np.median([fit[0] for fit in fits.values()]))
    if not HAND_SIZE_RANGE[0] <= scale <= HAND_SIZE_RANGE[1]:
        return None
    T = hand.T_cam_hand.copy()
    T[:, :3, 3] *= scale
    for n, (_, w) in fits.items():
        T[n] = _best_pose(scale * hand.joints[n, known[n]], X[n, known[n]], w)
    moved = replace(hand, vertices=scale * hand.vertices, joints=scale * hand.joints, T_cam_hand=T)
    middle = hand.vertices.mean(axis=1, keepdims=True)
    was, now = se3.transform(hand.T_cam_hand, middle), se3.transform(T, scale * middle)
    return AlignedHand(moved, scale, aligned, np.linalg.norm(now - was, axis=-1)[:, 0])


def refit_fingers(hand: HandTrack, X: Float[ndarray, "T 21 3"], side: Side) -> HandTrack:
    """Fit the generic hand to joints in the camera frame [m], where unknown (NaN) to those of an aligned hand.

    Fingers as one view shows them are guesses along its rays. The joints in the images stay.
    """
    assert hand.joints is not None
    joints = np.where(np.isfinite(X).all(axis=-1, keepdims=True), X, se3.transform(hand.T_cam_hand, hand.joints))
    fitted = fit_joints(generic.load(side), joints, "openpose").hand
    return replace(fitted, joints_2d=hand.joints_2d, joints_2d_confidence=hand.joints_2d_confidence)


def _best_similarity(X: Float[ndarray, "n 3"], Y: Float[ndarray, "n 3"]) -> tuple[float, Float[ndarray, "n"]]:
    """Return the scale of the robust similarity from X to Y, and the weights of the points."""
    w, scale = np.ones(len(X)), 1.0
    for _ in range(N_ALIGNMENTS):
        T = _best_pose(X, Y, w)
        mean_X, mean_Y = (np.average(each, axis=0, weights=w) for each in (X, Y))
        turned = (X - mean_X) @ T[:3, :3].T
        scale = float((w[:, None] * turned * (Y - mean_Y)).sum() / (w[:, None] * turned**2).sum())
        off = np.linalg.norm(scale * turned + mean_Y - Y, axis=1)
        w = 1.0 / (1.0 + (off / ROBUST_SIGMA_M) ** 2)
    return scale, w


def _best_pose(X: Float[ndarray, "n 3"], Y: Float[ndarray, "n 3"], w: Float[ndarray, "n"]) -> Float[ndarray, "4 4"]:
    """Return the rigid motion from X to Y of least weighted squares."""
    mean_X, mean_Y = (np.average(each, axis=0, weights=w) for each in (X, Y))
    R = se3.nearest_rotation((w[:, None] * (Y - mean_Y)).T @ (X - mean_X))
    return np.asarray(se3.rigid(R, mean_Y - R @ mean_X))
