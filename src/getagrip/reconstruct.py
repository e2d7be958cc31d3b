"""From a clip to the object in the hand in every frame: the front room, in which every reconstruction can be followed.

``reconstruct`` repairs the hand, then takes the steps of a ``Pipeline``: of a ``StableGrasp``, the paper's problem
(Sec. 3.3), or of a ``Timeline``, whose segments are solved together. docs/reading.md walks through both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import ClassVar, Protocol

import numpy as np
from threadpoolctl import threadpool_limits

from getagrip.checks import INPUT_CHECKS, Evidence, compute_features, input_checks, result_checks, run_checks
from getagrip.checks.timeline_checks import GRASP_CHECKS
from getagrip.clip import Clip, Masks, check_clip, check_masks, masks_in_memory, read_masks, with_masks
from getagrip.clip.views import View, from_best_view, with_packed_views, with_views
from getagrip.compiling import COMPILATION_MESSAGE, compile_once
from getagrip.errors import GetagripError, InputError, UsageError, check_arguments
from getagrip.fitting.hand.joint_hand_object import restore_object_size, with_hand_size
from getagrip.fitting.methods import METHODS
from getagrip.fitting.methods.all_frames import refit_hinge
from getagrip.fitting.motion import Soft
from getagrip.fitting.options import Options
from getagrip.fitting.pipeline import (
    Clock,
    FrameSolutions,
    Judgement,
    RepairedInput,
    make_reconstruction,
    repair_input,
)
from getagrip.fitting.problem import MethodResult, Problem, prepare_problem
from getagrip.fitting.solver.solve import minimise
from getagrip.fitting.stages.confidence import VIEWS_SIGN, hand_alternatives, probabilities, solved_of
from getagrip.fitting.stages.distance import distance_interval
from getagrip.fitting.stages.loose_ends import meets_firm_frames, without_loose_ends
from getagrip.fitting.stages.remaining_frames import SolutionTrack, at_sampled_frames, extend_to_every_frame
from getagrip.fitting.stages.robust_masks import fit_without_outliers, image_iou
from getagrip.fitting.stages.surface_motion import turn_with_surface
from getagrip.fitting.stages.texture import prefer_texture
from getagrip.fitting.stages.view_agreement import is_in_the_way, suspect_view
from getagrip.geometry import se3
from getagrip.io.terminal import Progressed, progress_callback
from getagrip.result import Reconstruction, Status
from getagrip.timelines.joint import Chain, choose_hypotheses, fill_all_frames
from getagrip.timelines.observations import TimelineInputs
from getagrip.timelines.timeline_confidence import TimelineAnswer, judge_timeline
from getagrip.timelines.transitions import TimelineMotion

MAX_MASK_PIXELS_IN_MEMORY = 2**28
"""Maximum pixels of all frames of a clip whose masks are read at once, a bit each; else frame by frame, some twice."""
CONVERGENCE_CHECK_STAGE = 256, 8
"""Resolution [px] and iterations of the usual search's last stage: as many again are made where it was cut off."""


class Pipeline(Protocol):
    """The steps of a reconstruction after the hand's repair, in their order; construction prepares the search.

    Search and fit call the clock with the name of every stage that has ended, ``stages`` times in all.
    """

    stages: ClassVar[int]

    def __init__(self, source: RepairedInput) -> None:
        """Prepare the search. Raises ``InputError`` for what no clip can be."""

    def search(self, clock: Clock) -> None:
        """Find solutions at some of the frames. Raises ``GetagripError`` where nothing can be rendered."""

    def fit_all_frames(self, clock: Clock) -> FrameSolutions:
        """Extend the best solutions to all frames."""

    def judge(self) -> Judgement:
        """Judge the answer without ground truth."""


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
    if threads < 1:
        raise UsageError(f"threads must be 1 or more (got {threads})")
    options, given = options or Options(), clip
    with progress_callback(progress, clip.name) as on_stage:
        check_clip(clip)
        if masks is not None:
            check_masks(clip, masks)
            clip = with_masks(clip, masks.in_bits)
        # The paper's method has one view.
        clip, view = (with_views(clip, []), None) if options.as_published else from_best_view(with_packed_views(clip))
        if (
            masks_in_memory(clip) is None
            and options.every_frame
            and len(clip) * clip.size[0] * clip.size[1] <= MAX_MASK_PIXELS_IN_MEMORY
        ):
            clip = with_masks(clip, read_masks(clip))  # each file once: for its object, its fit and its frame
        clip = with_hand_size(clip, options)
        compile_once(lambda: on_stage and on_stage(COMPILATION_MESSAGE, 0.0))
        kind: type[Pipeline] = Timeline if clip.segments else StableGrasp
        with threadpool_limits(
            1, user_api="blas"
        ):  # small matrices: threads that wait for busy cores cost ten times as much
            clock = Clock(on_stage, kind.stages)
            source = repair_input(clip, options, threads)
            pipeline = kind(source)
            clock("prepare")
            pipeline.search(clock)
            answer = pipeline.fit_all_frames(clock)
            if (firm := without_loose_ends(source, answer)) is not None:
                in_firm_frames = kind(firm)
                in_firm_frames.search(clock)
                found = in_firm_frames.fit_all_frames(clock)
                if meets_firm_frames(found, answer):
                    source, pipeline, answer = firm, in_firm_frames, found
            judgement = pipeline.judge()
            clock("check of the result")
        result = make_reconstruction(source, answer, judgement, clock.seconds())
        result = restore_object_size(result, source.original)
        result = result if view is None else _in_first_camera(result, source.original, view)
        known = distance_interval(clip, result)
        return replace(result, distance_interval_mm=known).made_of(given, masks)


