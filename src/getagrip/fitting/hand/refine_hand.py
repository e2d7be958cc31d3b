"""Repair an input hand's tracker glitches, and refine its poses against its silhouette and its 2D joints.

**Glitches** are flips, dropouts and identity swaps. In each frame the hand may be the input hand, or flipped: turned by
half a turn about one of its axes. The frames that are kept, each with one of these four hands, minimise

    sum_(i, j) d(i, j) + price * (number of frames left out) + FLIP * price * (number of flips),

over neighbouring kept frames i < j, with d(i, j) the motion of the hand's surface from i to j (root mean square). So a
frame is left out where the detour through it is longer than the price, and k in a row where the detour is longer than k
prices; a frame whose hand is on the path but for a flip costs less. In frames left out the hand is interpolated.

**Refinement** minimises, over the errors x_n = b + e_n of each frame (``HandErrors``), b the same in all frames,

    PIXEL * sum_n E_n(x_n) + 1/2 |b / bias|^2 + 1/2 sum_n |e_n / jitter|^2

with E_n the pixels in which the hand's silhouette differs from its mask (``HandSilhouette``), and the joints' cost. E
counts area, so that a wrong finger weighs by its length and not by its length squared.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip import least_squares
from getagrip.checks.evidence import Glitches
from getagrip.clip import Clip, HandTrack, Masks
from getagrip.clip.clip import frame_indices
from getagrip.clip.views import View, rows_in_view, views_of
from getagrip.fitting.hand.hand_error_model import (
    N_RIGID_ERRORS,
    ROTATION_ERRORS,
    SIZE_ERROR,
    TRANSLATION_ERRORS,
    AssumedErrors,
    HandErrors,
    HandFit,
)
from getagrip.fitting.hand.hand_silhouette import HandSilhouette
from getagrip.fitting.hand.joint_reprojection import SeenJoints
from getagrip.fitting.motion import PosesInHand, interpolate_object_poses
from getagrip.fitting.options import Options
from getagrip.geometry import se3
from getagrip.provenance import HandsKind, kind_of_hands

MIN_FRAME_PRICE_M = 0.04
"""Minimum price of a frame [m]. On DexYCB's training subjects no true hand makes a detour of more than 5 mm."""
FRAME_PRICE_FACTOR = 4.0
"""Price where hands are fast, in the step from frame to frame that two thirds of the steps exceed."""
END_PRICE_FACTOR, MAX_END_FRAMES = 2.0, 3
"""Price at either end of a clip, in the median of the steps that follow; number of these steps, and maximum number of
frames left out at an end."""
FLIP_PRICE_FRACTION = 0.25
"""Price of a flip, in the price of a frame."""
FLIP_ROTATIONS = se3.exp_so3(np.pi * np.eye(4)[:, 1:])
"""No turn, and half a turn about each of the hand's axes."""
MAX_GLITCH_GAP_FRAMES = 30
"""Maximum number of frames from one kept frame to the next."""
N_GLITCH_POINTS = 16
"""Number of surface points whose motion is measured."""
HAND_PIXEL_WEIGHT = 0.03
"""Weight of a pixel against the prior: thirty pixels, side by side along a contour, count as one observation."""
ASSUMED_ERRORS: Mapping[HandsKind, AssumedErrors] = {
    "measured": AssumedErrors.of((0.08, 0.008, 0.01, 0.2), (0.03, 0.003, 0.003, 0.1), HAND_PIXEL_WEIGHT),
    "estimated": AssumedErrors.of((0.14, 0.008, 0.01, 0.2), (0.08, 0.006, 0.003, 0.1), HAND_PIXEL_WEIGHT),
}
"""Assumed errors that all frames share, and each frame's own, which are taken as independent. Those of estimates from
images are measured (docs/datasets.md), but for the size, without which nothing tells the distance."""
SIZE_SIGMA_WITH_JOINTS = 0.05
"""Standard deviation of the size of an estimated hand with 2D joints; chosen on real ones (docs/trials.md)."""
SHIFT_SIGMA_WITH_VIEWS_M = 0.04
"""Standard deviation of the shift of an estimated hand that all frames share, in any direction, where further views
show its distance [m]: estimates are off by a few centimetres along the camera's ray. Chosen on training clips."""
MIN_CORRECTED_FRACTION = 0.01
"""Minimum fraction of the hand's visible pixels that a refinement must correct; less is noise of masks."""
MIN_JOINT_CORRECTION = 0.01, 0.002
"""Minimum turn [rad] and shift [m] that joints must ask for where pixels ask for none; a hand lifted from the same
joints agrees with them."""
MAX_DIFFERING_FRACTION, MAX_DIFFERING_WITH_JOINTS = 0.25, 0.4
"""Maximum fraction of pixels that differ after refinement; above it the mask is another hand's. With joints that tell
the fingers the maximum is that of the finding ``hand-off-pixels``."""
SUSPECT_JOINTS_FRACTION, JOINTS_CONTRADICTION_FRACTION = 0.12, 0.05
"""Fraction of differing pixels above which joints are suspect, and decrease of the fraction without them above which
they are left out, as another hand's or another camera's."""
MAX_MEASURED_TURN_RAD, MAX_REMAINING_FRACTION = np.radians(4.5), 0.5
"""A hand declared as measured counts as estimated if it is turned by more than the first, and at most the second of its
differing pixels remain [fraction]. On training clips hands of 10 mm and 8 degrees are turned by 4.9 or more,
``moderate`` ones by up to 4.3, and ``strong`` ones leave 36 % at most. Masks that are off by 4 px turn exact hands by
up to 6.2 degrees, but then leave 80 %."""
REFINEMENT_ITERATIONS, RIGID_ITERATIONS_WITH_VIEWS = (10, 8, 3), 30
"""Iterations: without bends; with them, at some of the frames; at all of them. Without bends more with further views,
which bring hands from farther."""
N_FLEXION_FRAMES = 10
"""Number of frames of the second stage."""


