"""Checks of timelines: each mistake is found in its segment, and right ones have no finding."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from getagrip.checks.timeline_checks import TimelineChecks, check_timeline
from getagrip.clip import Clip, Masks, check_clip
from getagrip.errors import InputError
from getagrip.fitting.stages.robust_masks import image_iou
from getagrip.geometry import se3
from helpers.scenes import COMES, LIES, timeline


def examined(clip: Clip, iou: float = 0.9, away: float = 0.0, hidden: bool = False) -> TimelineChecks:
    """The true poses, the lying object moved away by so many metres and met with that IOU."""
    masks = timeline()[1]
    T_cam_obj, met = clip.truth.T_cam_obj.copy(), np.full(len(clip), 0.9)
    T_cam_obj[:LIES, 0, 3] += away
    met[:LIES] = np.nan if hidden else iou
    return check_timeline(clip, masks, clip.hand.T_cam_hand, T_cam_obj, 1.0, met)


def test_nothing_is_found_where_all_is_right() -> None:
    found = examined(timeline()[0])
    assert (found.findings, found.failed) == ((), "")
    lies, comes, grasp = found.of_segments
    assert lies["floats"] == pytest.approx(0.0, abs=0.5)
    assert {*comes} == {"mask-fit", "poor-mask-fit", "worst-frame", "uneven-mask-fit", "object-distance", "mask-pixels"}
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


def serious(clip: Clip, masks: Masks, T_cam_obj: np.ndarray, iou: np.ndarray) -> dict[str, str]:
    """Messages of the serious findings, by check."""
    found = check_timeline(clip, masks, clip.hand.T_cam_hand, T_cam_obj, 1.0, iou)
    return {finding.check: finding.message for finding in found.findings if finding.serious}


def poses(clip: Clip) -> np.ndarray:
    return clip.truth.T_cam_obj.copy()


def met(clip: Clip, masks: Masks, T_cam_obj: np.ndarray) -> np.ndarray:
    return image_iou(clip, masks, se3.inverse(clip.hand.T_cam_hand) @ T_cam_obj, 1.0)


@pytest.mark.parametrize("metres", [0.01, 27.0])
def test_an_object_where_no_hand_could_be_is_serious(metres: float) -> None:
    clip, masks = timeline()
    T = poses(clip)
    T[:LIES, :3, 3] *= metres / np.linalg.norm(T[:LIES, :3, 3], axis=1, keepdims=True)
    found = serious(clip, masks, T, np.full(len(clip), 0.95))
    assert found["object-distance"].startswith("static from 000000: the object is ")


@pytest.mark.parametrize("side", [1, 2, 5])
def test_masks_of_few_pixels_are_serious_in_any_state(side: int) -> None:
    clip, masks = timeline()
    small = masks.object.copy()
    for n in range(LIES):
        v, u = np.argwhere(small[n]).mean(axis=0).astype(int)
        small[n] = False
        small[n, v : v + side, u : u + side] = True
    found = serious(clip, replace(masks, object=small), poses(clip), np.full(len(clip), 0.95))
    assert found["mask-pixels"].startswith(f"static from 000000: even the largest mask has {side * side} pixels")


@pytest.mark.parametrize("moving", [0, 2, 3, LIES])
def test_a_static_object_that_moves_is_serious(moving: int) -> None:
    """In the last of its frames; or the camera does, and is said to stand still."""
    clip, masks = timeline()
    moved = masks.object.copy()
    for n in range(moving):
        moved[LIES - moving + n] = np.roll(masks.object[LIES - moving + n], 30 * (n + 1), axis=1)
    other = replace(masks, object=moved)
    found = serious(clip, other, poses(clip), met(clip, other, poses(clip)))
    assert ("static-moves" in found) == (moving > 0)
    assert all(message.startswith("static from 000000: ") for message in found.values())


@pytest.mark.parametrize("seen", [0, 1])
def test_a_grasp_that_nothing_shows_is_serious(seen: int) -> None:
    clip, masks = timeline()
    iou = np.full(len(clip), 0.95)
    iou[clip.segments[2].rows[seen:]] = np.nan
    (message,) = serious(clip, masks, poses(clip), iou).values()
    assert message.startswith(f"grasp from {clip.frames[LIES + COMES]}: the masks show the object in {seen} of its 8")


@pytest.mark.parametrize("far", [1e14, -1e300, 2e5])
def test_a_camera_far_from_the_world_is_refused(far: float) -> None:
    clip, _ = timeline()
    T = clip.world.T_world_cam.copy()
    T[:, 1, 3] = far
    with pytest.raises(InputError, match=r"T_world_cam must be .*got a camera .* from the world's origin in frame"):
        check_clip(replace(clip, world=replace(clip.world, T_world_cam=T)))