def _in_first_camera(result: Reconstruction, clip: Clip, view: View) -> Reconstruction:
    """Return the result of a clip that was fitted from a further view, with poses in the first camera's frame."""
    assert result.T_cam_hand is not None
    T = view.T_cam_view[clip.index_of(result.frames)]
    note = f"fitted from the view {view.name}, which shows the object in more frames; IOU is of that view"
    return replace(result, T_cam_hand=T @ result.T_cam_hand, notes=(*result.notes, note))


class StableGrasp:
    """One stable grasp (paper, Sec. 3.3), by whichever method.

    Attributes:
        source: the clip, its hand repaired.
        problem: the clip at the frames that are used; after the search without outlier masks, with the fitted mesh.
        clip: the same frames as prepared, with the hand before it was corrected.
        checks: what the checks of the input have measured, by name.
        findings: what is unusual about the input.
        found: the method's solutions.
        sampled: these solutions at the problem's frames.
        answer: the best of them in every frame.
    """

    stages: ClassVar[int] = 8
    found: MethodResult
    sampled: SolutionTrack
    answer: FrameSolutions

    def __init__(self, source: RepairedInput) -> None:
        self.source = source
        self.prepare()

    def prepare(self, views_left_out: tuple[str, ...] = ()) -> None:
        """Choose frames, correct the hand, crop the masks; check the input."""
        source = self.source
        self.problem = prepare_problem(source.clip, source.options, source.threads, views_left_out)
        index = source.clip.index_of(self.problem.clip.frames)
        self.clip = replace(self.problem.clip, hand=source.clip.hand.take(index))
        evidence = Evidence(self.clip, self.problem.input_masks, glitches=source.glitches)
        self.checks, self.findings = run_checks(input_checks(), evidence)

    def search(self, clock: Clock) -> None:
        """Run the method in the frames without outlier masks, and without further views that are in the way.

        Where it fails, the error also says what was unusual about its inputs.
        """
        self.fit(clock)
        while (view := suspect_view(self.problem, self.found)) is not None:
            joint = self.problem, self.found, self.clip, self.checks, self.findings
            self.prepare((*self.problem.trust.views_left_out, view))
            self.fit(clock)
            if not is_in_the_way(view, joint[1], self.found):
                self.problem, self.found, self.clip, self.checks, self.findings = joint
                break
        self.found = prefer_texture(self.problem, self.found)
        self.sampled = at_sampled_frames(self.problem, self.found)
        clock("finish")

    def fit(self, clock: Clock) -> None:
        """Run the method on all views that are not left out."""
        method, problem = METHODS[self.problem.options.method], self.problem
        try:
            if method.checks_masks and problem.options.masks == "checked":
                self.problem, self.found = fit_without_outliers(
                    problem,
                    lambda some: method.fit(some, clock),
                    lambda some, found, frames: refit_hinge(some, found, frames, clock),
                )
            else:
                self.found = method.fit(problem, clock)
                self.problem = problem.as_found(self.found)
        except InputError:
            raise
        except GetagripError as error:
            raise GetagripError("; ".join(map(str, (error, *self.findings)))) from error

    def fit_all_frames(self, clock: Clock) -> FrameSolutions:
        """Extend the solutions to all frames that the options ask for; turn a soft hinge as its surface moves."""
        problem, found = self.problem, self.found
        clip = (self.source.clip if problem.options.every_frame else self.clip).warped(found.warp)
        track = extend_to_every_frame(clip, problem, found, self.sampled)
        turned: tuple[str, ...] = ()
        if isinstance(found.motion, Soft):  # the motions of other methods do not allow such turns
            track, turned = turn_with_surface(clip, problem, track, float(found.poses.scale[0]))
        clock("every frame")
        self.answer = FrameSolutions(
            track=track,
            scale=found.poses.scale,
            energy=found.energy,
            next_best=float(found.energy[1]) if len(found.energy) > 1 else float("inf"),
            status=found.status,
            terms=found.terms,
            axis=None if found.axis is None or track.angle is None else replace(found.axis, angle=track.angle),
            warp=found.warp,
            T_cam_other_hand=None,
            notes=(*problem.notes, *turned),
            hand=found.hand,
            cut_off=unconverged_motion(problem, found),
        )
        return self.answer

    def judge(self) -> Judgement:
        """Run the checks, and compute signs and probabilities."""
        problem, found, source = self.problem, self.found, self.source
        solved = solved_of(source.clip, problem, found, self.sampled, self.answer.track)
        checks, after = run_checks(result_checks(), solved)
        findings, signs = (*self.findings, *after), compute_features(solved)
        signs |= {VIEWS_SIGN: 1.0 + len(problem.views)} if problem.views else {}
        terms = {*found.terms} if found.hand is None else {*found.terms, *found.hand.energy}
        right = probabilities(source.clip, source.options, signs, findings, terms)
        return Judgement(self.checks | checks, findings, signs, right, hand_alternatives(problem, found))


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