def repair_hand(clip: Clip, options: Options) -> tuple[Clip, Glitches | None]:
    """Flip the hand back, or interpolate it, in frames with tracker glitches; also return these frames.

    Where the options leave hands as they are, the clip stays unchanged and no frames (None) are returned. Rotations are
    interpolated along the shortest path, the hand's middle along a line; before the first kept frame and after the last
    the hand has their poses. Vertices stay unchanged.
    """
    if options.hands == "as-given" or options.as_published:
        return clip, None
    kept, flip = frames_without_glitch(clip.hand)
    moved = np.setdiff1d(np.arange(len(clip)), kept[flip == 0])
    if not len(moved) or len(kept) < 2:
        return clip, Glitches((), len(clip))
    T, middle = clip.hand.T_cam_hand.copy(), clip.hand.vertices.mean(axis=(0, 1))
    T[kept[flip > 0]] = (T[kept] @ _flips_about_middle(middle)[flip])[flip > 0]
    left_out = np.setdiff1d(moved, kept)
    known = PosesInHand(T[None, kept, :3, :3], se3.transform(T[kept], middle[None])[None, :, 0], np.ones(1))
    between = interpolate_object_poses(known, kept, left_out)
    T[left_out] = se3.rigid(between.R[0], between.centre[0] - between.R[0] @ middle)
    return clip.with_hand_at(T), Glitches(tuple(clip.frames[n] for n in moved), len(clip))


def frames_without_glitch(hand: HandTrack) -> tuple[Int[ndarray, "n"], Int[ndarray, "n"]]:
    """Return the kept frames, and the index of each one's turn among ``FLIP_ROTATIONS``."""
    steps = _surface_steps(hand)
    if not steps:
        return np.arange(len(hand.T_cam_hand)), np.zeros(len(hand.T_cam_hand), int)
    given = steps[0][:, 0, 0]
    shortest = np.minimum(steps[0][:, 0].min(axis=1), steps[0][:, :, 0].min(axis=1))
    price = max(MIN_FRAME_PRICE_M, FRAME_PRICE_FACTOR * float(np.quantile(shortest, 1 / 3)))
    N, flips = len(given) + 1, FLIP_PRICE_FRACTION * price * np.minimum(np.arange(len(FLIP_ROTATIONS)), 1)
    # Cost of the best choice that ends with a frame and a flip in it: at first, with this frame alone.
    cost = _leading_frames_cost(given, price)[:, None] + flips
    before = np.full((N, len(FLIP_ROTATIONS), 2), -1)
    for n in range(1, N):
        gaps = np.arange(min(n, len(steps)))
        costs = (cost[n - 1 - gaps] + price * gaps[:, None])[:, :, None] + [steps[gap][n - 1 - gap] for gap in gaps]
        for k, through in enumerate(np.moveaxis(costs, 2, 0)):
            gap, flip = np.unravel_index(np.argmin(through), through.shape)
            if through[gap, flip] + flips[k] < cost[n, k]:
                cost[n, k], before[n, k] = through[gap, flip] + flips[k], (n - 1 - gap, flip)
    at_end = cost + _leading_frames_cost(given[::-1], price)[::-1, None]
    kept = [np.array(np.unravel_index(np.argmin(at_end), at_end.shape))]
    while before[*kept[-1]][0] >= 0:
        kept.append(before[*kept[-1]])
    frames, flip = np.array(kept[::-1]).T
    return frames, flip


