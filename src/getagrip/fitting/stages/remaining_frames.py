"""Extend a fit of the sampled frames to every frame of the clip.

The parameters that frames share (axis, base pose, scale) stay fixed. In other frames whose masks show the object, the
frame's own parameters (angle, deviations) start between its neighbours' and are fitted to the frame's mask, and to the
neighbours: the object moves little in the hand from one frame to the next. Poses are interpolated where no mask shows
the object, where the mask is an outlier, and for methods without a motion model.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip import Clip
from getagrip.fitting.energy import Term
from getagrip.fitting.energy.homan_terms import BendingTerm, TermInFrame, vertex_moments
from getagrip.fitting.motion import Frozen, Motion, PosesInHand, hand_object_transforms, interpolate_object_poses
from getagrip.fitting.problem import MethodResult, Problem
from getagrip.fitting.solver.solve import minimise
from getagrip.fitting.stages.mesh_deformation import relative_contour_error
from getagrip.fitting.stages.robust_masks import NeighbourPrediction, image_iou, view_outliers
from getagrip.geometry import se3
from getagrip.result import FrameKind

FIT_CHUNK_FRAMES = 30
"""Number of frames that are read and fitted at once."""
REMAINING_FRAMES_STAGES = ((128, 5), (256, 5))
"""Resolution [px] and iterations of each stage of the fit."""
BENDING_WEIGHT = 1e6
"""Energy of a bending motion in the hand [px^2 per (m per frame^2)^2], multiplied by the misfit minus 1: masks that the
object's own mesh meets determine each pose better than its neighbours do. Chosen on a video of a mug."""


@dataclass(frozen=True)
class SolutionTrack:
    """K solutions in T frames.

    Attributes:
        frames: names of the frames.
        kind: kind of each frame's pose: sampled, fitted or interpolated.
        T_cam_hand: (T, 4, 4) poses of the hand, which ``T_hand_obj`` are relative to.
        T_hand_obj: (K, T, 4, 4) poses of the mesh's own frame in the hand frame.
        angle: (T,) angle about the axis of the best [rad], where the method has one.
        iou: (T,) overlap of the best with the masks (``image_iou``); NaN where no mask shows the object, or the mask is
            an outlier.
        outliers: names of the frames with outlier masks.
    """

    frames: tuple[str, ...]
    kind: tuple[FrameKind, ...]
    T_cam_hand: Float[ndarray, "T 4 4"]
    T_hand_obj: Float[ndarray, "K T 4 4"]
    angle: Float[ndarray, "T"] | None
    iou: Float[ndarray, "T"]
    outliers: tuple[str, ...] = ()


def at_sampled_frames(problem: Problem, found: MethodResult) -> SolutionTrack:
    """Return a method's solutions in the sampled frames."""
    clip = problem.clip
    T_hand_obj = hand_object_transforms(found.poses, clip.mesh.centre)
    iou = image_iou(clip, problem.masks, T_hand_obj[0], float(found.poses.scale[0]))
    kind: tuple[FrameKind, ...] = tuple("sampled" for _ in clip.frames)
    angle = None if found.axis is None else found.axis.angle
    return SolutionTrack(clip.frames, kind, clip.hand.T_cam_hand, T_hand_obj, angle, iou)