class Timeline:
    """A clip of several segments, from table to hand and back: all of them together, with one scale.

    Attributes:
        inputs: the clip and its masks, and problems at any of its frames.
        chain: the hypotheses of all segments that are best together.
        answer: the motion over all segments and between them.
    """

    stages: ClassVar[int] = 7
    chain: Chain
    answer: TimelineAnswer

    def __init__(self, source: RepairedInput) -> None:
        """Read the masks that show the object."""
        self.inputs = TimelineInputs.of(source)

    def search(self, clock: Clock) -> None:
        """Search for the hypotheses of all segments that are best together.

        Where there are none, the error also says what is unusual about the inputs.
        """
        try:
            self.chain = choose_hypotheses(self.inputs, support=True, on_stage=clock)
        except GetagripError as error:
            of_clip = [check for check in INPUT_CHECKS.working().values() if check.name not in GRASP_CHECKS]
            original = self.inputs.source.original
            clip = replace(self.inputs.clip, hand=original.hand, world=original.world)
            serious = [found for found in run_checks(of_clip, Evidence(clip, self.inputs.masks))[1] if found.serious]
            if not serious:
                raise
            raise GetagripError("; ".join(map(str, (error, *serious)))) from error

    def fit_all_frames(self, clock: Clock) -> FrameSolutions:
        """Fill the motion over all segments and between them."""
        inputs, chain = self.inputs, self.chain
        motion, clip = fill_all_frames(inputs, chain, clock), inputs.clip
        T_cam_hand = motion.T_cam_hand
        T_hand_obj = se3.inverse(T_cam_hand) @ motion.T_cam_obj
        iou = np.where(inputs.shown, image_iou(clip.with_hand_at(T_cam_hand), inputs.masks, T_hand_obj, 1.0), np.nan)
        self.answer = TimelineAnswer(
            track=SolutionTrack(clip.frames, tuple(motion.kind), T_cam_hand, T_hand_obj[None], None, iou),
            scale=np.array([inputs.scale]),
            energy=np.array([chain.energy]),
            next_best=chain.next_best,
            status=Status.JOINT,
            terms={},
            axis=None,
            warp=None,
            T_cam_other_hand=motion.T_cam_other_hand,
            notes=(*_notes_of_grasps(clip, motion, inputs.some.notes), *inputs.some.notes),
            motion=motion,
        )
        return self.answer

    def judge(self) -> Judgement:
        """Judge the clip by its checks, and each of its grasps."""
        return judge_timeline(self.inputs, self.chain, self.answer)


def _notes_of_grasps(clip: Clip, motion: TimelineMotion, known: Sequence[str]) -> list[str]:
    """List the notes of a timeline's grasps that are not ``known`` yet, and the grasps that could not be solved."""
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