def _leading_frames_cost(steps: Float[ndarray, "n"], price: float) -> Float[ndarray, "n+1"]:
    """Compute the cost of leaving out all frames before each one.

    An end has no detour, and a hand that comes in fast keeps its first frames. So few frames can be left out, and each
    costs at least ``END_PRICE_FACTOR`` times the steps that follow.
    """
    cost = np.full(len(steps) + 1, np.inf)
    for n in range(min(MAX_END_FRAMES + 1, len(steps))):
        cost[n] = n * max(price, END_PRICE_FACTOR * float(np.median(steps[n : n + MAX_END_FRAMES])))
    return cost


def _surface_steps(hand: HandTrack) -> list[Float[ndarray, "_ 4 4"]]:
    """Compute the motion of the hand's surface [m] from each frame to the next, to the next but one, and so on.

    Each array is (frame, flip in it, flip in the later frame), flips by their index in ``FLIP_ROTATIONS``.
    """
    template = hand.vertices.mean(axis=0)
    some = template[frame_indices(len(template), N_GLITCH_POINTS)]
    posed = se3.transform(hand.T_cam_hand[:, None] @ _flips_about_middle(template.mean(axis=0)), some)
    X = posed.reshape(len(posed), len(FLIP_ROTATIONS), -1) / np.sqrt(len(some))
    squares = np.square(X).sum(axis=-1)

    def steps(gap: int) -> Float[ndarray, "_ 4 4"]:
        between = squares[:-gap, :, None] + squares[gap:, None] - 2.0 * X[:-gap] @ np.swapaxes(X[gap:], 1, 2)
        return np.sqrt(np.maximum(between, 0.0))

    return [steps(gap) for gap in range(1, min(MAX_GLITCH_GAP_FRAMES, len(X) - 1) + 1)]


def _flips_about_middle(middle: Float[ndarray, "3"]) -> Float[ndarray, "4 4 4"]:
    return se3.rigid(FLIP_ROTATIONS, middle - FLIP_ROTATIONS @ middle)


