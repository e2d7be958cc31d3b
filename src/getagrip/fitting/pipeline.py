"""Data that the steps of ``getagrip.reconstruct`` hand on: the repaired input, solutions, judgement, result."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.checks import MIN_MEAN_IOU
from getagrip.checks.calibration import Where
from getagrip.checks.evidence import Glitches
from getagrip.clip import Clip
from getagrip.fitting.hand.hand_error_model import SolvedHand
from getagrip.fitting.hand.refine_hand import repair_hand
from getagrip.fitting.options import Options
from getagrip.fitting.stages.remaining_frames import SolutionTrack
from getagrip.geometry.warp import Warp
from getagrip.provenance import assumptions
from getagrip.result import Axis, Candidates, Reconstruction, SegmentResult, Status
from getagrip.result.findings import Finding, Probability

AMBIGUOUS_ENERGY_RATIO = 1.05
"""A distinct solution within this factor of the best energy makes a result ambiguous."""

SCALE_ASSUMPTION_NOTE = "the scale {:.3f} is estimated from the masks and the hand's size, not measured"
STATED_SIZE_NOTE = "the size is stated for a guessed shape, which fits best with {:.3f} times that size"
SHAPE_ASSUMPTION_NOTE = (
    "the object's shape is an assumption from the masks: no pose of the mesh explains their contours"
)
"""A note where the mesh was not taken as it is given."""
PROFILE_ASSUMPTION_NOTE = (
    SHAPE_ASSUMPTION_NOTE + "; the profile of its body is fitted: radii of {:.3g} to {:.3g} times the built-in shape's"
)
"""The note where the radii of a body of revolution were fitted, too."""

RESULT_MISFIT_MESSAGE = "failed: even the best pose has a mean mask IOU of only {:.2f}; the object's pose is unknown"
"""The message of a result whose mean IOU is below ``MIN_MEAN_IOU``, however the minimisation ended."""
PARTIAL_MISFIT_MESSAGE = "partly failed: low mask IOU in the segments {}"
"""The message of a result some of whose segments are below ``MIN_MEAN_IOU``."""
CONVERGED_MESSAGE = "converged to {:.1f} mm: further iterations would move the object by no more"
ITERATION_LIMIT_MESSAGE = (
    "stopped at the iteration limit: further iterations would move the object by {:.1f} mm; --thorough, in Python "
    "Options(thorough=True), goes on longer"
)
"""The messages of a fit that ended at the iteration limit."""
CONVERGENCE_TOLERANCE_M = 1e-4
"""A fit whose object further iterations would move by no more has converged [m]."""
CONVERGENCE_TOLERANCE_DIAMETERS = 0.02
"""Share of the diameter up to which a fit at the iteration limit is near its end: a pose is right within 0.1."""


@dataclass(frozen=True)
class RepairedInput:
    """A clip to reconstruct, its hand repaired.

    Attributes:
        original: the clip with the input hand; its mesh is not too large to fit (``Clip.light``).
        clip: the same with its hand between its neighbours where it jumps.
        glitches: where the hand jumps; None where nobody looked.
        notes: what is to be known about the mesh.
    """

    original: Clip
    clip: Clip
    options: Options
    threads: int = 1
    glitches: Glitches | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class FrameSolutions:
    """The answer in every frame that the options ask for.

    Attributes:
        track: the K best distinct solutions in these frames, the best first.
        scale: (K,) scale of the mesh in each.
        energy: (K,) energy of each [px^2 of the 256-pixel crop].
        next_best: energy of the best distinct solution but one; infinite where there is none.
        status: how the minimisation ended.
        terms: energy of the best, per term.
        axis: axis of the best, where it has one, with its angles in these frames.
        warp: what was made of the mesh.
        T_cam_other_hand: (T, 4, 4) poses of a timeline's other hand.
        notes: what is to be known about it.
        hand: the hand as it was solved with the object; None where it was not.
        cut_off: how far further iterations would move the object [m]; NaN where that is not known.
    """

    track: SolutionTrack
    scale: Float[ndarray, "K"]
    energy: Float[ndarray, "K"]
    next_best: float
    status: Status
    terms: Mapping[str, float]
    axis: Axis | None
    warp: Warp | None
    T_cam_other_hand: Float[ndarray, "T 4 4"] | None
    notes: tuple[str, ...]
    hand: SolvedHand | None = field(default=None, kw_only=True)
    cut_off: float = field(default=float("nan"), kw_only=True)


@dataclass(frozen=True)
class Judgement:
    """The judgement of a result without ground truth.

    Attributes:
        checks: what each check has measured, by its name.
        findings: what is unusual, about the inputs first.
        signs: what is known about whether it is right, by name.
        right: how probable that is, in the hand and in the camera; None where it is not known.
        hand_alternatives: where the hand may be instead; None where it was not solved with the object.
        segments: what was found in each segment of a timeline.
        failed: the segments that hardly meet their masks, in words; empty: none.
    """

    checks: dict[str, float]
    findings: tuple[Finding, ...]
    signs: dict[str, float] = field(default_factory=dict)
    right: Mapping[Where, Probability | None] = field(default_factory=dict)
    hand_alternatives: Float[ndarray, "M 4 4"] | None = None
    segments: tuple[SegmentResult, ...] = ()
    failed: str = ""


class Clock:
    """Seconds per stage, and the caller's progress."""

    def __init__(self, progress: Callable[[str, float], None] | None, stages: int) -> None:
        self.progress, self.stages = progress, stages
        self.spent, self.since = dict[str, float](), time.perf_counter()

    def __call__(self, stage: str) -> None:
        now = time.perf_counter()
        self.spent[stage], self.since = self.spent.get(stage, 0.0) + now - self.since, now
        if self.progress:
            self.progress(stage, len(self.spent) / self.stages)

    def seconds(self) -> dict[str, float]:
        return {"total": sum(self.spent.values()), **self.spent}


