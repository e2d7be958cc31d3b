"""From a clip to the object in every frame: timelines by all of their segments, other clips as one stable grasp.

The steps of one stable grasp (paper, Sec. 3.3), by whichever method: from a clip to the object in the hand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from getagrip.checks import INPUT_CHECKS, Evidence, compute_features, input_checks, result_checks, run_checks
from getagrip.checks.timeline_checks import GRASP_CHECKS
from getagrip.clip import Clip, Masks
from getagrip.errors import GetagripError, InputError, check_arguments
from getagrip.fitting.methods import METHODS
from getagrip.fitting.options import Options
from getagrip.fitting.pipeline import Clock, FrameSolutions, Judgement, PipelineSteps, RepairedInput, run_pipeline
from getagrip.fitting.problem import MethodResult, Problem, prepare_problem
from getagrip.fitting.solver.solve import minimise
from getagrip.fitting.stages.confidence import hand_alternatives, probabilities, solved_of
from getagrip.fitting.stages.remaining_frames import SolutionTrack, at_sampled_frames, extend_to_every_frame
from getagrip.fitting.stages.robust_masks import fit_without_outliers, image_iou
from getagrip.geometry import se3
from getagrip.io.terminal import Progressed, progress_callback
from getagrip.result import Reconstruction, Status
from getagrip.result.findings import Finding
from getagrip.timelines.joint import Chain, choose_hypotheses, fill_all_frames
from getagrip.timelines.observations import TimelineInputs
from getagrip.timelines.timeline_confidence import TimelineAnswer, judge_timeline
from getagrip.timelines.transitions import TimelineMotion

CONVERGENCE_CHECK_STAGE = 256, 8
"""Resolution [px] and iterations of the usual search's last stage: as many again are made where it was cut off."""


@dataclass(frozen=True)
class PreparedGrasp:
    """A grasp, prepared for the search.

    Attributes:
        problem: the clip at the frames that are used.
        clip: the same frames, with the hand before it was corrected.
        checks: what the checks of the input have measured, by name.
        findings: what is unusual about the input.
    """

    source: RepairedInput
    problem: Problem
    clip: Clip
    checks: dict[str, float]
    findings: tuple[Finding, ...]


@dataclass(frozen=True)
class MethodSolutions:
    """The solutions of a method.

    Attributes:
        problem: the clip at the frames without outlier masks, with the fitted mesh.
        result: the solutions.
        sampled: the solutions at the problem's frames.
    """

    problem: Problem
    result: MethodResult
    sampled: SolutionTrack


def _prepare_grasp(source: RepairedInput) -> PreparedGrasp:
    """Choose frames, correct the hand, crop the masks; check the input."""
    problem = prepare_problem(source.clip, source.options, source.threads)
    index = source.clip.index_of(problem.clip.frames)
    clip = replace(problem.clip, hand=source.clip.hand.take(index))
    checks, findings = run_checks(input_checks(), Evidence(clip, problem.input_masks, glitches=source.glitches))
    return PreparedGrasp(source, problem, clip, checks, findings)


def _search_grasp(prepared: PreparedGrasp, clock: Clock) -> MethodSolutions:
    """Run the method in the frames without outlier masks.

    Where it fails, the error also says what was unusual about its inputs.
    """
    problem = prepared.problem
    method = METHODS[problem.options.method]
    try:
        if method.checks_masks and problem.options.masks == "checked":
            problem, found = fit_without_outliers(problem, lambda some: method.fit(some, clock))
        else:
            found = method.fit(problem, clock)
            problem = problem.as_found(found)
    except InputError:
        raise
    except GetagripError as error:
        raise GetagripError("; ".join(map(str, (error, *prepared.findings)))) from error
    sampled = at_sampled_frames(problem, found)
    clock("finish")
    return MethodSolutions(problem, found, sampled)