@dataclass(frozen=True)
class HandRefinement:
    """A refined hand.

    Attributes:
        T_cam_hand: (N, 4, 4) its poses.
        turned: mean angle to the input poses [rad].
        moved: mean distance of the hand's middle from its input place [m].
        before, after: fraction of the hand's visible pixels that differ from its silhouette, before and after.
        grown: growth of masks that are too small all round [px of a crop of 128].
        seen: the input hand's errors, and its mask.
        shared: (P,) the errors that all frames share (``HandErrors``).
        own: (N, P) the errors of each frame.
        joints: its 2D joints; None where they are unknown.
        kind: the kind of hand whose errors were assumed; a hand declared as measured may prove to be an estimate.
        views: what further views show of the hand.
    """

    T_cam_hand: Float[ndarray, "N 4 4"]
    turned: float
    moved: float
    before: float
    after: float
    grown: float
    seen: HandSilhouette = field(repr=False)
    shared: Float[ndarray, "P"] = field(repr=False)
    own: Float[ndarray, "N P"] = field(repr=False)
    joints: SeenJoints | None = field(repr=False)
    kind: HandsKind
    views: tuple[HandEvidence, ...] = field(default=(), repr=False)

    def take(self, index: Int[ndarray, "n"]) -> HandRefinement:
        """Return the refinement at some of its frames."""
        return replace(
            self, T_cam_hand=self.T_cam_hand[index], seen=self.seen.take(index), own=self.own[index],
            joints=self.joints and self.joints.take(index), views=tuple(view.take(index) for view in self.views),
        )  # fmt: skip

    def in_view(self, view: View, rows: Int[ndarray, "n"]) -> HandRefinement | None:
        """Return the refinement in some of its frames as a further view shows the hand, by that view's own evidence."""
        seen = next((seen for seen in self.views if seen.view == view.name), None)
        if seen is None or not {*rows} <= {*seen.rows}:
            return None
        seen, T = seen.take(rows), view.T_view_cam[rows]
        return replace(
            self, T_cam_hand=T @ self.T_cam_hand[rows], own=self.own[rows], seen=seen.silhouette, joints=seen.joints,
            views=(),
        )  # fmt: skip

    @property
    def bent(self) -> HandErrors:
        """The rigid errors of the input hand, its fingers bent as refined."""
        errors, x = self.seen.errors, self.shared + self.own
        return replace(errors, tracked=_apply_finger_errors(errors, x), weights=None)

    def with_fingers(self, hand: HandTrack, at: Int[ndarray, "N"]) -> HandTrack:
        """Return a hand with its fingers bent as refined in the frames ``at``, and interpolated between them.

        Fingers stay unchanged without 2D joints that tell them.
        """
        if self.joints is None or not self.joints.loose:
            return hand
        found, every = self.shared + self.own, np.arange(len(hand.T_cam_hand))
        x = np.stack([np.interp(every, at, one) for one in found.T], axis=1)
        return _apply_finger_errors(replace(self.seen.errors, tracked=hand), x)

    def __str__(self) -> str:
        pixels = f"{100 * self.before:.0f} % of its pixels differed, {100 * self.after:.0f} % still do"
        grown = f" (grown by {self.grown:.1f} px: its masks are too small on all sides)" if self.grown else ""
        by = " and ".join(["pixels"] * (not np.isnan(self.before)) + ["joints"] * (self.joints is not None))
        return (
            f"the hand was refined against its own {by}{grown}: turned by {np.degrees(self.turned):.1f} degrees and "
            f"moved by {1e3 * self.moved:.1f} mm on average" + ("" if np.isnan(self.before) else f"; {pixels}")
        )


def _apply_finger_errors(errors: HandErrors, x: Float[ndarray, "N P"]) -> HandTrack:
    """Return a hand with the bends of its errors, without the rigid ones."""
    vertices, joints = errors.surface(np.where(np.arange(x.shape[1]) < N_RIGID_ERRORS, 0.0, x))
    return replace(errors.tracked, vertices=vertices, joints=joints)


@dataclass(frozen=True)
class HandEvidence:
    """A view of the hand: its silhouette and, where they are known, its joints.

    Attributes:
        rows: (n,) the frames that the view shows.
        view: name of the view; empty: the clip's own.
    """

    silhouette: HandSilhouette
    joints: SeenJoints | None
    rows: Int[ndarray, "n"]
    view: str = ""

    @staticmethod
    def of(clip: Clip, masks: Masks) -> list[HandEvidence]:
        """Collect the evidence of the clip's own view, first, and of all further ones that show the hand."""
        everywhere = np.arange(len(clip))
        out = [HandEvidence(HandSilhouette.of(clip, masks), SeenJoints.of(clip, masks), everywhere)]
        for view in views_of(clip):
            rows = np.flatnonzero(view.masks.observed)
            seen, of_view = rows_in_view(clip, view, rows), view.masks.take(rows)
            if len(rows) > 1 and in_front_of_camera(seen):
                one = HandEvidence(HandSilhouette.of(seen, of_view), SeenJoints.of(seen, of_view), rows, view.name)
                out += [one] if one.silhouette.mask.pixels or one.joints is not None else []
        return out

    @property
    def loose(self) -> bool:
        """True where joints tell the size of an estimated hand, and its fingers."""
        return self.joints is not None and self.joints.loose

    def with_fingers(self, sideways: bool) -> HandEvidence:
        """Return the evidence with fingers that may bend, and turn sideways."""
        joints = self.joints and replace(self.joints, errors=self.joints.errors.with_fingers(sideways))
        return replace(self, silhouette=self.silhouette.with_fingers(sideways), joints=joints)

    def with_masks_grown(self) -> HandEvidence:
        """Grow the masks to the size of the input hand's silhouettes, if they are much too small."""
        seen = self.silhouette
        unrefined = np.zeros((len(self.rows), N_RIGID_ERRORS))
        return replace(self, silhouette=seen.with_masks_grown(unrefined)) if seen.mask.pixels else self

    def take(self, index: Int[ndarray, "n"]) -> HandEvidence:
        """Return the evidence in some frames, in rising order."""
        at = np.flatnonzero(np.isin(self.rows, index))
        joints, rows = self.joints and self.joints.take(at), np.searchsorted(index, self.rows[at])
        return HandEvidence(self.silhouette.take(at), joints, rows, self.view)

    def __call__(
        self, x: Float[ndarray, "n P"]
    ) -> tuple[Float[ndarray, "n"], Float[ndarray, "n P"], Float[ndarray, "n P P"]]:
        """Sum the differing pixels of each frame and its joints' cost in pixels; with derivatives."""
        found = self.silhouette(x)
        if self.joints is None:
            return found
        joints = self.joints.rigid if x.shape[1] == N_RIGID_ERRORS else self.joints
        value, g, H = (a + b / HAND_PIXEL_WEIGHT for a, b in zip(found, joints(x), strict=True))
        return value, g, H


