"""The hand's 2D joints against its skeleton, under detectors' errors.

A joint's error in the image is the sum of four, in fractions of the hand's box: a shift of all joints of a frame, an
error of the joint that lasts through the clip, the joint's own error in each frame, and rarely a large one. With r the
difference of joint j's projection in frame n from its 2D point, the cost of a frame [nats] is

    min_d  1/2 |d|^2 / t^2 + sum_j c_j (k + 2)/2 log(1 + |r_j - d|^2 / (k s_j^2)),    s^2 = own^2 + N lasting^2

(Student's t, which large errors hardly move). The lasting error's variance is multiplied by N, so that N frames
together count it once. ``own`` and ``lasting`` are estimated from the clip, t is a fraction of ``own``. Joints in the
object's mask are hidden.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip import least_squares
from getagrip.clip import Clip, HandTrack, Masks
from getagrip.fitting.hand.hand_error_model import AssumedErrors, HandErrors, HandFit
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.hands.bending import BONE_OF_JOINT
from getagrip.io.images import pack_masks
from getagrip.provenance import is_assumed, kind_of_hands

JOINT_STUDENT_T_DOF = 4.0
"""Degrees of freedom of Student's t."""
HIDDEN_JOINT_FACTOR = 2.5
"""Factor on the error of a joint that the object hides."""
COMMON_SHIFT_RATIO = 0.85
"""Shift of all joints of a frame, in ``own``: as measured, if half of the rest is a frame's own
(``results/landmark-errors.json``)."""
INITIAL_JOINT_ERROR, MIN_JOINT_ERROR = 0.03, 0.004
"""Initial value and minimum of the estimated errors [fractions of the hand's box]."""
MASK_MARGIN_FRACTION, MAX_OUTSIDE_MASK_FRACTION = 0.08, 0.3
"""Joint-to-mask distance, as a fraction of the joints' bounding box, above which a joint is an outlier; and fraction of
outliers above which the detection is discarded."""
MAX_LASTING_ERROR, MAX_MISPLACED_ERROR = 0.1, 0.18
"""Maximum lasting error of this hand's joints, and maximum lasting error of the worst joint but one in their right
order: at most 0.16 on training clips; with two fingers exchanged half are above the maximum, and the others do no harm
(docs/trials.md)."""
MAX_JOINT_COORDINATE_PX = 1e6
"""Coordinate from which on a joint counts as invisible [px]."""
N_ERROR_ITERATIONS, ERROR_FIT_STEPS = 2, 12
MAX_SHIFT_ITERATIONS, SHIFT_TOLERANCE = 40, 1e-4
"""Maximum number of iterations for d, and the step that ends them [deviations]."""
ASSUMED_HAND_ERRORS = AssumedErrors.of((0.16, 0.015, 0.06, 0.2), (0.08, 0.006, 0.003, 0.1))
"""Errors of the hand while the joints' are estimated; wide, so that they do not count as the joints'."""


