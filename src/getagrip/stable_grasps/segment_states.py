"""Segments of a timeline from true poses: the state of an object in each frame of labelled motion.

Static is a run of frames in which the object stays where it is in the first of them and no hand touches it. Grasps are
those of Eq. 2. What lies between is an unstable contact where a hand touches the object in any of its frames, else a
free motion.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray

from getagrip.clip import Clip, Segment
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.hands.model import Side
from getagrip.stable_grasps.definition import Definition
from getagrip.stable_grasps.find import PairwiseIou, contact_sets, stable_grasps

MAX_STATIC_DISPLACEMENT_M = 0.003
"""A static object's surface is displaced by less than this, on average over its vertices [m]."""
MIN_STATIC_RUN_FRAMES = 5
"""Frames: fewer are a pause, or chance."""
STATIC_MARGIN_FRAMES = 30
"""Frames of a long static segment that belong to what comes before it, and to what comes after."""


def true_segments(clip: Clip, definition: Definition) -> tuple[Segment, ...]:
    """Segment a whole clip, every frame in one segment; its one hand is that of the segments with a side.

    ``definition`` is what contact and a grasp are. Raises ``InputError`` for a clip without ground truth or without
    the camera's poses.
    """
    return segment_by_contact(clip, {clip.side: contact_sets(clip, definition.contact, definition.points)}, definition)


def segment_by_contact(
    clip: Clip, contact: Mapping[Side, Bool[ndarray, "T P"]], definition: Definition
) -> tuple[Segment, ...]:
    """Segment a whole clip by the contact sets of one hand or both.

    Where both hold the object, the clip's hand counts.

    Raises ``InputError`` for a clip without the camera's poses.
    """
    if clip.world is None:
        raise InputError(clip.origin, "camera.T_world_cam", "no such key", "the camera's poses in the world")
    assert clip.truth is not None  # contact sets are made from it
    touched = {side: np.asarray(sets.any(axis=1)) for side, sets in contact.items()}
    T_world_obj = clip.world.T_world_cam @ clip.truth.T_cam_obj
    still = static_runs(T_world_obj, clip.truth.scale * clip.mesh.vertices, np.any([*touched.values()], axis=0))
    found = [Segment("static", first, last) for first, last in still]
    for side, sets in contact.items():
        spans = stable_grasps(PairwiseIou.of(sets), definition.tau, definition.shortest, definition.rule)
        found += [Segment("grasp", first, last, side) for first, last in spans]
    apart = [
        s for s in resolve_overlaps(found, len(clip), clip.side) if s.state == "static" or len(s) >= definition.shortest
    ]
    return tuple(_fill_between_segments(apart, touched, len(clip)))


def resolve_overlaps(segments: Sequence[Segment], frames: int, side: Side) -> tuple[Segment, ...]:
    """Resolve overlaps of segments.

    Grasps of hand ``side`` take precedence over those of the other hand, these over contacts, these over static and
    free segments, and otherwise later segments over earlier ones.
    """
    order: dict[str, int] = {"static": 0, "free": 0, "contact": 1, "grasp": 2}
    over = sorted(segments, key=lambda s: (order[s.state], s.state == "grasp" and s.side == side, s.first))
    label = np.full(frames, -1)
    for n, segment in enumerate(over):
        label[segment.first : segment.last + 1] = n
    edges = np.flatnonzero(np.diff(label, prepend=-2, append=-2))
    runs = zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True)
    return tuple(replace(over[label[a]], first=a, last=b - 1) for a, b in runs if label[a] >= 0)


def interactions(segments: Sequence[Segment]) -> Iterator[Int[ndarray, "n"]]:
    """Yield the frames of each timeline of a long recording: the interactions between two long static segments.

    Such a segment is longer than twice ``STATIC_MARGIN_FRAMES``; its first frames belong to the timeline before it, its last to that
    after it. Where the object is never held or touched in between, there is no timeline.
    """
    if not segments:
        return
    begin = segments[0].first
    grasped = False
    for segment in segments:
        if segment.state == "static" and len(segment) > 2 * STATIC_MARGIN_FRAMES:
            if grasped:
                yield np.arange(begin, segment.first + STATIC_MARGIN_FRAMES)
            begin, grasped = segment.last + 1 - STATIC_MARGIN_FRAMES, False
        grasped |= segment.state in ("contact", "grasp")
    if grasped:
        yield np.arange(begin, segments[-1].last + 1)


def static_runs(
    T_world_obj: Float[ndarray, "T 4 4"], vertices: Float[ndarray, "V 3"], touched: Bool[ndarray, "T"]
) -> Iterator[tuple[int, int]]:
    """Yield the first and last frame of each run in which the untouched object stays where the run began."""
    first = 0
    while first < len(T_world_obj):
        length = _static_length(T_world_obj[first:], vertices, touched[first:])
        if length >= MIN_STATIC_RUN_FRAMES:
            yield first, first + length - 1
            first += length
        else:
            first += 1


def _static_length(
    T_world_obj: Float[ndarray, "T 4 4"], vertices: Float[ndarray, "V 3"], touched: Bool[ndarray, "T"]
) -> int:
    """For how many frames the object stays where it is in the first, untouched."""
    at_first = se3.transform(T_world_obj[0], vertices)
    begin, end = 0, MIN_STATIC_RUN_FRAMES
    while begin < len(T_world_obj):
        posed = se3.transform(T_world_obj[begin:end], vertices[None])
        ends = (np.linalg.norm(posed - at_first, axis=2).mean(axis=1) >= MAX_STATIC_DISPLACEMENT_M) | touched[begin:end]
        if ends.any():
            return begin + int(np.argmax(ends))
        begin, end = end, min(2 * end, end + 128)
    return len(T_world_obj)


def _fill_between_segments(
    found: Sequence[Segment], touched: Mapping[Side, Bool[ndarray, "T"]], frames: int
) -> Iterator[Segment]:
    """Yield the segments, and what lies between them."""
    at = 0
    for segment in (*found, None):
        end = frames if segment is None else segment.first
        if end > at:
            often = {side: int(np.count_nonzero(rows[at:end])) for side, rows in touched.items()}
            side = max(often, key=lambda one: often[one])
            yield Segment("contact", at, end - 1, side) if often[side] else Segment("free", at, end - 1)
        if segment is not None:
            yield segment
            at = segment.last + 1
