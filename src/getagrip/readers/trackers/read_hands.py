"""The hand of a clip from a tracker's files: ``read_tracked_hands``, with the hand's provenance.

Three steps: plain joints are checked for their order, side and position before the camera; parameters or joints become
a surface, MANO's where the user has MANO's files, else the generic hand's; of several hands in a frame, one is chosen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import HandTrack
from getagrip.clip.read_arrays import check_in_hand, check_poses
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.hands import generic, mano
from getagrip.hands.fit_joints import JOINT_ORDERS, JointOrder, JointsError, fit_joints
from getagrip.hands.model import (
    ORDER_21,
    HandModel,
    PosedHand,
    Side,
    hand_track,
    mirrored,
    mirrored_model,
    mirrored_pose,
    root_transform,
)
from getagrip.io import arrays
from getagrip.io.images import read_mask
from getagrip.provenance import EXTRAPOLATED_HANDS_KEY, Provenance, Source, assumed, estimated, join_sources
from getagrip.readers.datasets.mano_tracks import load_mano_hand
from getagrip.readers.trackers.estimates import ONE_CAMERA_NOTE, OPPOSITE_SIDE, Estimate, Estimates, Request
from getagrip.readers.trackers.records import list_record_files
from getagrip.readers.trackers.tracker import Tracker

Order = Literal[JointOrder, "auto"]

MAX_JOINT_MISFIT_M = 0.010
"""Maximum distance of joints from the nearest pose of a hand [m, root mean square]. Datasets' joints are 2 mm off,
joints with noise of 10 mm 12 mm off, joints in another order 30 mm and more."""
EXACT_JOINT_MISFIT_M = 0.003
"""Joint misfit below which other orders and sides are not tried [m, root mean square]."""
CERTAIN_MISFIT_RATIO, POSSIBLE_MISFIT_RATIO = 0.5, 0.85
"""Ratios of another order's or side's misfit to the stated one's below which it is certainly, or possibly, right."""
MIN_JOINT_DISTANCE_M = 0.05
"""Minimum distance of a joint from the camera [m]."""
N_ORDER_TEST_FRAMES = 5
"""Number of frames in which orders and sides are tried."""


class Ordered(NamedTuple):
    """Joints in this package's order."""

    joints: Float[ndarray, "T 21 3"]
    chosen: str
    """How the order was chosen, in words; empty for a stated order."""
    warning: str
    """A warning about the joints, in words; empty without one."""


def check_before_camera(path: Path, joints: Float[ndarray, "T 21 3"]) -> None:
    """Raise ``InputError`` for hands behind or around the camera, as of joints relative to the wrist."""
    z, nearest = joints[..., 2].mean(axis=1), np.linalg.norm(joints, axis=-1).min(axis=1)
    wrong = (z <= 0) | (nearest < MIN_JOINT_DISTANCE_M)
    if wrong.any():
        row = int(np.argmax(wrong))
        where = f"{-z[row]:.2g} m behind the camera" if z[row] <= 0 else f"{nearest[row]:.2g} m from the camera"
        expected = "joints before the camera, z forward [m]; are these relative to the wrist or to the hand's middle?"
        raise InputError(path, "joints", f"a hand {where} in row {row}", expected)


def reorder_joints(path: Path, joints: Float[ndarray, "T 21 3"], order: Order, side: Side) -> Ordered:
    """Return joints (T, 21, 3) [m] in this package's order, from a stated order or, ``auto``, the best-fitting one.

    Raises ``InputError`` for joints that fit another order or the other side clearly better.
    """
    some = joints[np.unique(np.linspace(0, len(joints) - 1, N_ORDER_TEST_FRAMES).astype(int))]
    if order == "auto":
        fits = sorted((joint_misfit(some, each, side), each) for each in JOINT_ORDERS)
        (best, order), (second, other) = fits[:2]
        both = f"joints {_mm(best)} off a {side} hand as {order}, {_mm(second)} as {other}"
        if best > min(2 * MAX_JOINT_MISFIT_M, POSSIBLE_MISFIT_RATIO * second):
            raise InputError(path, "joints", both, "one order that fits; are they in metres, and of this side?")
        chosen = f"order {order}, a guess: {both}"
    else:
        best, chosen = joint_misfit(some, order, side), ""
    return Ordered(joints[:, JOINT_ORDERS[order]], chosen, _order_warning(path, some, order, side, best))