def unconverged_motion(problem: Problem, found: MethodResult) -> float:
    """Compute how far further iterations would move points of the object's surface, root mean square over frames [m].

    The result stays as it is: only going on tells whether the search stopped early. 0 where it did not stop at the
    limit; NaN for a method that has no motion of its own.
    """
    if found.status is not Status.LIMIT:
        return 0.0
    if found.motion is None or found.energy_of is None:
        return float("nan")
    terms, motion = (
        found.energy_of(problem)(CONVERGENCE_CHECK_STAGE[0], np.arange(len(problem.clip))),
        found.motion.take(np.zeros(1, int)),
    )
    after = minimise(motion, terms, problem.clip.hand.T_cam_hand, CONVERGENCE_CHECK_STAGE[1]).motion.poses()
    first, then = (
        poses.scale[0] * problem.surface.points @ np.swapaxes(poses.R[0], -1, -2) + poses.centre[0][:, None]
        for poses in (found.poses, after)
    )
    return float(np.sqrt(np.mean(np.sum((then - first) ** 2, axis=-1))))


def _fit_all_frames(prepared: PreparedGrasp, found: MethodSolutions, clock: Clock) -> FrameSolutions:
    """Extend the solutions to all frames that the options ask for."""
    source, result, problem = prepared.source, found.result, found.problem
    clip = source.clip if problem.options.every_frame else prepared.clip
    track = extend_to_every_frame(clip.warped(result.warp), problem, result, found.sampled)
    clock("every frame")
    return FrameSolutions(
        track=track,
        scale=result.poses.scale,
        energy=result.energy,
        next_best=float(result.energy[1]) if len(result.energy) > 1 else float("inf"),
        status=result.status,
        terms=result.terms,
        axis=None if result.axis is None or track.angle is None else replace(result.axis, angle=track.angle),
        warp=result.warp,
        T_cam_other_hand=None,
        notes=problem.notes,
        hand=result.hand,
        cut_off=unconverged_motion(problem, result),
    )


def _judge_grasp(prepared: PreparedGrasp, found: MethodSolutions, answer: FrameSolutions) -> Judgement:
    """Run the checks, and compute signs and probabilities."""
    source = prepared.source
    solved = solved_of(source.clip, found.problem, found.result, found.sampled, answer.track)
    checks, after = run_checks(result_checks(), solved)
    findings, signs = (*prepared.findings, *after), compute_features(solved)
    hand, terms = found.result.hand, {*found.result.terms}
    terms = terms if hand is None else terms | {*hand.energy}
    right = probabilities(source.clip, source.options, signs, findings, terms)
    return Judgement(prepared.checks | checks, findings, signs, right, hand_alternatives(found.problem, found.result))


GRASP_STEPS = PipelineSteps(_prepare_grasp, _search_grasp, _fit_all_frames, _judge_grasp, stages=8)


@check_arguments
def reconstruct(
    clip: Clip,
    masks: Masks | None = None,
    options: Options | None = None,
    progress: Progressed = None,
    threads: int = 1,
) -> Reconstruction:
    """Find the object's pose in the hand in every frame by comparing rendered and observed masks (paper, Eq. 5).

    A clip without ``segments`` is treated as one stable grasp. The segments of a timeline are solved together, with one
    scale. Either way, every frame gets a pose, unless ``options.every_frame`` is False.

    Args:
        clip: the hand in each frame, the object's mesh and the camera, from ``read_clip`` or made as a ``Clip``. If
            ``clip.scale`` is ``free``, the object's size is estimated, too.
        masks: masks of the object in all frames of the clip, from ``read_masks`` or made as ``Masks``. If None, they
            are read from the clip's folder, for the frames that are used.
        options: the method, the number of initial poses, whether inputs are repaired, and more (``Options``); None for
            the defaults. ``options.frames`` frames, sampled evenly, are fitted together. Each other frame is then
            fitted to its own mask.
        progress: True for a bar on a terminal or in a notebook; or a function that is called after each stage with its
            name and the fraction of the work that is done, 0 to 1.
        threads: number of threads for one clip. The result is the same to the last bit for any number. For many clips,
            run several processes with one thread each: that is faster. Timelines use one thread.

    Returns:
        The object's pose in the hand in each frame, its scale, how the fit ended, what the checks found, the
        assumptions behind the result and the probability that it is right.

    Raises:
        UsageError: the masks have another number or size of frames than the clip, or the clip is a timeline and
            ``options.method`` is not ``soft-hinge``.
        InputError: the clip's data is impossible (``read_clip`` lists the rules), the object is visible in fewer than
            two frames, or no segment of a timeline can be solved.
        GetagripError: the object is out of view in every hypothesis, so there is nothing to compare with the masks.
    """
    options = options or Options()
    with progress_callback(progress, clip.name) as on_stage:
        if clip.segments:
            return run_pipeline(TIMELINE_STEPS, clip, masks, options, on_stage, threads).made_of(clip, masks)
        return run_pipeline(GRASP_STEPS, clip, masks, options, on_stage, threads).made_of(clip, masks)


