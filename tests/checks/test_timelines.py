"""Checks of timelines: nothing where all is right; each mistake is found in the segment where it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from getagrip.checks.of_timeline import Examined, examine_timeline
from getagrip.clip import Clip
from helpers.timelines import LIES, timeline


def examined(clip: Clip, iou: float = 0.9, away: float = 0.0, hidden: bool = False) -> Examined:
    """The true poses, the lying object moved away by so many metres and met with that IOU."""
    masks = timeline()[1]
    assert clip.truth is not None
    T_cam_obj, met = clip.truth.T_cam_obj.copy(), np.full(len(clip), 0.9)
    T_cam_obj[:LIES, 0, 3] += away
    met[:LIES] = np.nan if hidden else iou
    return examine_timeline(clip, masks, clip.hand.T_cam_hand, T_cam_obj, 1.0, met)


def test_nothing_is_found_where_all_is_right() -> None:
    found = examined(timeline()[0])
    assert (found.findings, found.failed) == ((), "")
    lies, comes, grasp = found.of_segments
    assert lies["floats"] == pytest.approx(0.0, abs=0.5)
    assert {*comes} == {"mask-fit", "worst-frame"}
    assert {"frame-order", "contact-gap"} < {*grasp}
    assert "hand-side" in found.checks


def test_a_pose_that_jumps_and_a_segment_that_fails_are_said() -> None:
    found = examined(timeline()[0], iou=0.3, away=0.2)
    assert {finding.check for finding in found.findings if finding.serious} == {"jump", "mask-fit"}
    (poor,) = (finding for finding in found.findings if finding.check == "mask-fit")
    assert poor.message.startswith("static from 000000: ")
    assert found.failed == "static from 000000 (0.30)"


def test_a_segment_that_nothing_shows_is_not_checked() -> None:
    found = examined(timeline()[0], hidden=True)
    assert found.of_segments[0] == {}
    assert found.findings == ()


def test_hands_in_reverse_are_found_in_the_grasp_alone() -> None:
    clip, _ = timeline()
    rows = clip.segments[2].rows
    T = clip.hand.T_cam_hand.copy()
    T[rows] = T[rows[::-1]]
    found = examined(replace(clip, hand=replace(clip.hand, T_cam_hand=T)))
    assert any(f.check == "frame-order" and f.message.startswith("grasp from") for f in found.findings)