def _order_warning(path: Path, some: Float[ndarray, "T 21 3"], order: JointOrder, side: Side, off: float) -> str:
    """Describe another order or side that may fit better. Raises ``InputError`` where one clearly does."""
    if off < EXACT_JOINT_MISFIT_M:
        return ""
    others = [(o, s) for o in JOINT_ORDERS for s in (side, OPPOSITE_SIDE[side]) if (o, s) != (order, side)]
    best, (other, of) = min(((joint_misfit(some, o, s), (o, s)) for o, s in others), key=lambda item: item[0])
    if best > POSSIBLE_MISFIT_RATIO * off or (off == np.inf and best > MAX_JOINT_MISFIT_M):
        return ""  # joints that cannot be fitted have an error of their own
    is_order = f"--order {other} fits, {_mm(best)} off"
    is_side = f"a {of} hand{'' if other == order else f' in --order {other}'} fits, {_mm(best)} off"
    fits = is_order if of == side else f"{is_side}: are they the other hand's, or mirrored (an axis reversed)?"
    got = f"joints {_mm(off)} off every pose of a {side} hand in --order {order}"
    if best < CERTAIN_MISFIT_RATIO * off:
        raise InputError(path, "joints", got, f"joints of such a hand; {fits}")
    return f"{got}; {fits}"


def joint_misfit(joints: Float[ndarray, "T 21 3"], order: JointOrder, side: Side) -> float:
    """Compute the distance of joints in an order from the nearest hand [m, root mean square]; infinite without one."""
    try:
        fit = fit_joints(generic.load(side), joints[:, JOINT_ORDERS[order]], "openpose")
    except UsageError:
        return np.inf
    return float(np.sqrt(np.mean(fit.residuals**2)))


def _mm(metres: float) -> str:
    return "far" if metres == np.inf else f"{1e3 * metres:.1f} mm"


MAX_VERTEX_RMS_M = 0.03
"""Maximum distance of MANO's vertices from the estimator's [m, root mean square] that another shape explains."""


def load_mano(folder: Path | None, side: Side) -> mano.Mano | None:
    """Load the user's MANO hand of a side; None without a folder. Raises ``InputError``."""
    return None if folder is None else load_mano_hand(folder, side)


def estimates_to_track(estimates: Estimates, folder: Path | None) -> tuple[HandTrack, str]:
    """Return the hand in every frame, and a description of its model.

    With a ``folder`` of MANO files and MANO's parameters, MANO's hand; else the generic hand, fitted to the estimator's
    joints, or without joints in the estimator's rotation. Raises ``InputError``.
    """
    side, hands = estimates.side, estimates.hands
    joints = [hand.joints for hand in hands if hand.joints is not None]
    parameters = [hand.mano for hand in hands if hand.mano is not None]
    vertices = [hand.vertices for hand in hands if hand.vertices is not None]
    if folder is not None and not parameters and len(vertices) == len(hands):
        track = make_mano_track(network_model(side, folder), np.array(vertices), np.array(joints))
        return track, "MANO's vertices as saved"
    if len(joints) == len(hands) and (folder is None or not parameters):
        return fit_generic_hand(hands[0].path, side, np.array(joints))
    R, pose, betas, t = (np.array(values) for values in zip(*parameters, strict=True))
    if folder is None:
        shaped = generic.load(side).with_shape()
        posed, root = shaped.with_pose(pose), shaped.joints[0]
        what = "the generic hand of mean size, turned as the estimator's MANO hand: not its surface"
    elif side == "left" and estimates.left_model == "mirrored":
        posed, root = _mirror_right_hand(load_mano_hand(folder, "right").model, betas, pose)
        what = "MANO's right hand mirrored, as the estimator has it"
    else:
        shaped = load_mano_hand(folder, side).model.with_shape(betas)
        posed, root = shaped.with_pose(pose), shaped.joints[:, 0]
        what = f"MANO's {side} hand"
    T_cam_hand = root_transform(R, t, root)
    if all(hand.vertices is not None for hand in hands):
        T_cam_hand = _align_to_vertices(estimates, posed, T_cam_hand)
    return hand_track(posed, T_cam_hand), what


