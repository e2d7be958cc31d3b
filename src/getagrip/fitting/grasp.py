"""The steps of one stable grasp (paper, Sec. 3.3), by whichever method: from a clip to the object in the hand."""

from __future__ import annotations

from dataclasses import dataclass, replace

from getagrip.checks import Evidence, examine, input_checks, read_signs, result_checks
from getagrip.clip import Clip
from getagrip.errors import GetagripError, InputError
from getagrip.finding import Finding
from getagrip.fitting.cut_off import cut_off
from getagrip.fitting.every_frame import Track, at_every_frame, at_sampled_frames
from getagrip.fitting.judge import hand_alternatives, probabilities, solved_of
from getagrip.fitting.methods import METHODS
from getagrip.fitting.outlier_masks import fit_without_outliers
from getagrip.fitting.pipeline import Answer, Clock, Input, Judgement, Steps
from getagrip.fitting.problem import MethodResult, Problem, prepare


@dataclass(frozen=True)
class Prepared:
    """A grasp, prepared for the search.

    Attributes:
        problem: the clip at the frames that are used.
        clip: the same frames, with the hand before it was corrected.
        checks: what the checks of the input have measured, by name.
        findings: what is unusual about the input.
    """

    source: Input
    problem: Problem
    clip: Clip
    checks: dict[str, float]
    findings: tuple[Finding, ...]


@dataclass(frozen=True)
class Found:
    """The solutions of a method.

    Attributes:
        problem: the clip at the frames without outlier masks, with the fitted mesh.
        result: the solutions.
        sampled: the solutions at the problem's frames.
    """

    problem: Problem
    result: MethodResult
    sampled: Track


def _prepare(source: Input) -> Prepared:
    """Choose frames, correct the hand, crop the masks; check the input."""
    problem = prepare(source.clip, source.options, source.threads)
    index = source.clip.index_of(problem.clip.frames)
    clip = replace(problem.clip, hand=source.clip.hand.take(index))
    checks, findings = examine(input_checks(), Evidence(clip, problem.input_masks, glitches=source.glitches))
    return Prepared(source, problem, clip, checks, findings)


def _search(prepared: Prepared, clock: Clock) -> Found:
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
    return Found(problem, found, sampled)


def _fit_all_frames(prepared: Prepared, found: Found, clock: Clock) -> Answer:
    """Extend the solutions to all frames that the options ask for."""
    source, result, problem = prepared.source, found.result, found.problem
    clip = source.clip if problem.options.every_frame else prepared.clip
    track = at_every_frame(clip.warped(result.warp), problem, result, found.sampled)
    clock("every frame")
    return Answer(
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
        cut_off=cut_off(problem, result),
    )


def _judge(prepared: Prepared, found: Found, answer: Answer) -> Judgement:
    """Run the checks, and compute signs and probabilities."""
    source = prepared.source
    solved = solved_of(source.clip, found.problem, found.result, found.sampled, answer.track)
    checks, after = examine(result_checks(), solved)
    findings, signs = (*prepared.findings, *after), read_signs(solved)
    hand, terms = found.result.hand, {*found.result.terms}
    terms = terms if hand is None else terms | {*hand.energy}
    right = probabilities(source.clip, source.options, signs, findings, terms)
    return Judgement(prepared.checks | checks, findings, signs, right, hand_alternatives(found.problem, found.result))


GRASP = Steps(_prepare, _search, _fit_all_frames, _judge, stages=8)
