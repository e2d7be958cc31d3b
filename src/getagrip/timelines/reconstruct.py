"""From a clip to the object in every frame: timelines by all of their segments, other clips as one stable grasp."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from threadpoolctl import threadpool_limits

from getagrip.checks import INPUT_CHECKS, LEAST_IOU, Evidence, calibration, examine
from getagrip.checks.of_timeline import WITH_HAND, examine_timeline, name_of
from getagrip.clip import Clip, Masks, Segment, check_clip, check_masks, read_masks
from getagrip.errors import GetagripError, UsageError
from getagrip.finding import Finding
from getagrip.fitting import reconstruct as grasp
from getagrip.fitting.image_iou import image_iou
from getagrip.fitting.judge import probability_right
from getagrip.fitting.methods.all_frames import soft_hinges
from getagrip.fitting.options import Options
from getagrip.fitting.problem import prepare
from getagrip.fitting.tracker_glitches import repair_hand
from getagrip.geometry import se3
from getagrip.geometry.mesh import Mesh
from getagrip.probability import Probability
from getagrip.provenance import assumptions
from getagrip.result import Candidates, Reconstruction, SegmentResult, Status
from getagrip.timelines.footage import Footage, grasp_clip
from getagrip.timelines.joint import joint
from getagrip.timelines.motion import Motion
from getagrip.timelines.signs import signs_of

METHOD = "soft-hinge"
"""How objects move in the grasps of a timeline."""
MEANING = f"{calibration.MEANING.format('hand')}; calibrated on grasps by themselves, of timelines a rough guide only"
"""Of a grasp's probability (docs/checks.md)."""
UNEXPLAINED = "failed in part: masks are hardly met (mean IOU) in the segments {}"
"""The message of a result some of whose segments are below ``LEAST_IOU``."""


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
        options: method, number of initial poses, weights and what of the inputs is believed; None for the usual ones.
            ``options.frames`` frames, sampled evenly, are fitted together, and the others follow from them.
        progress: called with the name of the stage that has ended and the fraction done, 0 to 1.
        threads: number of threads that share the hypotheses of a search. The result is the same to the last bit
            whatever their number. Two are worth it where one clip is waited for; many clips are done sooner by as many
            processes. A timeline is solved on one.

    Returns:
        The object's poses in the hand, what was believed, and how probable it is that they are right.

    Raises:
        UsageError: masks of another clip, or a timeline and another method than the soft hinge.
        InputError: what no clip can be (as of ``read_clip``), an object that is visible in fewer than two frames, or a
            timeline of which no segment can be solved.
        GetagripError: nothing can be rendered.
    """
    options = options or Options()
    if not clip.segments:
        return grasp.reconstruct(clip, masks, options, progress, threads)
    if options.method != METHOD:
        raise UsageError(f"method must be {METHOD!r} for a clip with segments (got {options.method!r})")
    check_clip(clip)
    if masks is None:
        masks = read_masks(clip)
    check_masks(clip, masks)
    with threadpool_limits(1, user_api="blas"):
        clock = grasp.Clock(progress)
        light, scale = clip.light(), 1.0
        if clip.scale == "free":
            scale = scale_of(light, masks, options)
            light = replace(light, mesh=Mesh(scale * light.mesh.vertices, light.mesh.faces), scale="known", truth=None)
        footage = Footage.of(light, masks, options)
        clock("prepare")
        try:
            motion = joint(footage, on_stage=clock)
        except GetagripError as error:
            of_clip = [check for check in INPUT_CHECKS if check.name not in WITH_HAND]
            serious = [finding for finding in examine(of_clip, Evidence(light, masks))[1] if finding.serious]
            if not serious:
                raise
            raise GetagripError("; ".join(map(str, (error, *serious)))) from error
    return result_of(clip, footage, motion, scale, clock.seconds())


def scale_of(clip: Clip, masks: Masks, options: Options) -> float:
    """The object's scale: that of the longest grasp, where hand and camera tell it. Raises ``InputError``."""
    clip, _ = repair_hand(clip, options)
    grasps = [grasp_clip(clip, masks, s) for s in clip.segments if s.state == "grasp"]
    longest = max((grasp for grasp in grasps if grasp is not None), key=lambda grasp: len(grasp[2]), default=None)
    problem = prepare(*(longest[:2] if longest else (clip, masks)), options)
    return float(soft_hinges(problem, lambda _: None).motion.poses().scale[0])


