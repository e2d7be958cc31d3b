"""The checks of a timeline: each segment by the checks of its state, and the clip by the others.

Checks of a stable grasp apply to the grasps of a timeline: hands and masks move together, hand and object touch. In
other states the object may be far from the hand, which is the input hand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from getagrip.checks.check import Check, format_diameter_share, format_millimetres, format_percent, run_checks
from getagrip.checks.evidence import Evidence, Glitches
from getagrip.checks.table import INPUT_CHECKS, MIN_MEAN_IOU, RESULT_CHECKS
from getagrip.clip import Clip, Masks, Segment, modalities, with_evidence, with_masks
from getagrip.clip.clip import frame_indices
from getagrip.geometry import se3
from getagrip.geometry.rasterize import render_packed
from getagrip.result.findings import Finding

MIN_OBJECT_RANGE_M, MAX_OBJECT_RANGE_M = 0.05, 20.0
"""Plausible distances of an object from the camera [m], equal to those of an input hand."""
MIN_SHOWN_FRACTION = 0.5
"""Fraction of the largest mask's pixels below which a mask shows too little of the object to locate it."""
MAX_SEGMENT_FRAMES = 30
"""Maximum number of a segment's frames that are checked: as many as are fitted together."""
HAND_SIDE_CHECK = "hand-side"
"""Name of the check of the other hand in its grasps; the clip's own hand is checked in the whole clip."""
GRASP_CHECKS = (
    "mask-size", "visible-size", "frame-order", "frames-late", "masks-follow-hand", "object-over-hand",
    "hand-over-object", "regrasp", "second-gap", "contact-gap", "penetration",
)  # fmt: skip
"""Checks that assume a grasp, applied to the grasping hand."""
MIN_SEEN_GRASP_FRAMES = 2
"""Minimum number of frames of a grasp that must show the object."""
UNSEEN_ADVICE = "this grasp has no evidence: add masks, or remove it if it is of another object"
MASK_CHECKS = ("mask-fit", "poor-mask-fit", "worst-frame", "uneven-mask-fit")
"""Checks of any segment's result."""


def camera_distance(it: Evidence) -> float:
    """Compute the object's distance from the camera [m]: the least if that is too near, else the largest."""
    away = np.linalg.norm(it.posed.mean(axis=1), axis=1)
    return float(away.min() if away.min() < MIN_OBJECT_RANGE_M else away.max())


def max_mask_pixels(it: Evidence) -> float:
    """Return the number of pixels of the largest mask."""
    return float(it.mask_area.max())


def mask_drift(it: Evidence) -> float:
    """Compute the motion of the masks against the silhouette [roots of the mask's area].

    It is the 0.9 quantile of the distances of the centroids' offsets from their median offset.
    """
    offsets = []
    for n in np.flatnonzero(it.mask_area >= MIN_SHOWN_FRACTION * it.mask_area.max()):
        drawn = render_packed(it.posed[n], it.clip.mesh.faces, it.clip.K[n], it.clip.size)
        mask, ignored = it.shown.frames[n].part(drawn.box), it.ignored.frames[n].part(drawn.box)
        rows, columns = np.nonzero(drawn.part(drawn.box) & (mask | ~ignored))
        if len(rows):
            middle = np.array([(columns + drawn.left).mean(), (rows + drawn.top).mean()]) + 0.5
            offsets.append((it.centroids[n] - middle) / np.sqrt(it.mask_area[n]))
    if not offsets:
        return float("nan")
    from_most = np.linalg.norm(np.array(offsets) - np.median(offsets, axis=0), axis=1)
    return float(np.quantile(from_most, 0.9))