@dataclass(frozen=True)
class SeenJoints:
    """A hand and its 2D joints in N frames.

    Attributes:
        errors: the errors of the hand, which has joints.
        K: (N, 3, 3) intrinsics [px].
        points: (N, 21, 2) the 2D joints [px].
        confidence: (N, 21) weight of each, 0 to 1.
        box: (N, 21) size of the hand's box [px], times ``HIDDEN_JOINT_FACTOR`` for a hidden joint.
        own, lasting: standard deviations [fractions of the box].
        misplaced: lasting error of the worst joint but one [fraction of the box].
    """

    errors: HandErrors
    K: Float[ndarray, "N 3 3"]
    points: Float[ndarray, "N 21 2"]
    confidence: Float[ndarray, "N 21"]
    box: Float[ndarray, "N 21"]
    own: float = INITIAL_JOINT_ERROR
    lasting: float = INITIAL_JOINT_ERROR
    misplaced: float = 0.0

    @staticmethod
    def of(clip: Clip, masks: Masks | None) -> SeenJoints | None:
        """Make them from a clip's joints, their errors estimated; None without joints, or for another hand's.

        ``masks`` are in the same frames; None: no joint counts as hidden.
        """
        hand = clip.hand
        if hand.joints is None or hand.joints_2d is None or hand.joints_2d_confidence is None:
            return None
        visible = (np.abs(hand.joints_2d) < MAX_JOINT_COORDINATE_PX).all(axis=-1)  # not of NaN
        confidence = np.where(visible, hand.joints_2d_confidence, 0.0)
        points = np.where(visible[..., None], hand.joints_2d, 0.0)
        if np.count_nonzero(confidence.any(axis=1)) < 2:
            return None
        if masks is not None and outside_mask_fraction(clip, masks) > MAX_OUTSIDE_MASK_FRACTION:
            return None
        lifted = is_assumed(clip.provenance.get("hands_scale"))  # from these joints, with which it agrees
        loose = kind_of_hands(clip.provenance) == "estimated" and not lifted
        box = np.ptp(_project_joints(clip.K, _joints_in_camera(hand)), axis=1).max(axis=-1)
        hidden = np.zeros(confidence.shape, dtype=bool) if masks is None else _inside_object_masks(masks, points)
        seen = SeenJoints(
            HandErrors.of(hand).with_fingers(sideways=loose), clip.K, points, confidence,
            box[:, None] * np.where(hidden, HIDDEN_JOINT_FACTOR, 1.0),
        )  # fmt: skip
        if not np.isfinite(seen.cost_and_pull(_joints_in_camera(hand))[0]).all():
            return None
        seen = seen.with_sizes_estimated()
        return seen if seen.lasting < MAX_LASTING_ERROR and seen.misplaced < MAX_MISPLACED_ERROR else None

    def take(self, index: Int[ndarray, "n"]) -> SeenJoints:
        """Return the joints at some of the frames."""
        return replace(
            self, errors=self.errors.take(index), K=self.K[index], points=self.points[index],
            confidence=self.confidence[index], box=self.box[index],
        )  # fmt: skip

    @property
    def loose(self) -> bool:
        """True of an estimated hand not lifted from these joints, whose size and fingers may be far off."""
        return self.errors.sideways

    @property
    def rigid(self) -> SeenJoints:
        """The joints of a hand whose fingers stay fixed."""
        return replace(self, errors=replace(self.errors, weights=None))

    @property
    def size(self) -> float:
        """Standard deviation of a joint in a frame, of all its errors [fraction of the hand's box]."""
        return float(np.sqrt((1.0 + COMMON_SHIFT_RATIO**2) * self.own**2 + self.lasting**2))

    def with_sizes_estimated(self) -> SeenJoints:
        """Estimate ``own`` and ``lasting`` from the residuals of a fit of the hand.

        Differences of consecutive frames tell the first, the median of each joint over all frames the second. Residuals
        of a fit of p parameters to m numbers are smaller than the errors, by sqrt(1 - p / m).
        """
        seen, start = self, np.zeros((len(self.K), self.errors.size))
        for _ in range(N_ERROR_ITERATIONS):
            found = least_squares.minimise(HandFit.of(seen, ASSUMED_HAND_ERRORS, start), ERROR_FIT_STEPS).state
            left = (seen.points - _project_joints(seen.K, seen.in_camera(found.errors))) / seen.box[..., None]
            counts = seen.confidence > 0.0
            m = 2.0 * np.count_nonzero(counts) / len(counts)
            free_own = np.trace(_evidence_share(found.H, ASSUMED_HAND_ERRORS.jitter), axis1=1, axis2=2).mean() / m
            free_shared = np.trace(_evidence_share(found.H.sum(axis=0), ASSUMED_HAND_ERRORS.bias)) / m
            both = counts[1:] & counts[:-1]
            own = _robust_deviation((left[1:] - left[:-1])[both]) / np.sqrt(2.0 * max(1.0 - free_own, 0.2))
            each = np.nanmedian(np.where(counts[..., None], left, np.nan)[:, counts.any(axis=0)], axis=0)
            lasting = _robust_deviation(each) / np.sqrt(max(1.0 - free_shared, 0.2))
            of_median = 0.5 * np.pi * own**2 / len(counts)
            lasting = float(np.sqrt(max(lasting**2 - of_median, 0.0)))
            misplaced = float(np.sort(np.linalg.norm(each, axis=-1))[-2:][0])
            own, lasting = max(own, MIN_JOINT_ERROR), max(lasting, MIN_JOINT_ERROR)
            seen = replace(seen, own=own, lasting=lasting, misplaced=misplaced)
        return seen

    def in_camera(self, x: Float[ndarray, "N P"]) -> Float[ndarray, "N 21 3"]:
        """Return the skeleton in the camera frame, with the hand's errors x."""
        joints = self.errors.surface(x)[1]
        assert joints is not None
        return np.asarray(se3.transform(self.errors.T_cam_hand(x), joints))

    def __call__(
        self, x: Float[ndarray, "N P"]
    ) -> tuple[Float[ndarray, "N"], Float[ndarray, "N P"], Float[ndarray, "N P P"]]:
        """Compute the cost of each frame [nats], with gradient and Gauss-Newton Hessian by the hand's errors."""
        joints = self.errors.surface(x)[1]
        assert joints is not None
        X = se3.transform(self.errors.T_cam_hand(x), joints)
        along = projection_jacobian(self.K, X).reshape(len(X), 42, 3)
        errors = self.errors if self.errors.weights is None else replace(self.errors, weights=BONE_OF_JOINT)
        which = np.broadcast_to(np.repeat(np.arange(21), 2), along.shape[:2])
        return self.quadratic(X, errors.jacobian(x, joints, joints, which, along))

    def quadratic(
        self, X: Float[ndarray, "N 21 3"], J: Float[ndarray, "N 42 P"]
    ) -> tuple[Float[ndarray, "N"], Float[ndarray, "N P"], Float[ndarray, "N P P"]]:
        """Return cost, gradient and Gauss-Newton Hessian of joints in the camera, by P numbers that move them by J."""
        value, error, weight, shift = self.cost_and_pull(X)
        flat = np.repeat(weight, 2, axis=1)
        WJ = flat[..., None] * J
        JW = np.swapaxes(WJ, 1, 2)
        g = (JW @ error.reshape(len(X), 42, 1))[..., 0]
        # The frame's shift is eliminated (Schur complement).
        taken = WJ.reshape(len(X), 21, 2, -1).sum(axis=1)
        H = JW @ J - np.swapaxes(taken, 1, 2) @ (taken / (weight.sum(axis=1) + shift**-2.0)[:, None, None])
        return value, g, H

    def cost_and_pull(
        self, X: Float[ndarray, "N 21 3"]
    ) -> tuple[Float[ndarray, "N"], Float[ndarray, "N 21 2"], Float[ndarray, "N 21"], Float[ndarray, "N"]]:
        """Return cost, error [px], weight of the squared error [1/px^2], and deviation of a frame's shift [px]."""
        s2 = self.box**2 * (self.own**2 + len(self.K) * self.lasting**2)
        t = self.box.min(axis=1) * COMMON_SHIFT_RATIO * self.own
        off = _project_joints(self.K, X) - self.points
        d, w = np.zeros((len(X), 2)), self.confidence / s2
        for _ in range(MAX_SHIFT_ITERATIONS):
            d, before = (w[..., None] * off).sum(axis=1) / (w.sum(axis=1) + t**-2.0)[:, None], d
            q = np.sum((off - d[:, None]) ** 2, axis=-1) / s2
            w = self.confidence * (JOINT_STUDENT_T_DOF + 2.0) / (JOINT_STUDENT_T_DOF + q) / s2
            if np.all(np.abs(d - before) < SHIFT_TOLERANCE * t[:, None]):
                break
        tails = np.sum(self.confidence * np.log1p(q / JOINT_STUDENT_T_DOF), axis=1)
        value = 0.5 * np.sum(d**2, axis=1) / t**2 + 0.5 * (JOINT_STUDENT_T_DOF + 2.0) * tails
        return np.where((X[..., 2] > 0.0).all(axis=1), value, np.inf), off - d[:, None], w, t


