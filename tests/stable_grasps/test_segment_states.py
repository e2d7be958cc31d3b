"""The segments of labelled motion: an object that lies, is touched, carried, put down and left."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from getagrip.clip import Clip, Segment, Truth, World
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.mesh import subdivide_parts
from getagrip.stable_grasps.definition import Definition
from getagrip.stable_grasps.segment_states import (
    STATIC_MARGIN_FRAMES,
    interactions,
    resolve_overlaps,
    static_runs,
    true_segments,
)
from helpers.clips import box, small_clip

LIE, TOUCH, HOLD, LEAVE = 8, 3, 9, 6
EVERY = LIE + TOUCH + HOLD + LEAVE
DEFINITION = Definition(contact=0.005, shortest=5)


@pytest.fixture
def labelled() -> Clip:
    """A plate for a hand that comes from above, slides along a box, carries it away and lets it lie."""
    clip, _ = small_clip(EVERY)
    t = np.arange(EVERY)
    held = np.clip(t - (LIE + TOUCH - 1), 0, HOLD)
    at = np.array([0.0, 0.0, 0.6]) + held[:, None] * [0.02, 0.0, 0.0]
    T_world_obj = se3.rigid(np.tile(np.eye(3), (EVERY, 1, 1)), at)
    beside = np.tile([0.0, -0.052, 0.0], (EVERY, 1))
    beside[:LIE, 1] = -0.1
    beside[LIE : LIE + TOUCH, 0] = [-0.12, -0.115, -0.11]
    beside[LIE + TOUCH + HOLD :, 1] = -0.1
    T_world_hand = se3.rigid(np.tile(np.eye(3), (EVERY, 1, 1)), at + beside)
    T_world_cam = se3.rigid(se3.exp_so3(0.01 * t[:, None] * [0.0, 1.0, 0.0]), 0.01 * t[:, None] * [1.0, 0.0, 0.0])
    T_cam_world = se3.inverse(T_world_cam)
    plate = box(0.2, 0.03, 0.1).vertices
    hand = replace(clip.hand, vertices=np.tile(plate, (EVERY, 1, 1)), T_cam_hand=T_cam_world @ T_world_hand)
    mesh = subdivide_parts([box(0.05, 0.07, 0.11)], 500)[0]
    truth = Truth(T_cam_world @ T_world_obj, 1.0, hand.T_cam_hand, hand.vertices)
    return replace(clip, hand=hand, mesh=mesh, truth=truth, world=World(T_world_cam))


def test_states_follow_from_contact_and_from_where_the_object_is(labelled: Clip) -> None:
    first = np.cumsum([0, LIE, TOUCH, HOLD, LEAVE])
    assert true_segments(labelled, DEFINITION) == (
        Segment("static", 0, int(first[1]) - 1),
        Segment("contact", int(first[1]), int(first[2]) - 1, "right"),
        Segment("grasp", int(first[2]), int(first[3]) - 1, "right"),
        Segment("static", int(first[3]), EVERY - 1),
    )


def test_without_a_world_nothing_is_static(labelled: Clip) -> None:
    with pytest.raises(InputError, match="T_world_cam"):
        true_segments(replace(labelled, world=None), DEFINITION)


def test_what_creeps_is_not_static() -> None:
    vertices = np.zeros((4, 3))
    at = np.tile(np.eye(4), (20, 1, 1))
    untouched = np.zeros(20, dtype=bool)
    assert list(static_runs(at, vertices, untouched)) == [(0, 19)]
    at[:, 0, 3] = 0.001 * np.arange(20)  # 3 mm away after three frames
    assert list(static_runs(at, vertices, untouched)) == []
    at[10:] = at[10]
    assert list(static_runs(at, vertices, untouched)) == [(8, 19)]  # by then it is within 3 mm of where it stays


@pytest.mark.parametrize(
    ("touched", "runs"), [(0, [(1, 19)]), (9, [(0, 8), (10, 19)]), (19, [(0, 18)]), (3, [(4, 19)]), (16, [(0, 15)])]
)
def test_no_frame_of_a_static_run_is_touched(touched: int, runs: list[tuple[int, int]]) -> None:
    still, vertices = np.tile(np.eye(4), (20, 1, 1)), box(0.1, 0.1, 0.1).vertices
    assert list(static_runs(still, vertices, np.arange(20) == touched)) == runs


def test_grasps_cover_what_they_overlap_and_the_clips_hand_the_other() -> None:
    listed = [
        Segment("static", 0, 10), Segment("contact", 10, 14), Segment("grasp", 14, 20, "right"),
        Segment("grasp", 17, 18, "left"), Segment("static", 22, 30),
    ]  # fmt: skip
    spans = [(s.state, s.first, s.last, s.side) for s in resolve_overlaps(listed, 40, "left")]
    assert spans == [
        ("static", 0, 9, None), ("contact", 10, 13, None), ("grasp", 14, 16, "right"), ("grasp", 17, 18, "left"),
        ("grasp", 19, 20, "right"), ("static", 22, 30, None),
    ]  # fmt: skip
    assert [s.side for s in resolve_overlaps(listed, 40, "right") if s.state == "grasp"] == ["right"]


def test_long_static_segments_part_timelines() -> None:
    long, short = 2 * STATIC_MARGIN_FRAMES + 10, 2 * STATIC_MARGIN_FRAMES
    segments, at = [], 0
    for state, length in [
        ("static", long), ("contact", 5), ("static", short), ("grasp", 20), ("static", long), ("free", 9),
        ("static", long), ("contact", 3),
    ]:  # fmt: skip
        segments.append(Segment(state, at, at + length - 1, "left" if state == "grasp" else None))  # type: ignore[arg-type]
        at += length
    found = [(int(rows[0]), int(rows[-1])) for rows in interactions(segments)]
    assert found == [
        (long - STATIC_MARGIN_FRAMES, long + 5 + short + 20 + STATIC_MARGIN_FRAMES - 1),
        (at - 3 - STATIC_MARGIN_FRAMES, at - 1),
    ]
    assert list(interactions(segments[:1])) == []
