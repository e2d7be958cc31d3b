"""From a clip to the object in every frame: timelines by all of their segments, other clips as one stable grasp."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from getagrip.checks import INPUT_CHECKS, Evidence, examine
from getagrip.checks.of_timeline import WITH_HAND
from getagrip.clip import Clip, Masks
from getagrip.errors import GetagripError
from getagrip.fitting.every_frame import Track
from getagrip.fitting.grasp import GRASP
from getagrip.fitting.image_iou import image_iou
from getagrip.fitting.options import Options
from getagrip.fitting.pipeline import Clock, Steps, run
from getagrip.geometry import se3
from getagrip.result import Reconstruction, Status
from getagrip.timelines.footage import Footage
from getagrip.timelines.joint import Chain, choose_hypotheses, fill_all_frames
from getagrip.timelines.judge import TimelineAnswer, judge_timeline
from getagrip.timelines.motion import Motion


def reconstruct(
    clip: Clip,
    masks: Masks | None = None,
    options: Options | None = None,
    progress: Callable[[str, float], None] | None = None,
    threads: int = 1,
) -> Reconstruction:
    """Find the object's pose in the hand in every frame by comparing rendered and observed masks (paper, Eq. 5).

    A clip without segments is one stable grasp. Of a timeline all segments are solved together, by one scale, and every
    frame has an answer.

    Args:
        clip: hands, mesh and camera (``read_clip``, ``Clip``); a free scale is found, too.
        masks: masks of all of the clip's frames. Without them, those of the frames that are used are read from the
            clip's folder.
        options: method, number of initial poses, weights and use of the inputs; None for the defaults.
            ``options.frames`` frames, sampled evenly, are fitted together, and the others follow from them.
        progress: called with the name of the stage that has ended and the fraction done, 0 to 1.
        threads: number of threads that share the hypotheses of a search. The result is the same to the last bit
            whatever their number. Two are worth it where one clip is waited for; many clips are done sooner by as many
            processes. A timeline is solved on one.

    Returns:
        The object's poses in the hand, the assumptions behind them, and the probability that they are right.

    Raises:
        UsageError: masks of another clip, or a timeline and another method than the soft hinge.
        InputError: what no clip can be (as of ``read_clip``), an object that is visible in fewer than two frames, or a
            timeline of which no segment can be solved.
        GetagripError: nothing can be rendered.
    """
    options = options or Options()
    if clip.segments:
        return run(TIMELINE, clip, masks, options, progress, threads)
    return run(GRASP, clip, masks, options, progress, threads)


def _search(footage: Footage, clock: Clock) -> Chain:
    """Search for the hypotheses of all segments that are best together.

    Where there are none, the error also says what is unusual about the inputs.
    """
    try:
        return choose_hypotheses(footage, support=True, on_stage=clock)
    except GetagripError as error:
        of_clip = [check for check in INPUT_CHECKS.working().values() if check.name not in WITH_HAND]
        original = footage.source.original
        clip = replace(footage.clip, hand=original.hand, world=original.world)
        serious = [finding for finding in examine(of_clip, Evidence(clip, footage.masks))[1] if finding.serious]
        if not serious:
            raise
        raise GetagripError("; ".join(map(str, (error, *serious)))) from error


def _fit_all_frames(footage: Footage, chain: Chain, clock: Clock) -> TimelineAnswer:
    """Fill the motion over all segments and between them."""
    motion, clip = fill_all_frames(footage, chain, clock), footage.clip
    T_cam_hand = motion.T_cam_hand
    T_hand_obj = se3.inverse(T_cam_hand) @ motion.T_cam_obj
    iou = np.where(footage.shown, image_iou(clip.with_hand_at(T_cam_hand), footage.masks, T_hand_obj, 1.0), np.nan)
    return TimelineAnswer(
        track=Track(clip.frames, tuple(motion.kind), T_cam_hand, T_hand_obj[None], None, iou),
        scale=np.array([footage.scale]),
        energy=np.array([chain.energy]),
        next_best=chain.next_best,
        status=Status.JOINT,
        terms={},
        axis=None,
        warp=None,
        hand_moved=not np.array_equal(T_cam_hand, footage.source.original.hand.T_cam_hand),
        T_cam_other_hand=motion.T_cam_other_hand,
        notes=(*_notes_of_grasps(clip, motion, footage.some.notes), *footage.some.notes),
        motion=motion,
    )


def _notes_of_grasps(clip: Clip, motion: Motion, known: Sequence[str]) -> list[str]:
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


TIMELINE = Steps(Footage.of, _search, _fit_all_frames, judge_timeline, stages=7)