def make_mano_track(model: HandModel, vertices: Float[ndarray, "T V 3"], joints: Float[ndarray, "T 21 3"]) -> HandTrack:
    """Make the hand of MANO's vertices and joints before the camera [m]."""
    T_cam_hand = mano_motions(model, vertices)[:, 0]
    inside = se3.inverse(T_cam_hand)
    joints = se3.transform(inside, joints)
    posed = PosedHand(model.side, se3.transform(inside, vertices), model.faces, joints, model.regions)
    return hand_track(posed, T_cam_hand)


def network_model(side: Side, folder: Path) -> HandModel:
    """Return the hand of networks trained on right hands: MANO's right hand, or its mirror image."""
    right = load_mano_hand(folder, "right").model
    return right if side == "right" else mirrored_model(right)


def mano_motions(model: HandModel, vertices: Float[ndarray, "*n V 3"]) -> Float[ndarray, "*n 16 4 4"]:
    """Fit the rigid motion of each part of a hand from rest to its vertices (least squares).

    A part's vertices have more than half of their weight on its joint.
    """
    weights = np.where(model.weights > 0.5, model.weights, 0.0).T
    weights = weights / weights.sum(axis=1, keepdims=True)
    rest, moved = weights @ model.template, np.einsum("jv,...vc->...jc", weights, vertices)
    H = np.einsum("jv,...vc,vd->...jcd", weights, vertices, model.template)
    R = se3.nearest_rotation(H - moved[..., None] * rest[:, None, :])
    return se3.rigid(R, moved - (R @ rest[..., None])[..., 0])


def mano_joints(model: HandModel, vertices: Float[ndarray, "V 3"]) -> Float[ndarray, "21 3"]:
    """Compute the 21 joints of a hand from its surface, each moved with its part."""
    at = se3.transform(mano_motions(model, vertices), model.joints[:, None])[:, 0]
    return np.concatenate([at, vertices[model.tips]])[ORDER_21]


def fit_generic_hand(path: Path, side: Side, joints: Float[ndarray, "T 21 3"]) -> tuple[HandTrack, str]:
    """Fit the generic hand to joints before the camera [m], in this package's order. Raises ``InputError``."""
    try:
        fit = fit_joints(generic.load(side), joints, "openpose")
    except JointsError as error:
        raise InputError(path, "joints", error.got, error.expected) from error
    off = 1e3 * np.sqrt(np.mean(fit.residuals**2))
    return fit.hand, f"the generic hand fitted to the estimator's joints ({off:.1f} mm off, root mean square)"


def generic_joints(side: Side, R: Float[ndarray, "3 3"], pose: Float[ndarray, "45"]) -> Float[ndarray, "21 3"]:
    """Compute the joints of the generic hand with a global rotation and a pose, in the camera's axes [m]."""
    return generic.load(side).with_shape().with_pose(pose).joints @ R.T


def _mirror_right_hand(
    model: HandModel, betas: Float[ndarray, "T 10"], pose: Float[ndarray, "T 45"]
) -> tuple[PosedHand, Float[ndarray, "T 3"]]:
    shaped = model.with_shape(betas)
    posed = shaped.with_pose(mirrored_pose(pose))
    vertices, joints, faces = mirrored(posed.vertices), mirrored(posed.joints), posed.faces[:, ::-1].copy()
    left = replace(posed, side="left", vertices=vertices, faces=faces, joints=joints)
    return left, mirrored(shaped.joints[:, 0])


def _align_to_vertices(
    estimates: Estimates, posed: PosedHand, T_cam_hand: Float[ndarray, "T 4 4"]
) -> Float[ndarray, "T 4 4"]:
    """Move MANO's hands such that the means of their vertices match the estimator's vertices.

    Raises ``InputError`` for moved vertices that are far from the estimator's.
    """
    value = np.array([hand.vertices for hand in estimates.hands])
    ours = se3.transform(T_cam_hand, posed.vertices)
    shift = value.mean(axis=1) - ours.mean(axis=1)
    off = np.sqrt(np.mean(np.sum((ours + shift[:, None] - value) ** 2, axis=-1), axis=1))
    if off.max() > MAX_VERTEX_RMS_M:
        worst = estimates.hands[int(np.argmax(off))]
        got = f"vertices {1e3 * off.max():.0f} mm from MANO's in the same pose"
        raise InputError(worst.path, "pred_vertices_smpl", got, "the hand of pred_hand_pose")
    return se3.rigid(None, shift) @ T_cam_hand


