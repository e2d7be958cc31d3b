"""From a clip and its masks to the object in the hand, in every frame (paper, Sec. 3.3), by whichever method."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, replace

import numpy as np
from threadpoolctl import threadpool_limits

from getagrip.checks import INPUT_CHECKS, LEAST_IOU, Evidence, examine
from getagrip.clip import Clip, Masks, check_clip, check_masks
from getagrip.errors import GetagripError, InputError, UsageError
from getagrip.finding import Finding
from getagrip.fitting.every_frame import Track, at_every_frame, at_sampled_frames
from getagrip.fitting.judge import judge, probabilities
from getagrip.fitting.methods import METHODS
from getagrip.fitting.options import Options
from getagrip.fitting.outlier_masks import fit_without_outliers
from getagrip.fitting.problem import MethodResult, Problem, prepare
from getagrip.fitting.tracker_glitches import repair_hand
from getagrip.provenance import assumptions
from getagrip.result import Candidates, Reconstruction, Status

AMBIGUOUS = 1.05
"""A distinct candidate within this factor of the best energy makes a result ambiguous."""

SCALE_GUESSED = "the scale {:.3f} is a guess from the masks and the hand's size, not a measurement"
SHAPE_GUESSED = "the object's shape is a guess from the masks: the mesh leaves contours that no pose explains"
"""A note where the mesh was not taken as it is given."""

UNEXPLAINED = "failed: the best pose meets the masks with a mean IOU of {:.2f} only; nothing is known of the object"
"""The message of a result whose mean IOU is below ``LEAST_IOU``, however the minimisation ended."""


def reconstruct(
    clip: Clip,
    masks: Masks | None = None,
    options: Options | None = None,
    progress: Callable[[str, float], None] | None = None,
    threads: int = 1,
) -> Reconstruction:
    """Reconstruct one stable grasp: repair the hand, prepare, search, fit all frames, judge.

    Arguments and errors are those of ``getagrip.reconstruct``. BLAS runs on one thread meanwhile, in the whole process:
    the matrices are small, and with several threads that wait for busy cores a clip takes ten times as long.
    """
    options = options or Options()
    if threads < 1:
        raise UsageError(f"threads must be 1 or more (got {threads})")
    check_clip(clip)
    if masks is not None:
        check_masks(clip, masks)
    with threadpool_limits(1, user_api="blas"):
        clock = Clock(progress)
        steady, glitches = repair_hand(clip, options)
        light = steady.light()
        problem = prepare(light, masks, options, threads)
        clock("prepare")
        evidence = Evidence(light.take(light.index_of(problem.clip.frames)), problem.input_masks, glitches=glitches)
        measured, findings = examine(INPUT_CHECKS, evidence)
        clock("check of the input")
        problem, found = _searched(problem, clock, findings)
        sampled, whole = _followed(light, masks, evidence, problem, found, clock)
        judgement = judge(light, problem, found, sampled, whole)
        clock("check of the result")
    findings = (*findings, *judgement.findings)
    right = probabilities(clip, options, judgement.signs, findings)
    moved = problem.trust.hand_refined or bool(glitches and glitches.frames)
    result = _reconstruction(problem, options, found, whole, moved, clock.seconds())
    return replace(
        result,
        notes=(*result.notes, *light.mesh.stands_for(clip.mesh, "fitted")),
        findings=findings,
        checks=measured | judgement.checks,
        signs=judgement.signs,
        probability_right=right["hand"],
        probability_right_in_camera=right["camera"],
    )


def _searched(problem: Problem, clock: Clock, findings: tuple[Finding, ...]) -> tuple[Problem, MethodResult]:
    """What the method finds, and the problem in the frames whose masks are believed.

    Where it fails, the error also says what was unusual about its inputs.
    """
    method = METHODS[problem.options.method]
    try:
        if method.checks_masks and problem.options.masks == "checked":
            return fit_without_outliers(problem, lambda some: method.fit(some, clock))
        found = method.fit(problem, clock)
        return problem.warped(found.warp), found
    except InputError:
        raise
    except GetagripError as error:
        raise GetagripError("; ".join(map(str, (error, *findings)))) from error


def _followed(
    clip: Clip, masks: Masks | None, it: Evidence, problem: Problem, found: MethodResult, clock: Clock
) -> tuple[Track, Track]:
    """The solutions in the frames that were fitted together, and in all that the options ask for."""
    sampled = at_sampled_frames(problem, found)
    clock("finish")
    footage = (clip, masks) if problem.options.every_frame else (it.clip, it.masks)
    whole = at_every_frame(footage[0].warped(found.warp), footage[1], problem, found, sampled)
    clock("every frame")
    return sampled, whole


def _reconstruction(
    problem: Problem,
    options: Options,
    found: MethodResult,
    track: Track,
    hand_moved: bool,
    seconds: dict[str, float],
) -> Reconstruction:
    """A method's solutions, with all that is known about how they were found; ``options`` are those that were given."""
    clip, energy = problem.clip, found.energy
    scale = float(found.poses.scale[0])
    shown = np.count_nonzero(~np.isnan(track.iou)) + len(track.outliers)
    mean_iou = float(np.nansum(track.iou)) / shown  # a doubted mask is one that is not explained
    explained = mean_iou >= LEAST_IOU
    guesses = {}
    if clip.scale == "free":
        guesses["scale"] = SCALE_GUESSED.format(scale)
    if found.warp is not None:
        guesses["shape"] = SHAPE_GUESSED
    axis = None if found.axis is None or track.angle is None else replace(found.axis, angle=track.angle)
    return Reconstruction(
        clip=clip.name,
        method=options.method,
        frames=track.frames,
        frame_kind=track.kind,
        T_hand_obj=track.T_hand_obj[0],
        scale=scale,
        iou=track.iou,
        axis=axis,
        candidates=Candidates(track.T_hand_obj, found.poses.scale, energy),
        energy={"total": float(energy[0]), **found.terms},
        status=found.status if explained else Status.MISFIT,
        message=found.status.sentence if explained else UNEXPLAINED.format(mean_iou),
        ambiguous=bool(len(energy) > 1 and energy[1] < AMBIGUOUS * energy[0]),
        seconds=seconds,
        options=asdict(options),
        seed=options.seed,
        T_cam_hand=track.T_cam_hand if hand_moved else None,
        warp=found.warp,
        notes=(*problem.notes, *guesses.values()),
        assumptions=assumptions(clip.provenance) | guesses,
    )


class Clock:
    """Seconds per stage, and the caller's progress."""

    STAGES = (
        "prepare",
        "check of the input",
        "coarse",
        "middle",
        "fine",
        "finest",
        "finish",
        "every frame",
        "check of the result",
    )

    def __init__(self, progress: Callable[[str, float], None] | None) -> None:
        self.progress, self.spent, self.since = progress, dict[str, float](), time.perf_counter()

    def __call__(self, stage: str) -> None:
        now = time.perf_counter()
        self.spent[stage], self.since = self.spent.get(stage, 0.0) + now - self.since, now
        if self.progress:
            self.progress(stage, len(self.spent) / len(self.STAGES))

    def seconds(self) -> dict[str, float]:
        return {"total": sum(self.spent.values()), **self.spent}
