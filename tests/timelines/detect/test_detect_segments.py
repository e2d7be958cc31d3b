"""Segments of an uncut clip, found without its ground truth."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from getagrip.clip import HandTrack, Masks, OtherHand
from getagrip.errors import UsageError
from getagrip.fitting.options import Options
from getagrip.stable_grasps.definition import Definition
from getagrip.timelines.detect.detect_segments import DetectedSegments, find_segments
from helpers.scenes import HOLDING, LYING, from_table

DEFINITION = Definition(contact=0.010, shortest=10)
QUICK = Options(inits=12, frames=12)


@cache
def found() -> DetectedSegments:
    clip, masks = from_table()
    return find_segments(replace(clip, truth=None), masks, DEFINITION, QUICK)


@pytest.mark.slow
def test_a_grasp_is_found_within_a_few_frames_under_a_moving_head() -> None:
    states = [(s.segment.state, s.segment.first, s.segment.last) for s in found().segments]
    assert states[0][0] == "static"
    assert states[-1] == ("grasp", states[-1][1], LYING + HOLDING - 1)
    assert abs(states[-1][1] - LYING) <= 3
    assert found().grasps == [states[-1][1:]]


@pytest.mark.slow
def test_frames_without_a_mask_are_no_sign_that_the_object_lies() -> None:
    clip, masks = from_table()
    seen, ignored = masks.object.copy(), masks.ignore.copy()
    seen[1::2], ignored[1::2] = False, True
    some = find_segments(replace(clip, truth=None), Masks(seen, ignored), replace(DEFINITION, shortest=5), QUICK)
    states = [(s.segment.state, s.segment.first, s.segment.last) for s in some.segments]
    assert states[0][:2] == ("static", 0)
    assert all(b[1] == a[2] + 1 for a, b in pairwise(states))
    assert states[-1] == ("grasp", states[-1][1], LYING + HOLDING - 1)
    assert abs(states[-1][1] - LYING) <= 6
    assert any(f"{(LYING + HOLDING) // 2} of {LYING + HOLDING} frames have no mask" in note for note in some.notes)


@pytest.mark.slow
def test_segments_cover_the_clip_and_are_better_than_the_next_best() -> None:
    segments = [s.segment for s in found().segments]
    assert segments[0].first == 0
    assert all(b.first == a.last + 1 for a, b in pairwise(segments))
    assert all(s.margin > 0.0 for s in found().segments)
    assert {s.side for s in segments if s.state == "grasp"} == {"right"}
    assert not found().notes


@pytest.mark.slow
def test_a_grasp_of_the_other_hand_is_found_as_its() -> None:
    clip, masks = from_table()
    mirror, T = np.array([-1.0, 1.0, 1.0]), np.repeat(clip.hand.T_cam_hand[:1], len(clip), axis=0)
    T[:, 0, 3] -= 0.12
    own = HandTrack(mirror * clip.hand.vertices, clip.hand.faces[:, ::-1], T, clip.hand.regions)
    known = np.arange(LYING - 4, len(clip))
    other = OtherHand.at(clip.hand.take(known), known, len(clip))
    both = replace(clip, truth=None, hand=own, side="left", other_hand=other)
    segments = [s.segment for s in find_segments(both, masks, DEFINITION, Options(inits=6, frames=8)).segments]
    assert (segments[-1].state, segments[-1].side) == ("grasp", "right")
    assert abs(segments[-1].first - LYING) <= 3
    assert segments[0].state == "static"


def test_an_object_that_never_moves_is_static_and_no_fit_is_needed() -> None:
    clip, masks = from_table()
    lying = np.zeros(12, dtype=int)
    still = replace(clip.take(np.arange(12)), world=None)
    held = {"hands_held": "a guess in the frames 000000 to 000002"}
    alone = find_segments(replace(still, provenance=held), masks.take(lying), DEFINITION)
    assert [(s.segment.state, s.segment.first, s.segment.last) for s in alone.segments] == [("static", 0, 11)]
    assert alone.notes[0] == "the camera is taken to stand still: a guess"
    assert alone.notes[1].startswith("hands_held: a guess in the frames 000000 to 000002")


def test_masks_of_another_clip_are_refused() -> None:
    clip, masks = from_table()
    with pytest.raises(UsageError, match="masks"):
        find_segments(clip, Masks(masks.object[1:], masks.ignore[1:]))