def _search_hypotheses(footage: TimelineInputs, clock: Clock) -> Chain:
    """Search for the hypotheses of all segments that are best together.

    Where there are none, the error also says what is unusual about the inputs.
    """
    try:
        return choose_hypotheses(footage, support=True, on_stage=clock)
    except GetagripError as error:
        of_clip = [check for check in INPUT_CHECKS.working().values() if check.name not in GRASP_CHECKS]
        original = footage.source.original
        clip = replace(footage.clip, hand=original.hand, world=original.world)
        serious = [finding for finding in run_checks(of_clip, Evidence(clip, footage.masks))[1] if finding.serious]
        if not serious:
            raise
        raise GetagripError("; ".join(map(str, (error, *serious)))) from error


def _fill_timeline_frames(footage: TimelineInputs, chain: Chain, clock: Clock) -> TimelineAnswer:
    """Fill the motion over all segments and between them."""
    motion, clip = fill_all_frames(footage, chain, clock), footage.clip
    T_cam_hand = motion.T_cam_hand
    T_hand_obj = se3.inverse(T_cam_hand) @ motion.T_cam_obj
    iou = np.where(footage.shown, image_iou(clip.with_hand_at(T_cam_hand), footage.masks, T_hand_obj, 1.0), np.nan)
    return TimelineAnswer(
        track=SolutionTrack(clip.frames, tuple(motion.kind), T_cam_hand, T_hand_obj[None], None, iou),
        scale=np.array([footage.scale]),
        energy=np.array([chain.energy]),
        next_best=chain.next_best,
        status=Status.JOINT,
        terms={},
        axis=None,
        warp=None,
        T_cam_other_hand=motion.T_cam_other_hand,
        notes=(*_notes_of_grasps(clip, motion, footage.some.notes), *footage.some.notes),
        motion=motion,
    )


def _notes_of_grasps(clip: Clip, motion: TimelineMotion, known: Sequence[str]) -> list[str]:
    """Say what is to be known about grasps beyond what is ``known``, and which could not be solved as such."""
    out, masks_only = list[str](), list[str]()
    for segment in (segment for segment in clip.segments if segment.state == "grasp"):
        track = motion.grasps.get(segment.first)
        if track is not None:
            first = clip.frames[track.solutions.grasp.rows[0]]
            out += [f"grasp from {first}: {note}" for note in track.solutions.problem.notes if note not in known]
            continue
        name = f"grasp from {clip.frames[segment.first]} ({segment.side} hand)"
        has_hand = clip.hand_known(segment.side)[segment.rows].any()
        why = (
            "the object is visible in fewer than two frames"
            if has_hand
            else f"the clip has no {segment.side} hand there"
        )
        masks_only.append(f"{name}: {why}, so it was tracked by its masks as in unstable contact, without an axis")
    return [*out, *masks_only]


TIMELINE_STEPS = PipelineSteps(TimelineInputs.of, _search_hypotheses, _fill_timeline_frames, judge_timeline, stages=7)
