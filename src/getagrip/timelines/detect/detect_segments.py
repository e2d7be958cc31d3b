"""The segments of an uncut clip, from its masks, hands and camera.

Clips from an uncut clip's segments: the whole clip as a timeline, or one clip per stable grasp.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray
from scipy.ndimage import gaussian_filter1d
from threadpoolctl import threadpool_limits

from getagrip.clip import Clip, Masks, Segment, Truth, check_clip, check_masks, read_masks
from getagrip.clip.read import SegmentList, add_segments
from getagrip.clip.timeline import SIDES, Side, State
from getagrip.clip.write import write_clip_contents
from getagrip.errors import InputError
from getagrip.fitting.hand.refine_hand import repair_hand
from getagrip.fitting.options import Options
from getagrip.geometry import se3
from getagrip.io import files
from getagrip.provenance import EXTRAPOLATED_HANDS_KEY, assumed
from getagrip.stable_grasps.definition import Definition
from getagrip.stable_grasps.find import as_listed, segment
from getagrip.stable_grasps.grasp_lists import CLIP_NAME_SEPARATOR
from getagrip.timelines.detect.grasp_evidence import (
    HINGE_FIT_METHOD,
    HingeFit,
    NothingToFitError,
    fit_hinge,
    split_runs,
)
from getagrip.timelines.detect.image_motion import ImageMotion, image_motion
from getagrip.timelines.detect.semi_markov import (
    MOTION_STATES,
    Division,
    Motion,
    best_fit_in_window,
    cheapest_division,
    division_margins,
    window_costs,
)

STATE_WITHOUT_GRASP: dict[Motion, State] = {"static": "static", "held": "contact", "free": "free"}
"""State of each motion outside of stable grasps."""
MAX_MASK_LAG_S = 0.13
"""Maximum time between two compared masks [s]."""
MAX_FIT_FRAMES, MIN_FIT_FRAMES = 60, 6
"""Maximum and minimum number of frames of a fit."""
FIT_OVERLAP_FRAMES, FIT_CONTEXT_FRAMES = 30, 150
"""Number of frames by which a fit is extended beyond the pauses beside it, and maximum extension on either side."""
MAX_SEGMENTED_FRAMES = 3000
"""Maximum number of frames of a clip: the cost table has an entry for every window of frames."""
CONTACT_10_MM_DEFINITION = Definition(contact=0.010)
STATIC_CAMERA_NOTE = "which is a guess: nothing is known of its motion"
"""Note on a camera that is assumed to be static (``clip.read``)."""
FINGER_SMOOTHING_SIGMA_S = 0.067
"""Standard deviation of the Gaussian that smooths the fingers in time [s]: a tracker's jitter changes the contacts."""


@dataclass(frozen=True)
class DetectedSegment:
    """A segment and its margin.

    Attributes:
        segment: frames, state and side.
        margin: additional cost of the next best division, without this segment's state in its frames
            (``semi_markov.division_margins``); of a grasp, that of the grasped segment around it [nats].
    """

    segment: Segment
    margin: float


@dataclass(frozen=True)
class DetectedSegments:
    """All segments of a clip, consecutive, and notes on assumptions."""

    segments: tuple[DetectedSegment, ...]
    notes: tuple[str, ...]

    @property
    def grasps(self) -> list[tuple[int, int]]:
        """First and last frame of each stable grasp, both included."""
        return [(s.segment.first, s.segment.last) for s in self.segments if s.segment.state == "grasp"]


