"""The steps of one stable grasp (paper, Sec. 3.3), by whichever method: from a clip to the object in the hand."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from getagrip.checks import Evidence, compute_features, input_checks, result_checks, run_checks
from getagrip.clip import Clip
from getagrip.errors import GetagripError, InputError
from getagrip.finding import Finding
from getagrip.fitting.every_frame import SolutionTrack, at_sampled_frames, extend_to_every_frame
from getagrip.fitting.judge import hand_alternatives, probabilities, solved_of
from getagrip.fitting.methods import METHODS
from getagrip.fitting.outlier_masks import fit_without_outliers
from getagrip.fitting.pipeline import Clock, FrameSolutions, Judgement, PipelineSteps, RepairedInput
from getagrip.fitting.problem import MethodResult, Problem, prepare_problem
from getagrip.fitting.solve import minimise
from getagrip.result import Status

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
