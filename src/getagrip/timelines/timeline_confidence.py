"""Confidence in a timeline, without ground truth: checks, findings per segment, the probability of each grasp."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.checks import INPUT_CHECKS
from getagrip.checks.calibration import PROBABILITY_MEANINGS
from getagrip.checks.features import compute_features
from getagrip.checks.timeline_checks import check_timeline
from getagrip.clip import Clip, Segment, other_evidence
from getagrip.fitting.methods.all_frames import soft_energy
from getagrip.fitting.motion import PosesInHand
from getagrip.fitting.options import Options
from getagrip.fitting.pipeline import FrameSolutions, Judgement
from getagrip.fitting.solver.search import suppress_duplicates
from getagrip.fitting.solver.solve import poses_in_camera
from getagrip.fitting.stages.confidence import probability_right, solved_of
from getagrip.fitting.stages.remaining_frames import at_sampled_frames
from getagrip.result import SegmentResult
from getagrip.result.findings import Finding, Probability
from getagrip.timelines.joint import Chain
from getagrip.timelines.observations import TimelineInputs
from getagrip.timelines.segments import COMPARISON_RESOLUTION_PX, GraspTrack
from getagrip.timelines.transitions import TimelineMotion

N_JUDGED_CANDIDATES = 4
"""Number of a grasp's solutions that its features compare, the chosen one included: as many as a search ends with."""
TIMELINE_PROBABILITY_MEANING = PROBABILITY_MEANINGS["hand"]
TIMELINE_PROBABILITY_MEANING += "; calibrated on single grasps, a rough guide for timelines"
"""Meaning of a grasp's probability of being right (docs/checks.md)."""


@dataclass(frozen=True)
class TimelineAnswer(FrameSolutions):
    """Poses of a timeline in all frames, and the motion from which they come."""

    motion: TimelineMotion


def judge_timeline(footage: TimelineInputs, chain: Chain, answer: TimelineAnswer) -> Judgement:
    """Check a timeline and its segments, and compute the probability that each grasp is right."""
    source, motion, iou = footage.source, answer.motion, answer.track.iou
    hands = motion.T_cam_hand, motion.T_cam_obj, footage.scale, iou, motion.T_cam_other_hand
    examined = check_timeline(source.original, footage.masks, *hands, source.glitches)
    segments = []
    for n, (segment, checks) in enumerate(zip(source.original.segments, examined.of_segments, strict=True)):
        found = replace(_summarise_segment(source.original, segment, motion, iou), checks=checks)
        track = motion.grasps.get(segment.first) if segment.state == "grasp" else None
        if track is not None:
            signs = read_grasp_signs(track)
            evidence = other_evidence(track.solutions.problem.clip)
            right = _grasp_probability(source.options, signs, (*examined.of_clip, *examined.own[n]), evidence)
            found = replace(found, signs=signs, probability_right=right)
        segments.append(found)
    return Judgement(examined.checks, examined.findings, segments=tuple(segments), failed=examined.failed)


def _summarise_segment(clip: Clip, segment: Segment, motion: TimelineMotion, iou: Float[ndarray, "T"]) -> SegmentResult:
    rows, is_grasp = segment.rows, segment.state == "grasp"
    seen = iou[rows][~np.isnan(iou[rows])]
    grasp = motion.grasps.get(segment.first) if is_grasp else None
    axis = None if grasp is None else grasp.axis
    lying = segment.state == "static" and clip.world is not None
    return SegmentResult(
        state=segment.state,
        first=clip.frames[segment.first],
        last=clip.frames[segment.last],
        side=segment.side,
        iou=float(seen.mean()) if len(seen) else None,
        by_masks=is_grasp and grasp is None,
        T_world_obj=clip.world.T_world_cam[rows[0]] @ motion.T_cam_obj[rows[0]] if lying and clip.world else None,
        axis_point=None if axis is None else axis.point,
        axis_direction=None if axis is None else axis.direction,
    )


def _grasp_probability(
    options: Options, signs: dict[str, float], findings: Sequence[Finding], evidence: Sequence[str]
) -> Probability | None:
    """Compute the probability that a grasp is right; ``findings`` are the grasp's own and the clip's."""
    of_input = [one for one in findings if one.check in {*INPUT_CHECKS}]
    right = probability_right(options, signs, of_input, terms=evidence)
    return right and replace(right, meaning=TIMELINE_PROBABILITY_MEANING)


def read_grasp_signs(track: GraspTrack) -> dict[str, float]:
    """Compute the features of a grasp at its sampled frames; energies of its solutions are without links."""
    solutions, found = track.solutions, track.found
    problem, poses = solutions.problem, solutions.motion.poses()
    energy = solutions.energy.copy()
    energy[track.chosen] = min(0.0, float(energy.min())) - 1.0
    best = suppress_duplicates(poses, energy, problem.surface, N_JUDGED_CANDIDATES)
    distinct = poses.take(best)
    R, centre = distinct.R.copy(), distinct.centre.copy()
    R[0], centre[0] = found.poses.R[0], found.poses.centre[0]
    mask, *_ = soft_energy(problem)(COMPARISON_RESOLUTION_PX, np.arange(len(problem.clip)))
    assert found.motion is not None
    missed = float(mask(poses_in_camera(found.motion, problem.clip.hand.T_cam_hand), np.full(1, np.inf)).value.sum())
    poses, terms = PosesInHand(R, centre, distinct.scale), found.terms | {"mask": missed}
    result = replace(found, poses=poses, energy=solutions.energy[best], terms=terms)
    sampled = at_sampled_frames(problem, result)
    return compute_features(solved_of(solutions.grasp.clip, problem, result, sampled, sampled))