def find_segments(
    clip: Clip,
    masks: Masks | None = None,
    definition: Definition = CONTACT_10_MM_DEFINITION,
    options: Options | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> DetectedSegments:
    """Find the segments of a clip; ``masks`` are read from its folder unless passed.

    Without ``clip.world`` the camera is assumed to be static. Frames without a known mask are skipped, and joined to
    the segment of the nearest frame. The clip's own segments and ground truth are not used, neither are the options'
    method and options about remaining frames. Raises ``UsageError`` for masks of another clip, and ``InputError`` for
    an invalid clip and for more than ``MAX_SEGMENTED_FRAMES`` frames.
    """
    check_clip(clip)
    if len(clip) > MAX_SEGMENTED_FRAMES:
        raise InputError(clip.origin, "frames", f"{len(clip)} frames", f"at most {MAX_SEGMENTED_FRAMES}: cut the clip")
    masks = read_masks(clip) if masks is None else masks
    check_masks(clip, masks)
    options = replace(options or Options(), method=HINGE_FIT_METHOD)
    rows = np.flatnonzero(masks.known)
    if 1 < len(rows) < len(clip):
        rate = clip.fps * (len(rows) - 1) / (rows[-1] - rows[0])
        some = replace(replace(clip, segments=(), truth=None).take(rows), fps=rate)
        found = find_segments(some, masks.take(rows), definition, options, progress)
        return _spread_to_all_frames(found, rows, len(clip))
    clip, glitches = repair_hand(replace(clip, segments=(), truth=None), options)
    moved = _image_motion_of_clip(clip, masks)
    with threadpool_limits(1, user_api="blas"):
        fits = _fit_moving_parts(clip, masks, _runs_between_static(moved), options, progress)
    cost = window_costs(moved, fits)
    division = cheapest_division(cost)
    notes = [] if clip.world is not None else ["the camera is taken to stand still: a guess"]
    if EXTRAPOLATED_HANDS_KEY in clip.provenance:
        hands = f"{EXTRAPOLATED_HANDS_KEY}: {clip.provenance[EXTRAPOLATED_HANDS_KEY]}"
        notes.append(f"{hands}: a grasp found there is one, too")
    if glitches is not None and glitches.frames:
        notes.append(str(glitches))
    margin = division_margins(cost, division)
    segments = _detected_segments(clip, division, margin, fits, moved.jitter, definition)
    return DetectedSegments(tuple(segments), tuple(notes))


def _spread_to_all_frames(found: DetectedSegments, rows: Int[ndarray, "n"], frames: int) -> DetectedSegments:
    """Extend segments of the frames ``rows`` to all ``frames``; borders lie halfway between two rows."""
    begins = [0, *(int(rows[s.segment.first - 1] + rows[s.segment.first]) // 2 + 1 for s in found.segments[1:])]
    ends = [*(begin - 1 for begin in begins[1:]), frames - 1]
    spread = tuple(
        replace(one, segment=replace(one.segment, first=first, last=last))
        for one, first, last in zip(found.segments, begins, ends, strict=True)
    )
    note = f"{frames - len(rows)} of {frames} frames have no mask: they are in the segment of the frames beside them"
    return DetectedSegments(spread, (*found.notes, note))


def moving_runs(clip: Clip, masks: Masks) -> list[tuple[int, int]]:
    """Return first and last frame of each run in which the object moves, by its motion in the image alone."""
    return _runs_between_static(_image_motion_of_clip(clip, masks))


def _image_motion_of_clip(clip: Clip, masks: Masks) -> ImageMotion:
    return image_motion(clip, masks, min(max(1, round(MAX_MASK_LAG_S * clip.fps)), len(clip) - 1))


def _runs_between_static(moved: ImageMotion) -> list[tuple[int, int]]:
    """Return the runs between static segments, by the cheapest division into static and free."""
    division = cheapest_division(window_costs(moved, []))
    lies = np.zeros(moved.moved.shape[1], dtype=bool)
    for (first, last), state in zip(division.spans, division.states, strict=True):
        lies[first : last + 1] = MOTION_STATES[state] == "static"
    edges = np.flatnonzero(np.diff(np.concatenate([[True], lies, [True]])))
    return [(int(first), int(end) - 1) for first, end in edges.reshape(-1, 2)]


def _fit_moving_parts(
    clip: Clip, masks: Masks, runs: Sequence[tuple[int, int]], options: Options, progress: Callable[[float], None]
) -> list[HingeFit]:
    """Fit the object to each known hand in all moving runs; frames that cannot be fitted are skipped."""
    hands, parts, fits = _clips_by_hand(clip, masks), list(split_runs(runs, MAX_FIT_FRAMES, MIN_FIT_FRAMES)), []
    for k, frames in enumerate(parts):
        before = parts[k - 1][-1] + 1 - FIT_OVERLAP_FRAMES if k else 0
        after = parts[k + 1][0] + FIT_OVERLAP_FRAMES if k + 1 < len(parts) else len(clip)
        first, end = frames[0] - FIT_CONTEXT_FRAMES, frames[-1] + 1 + FIT_CONTEXT_FRAMES
        around = np.arange(max(0, before, first), min(len(clip), after, end))
        for by, seen, known in hands:
            with suppress(NothingToFitError):
                fits.append(fit_hinge(by, seen, frames[known[frames]], around[known[around]], options))
        progress((k + 1) / len(parts))
    return fits


def _clips_by_hand(clip: Clip, masks: Masks) -> list[tuple[Clip, Masks, Bool[ndarray, "T"]]]:
    """Return a clip and masks per known hand, and the frames in which the hand is known."""
    hands = [(clip, masks, clip.hand_known(clip.side))]
    for side in SIDES:
        by = clip.with_side(side)
        if by is not None and by is not clip:  # no mask shows the other hand alone
            hands.append((by, replace(masks, hand=None), clip.hand_known(side)))
    return hands


def _detected_segments(
    clip: Clip,
    division: Division,
    margin: Float[ndarray, "n"],
    fits: Sequence[HingeFit],
    jitter: float,
    definition: Definition,
) -> Iterator[DetectedSegment]:
    """Yield the segments of a division; Eq. 2 divides grasped ones.

    A hand can hold an object steadily before it is lifted and after it is put down: such a grasp takes frames from the
    neighbouring static segments.
    """
    spans, motions = division.spans, [MOTION_STATES[state] for state in division.states]
    lengths = spans[:, 1] + 1 - spans[:, 0]
    owner = np.repeat(np.arange(len(spans)), lengths)
    stable, sides = np.full(len(clip), -1), dict[int, Side]()
    lying = np.where(np.array(motions) == "static", lengths, 0)
    for k in np.flatnonzero(np.array(motions) == "held"):
        first, last = (int(n) for n in spans[k])
        before, after = (int(lying[n]) if 0 <= n < len(spans) else 0 for n in (k - 1, k + 1))
        fit = best_fit_in_window(fits, first, last, jitter)
        by, known = clip.with_side(fit.side), clip.hand_known(fit.side)
        assert by is not None
        before = before - int(np.flatnonzero(~known[first - before : first]).max(initial=-1)) - 1
        after = int(np.argmin([*known[last + 1 : last + 1 + after], False]))
        sides[int(k)] = fit.side
        found = reconstruct_segment(by, fit, first, last, before, after)
        for n, (a, b) in enumerate(stable_grasps_in(by, found, definition)):
            taken = np.arange(a, b + 1)
            taken = taken[stable[a : b + 1] < 0]
            owner[taken], stable[taken] = k, n
    key = np.stack([owner, stable], axis=1)
    breaks = np.flatnonzero(np.any(np.diff(key, axis=0), axis=1)) + 1
    for rows in np.split(np.arange(len(clip)), breaks):
        k = owner[rows[0]]
        state = "grasp" if stable[rows[0]] >= 0 else STATE_WITHOUT_GRASP[motions[k]]
        side = sides.get(int(k)) if state in ("grasp", "contact") else None
        yield DetectedSegment(Segment(state, int(rows[0]), int(rows[-1]), side), float(margin[k]))


@dataclass(frozen=True)
class ReconstructedMotion:
    """An object's motion in consecutive frames: moved by a hand, and at rest before and after.

    Attributes:
        frames: (n,) the frames.
        grasped: (n,) true in frames in which the hand moves the object.
        T_cam_obj: (n, 4, 4) poses of the object.
        T_cam_hand: (n, 4, 4) poses of the hand.
        scale: scale of the object.
    """

    frames: Int[ndarray, "n"]
    grasped: Bool[ndarray, "n"]
    T_cam_obj: Float[ndarray, "n 4 4"]
    T_cam_hand: Float[ndarray, "n 4 4"]
    scale: float


def reconstruct_segment(
    clip: Clip, fit: HingeFit, first: int, last: int, still_before: int, still_after: int
) -> ReconstructedMotion:
    """Return a fit's motion in its segment, extended by frames in which the object rests in the world.

    The hand's pose is the fit's in all frames of the fit, else the clip's.
    """
    frames = np.arange(first - still_before, last + 1 + still_after)
    inside = (fit.frames >= first) & (fit.frames <= last)
    T_world_cam = np.tile(np.eye(4), (len(clip), 1, 1)) if clip.world is None else clip.world.T_world_cam
    T_world_obj = T_world_cam[first : last + 1] @ fit.T_cam_obj[inside]
    nearest = np.clip(frames, first, last) - first
    T_cam_obj = se3.inverse(T_world_cam[frames]) @ T_world_obj[nearest]
    T_cam_obj[still_before : still_before + last + 1 - first] = fit.T_cam_obj[inside]
    T_cam_hand = clip.hand.T_cam_hand.copy()
    T_cam_hand[fit.frames] = fit.T_cam_hand
    return ReconstructedMotion(frames, (frames >= first) & (frames <= last), T_cam_obj, T_cam_hand[frames], fit.scale)


def stable_grasps_in(clip: Clip, found: ReconstructedMotion, definition: Definition) -> list[tuple[int, int]]:
    """Return first and last frame of each stable grasp (Eq. 2) that includes a grasped frame."""
    part = clip.take(found.frames)
    fingers = gaussian_filter1d(part.hand.vertices, FINGER_SMOOTHING_SIGMA_S * clip.fps, axis=0, mode="nearest")
    posed = Truth(found.T_cam_obj, found.scale, found.T_cam_hand, fingers)
    _, grasps = segment(replace(part, truth=posed), definition)
    spans = [(int(found.frames[first]), int(found.frames[last])) for first, last in grasps]
    return [span for span, (a, b) in zip(spans, grasps, strict=True) if found.grasped[a : b + 1].any()]


def detected_segment_list(clip: Clip, found: DetectedSegments) -> SegmentList:
    """Return the segments with their provenance."""
    least = min(one.margin for one in found.segments)
    source = f"found in masks and hands, each at least {least:.0f} nats before the next best"
    still = STATIC_CAMERA_NOTE if clip.world is None else None
    return SegmentList.of(clip, [one.segment for one in found.segments], source, still)


def write_timeline(clip: Clip, masks: Masks, found: DetectedSegments, folder: Path) -> list[Path]:
    """Write the whole clip with its segments into ``folder/<clip>``; return this folder, in a list.

    Images of the clip's folder are copied. The folder of an earlier call is replaced.
    """
    whole = add_segments(clip, detected_segment_list(clip, found))
    return [_write_clip_part(whole, masks, clip, np.arange(len(clip)), folder / clip.name)]


def write_grasps(clip: Clip, masks: Masks, found: DetectedSegments, folder: Path) -> list[Path]:
    """Write each stable grasp into ``folder/<clip>--<n>``, n from 1; return these folders.

    Images of the clip's folder are copied. Folders of an earlier call are replaced.
    """
    grasps = [one for one in found.segments if one.segment.state == "grasp"]
    stem = f"{clip.name}{CLIP_NAME_SEPARATOR}"
    return [_write_grasp(clip, masks, found, one, folder / f"{stem}{n}") for n, one in enumerate(grasps, 1)]


def _write_grasp(clip: Clip, masks: Masks, found: DetectedSegments, one: DetectedSegment, folder: Path) -> Path:
    segment = one.segment
    by = clip.with_side(segment.side)
    assert by is not None
    if by is not clip:
        masks = replace(masks, hand=None)
    rows = segment.rows[clip.hand_known(segment.side)[segment.rows]]
    provenance = {
        **clip.provenance,
        "grasp": as_listed(by, segment.first, segment.last).row(),
        "found": f"in the masks of {clip.name}, {one.margin:.0f} nats before the next best",
        **{f"assumed {n}": assumed(note) for n, note in enumerate(found.notes, start=1)},
    }
    alone = replace(by, name=folder.name, segments=(), other_hand=None, provenance=provenance)
    return _write_clip_part(alone.take(rows), masks.take(rows), clip, rows, folder)


def _write_clip_part(part: Clip, masks: Masks, clip: Clip, rows: Int[ndarray, "n"], folder: Path) -> Path:
    images = [clip.image_file(int(n)) for n in rows]
    with files.new_folder(folder, ("clip.json",) if folder.exists() else ()) as new:
        write_clip_contents(new, part, masks, None)
        if all(images):
            (new / "frames").mkdir()
            for image in images:
                assert image is not None
                shutil.copyfile(image, new / "frames" / image.name)
    return folder
