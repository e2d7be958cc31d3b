"""The steps of a timeline: all segments are searched, chosen together, and fitted in all frames."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from getagrip.checks import INPUT_CHECKS, Evidence, examine
from getagrip.checks.of_timeline import WITH_HAND
from getagrip.errors import GetagripError
from getagrip.fitting.every_frame import Track
from getagrip.fitting.image_iou import image_iou
from getagrip.fitting.pipeline import Answer, Clock, Input, Judgement, Steps
from getagrip.geometry import se3
from getagrip.result import Status
from getagrip.timelines.footage import Footage
from getagrip.timelines.joint import Chain, best_hypotheses, in_every_frame
from getagrip.timelines.judge import judge_motion
from getagrip.timelines.motion import Motion


@dataclass(frozen=True)
class TimelineAnswer(Answer):
    """What was found, and the motion that it is made of."""

    motion: Motion


def _prepare(given: Input, clock: Clock) -> Footage:
    """Read the masks, find the scale."""
    footage = Footage.of(given)
    clock("prepare")
    return footage


def _search(footage: Footage, clock: Clock) -> Chain:
    """The hypotheses of all segments that are best together.

    Where there are none, the error also says what is unusual about the inputs.
    """
    try:
        return best_hypotheses(footage, support=True, on_stage=clock)
    except GetagripError as error:
        of_clip = [check for check in INPUT_CHECKS if check.name not in WITH_HAND]
        given = footage.given.given
        clip = replace(footage.clip, hand=given.hand, world=given.world)
        serious = [finding for finding in examine(of_clip, Evidence(clip, footage.masks))[1] if finding.serious]
        if not serious:
            raise
        raise GetagripError("; ".join(map(str, (error, *serious)))) from error


def _fit_all_frames(footage: Footage, chain: Chain, clock: Clock) -> TimelineAnswer:
    """The motion over all segments and what lies between them."""
    motion, clip, given = in_every_frame(footage, chain, clock), footage.clip, footage.given
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
        hand_moved=not np.array_equal(T_cam_hand, given.given.hand.T_cam_hand),
        T_cam_other_hand=motion.T_cam_other_hand,
        notes=(*_notes_of_grasps(motion), *footage.some.notes),
        motion=motion,
    )


def _notes_of_grasps(motion: Motion) -> list[str]:
    """What is to be known about grasps, and about those that could not be solved as such."""
    footage, clip, out, masks_only = motion.footage, motion.footage.clip, list[str](), list[str]()
    for segment in (segment for segment in clip.segments if segment.state == "grasp"):
        held = motion.held.get(segment.first)
        if held is not None:
            grasp = held.held.grasp
            own = [note for note in grasp.problem.notes if note not in footage.some.notes]
            out += [f"grasp from {clip.frames[grasp.rows[0]]}: {note}" for note in own]
            continue
        name = f"grasp from {clip.frames[segment.first]} ({segment.side} hand)"
        known = clip.hand_known(segment.side)[segment.rows].any()
        why = "the object is not seen in two frames" if known else f"the clip has no {segment.side} hand there"
        masks_only.append(f"{name}: {why}, so it was followed by the masks as in unstable contact, without an axis")
    return [*out, *masks_only]


def _judge(footage: Footage, chain: Chain, answer: TimelineAnswer) -> Judgement:
    """What checks and signs say of the motion, and how probable it is that its grasps are right."""
    return judge_motion(answer.motion, answer.track.iou)


TIMELINE = Steps(_prepare, _search, _fit_all_frames, _judge, stages=7)