def repair_input(clip: Clip, options: Options, threads: int = 1) -> RepairedInput:
    """Repair the hand's tracker glitches, and simplify a mesh that is too large."""
    light = clip.light()
    steady, glitches = repair_hand(light, options)
    return RepairedInput(light, steady, options, threads, glitches, tuple(light.mesh.stands_for(clip.mesh, "fitted")))


def make_reconstruction(
    source: RepairedInput, answer: FrameSolutions, judged: Judgement, seconds: dict[str, float]
) -> Reconstruction:
    """Make the result, with all that is known about how it was found."""
    clip, options = source.original, source.options
    track, energy, guesses = answer.track, float(answer.energy[0]), _list_assumptions(clip, answer)
    status, message = _final_status(answer, judged.failed, clip.mesh.diameter)
    return Reconstruction(
        clip=clip.name,
        method=options.method,
        frames=track.frames,
        frame_kind=track.kind,
        T_hand_obj=track.T_hand_obj[0],
        scale=float(answer.scale[0]),
        iou=track.iou,
        axis=answer.axis,
        candidates=Candidates(track.T_hand_obj, answer.scale, answer.energy),
        energy={"total": energy, **answer.terms},
        status=status,
        message=message,
        ambiguous=answer.next_best < AMBIGUOUS_ENERGY_RATIO * energy,
        seconds=seconds,
        options=asdict(options) | {"without": [*options.without]},  # as JSON has it
        seed=options.seed,
        T_cam_hand=track.T_cam_hand,
        hand_covariance=None if answer.hand is None else answer.hand.covariance,
        hand_alternatives=judged.hand_alternatives,
        hand_energy={} if answer.hand is None else dict(answer.hand.energy),
        T_cam_other_hand=answer.T_cam_other_hand,
        warp=answer.warp,
        notes=(*answer.notes, *guesses.values(), *source.notes),
        assumptions=assumptions(clip.provenance) | guesses,
        findings=judged.findings,
        checks=judged.checks,
        signs=judged.signs,
        probability_right=judged.right.get("hand"),
        probability_right_in_camera=judged.right.get("camera"),
        probability_looks_right=judged.right.get("image"),
        segments=judged.segments,
    )


def _list_assumptions(clip: Clip, answer: FrameSolutions) -> dict[str, str]:
    """Return what the fit had to assume, by topic."""
    guesses = {}
    scale = float(answer.scale[0])
    if clip.size_sigmas is not None and clip.size_sigmas[1] > 0.0:
        guesses["scale"] = STATED_SIZE_NOTE.format(scale ** (1.0 - clip.hand_size_share))
    elif clip.scale == "free" and clip.size_sigmas is None:
        guesses["scale"] = SCALE_ASSUMPTION_NOTE.format(scale)
    if answer.warp is not None:
        profile, guesses["shape"] = answer.warp.profile, SHAPE_ASSUMPTION_NOTE
        if profile is not None:
            times = profile.after / profile.before
            guesses["shape"] = PROFILE_ASSUMPTION_NOTE.format(times.min(), times.max())
    return guesses


def _final_status(answer: FrameSolutions, failed: str, diameter: float) -> tuple[Status, str]:
    """Return how it ended, in a word and a sentence.

    ``failed`` are the segments that hardly meet their masks, ``diameter`` is the mesh's [m].
    """
    track = answer.track
    shown = np.count_nonzero(~np.isnan(track.iou)) + len(track.outliers)
    mean_iou = float(np.nansum(track.iou)) / shown  # an outlier mask is not explained
    if mean_iou < MIN_MEAN_IOU:
        return Status.MISFIT, RESULT_MISFIT_MESSAGE.format(mean_iou)
    if failed:
        return Status.PARTLY_FAILED, PARTIAL_MISFIT_MESSAGE.format(failed)
    if answer.status is not Status.LIMIT or np.isnan(answer.cut_off):
        return answer.status, answer.status.sentence
    if answer.cut_off <= CONVERGENCE_TOLERANCE_DIAMETERS * answer.scale[0] * diameter:
        status = Status.CONVERGED if answer.cut_off <= CONVERGENCE_TOLERANCE_M else Status.LIMIT
        return status, CONVERGED_MESSAGE.format(1e3 * max(answer.cut_off, CONVERGENCE_TOLERANCE_M))
    return Status.LIMIT, ITERATION_LIMIT_MESSAGE.format(1e3 * answer.cut_off)