def extend_to_every_frame(clip: Clip, problem: Problem, found: MethodResult, track: SolutionTrack) -> SolutionTrack:
    """Extend a method's solutions to every frame of the clip; ``track`` stays in the problem's frames.

    Masks beyond ``Trust.outlier_threshold`` are outliers as well. Masks that the clip does not have in memory are read
    from its folder, a few at a time.
    """
    sampled = clip.index_of(problem.clip.frames)
    clip = problem.with_hand_found(clip)
    T, K, scale = len(clip), len(track.T_hand_obj), float(found.poses.scale[0])
    kind: list[FrameKind] = ["interpolated"] * T
    outliers = list(problem.trust.outliers)
    iou, angle, known = np.full(T, np.nan), np.full(T, np.nan), np.zeros(T, dtype=bool)
    R, centre = np.empty((K, T, 3, 3)), np.empty((K, T, 3))
    R[:, sampled], centre[:, sampled], known[sampled], iou[sampled] = found.poses.R, found.poses.centre, True, track.iou
    if track.angle is not None:
        angle[sampled] = track.angle
    predicted = None
    if np.isfinite(problem.trust.outlier_threshold):
        predicted = NeighbourPrediction.by(problem, found.poses, sampled)
    times = relative_contour_error(problem.observation, found.terms.get("mask", 0.0) / len(sampled))
    smooth = BENDING_WEIGHT * max(0.0, times - 1.0)
    shown = np.flatnonzero([name not in {*problem.clip.left_out, *outliers} for name in clip.frames])
    others = np.setdiff1d(shown, sampled)
    for index, part in _chunks_of_frames(clip, problem, others, predicted):
        if found.motion is not None and found.energy_of is not None:
            at = _neighbouring_frames(known, index)
            near = PosesInHand(R[:, at], centre[:, at], found.poses.scale)
            beside = _bending_term(part, index, near, at, smooth) if smooth > 0.0 else None
            fitted = fit_frame_parameters(part, found, sampled, index, beside)
            poses, angles = fitted.poses(), fitted.angles()
            if angles is not None:
                angle[index] = angles[0]
            for n in index:
                kind[n] = "fitted"
        else:
            poses = interpolate_object_poses(found.poses, sampled, index)
        R[:, index], centre[:, index], known[index] = poses.R, poses.centre, True
        iou[index] = image_iou(part.clip, part.masks, hand_object_transforms(poses, clip.mesh.centre)[0], scale)
    outliers += [clip.frames[n] for n in others[~known[others]]]
    rest, solved = np.flatnonzero(~known), np.flatnonzero(known)
    poses = interpolate_object_poses(PosesInHand(R[:, solved], centre[:, solved], found.poses.scale), solved, rest)
    R[:, rest], centre[:, rest] = poses.R, poses.centre
    T_hand_obj = hand_object_transforms(PosesInHand(R, centre, found.poses.scale), clip.mesh.centre)
    T_hand_obj[:, sampled] = track.T_hand_obj
    for n in sampled:
        kind[n] = "sampled"
    names = tuple(name for name in clip.frames if name in outliers)
    if track.angle is not None:
        seen = ~np.isnan(angle)
        angle[~seen] = np.interp(np.flatnonzero(~seen), np.flatnonzero(seen), angle[seen])
    shown_angle = None if track.angle is None else angle
    return SolutionTrack(clip.frames, tuple(kind), clip.hand.T_cam_hand, T_hand_obj, shown_angle, iou, names)


def fit_frame_parameters(
    problem: Problem,
    found: MethodResult,
    sampled: Int[ndarray, "n"],
    index: Int[ndarray, "m"],
    beside: Term | None = None,
) -> Motion:
    """Fit the motions of the frames ``sampled`` of a clip in the problem's frames, which are the clip's ``index``.

    Only each frame's own parameters of the best motion are fitted, those of the others are interpolated; ``beside`` is
    a term that ties the best to neighbouring frames.
    """
    assert found.motion is not None
    assert found.energy_of is not None
    motion: Frozen[Motion] = Frozen(found.motion.resampled(sampled, index))
    energy, everywhere = found.energy_of(problem), np.arange(len(index))
    for level, iterations in REMAINING_FRAMES_STAGES if len(motion.lengths()[1]) else ():
        terms = [*energy(level, everywhere), *([] if beside is None else [beside])]
        best = minimise(motion.take(np.zeros(1, int)), terms, problem.clip.hand.T_cam_hand, iterations).motion
        motion = best.concatenate(motion.take(np.arange(1, len(motion.poses().scale))))
    return motion.core


def _neighbouring_frames(known: Bool[ndarray, "T"], index: Int[ndarray, "m"]) -> Int[ndarray, "n"]:
    """Return the known frames among and beside others."""
    at = np.flatnonzero(known)
    return at[max(int(np.searchsorted(at, index[0])) - 2, 0) : int(np.searchsorted(at, index[-1])) + 2]


def _bending_term(
    problem: Problem,
    index: Int[ndarray, "m"],
    known: PosesInHand,
    at: Int[ndarray, "n"],
    weight: float,
) -> Term:
    """Return the term on the bending of the best motion in the hand, at and between known frames."""
    mesh = problem.clip.mesh
    spread = vertex_moments(mesh.vertices - mesh.centre)
    term = BendingTerm(spread, weight, index, at, known.R[0], known.centre[0])
    return TermInFrame(term, se3.inverse(problem.clip.hand.T_cam_hand))


def _chunks_of_frames(
    clip: Clip, problem: Problem, others: Int[ndarray, "n"], predicted: NeighbourPrediction | None
) -> Iterator[tuple[Int[ndarray, "m"], Problem]]:
    """Yield other frames with their problems, a few neighbours at a time, without outlier masks."""
    for some in np.array_split(others, -(-len(others) // FIT_CHUNK_FRAMES)) if len(others) else ():
        index, part = some, problem.at(clip.take(some))
        if predicted is not None:
            wrong = predicted.overlap(part, some).differing > problem.trust.outlier_threshold
            index = some[~wrong]
            part = problem.at(clip.take(index)) if wrong.any() and len(index) else part
            if len(index) and (in_views := view_outliers(part, predicted, index)[0]):
                trust = replace(part.trust, view_outliers=part.trust.view_outliers | in_views)
                part = replace(part, trust=trust).at(part.clip)
        if len(index):
            yield index, part