def in_front_of_camera(clip: Clip) -> bool:
    """Return whether the hand is before the camera in every frame."""
    return bool((se3.transform(clip.hand.T_cam_hand, clip.hand.vertices)[..., 2] > 0.0).all())


@dataclass(frozen=True)
class _AllViews:
    """The evidence of all views on the errors of a hand in N frames; errors are the hand's, in whichever view."""

    each: tuple[HandEvidence, ...]

    def take(self, index: Int[ndarray, "n"]) -> _AllViews:
        return _AllViews(tuple(one.take(index) for one in self.each))

    def without_joints(self) -> _AllViews:
        return _AllViews(tuple(replace(one, joints=None) for one in self.each))

    def __call__(
        self, x: Float[ndarray, "N P"]
    ) -> tuple[Float[ndarray, "N"], Float[ndarray, "N P"], Float[ndarray, "N P P"]]:
        value, g, H = self.each[0](x)
        for one in self.each[1:]:
            for total, part in zip((value, g, H), one(x[one.rows]), strict=True):
                total[one.rows] += part
        return value, g, H

    def share(self, x: Float[ndarray, "N P"]) -> float:
        """Compute the fraction of the hand's visible pixels that differ from its silhouettes; NaN without any."""
        pixels = sum(one.silhouette.mask.pixels for one in self.each)
        return sum(one.silhouette.differing(x[one.rows]) for one in self.each) / pixels if pixels else float("nan")

    @property
    def has_joints(self) -> bool:
        return any(one.joints is not None for one in self.each)

    @property
    def loose(self) -> bool:
        return any(one.loose for one in self.each)


def assumed_errors(kind: HandsKind, loose: bool, views: int = 1) -> AssumedErrors:
    """Return the assumed errors of a kind of hands.

    ``loose``: 2D joints tell the fingers; ``views``: number of views, of which two show an estimated hand's distance.
    """
    assumed = ASSUMED_ERRORS[kind]
    bias = assumed.bias.copy()
    if loose:
        bias[SIZE_ERROR] = SIZE_SIGMA_WITH_JOINTS
    if kind == "estimated" and views > 1:
        bias[TRANSLATION_ERRORS] = SHIFT_SIGMA_WITH_VIEWS_M
    return replace(assumed, bias=bias)