def outside_mask_fraction(clip: Clip, masks: Masks) -> float:
    """Measure the fraction of joints in the image that lie neither on the hand's nor on the object's mask.

    NaN without joints, or without masks that show the hand.
    """
    hand, hands = clip.hand, masks.ignore if masks.hand is None else masks.hand
    if hand.joints_2d is None or hand.joints_2d_confidence is None:
        return float("nan")
    outside, height, width = [], *masks.object.shape[1:]
    both = pack_masks(hands).frames, pack_masks(masks.object).frames
    frames = zip(hand.joints_2d, hand.joints_2d_confidence, *both, strict=True)
    for joints, confidence, shown, held in frames:
        inside = np.all((joints >= 0.0) & (joints < [width, height]), axis=1)  # not of NaN
        points = joints[(confidence > 0.0) & inside]
        if not shown.area or not len(points):
            continue
        beside = MASK_MARGIN_FRACTION * np.ptp(points, axis=0).max()
        margin, pixels = int(beside) + 2, points.astype(int)
        first = np.maximum(pixels.min(axis=0) - margin, 0)
        last = np.minimum(pixels.max(axis=0) + margin + 1, [width, height])
        box = int(first[0]), int(first[1]), int(last[0]), int(last[1])
        far = cv2.distanceTransform((~(shown.part(box) | held.part(box))).astype(np.uint8), cv2.DIST_L2, 3)
        u, v = (pixels - first).T
        outside += list(far[v, u] > beside)
    return float(np.mean(outside)) if outside else float("nan")