SEGMENT_CHECKS = (
    Check(
        "object-distance", camera_distance, low=MIN_OBJECT_RANGE_M, high=MAX_OBJECT_RANGE_M, shown="{:.3g} m".format,
        fault="the object is {value} from the camera",
        advice="check the masks, the mesh's size and the focal length",
    ),
    Check(
        "mask-pixels", max_mask_pixels, low=50.0,
        fault="even the largest mask has {value} pixels only, too few to locate the object",
        advice="check that they are masks of the object, or give larger images",
    ),
)  # fmt: skip
STATIC_CHECK = Check(
    "static-moves", mask_drift, high=0.2, shown=format_percent,
    fault="the segment is static, but the masks move by {value} of their size against one pose",
    advice="correct the segments where the object moves in these frames; else check the camera's motion",
)  # fmt: skip


@dataclass(frozen=True)
class TimelineChecks:
    """The outcome of the checks of a timeline.

    Attributes:
        checks: measured values of the whole clip.
        of_segments: measured values of each segment.
        of_clip: findings about the whole clip.
        own: findings about each segment; messages begin with the segment's state and first frame.
        failed: the segments whose masks are not met, in words; empty without any.
    """

    checks: dict[str, float]
    of_segments: tuple[dict[str, float], ...]
    of_clip: tuple[Finding, ...]
    own: tuple[tuple[Finding, ...], ...]
    failed: str

    @property
    def findings(self) -> tuple[Finding, ...]:
        """All findings, first those about the whole clip."""
        return (*self.of_clip, *(one for some in self.own for one in some))


def check_timeline(
    clip: Clip,
    masks: Masks,
    T_cam_hand: Float[ndarray, "T 4 4"],
    T_cam_obj: Float[ndarray, "T 4 4"],
    scale: float,
    iou: Float[ndarray, "T"],
    T_cam_other_hand: Float[ndarray, "T 4 4"] | None = None,
    glitches: Glitches | None = None,
) -> TimelineChecks:
    """Check a timeline and its result: found poses, corrected hands, and IOU (NaN where no mask shows the object)."""
    T_hand_obj = se3.inverse(T_cam_hand) @ T_cam_obj
    whole = Evidence(clip.with_hand_at(T_cam_hand, T_cam_other_hand), masks, T_hand_obj, scale, iou, glitches=glitches)
    every = (*INPUT_CHECKS.working().values(), *RESULT_CHECKS.working().values(), JUMP_CHECK)
    of_clip = [c for c in every if c.name not in (*GRASP_CHECKS, *MASK_CHECKS)]
    checks, findings = run_checks(of_clip, whole)
    of_segments, own, failed = [], [], []
    for segment in clip.segments:
        name = f"{segment.state} from {clip.frames[segment.first]}"
        measured, found = _check_segment(segment, clip, whole)
        of_segments.append(measured)
        own.append(tuple(replace(one, message=f"{name}: {one.message}") for one in found))
        if measured.get("mask-fit", 1.0) < MIN_MEAN_IOU:
            failed.append(f"{name} ({measured['mask-fit']:.2f})")
    return TimelineChecks(checks, tuple(of_segments), findings, tuple(own), ", ".join(failed))


