"""Variants that the timeline benchmark compares: segments by themselves, the authors' propagation, and joint solutions.

Propagation follows the authors' later code (objects-along-hit). It starts at the longest static segment, goes back to
the first segment, on to the last and back again. Each visit adds a start pose, that of the previously visited segment
at the nearest frame, and a segment keeps the visit with the highest mean IOU. Static segments: one pose, E_mask. Grasps
and contacts: a free pose per frame, with contact consistency. By construction propagation can only gain IOU; the weight
of its links is 0. Search, optimiser and hand correction are ours.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.clip import Clip, Masks, Segment, with_masks
from getagrip.errors import InputError
from getagrip.fitting.methods import all_frames
from getagrip.fitting.options import Options
from getagrip.fitting.pipeline import repair_input
from getagrip.fitting.problem import prepare_problem
from getagrip.fitting.stages.remaining_frames import at_sampled_frames, extend_to_every_frame
from getagrip.fitting.stages.robust_masks import image_iou
from getagrip.geometry import se3
from getagrip.result import FrameKind
from getagrip.timelines.joint import choose_hypotheses, fill_all_frames
from getagrip.timelines.observations import GraspClip, TimelineInputs
from getagrip.timelines.segments import fit_in_all_frames, select_static_frames, solve_grasp, static_hypotheses
from getagrip.timelines.transitions import TimelineMotion, fill_gaps, split_at_gaps


def fit_grasps_only(footage: TimelineInputs) -> TimelineMotion:
    """Fit each grasp by itself.

    Static poses are copied from the nearest frame of a grasp; in other frames the object moves with the hand. Raises
    ``InputError`` where no grasp shows the object.
    """
    motion, known = TimelineMotion.of(footage.clip, footage.shown), list[Segment]()
    for segment in footage.clip.segments:
        grasp = GraspClip.of(footage.clip, segment) if segment.state == "grasp" else None
        if grasp is not None:
            problem = prepare_problem(grasp.clip, footage.source.options)
            motion.put_grasp(fit_in_all_frames(solve_grasp(grasp, problem, []), 0, []))
            known += split_at_gaps(segment, grasp.rows)
    _carry_to_unknown_frames(motion, footage, known)
    return motion


def fit_static_only(footage: TimelineInputs) -> TimelineMotion:
    """Fit each static segment by itself; in other frames the object moves with the hand.

    Raises ``InputError`` where no static segment shows the object.
    """
    motion, known = TimelineMotion.of(footage.clip, footage.shown), []
    for segment in footage.clip.segments:
        if segment.state == "static" and len(rows := select_static_frames(segment, footage.shown)):
            found = static_hypotheses(footage.problem(rows), len(segment), support=False)
            motion.put(segment.rows, found.take(np.zeros(1, int)), "sampled")
            known.append(segment)
    _carry_to_unknown_frames(motion, footage, known)
    return motion


def _carry_to_unknown_frames(motion: TimelineMotion, footage: TimelineInputs, known: list[Segment]) -> None:
    """Copy each unknown frame's pose from the nearest known frame: fixed in the hand, or in the world while static."""
    if not known:
        raise InputError(footage.clip.origin, "segments", "none that can be solved alone", "one at least")
    there = np.concatenate([segment.rows for segment in known])
    nearest = there[np.argmin(np.abs(np.arange(len(footage))[:, None] - there), axis=1)]
    static = {row: s for s in footage.clip.segments if s.state == "static" for row in s.rows}
    known_rows = {*there.tolist()}
    for row in range(len(footage)):
        if row in known_rows:
            continue
        source = int(nearest[row])
        to, segment = row, static.get(row)
        if segment is not None:  # the border of the static segment on the side of the source
            to = segment.last if source > segment.last else segment.first
        motion.T_cam_obj[row] = footage.T_cam_world[row] @ _pose_with_hand(motion, footage, source, to)


def _pose_with_hand(motion: TimelineMotion, footage: TimelineInputs, source: int, row: int) -> Float[ndarray, "4 4"]:
    """Return the world pose at ``row`` of an object that moves with the input hand from frame ``source``."""
    T_cam_hand = footage.clip.hand.T_cam_hand
    T_hand_obj = se3.inverse(T_cam_hand[source]) @ motion.T_cam_obj[source]
    return np.asarray(footage.T_world_cam[row] @ T_cam_hand[row] @ T_hand_obj)