def projection_jacobian(K: Float[ndarray, "N 3 3"], X: Float[ndarray, "N 21 3"]) -> Float[ndarray, "N 21 2 3"]:
    """Differentiate the projection of points by their place in the camera frame [px/m]."""
    z = np.maximum(X[..., 2:, None], 1e-6)
    K = K[:, None, :2]
    return np.asarray((K - (K @ X[..., None]) / z * np.array([0.0, 0.0, 1.0])) / z)


def _project_joints(K: Float[ndarray, "N 3 3"], X: Float[ndarray, "N 21 3"]) -> Float[ndarray, "N 21 2"]:
    """Project points that may be behind the camera, where their cost is infinite."""
    return np.asarray(project(K, np.concatenate([X[..., :2], np.maximum(X[..., 2:], 1e-6)], axis=-1)))


def _joints_in_camera(hand: HandTrack) -> Float[ndarray, "N 21 3"]:
    assert hand.joints is not None
    return np.asarray(se3.transform(hand.T_cam_hand, hand.joints))


def _inside_object_masks(masks: Masks, points: Float[ndarray, "N 21 2"]) -> Bool[ndarray, "N 21"]:
    height, width = masks.object.shape[1:]
    u, v = np.clip(points, 0.0, [width - 1, height - 1]).astype(int).transpose(2, 0, 1)
    return np.stack([mask.at(y, x) for mask, x, y in zip(pack_masks(masks.object).frames, u, v, strict=True)])


def _evidence_share(H: Float[ndarray, "*n P P"], deviation: Float[ndarray, "Q"]) -> Float[ndarray, "*n P P"]:
    """Compute the part of each number that the evidence decides, and not the prior."""
    return np.asarray(np.linalg.solve(H + np.diag(deviation[: H.shape[-1]] ** -2.0), H))


def _robust_deviation(error: Float[ndarray, "n 2"]) -> float:
    """Estimate the standard deviation along each axis, by the median."""
    if not len(error):
        return INITIAL_JOINT_ERROR
    return float(np.median(np.linalg.norm(error, axis=1)) / np.sqrt(2.0 * np.log(2.0)))
