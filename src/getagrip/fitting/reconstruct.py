"""From a clip and its masks to the object in the hand, in every frame (paper, Sec. 3.3), by whichever method."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, fields, replace

import numpy as np
from threadpoolctl import threadpool_limits

from getagrip.checks import INPUT_CHECKS, LEAST_IOU, RESULT_CHECKS, Evidence, Solved, examine, read_signs
from getagrip.checks.calibrated import CALIBRATIONS
from getagrip.checks.calibration import Where
from getagrip.clip import Clip, Masks, check_clip, check_masks
from getagrip.errors import GetagripError, InputError, UsageError
from getagrip.finding import Finding
from getagrip.fitting.doubted_masks import fitted_to_believed
from getagrip.fitting.every_frame import Track, at_every_frame, at_sampled_frames
from getagrip.fitting.hand_jumps import steady_hand
from getagrip.fitting.methods import METHODS
from getagrip.fitting.misfit import misfit
from getagrip.fitting.options import Options
from getagrip.fitting.other_size import other_size
from getagrip.fitting.pose_spread import pose_spread
from getagrip.fitting.problem import MethodResult, Problem, prepare
from getagrip.probability import Probability
from getagrip.result import Candidates, Reconstruction

AMBIGUOUS = 1.05
"""A distinct candidate within this factor of the best energy makes a result ambiguous."""

CHOICES = ("method", "inits", "init", "priors", "priors_only", "thorough", "seed", "frames", "every_frame")
"""Options that leave a calibration valid; it was made with the usual values of all."""

SHAPE_GUESSED = "the object's shape is a guess from the masks: the mesh leaves contours that no pose explains"
"""A note where the mesh was not taken as it is given."""

UNEXPLAINED = "failed: the best pose meets the masks with a mean IOU of {:.2f} only; nothing is known of the object"
"""The status of a result whose mean IOU is below ``LEAST_IOU``, however the minimisation ended."""


def reconstruct(
    clip: Clip,
    masks: Masks | None = None,
    options: Options | None = None,
    progress: Callable[[str, float], None] | None = None,
    threads: int = 1,
) -> Reconstruction:
    """Find the object's pose in the hand in every frame by comparing rendered and observed masks (Eq. 5).

    ``masks`` are those of the clip's frames; without them, those of the frames that are used are read from its folder.
    ``progress`` is called with the name of the stage that has ended and the fraction done. Raises ``UsageError`` for
    masks of another clip, ``InputError`` for what no clip can be (as ``read_clip`` does) and where the object is
    visible in fewer than two frames, and ``GetagripError`` when nothing can be rendered.

    ``options.frames`` frames, sampled evenly, are fitted together. The others follow from them (``every_frame``).

    ``threads`` share the hypotheses of a search. The result is the same to the last bit whatever their number. Two are
    worth it where one clip is waited for; many clips are done sooner by as many processes.

    BLAS runs on one thread meanwhile, in the whole process: the matrices are small, and with several threads that wait
    for busy cores a clip takes ten times as long.
    """
    options = options or Options()
    if threads < 1:
        raise UsageError(f"threads must be 1 or more (got {threads})")
    check_clip(clip)
    if masks is not None:
        check_masks(clip, masks)
    with threadpool_limits(1, user_api="blas"):
        clock = Clock(progress)
        clip, jumps = steady_hand(clip, options)
        whole_mesh, light = clip.mesh, clip.light()
        problem = prepare(light, masks, options, threads)
        clock("prepare")
        sampled = light.take(light.index_of(problem.clip.frames))
        given = Evidence(sampled, problem.given_masks, jumps=jumps)
        measured, findings = examine(INPUT_CHECKS, given)
        clock("check of the input")
        problem, found = _fitted(problem, clock, findings)
        clip, sampled = light.warped(found.warp), sampled.warped(found.warp)
        track, scale = at_sampled_frames(problem, found), float(found.poses.scale[0])
        clock("finish")
        footage = (clip, masks) if options.every_frame else (sampled, given.masks)
        whole = at_every_frame(*footage, problem, found, track)
        clock("every frame")
        deformed = 0.0 if found.warp is None else found.warp.displacement(light.mesh)
        solved = Solved(
            problem.clip, problem.given_masks, track.T_hand_obj[0], scale, whole.iou,
            doubted=whole.doubted, deformed=deformed / light.mesh.diameter, deformed_mm=1e3 * scale * deformed,
            candidates=Candidates(track.T_hand_obj, found.poses.scale, found.energy), axis=found.axis,
            hand_differing=problem.hand_differing,
            T_cam_hand_given=clip.hand.T_cam_hand[clip.index_of(problem.clip.frames)],
            misfit=misfit(problem.observation, found.terms["mask"] / len(problem.clip)),
            spread=pose_spread(problem, found), other_size=other_size(problem, found),
        )  # fmt: skip
        of_result, more = examine(RESULT_CHECKS, solved)
        signs = read_signs(solved)
        clock("check of the result")
    moved = problem.hand_corrected or bool(jumps and jumps.frames)
    result = _reconstruction(problem, options, found, whole, moved, clock.seconds())
    # No pixel tells a wrong focal length from another distance.
    camera_guessed = "guess" in str(clip.provenance.get("camera", "")).lower()
    return replace(
        result,
        notes=(*result.notes, *light.mesh.stands_for(whole_mesh, "fitted")),
        findings=(*findings, *more),
        checks=measured | of_result,
        signs=signs,
        probability_right=probability_right(options, signs, (*findings, *more)),
        probability_right_in_camera=None
        if camera_guessed
        else probability_right(options, signs, (*findings, *more), "camera"),
    )


def probability_right(
    options: Options, signs: Mapping[str, float], findings: Sequence[Finding], where: Where = "hand"
) -> Probability | None:
    """How probable it is that a result with such signs is right; ``findings`` are those about its input and itself.

    None where nothing is calibrated (``uncalibrated``).
    """
    calibration = CALIBRATIONS.get((options.method, where))
    if calibration is None or uncalibrated(options, findings):
        return None
    if not signs.keys() >= calibration.weights.keys():  # of a motion of one's own
        return None
    return calibration.probability(signs)


def uncalibrated(options: Options, findings: Sequence[Finding]) -> str:
    """Why there is no probability that a result is right, in words; empty where there is one.

    There is none for methods and energies other than those that were calibrated, for shorter searches, and where a
    finding is serious: wrong inputs were no part of the calibration.
    """
    if not any(method == options.method for method, _ in CALIBRATIONS):
        return f"none is calibrated for {options.method}"
    if options.inits < Options.inits:
        return f"none is calibrated for fewer than {Options.inits} initial poses"
    if options.priors_only:
        return "none is calibrated without uniform rotations among the initial poses"
    for option in fields(Options):
        if option.name not in CHOICES and (value := getattr(options, option.name)) != option.default:
            return f"none is calibrated with {option.name} {value}"
    if any(finding.serious for finding in findings):
        return "a finding is serious"
    return ""


def _fitted(problem: Problem, clock: Clock, findings: tuple[Finding, ...]) -> tuple[Problem, MethodResult]:
    """What the method finds, and the problem in the frames whose masks are believed.

    Where it fails, the error also says what was unusual about its inputs.
    """
    method = METHODS[problem.options.method]
    try:
        if method.checks_masks and problem.options.masks == "checked":
            return fitted_to_believed(problem, lambda some: method.fit(some, clock))
        found = method.fit(problem, clock)
        return problem.warped(found.warp), found
    except InputError:
        raise
    except GetagripError as error:
        raise GetagripError("; ".join(map(str, (error, *findings)))) from error


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
    shown = np.count_nonzero(~np.isnan(track.iou)) + len(track.doubted)
    mean_iou = float(np.nansum(track.iou)) / shown  # a doubted mask is one that is not explained
    guesses = []
    if clip.scale == "free":
        guesses.append(f"the scale {scale:.3f} is a guess from the masks and the hand's size, not a measurement")
    if found.warp is not None:
        guesses.append(SHAPE_GUESSED)
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
        status=found.status if mean_iou >= LEAST_IOU else UNEXPLAINED.format(mean_iou),
        ambiguous=bool(len(energy) > 1 and energy[1] < AMBIGUOUS * energy[0]),
        seconds=seconds,
        options=asdict(options),
        seed=options.seed,
        T_cam_hand=track.T_cam_hand if hand_moved else None,
        warp=found.warp,
        notes=(*problem.notes, *guesses),
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