def propagate(footage: TimelineInputs) -> TimelineMotion:
    """Solve the timeline by the authors' propagation. Raises ``InputError`` where no segment shows the object."""
    segments = [s for s in footage.clip.segments if footage.shown[s.rows].sum() > 1]
    if not segments:
        raise InputError(footage.clip.origin, "segments", "none", "one at least that shows the object in two frames")
    static = [n for n, s in enumerate(segments) if s.state == "static"]
    first = max(static or range(len(segments)), key=lambda n: len(segments[n]))
    last = len(segments) - 1
    visits = [*range(first, -1, -1), *range(1, last + 1), *range(last - 1, first - 1, -1)]
    motion, best = TimelineMotion.of(footage.clip, footage.shown), dict[int, float]()
    before: int | None = None
    for n in visits:
        if n != before:
            _refit_segment(motion, footage, segments, n, before, best)
        before = n
    fill_gaps(motion, footage, segments)
    return motion


def _refit_segment(
    motion: TimelineMotion,
    footage: TimelineInputs,
    segments: list[Segment],
    n: int,
    before: int | None,
    best: dict[int, float],
) -> None:
    """Fit segment n from the pose of segment ``before``, and keep the fit if its IOU is the highest so far."""
    segment, rows = segments[n], segments[n].rows
    start, kind = None, tuple[FrameKind, ...]()
    if before is not None:
        start = motion.at(segments[before].last if before < n else segments[before].first)
    if segment.state == "static":
        problem = footage.problem(select_static_frames(segment, footage.shown))
        found = static_hypotheses(problem, len(segment), support=False, start=start)
        T_cam_obj = footage.T_cam_world[rows] @ found.T_world_obj(footage.clip.mesh.centre)[0]
        T_cam_hand, kind = footage.clip.hand.T_cam_hand[rows], tuple("sampled" for _ in rows)
    else:
        clip = footage.clip.take(rows)
        problem = prepare_problem(clip, replace(footage.source.options, method="contact-consistency"))
        if start is not None:
            at = 0 if before is not None and before < n else -1
            T_hand_world = se3.inverse(problem.clip.world.T_world_cam[at] @ problem.clip.hand.T_cam_hand[at])  # type: ignore[union-attr]
            more = T_hand_world @ start.T_world_obj(clip.mesh.centre)[:, 0]
            problem = replace(problem, prior_poses=np.concatenate([more, problem.prior_poses]))
        fitted = all_frames.fit_contact_consistency(problem, lambda _: None)
        track = extend_to_every_frame(clip, problem, fitted, at_sampled_frames(problem, fitted))
        T_cam_obj, T_cam_hand, kind = track.T_cam_hand @ track.T_hand_obj[0], track.T_cam_hand, track.kind
    seen = rows[footage.shown[rows]]
    at_seen = np.searchsorted(rows, seen)
    posed = footage.clip.take(seen).with_hand_at(T_cam_hand[at_seen])
    T_hand_obj = se3.inverse(T_cam_hand[at_seen]) @ T_cam_obj[at_seen]
    iou = float(image_iou(posed, footage.masks.take(seen), T_hand_obj, 1.0).mean())
    if iou > best.get(n, -1.0):
        best[n] = iou
        motion.T_cam_obj[rows], motion.T_cam_hand[rows] = T_cam_obj, T_cam_hand
        for row, how in zip(rows, kind, strict=True):
            motion.kind[row] = how


TIMELINE_VARIANTS: dict[str, Callable[[TimelineInputs], TimelineMotion]] = {
    "grasp only": fit_grasps_only,
    "static only": fit_static_only,
    "propagate": propagate,
    "joint": lambda footage: fill_all_frames(footage, choose_hypotheses(footage, support=False)),
    "joint + plane": lambda footage: fill_all_frames(footage, choose_hypotheses(footage, support=True)),
}
"""By name; ``getagrip reconstruct`` uses the last."""


def reconstruct_variant(variant: str, clip: Clip, masks: Masks, options: Options) -> TimelineMotion:
    """Reconstruct the object's motion in a clip of known scale by a variant. Raises the variant's errors."""
    return TIMELINE_VARIANTS[variant](TimelineInputs.of(repair_input(with_masks(clip, masks), options)))