def refine_hand(clip: Clip, masks: Masks, have_gaps: bool = False) -> tuple[HandRefinement | None, float]:
    """Refine a clip's hand by silhouette and 2D joints; also return the fraction of its visible pixels that differ.

    The refinement is None where neither is known (without pixels the fraction is NaN), where the pixels ask for none,
    and where too many pixels would still differ: they are another hand's, or the hand is too far off. Pixels of the
    hand come from ``masks.hand``, else from the ignored pixels near the input hand. Where the object's masks leave gaps
    the hand's may be too small all round, and are grown first.
    """
    seen = _AllViews(tuple(HandEvidence.of(clip, masks)))
    if not any(one.silhouette.mask.pixels for one in seen.each) and not seen.has_joints:
        return None, float("nan")
    unrefined = np.zeros((len(clip), N_RIGID_ERRORS))
    before = seen.share(unrefined)
    if np.isinf(before):  # behind the camera the hand has no silhouette
        return None, 1.0
    if have_gaps:
        seen = _AllViews(tuple(one.with_masks_grown() for one in seen.each))
        before = seen.share(unrefined)
    if before < MIN_CORRECTED_FRACTION:
        return None, before
    seen = _AllViews(tuple(replace(one, silhouette=one.silhouette.with_field) for one in seen.each))
    kind = kind_of_hands(clip.provenance)
    fitted = _FittedHandErrors.to(seen, kind)
    turned_far = np.linalg.norm(fitted.found.errors[:, ROTATION_ERRORS], axis=1).mean() > MAX_MEASURED_TURN_RAD
    if kind == "measured" and turned_far and not fitted.after > MAX_REMAINING_FRACTION * before:
        fitted = _FittedHandErrors.to(seen, "estimated")
    if seen.has_joints and fitted.after > SUSPECT_JOINTS_FRACTION:
        by_pixels = _FittedHandErrors.to(seen.without_joints(), fitted.kind)
        if fitted.after - by_pixels.after > JOINTS_CONTRADICTION_FRACTION:
            fitted = by_pixels
    found, after, own = fitted.found, fitted.after, fitted.seen.each[0]
    agree = MAX_DIFFERING_WITH_JOINTS if fitted.seen.loose else MAX_DIFFERING_FRACTION
    if after > agree or (before - after < MIN_CORRECTED_FRACTION and not fitted.seen.has_joints):
        return None, before
    errors, T_input = own.silhouette.errors, clip.hand.T_cam_hand
    T, middle = errors.T_cam_hand(found.errors), errors.middle[None]
    turned = se3.angle_between(T[:, :3, :3], T_input[:, :3, :3])
    moved = np.linalg.norm(se3.transform(T, middle) - se3.transform(T_input, middle), axis=-1)
    small = turned.mean() < MIN_JOINT_CORRECTION[0] and moved.mean() < MIN_JOINT_CORRECTION[1]
    if small and not before - after >= MIN_CORRECTED_FRACTION:
        return None, before
    how = float(turned.mean()), float(moved.mean()), before, after, own.silhouette.mask.grown
    refined = HandRefinement(
        T, *how, own.silhouette, found.shared, found.own, own.joints, fitted.kind, fitted.seen.each[1:]
    )
    return refined, after


@dataclass(frozen=True)
class _FittedHandErrors:
    """Fitted errors, the evidence that they meet, and the kind of hand that they were fitted by."""

    found: HandFit
    seen: _AllViews
    kind: HandsKind

    @staticmethod
    def to(seen: _AllViews, kind: HandsKind) -> _FittedHandErrors:
        """Minimise the cost: first by rigid errors alone, since bends, too, could explain a hand that is turned."""
        assumed = assumed_errors(kind, seen.loose, len(seen.each))
        rigid, few, all_frames = REFINEMENT_ITERATIONS
        rigid = RIGID_ITERATIONS_WITH_VIEWS if len(seen.each) > 1 else rigid
        unrefined = np.zeros((len(seen.each[0].rows), N_RIGID_ERRORS))
        found = least_squares.minimise(HandFit.of(seen, assumed, unrefined), rigid).state
        bending = _AllViews(tuple(one.with_fingers(seen.loose) for one in seen.each))
        errors = bending.each[0].silhouette.errors
        if errors.weights is None:
            return _FittedHandErrors(found, seen, kind)
        spare = errors.size - N_RIGID_ERRORS
        shared, own = np.pad(found.shared, (0, spare)), np.pad(found.own, ((0, 0), (0, spare)))
        index = frame_indices(len(own), N_FLEXION_FRAMES)
        some = least_squares.minimise(HandFit.of(bending.take(index), assumed, own[index], shared), few).state
        found = least_squares.minimise(HandFit.of(bending, assumed, own, some.shared), all_frames).state
        return _FittedHandErrors(found, bending, kind)

    @cached_property
    def after(self) -> float:
        """Fraction of the hand's visible pixels that still differ; NaN without any."""
        return self.seen.share(self.found.errors)
