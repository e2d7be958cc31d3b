"""The segments of labelled motion: an object that lies, is touched, carried, put down and left."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from getagrip.clip import Clip, Segment, Truth, World
from getagrip.errors import InputError
from getagrip.geometry import se3
from getagrip.geometry.subdivide import fine
from getagrip.grasps.definition import Definition
from getagrip.grasps.states import static_runs, true_segments
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
    mesh = fine([box(0.05, 0.07, 0.11)], 500)[0]
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
    at = np.zeros((20, 4, 3))
    untouched = np.zeros(20, dtype=bool)
    assert list(static_runs(at, untouched)) == [(0, 19)]
    at[:, :, 0] = 0.001 * np.arange(20)[:, None]  # 3 mm away after three frames
    assert list(static_runs(at, untouched)) == []
    at[10:] = at[10]
    assert list(static_runs(at, untouched)) == [(8, 19)]  # by then it is within 3 mm of where it stays
