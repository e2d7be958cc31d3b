"""Segments of a timeline from true poses: the object's state in each frame of labelled motion.

A static segment is a run of frames in which the object stays at the place of the first frame and no hand touches it.
Grasps are those of Eq. 2. The frames in between are an unstable contact if a hand touches the object in any of them,
else a free motion.
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
"""Maximum displacement of a static object, mean over its vertices [m]."""
MIN_STATIC_RUN_FRAMES = 5
"""Minimum number of frames of a static run: fewer are a pause, or chance."""
STATIC_MARGIN_FRAMES = 30
"""Number of a long static segment's frames that belong to the interaction before it, and to the one after it."""


def true_segments(clip: Clip, definition: Definition) -> tuple[Segment, ...]:
    """Segment a whole clip, every frame in one segment; grasps and contacts are those of its single hand.

    ``definition`` defines contact and grasp. Raises ``InputError`` for a clip without ground truth or camera poses.
    """
    return segment_by_contact(clip, {clip.side: contact_sets(clip, definition.contact, definition.points)}, definition)


def segment_by_contact(
    clip: Clip, contact: Mapping[Side, Bool[ndarray, "T P"]], definition: Definition
) -> tuple[Segment, ...]:
    """Segment a whole clip by the contact sets of one hand or both; the clip's own hand has precedence.

    Raises ``InputError`` for a clip without camera poses.
    """
    if clip.world is None:
        raise InputError(clip.origin, "camera.T_world_cam", "no such key", "the camera's poses in the world")
    assert clip.truth is not None  # contact sets need it
    touched = {side: np.asarray(sets.any(axis=1)) for side, sets in contact.items()}
    T_world_obj = clip.world.T_world_cam @ clip.truth.T_cam_obj
    still = static_runs(T_world_obj, clip.truth.scale * clip.mesh.vertices, np.any([*touched.values()], axis=0))
    found = [Segment("static", first, last) for first, last in still]
    for side, sets in contact.items():
        spans = stable_grasps(PairwiseIou.of(sets), definition.tau, definition.shortest, definition.rule)
        found += [Segment("grasp", first, last, side) for first, last in spans]
    apart = resolve_overlaps(found, len(clip), clip.side)
    apart = tuple(s for s in apart if s.state == "static" or len(s) >= definition.shortest)
    return tuple(_fill_between_segments(apart, touched, len(clip)))


def resolve_overlaps(segments: Sequence[Segment], frames: int, side: Side) -> tuple[Segment, ...]:
    """Resolve overlaps of segments.

    The order of precedence: grasps of the hand ``side``, grasps of the other hand, contacts, static and free segments;
    among equals the later segment.
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
    """Yield the frames of each interaction of a long recording, between two long static segments.

    A static segment is long if it has more than 2 ``STATIC_MARGIN_FRAMES``: this number of frames at its start belongs
    to the interaction before it, at its end to the one after. Without any contact in between there is no interaction.
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
    """Yield first and last frame of each run in which the untouched object stays at the place of the run's start."""
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
    """Count the frames in which the object stays untouched at the first frame's place."""
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
    """Yield the segments, and contact or free segments for the frames in between."""
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