def result_of(clip: Clip, footage: Footage, motion: Motion, scale: float, seconds: dict[str, float]) -> Reconstruction:
    """The motion as a result; the mesh of ``footage`` is the clip's at its scale."""
    T_hand_obj = se3.inverse(motion.T_cam_hand) @ motion.T_cam_obj
    posed, other_hand = footage.clip.with_hand_at(motion.T_cam_hand), motion.T_cam_other_hand
    iou = np.where(footage.masks.observed, image_iou(posed, footage.masks, T_hand_obj, 1.0), np.nan)
    moved = not np.array_equal(motion.T_cam_hand, clip.hand.T_cam_hand)
    energy, other = motion.energy
    notes = [*motion.notes, *followed(clip, footage), *footage.some.notes]
    guesses = {"scale": grasp.SCALE_GUESSED.format(scale)} if clip.scale == "free" else {}
    mean_iou = float(np.nanmean(iou))
    hands = motion.T_cam_hand, motion.T_cam_obj, scale, iou, other_hand
    examined = examine_timeline(clip.light(), footage.masks, *hands, footage.glitches)
    status, message = Status.JOINT, Status.JOINT.sentence
    if examined.failed:
        status, message = Status.PARTLY_FAILED, UNEXPLAINED.format(examined.failed)
    if mean_iou < LEAST_IOU:
        status, message = Status.MISFIT, grasp.UNEXPLAINED.format(mean_iou)
    return Reconstruction(
        clip=clip.name,
        method=METHOD,
        frames=clip.frames,
        frame_kind=tuple(motion.kind),
        T_hand_obj=T_hand_obj,
        scale=scale,
        iou=iou,
        axis=None,
        candidates=Candidates(T_hand_obj[None], np.array([scale]), np.array([energy])),
        energy={"total": energy},
        status=status,
        message=message,
        ambiguous=other < grasp.AMBIGUOUS * energy,
        seconds=seconds,
        options=asdict(footage.options),
        seed=footage.options.seed,
        T_cam_hand=motion.T_cam_hand if moved else None,
        T_cam_other_hand=other_hand,
        notes=(*notes, *guesses.values()),
        assumptions=assumptions(clip.provenance) | guesses,
        findings=examined.findings,
        checks=examined.checks,
        segments=tuple(
            replace(segment_result(clip, segment, motion, iou), checks=checks, signs=signs, probability_right=right)
            for segment, checks in zip(clip.segments, examined.of_segments, strict=True)
            for signs, right in [probability_of(clip, segment, motion, footage, examined.findings)]
        ),
    )


def followed(clip: Clip, footage: Footage) -> list[str]:
    """What is to be known about grasps that could not be solved as such."""
    out = []
    for segment in clip.segments:
        if segment.state == "grasp" and footage.grasp_clip(segment) is None:
            name = f"grasp from {clip.frames[segment.first]} ({segment.side} hand)"
            known = clip.hand_known(segment.side)[segment.rows].any()
            why = "the object is not seen in two frames" if known else f"the clip has no {segment.side} hand there"
            out.append(f"{name}: {why}, so it was followed by the masks as in unstable contact, without an axis")
    return out


def probability_of(
    clip: Clip, segment: Segment, motion: Motion, footage: Footage, findings: Sequence[Finding]
) -> tuple[dict[str, float], Probability | None]:
    """The signs of a grasp, and how probable it is that it is right; nothing of other segments."""
    track = motion.grasps.get(segment.first)
    if segment.state != "grasp" or track is None:
        return {}, None
    signs, names = signs_of(footage, track), {check.name for check in INPUT_CHECKS}
    others = tuple(f"{name_of(clip, one)}: " for one in clip.segments if one is not segment)
    of_input = [one for one in findings if one.check in names and not one.message.startswith(others)]
    right = probability_right(footage.options, signs, of_input)
    return dict(signs), right and replace(right, meaning=MEANING)


def segment_result(clip: Clip, segment: Segment, motion: Motion, iou: Float[ndarray, "T"]) -> SegmentResult:
    """What was found in a segment."""
    rows, is_grasp = segment.rows, segment.state == "grasp"
    seen = iou[rows][~np.isnan(iou[rows])]
    axis = motion.axes.get(segment.first) if is_grasp else None
    lying = segment.state == "static" and clip.world is not None
    return SegmentResult(
        state=segment.state,
        first=clip.frames[segment.first],
        last=clip.frames[segment.last],
        side=segment.side,
        iou=float(seen.mean()) if len(seen) else None,
        by_masks=is_grasp and segment.first not in motion.grasps,
        T_world_obj=clip.world.T_world_cam[rows[0]] @ motion.T_cam_obj[rows[0]] if lying and clip.world else None,
        axis_point=None if axis is None else axis.point,
        axis_direction=None if axis is None else axis.direction,
    )
