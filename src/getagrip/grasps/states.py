"""What an object does in labelled motion, frame by frame: the segments of a timeline from true poses.

Static is a run of frames in which the object stays where it is in the first of them and no hand touches it. Grasps are
those of Eq. 2. What lies between is an unstable contact where the hand touches the object in any of its frames, else a
free motion.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from getagrip.clip import Clip, Segment
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.grasps.definition import Definition
from getagrip.grasps.stable import PairwiseIou, contact_sets, stable_grasps

STILL = 0.003
"""A static object's surface is displaced by less than this, on average over its vertices [m]."""
SHORTEST_STATIC = 5
"""Frames: fewer are a pause, or chance."""


def true_segments(clip: Clip, definition: Definition) -> tuple[Segment, ...]:
    """The segments of a whole clip, every frame in one of them, its one hand in those with a side.

    ``definition`` is what contact and a grasp are. Raises ``InputError`` for a clip without ground truth or without
    the camera's poses.
    """
    if clip.world is None:
        raise InputError(clip.origin, "camera.T_world_cam", "no such key", "the world, in which objects lie still")
    contact = contact_sets(clip, definition.contact, definition.points)
    assert clip.truth is not None  # contact_sets has looked
    found = [
        Segment("grasp", first, last, clip.side)
        for first, last in stable_grasps(PairwiseIou.of(contact), definition.tau, definition.shortest, definition.rule)
    ]
    posed = se3.transform(clip.world.T_world_cam @ clip.truth.T_cam_obj, clip.truth.scale * clip.mesh.vertices[None])
    touched = np.asarray(contact.any(axis=1))
    found += [Segment("static", first, last) for first, last in static_runs(posed, touched)]
    return tuple(_with_rest(sorted(found, key=lambda s: s.first), touched, clip))


def static_runs(posed: Float[ndarray, "T V 3"], touched: Bool[ndarray, "T"]) -> Iterator[tuple[int, int]]:
    """First and last of the runs of frames in which nothing touches an object and it stays where it is at first."""
    first = 0
    while first < len(posed):
        moved = np.linalg.norm(posed[first:] - posed[first], axis=2).mean(axis=1) >= STILL
        ends = moved | touched[first:]
        length = int(np.argmax(ends)) if ends.any() else len(ends)
        if length >= SHORTEST_STATIC:
            yield first, first + length - 1
            first += length
        else:
            first += 1


def _with_rest(found: list[Segment], touched: Bool[ndarray, "T"], clip: Clip) -> Iterator[Segment]:
    """The segments, and what lies between them."""
    at = 0
    for segment in (*found, None):
        end = len(touched) if segment is None else segment.first
        if end > at:
            held = bool(touched[at:end].any())
            yield Segment("contact", at, end - 1, clip.side) if held else Segment("free", at, end - 1)
        if segment is not None:
            yield segment
            at = segment.last + 1
