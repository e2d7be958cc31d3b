"""From a clip to the object in every frame: timelines by all of their segments, other clips as one stable grasp."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from getagrip.checks import INPUT_CHECKS, Evidence, run_checks
from getagrip.checks.of_timeline import GRASP_CHECKS
from getagrip.clip import Clip, Masks
from getagrip.errors import GetagripError
from getagrip.fitting.every_frame import SolutionTrack
from getagrip.fitting.grasp import GRASP_STEPS
from getagrip.fitting.image_iou import image_iou
from getagrip.fitting.options import Options
from getagrip.fitting.pipeline import Clock, PipelineSteps, run_pipeline
from getagrip.geometry import se3
from getagrip.io.named import check_arguments
from getagrip.io.terminal import Progressed, progress_callback
from getagrip.result import Reconstruction, Status
from getagrip.timelines.footage import TimelineInputs
from getagrip.timelines.joint import Chain, choose_hypotheses, fill_all_frames
from getagrip.timelines.judge import TimelineAnswer, judge_timeline
from getagrip.timelines.motion import TimelineMotion


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