def _check_segment(segment: Segment, clip: Clip, whole: Evidence) -> tuple[dict[str, float], tuple[Finding, ...]]:
    assert whole.iou is not None
    assert whole.T_hand_obj is not None
    iou = whole.iou[segment.rows]
    seen = segment.rows[~np.isnan(iou)]
    if segment.state == "grasp" and len(seen) < min(MIN_SEEN_GRASP_FRAMES, len(segment)):
        message = f"the masks show the object in {len(seen)} of its {len(segment)} frames; {UNSEEN_ADVICE}"
        return {}, (Finding("grasp-unseen", True, float(len(seen)), float(MIN_SEEN_GRASP_FRAMES), message),)
    if not len(seen):
        return {}, ()
    known = seen[clip.hand_known(segment.side)[seen]] if segment.state == "grasp" else seen[:0]
    grasped, rows = len(known) > 0, known if len(known) else seen
    rows = rows[frame_indices(len(rows), MAX_SEGMENT_FRAMES)]
    by, of, T_hand_obj, masks = whole.clip, clip, whole.T_hand_obj, whole.masks.take(rows)
    other = grasped and segment.side != clip.side
    if other:
        by, of = (_swap_hands(one) for one in (by, of))
        T_hand_obj = se3.inverse(by.hand.T_cam_hand) @ whole.clip.hand.T_cam_hand @ T_hand_obj
        masks = replace(masks, hand=None)
    seen_at = with_evidence(with_masks(by.take(rows), masks))
    names = tuple(clip.frames[n] for n in segment.rows)
    result = Evidence(seen_at, masks, T_hand_obj[rows], whole.scale, iou, names)
    applied = (*MASK_CHECKS, *GRASP_CHECKS) if grasped else MASK_CHECKS
    checks = [check for check in RESULT_CHECKS.working().values() if check.name in applied]
    checks += [*SEGMENT_CHECKS, *((STATIC_CHECK, FLOATING_CHECK) if segment.state == "static" else ())]
    present = [one for one in modalities() if one.of(seen_at) is not None]
    checks += [check for one in present for check in (*one.input_checks, *one.result_checks)]
    measured, findings = run_checks(checks, result)
    if not grasped:
        return measured, findings
    value, wanted = Evidence(of.take(rows), masks), (*GRASP_CHECKS, HAND_SIDE_CHECK) if other else GRASP_CHECKS
    of_input, before = run_checks([c for c in INPUT_CHECKS.own.values() if c.name in wanted], value)
    return of_input | measured, (*before, *findings)


def _swap_hands(clip: Clip) -> Clip:
    swapped = clip.with_side(clip.other_side)
    assert swapped is not None
    return swapped


def boundary_jump(it: Evidence) -> float:
    """Compute the largest step of the surface between two segments, minus the largest within one [diameters]."""
    surface = _surface_in_world(it, frame_indices(len(it.clip.mesh.vertices), 100))
    step = np.sqrt(np.mean(np.sum(np.diff(surface, axis=0) ** 2, axis=-1), axis=-1))
    border = np.isin(np.arange(1, len(it.clip)), [segment.first for segment in it.clip.segments])
    if not border.any():
        return float("nan")
    excess = step[border].max() - step[~border].max(initial=0.0)
    return float(max(excess, 0.0)) / (it.scale * it.clip.mesh.diameter)


def support_height(it: Evidence) -> float:
    """Compute the height of the lowest point over the support plane, median over frames [mm]; NaN without a plane."""
    world = it.clip.world
    if world is None or world.up is None or world.support is None:
        return float("nan")
    surface = _surface_in_world(it, np.arange(len(it.clip.mesh.vertices)))
    return 1e3 * float(np.median((surface @ world.up).min(axis=1) - world.support))


def _surface_in_world(it: Evidence, some: Int[ndarray, "n"]) -> Float[ndarray, "T n 3"]:
    """Pose some of the object's vertices in the world frame; without a world, in the camera frame."""
    assert it.T_hand_obj is not None
    T = it.clip.hand.T_cam_hand @ it.T_hand_obj
    if it.clip.world is not None:
        T = it.clip.world.T_world_cam @ T
    return np.asarray(se3.transform(T, it.scale * it.clip.mesh.vertices[some]))


JUMP_CHECK = Check(
    "jump", boundary_jump, high=0.2, shown=format_diameter_share,
    fault="where segments meet, the object jumps by {value} more than it moves anywhere else",
    advice="the pose in one of the two is probably wrong; check where the segments begin",
)  # fmt: skip
FLOATING_CHECK = Check(
    "floats", support_height, low=-15.0, high=15.0, serious=False, shown=format_millimetres,
    fault="the object lies {value} above the support plane",
    advice="right if it lies on another object; else check world_support, the mesh's size and the camera",
)  # fmt: skip