CHOSEN_HANDS_KEY = "hands_chosen"
"""Key of a clip's provenance: how one of several hands in a frame was chosen."""
MIN_HAND_MASK_MARGIN = 0.1
"""Minimum difference of the best and second hand's fractions of points in the hand mask by which the mask decides."""


@dataclass(frozen=True)
class TrackedHands:
    """The hand in the frames in which it was found, and its provenance."""

    track: HandTrack
    found: tuple[int, ...]
    """Rising indices of these frames among the frames of the ``Request``."""
    provenance: Provenance
    warnings: tuple[str, ...] = ()
    """Warnings about the hand, in words."""

    def extrapolate_to_ends(self, frames: Sequence[str]) -> TrackedHands:
        """Keep the hand still, as an assumption, before the first and after the last frame in which it was found.

        ``frames`` are the names of the frames of the ``Request``. Gaps between two frames with a hand stay.
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

    ``paths`` are files, folders of files, or patterns (``out/*.npz``). Raises as ``Tracker.read`` does, and
    ``InputError`` for missing files, without a hand of the side, and for an impossible hand.
    """
    paths = list_record_files(paths, tracker.layouts)
    with arrays.convert_to_input_errors(paths[0]):
        return _read_estimates(paths, tracker, request)


def _read_estimates(paths: Sequence[Path], tracker: Tracker, request: Request) -> TrackedHands:
    estimates = tracker.read(paths, request)
    if not estimates.hands:
        got = f"no {request.side} hand in the clip's frames, in {len(paths)} files"
        other = OPPOSITE_SIDE[request.side]
        raise InputError(paths[0], "", got, f"one; or is it the {other} hand that holds the object?")
    hands, chosen = choose_frame_hands(estimates.hands, request)
    depths = join_sources(hand.depth for hand in hands)
    estimates = replace(estimates, hands=tuple(hands))
    made, what = estimates_to_track(estimates, request.mano)
    if any(hand.seen is not None for hand in hands):
        seen = np.array([np.zeros((21, 3)) if hand.seen is None else hand.seen for hand in hands])
        made = replace(made, joints_2d=seen[..., :2], joints_2d_confidence=seen[..., 2])
    first = estimates.hands[0]
    if first.mano is not None:  # a hand fitted to plain joints has a hand's size; callers check that it is in view
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
    """Describe joints far from the joints of the fitted hand; empty where they fit."""
    value = [hand.joints for hand in estimates.hands if hand.joints is not None]
    if len(value) < len(estimates.hands) or made.joints is None:
        return ""
    apart = se3.transform(made.T_cam_hand, made.joints) - np.array(value)
    off = float(np.sqrt(np.mean(np.sum(apart**2, axis=-1))))
    causes = "noise, another order, another skeleton, or depths not in metres"
    if off <= MAX_JOINT_MISFIT_M:
        return ""
    return f"joints {1e3 * off:.1f} mm off every pose of a hand (root mean square): {causes}"


def choose_frame_hands(hands: Sequence[Estimate], request: Request) -> tuple[list[Estimate], Source | None]:
    """Choose one hand in each frame, in the order of frames; also return the reasons, None without a choice.

    An estimator may find the same hand twice, or another person's hand. The hand mask decides where the clip has one
    and the hands' fractions in it differ enough. Otherwise the hand nearest in the image to the previous frame's hand
    is chosen, or to the next frame's where no previous one is known; frames with one hand are known. If all frames have
    several hands, each is followed from the first frame on, and the largest in the images is chosen.
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
    """Choose the hand in each frame from the ``known`` frames: on to later frames, then to earlier ones."""
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
    """Return the hand with the largest fraction in the hand mask; None without a mask, or where it does not decide."""
    path = request.hand_masks[frame] if request.hand_masks else None
    if path is None:
        return None
    inside = [fraction_in_mask(path, points, request) for points in seen]
    second, best = sorted(inside)[-2:]
    return int(np.argmax(inside)) if best - second > MIN_HAND_MASK_MARGIN else None


def fraction_in_mask(path: Path, points: Float[ndarray, "N 2"], request: Request) -> float:
    """Compute the fraction of points [px] that are inside a hand mask. Raises ``InputError``."""
    u, v = np.floor(points).astype(int).T
    return float(np.mean(read_mask(path, request.size).at(v, u)))


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
