"""Plain joints give the hand that they are of."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from getagrip.hands.fit_joints import JOINT_ORDERS
from getagrip.hands.model import Side
from getagrip.readers.trackers import read_tracked_hands
from getagrip.readers.trackers.joints import Joints
from helpers.hand_files import SIDES, Known, joints_of, request, write_npz


@pytest.mark.parametrize("side", SIDES)
def test_joints(tmp_path: Path, side: Side) -> None:
    """Joints of a generic hand give that hand back but for what the prior takes, in whatever order the frames are."""
    known = Known(side, None)
    input_joints = np.empty_like(known.joints)
    input_joints[:, JOINT_ORDERS["ho3d"]] = known.joints
    content = {"joints": input_joints[[2, 0]], "frames": np.array(["000009", "frame_7"])}
    path = write_npz(tmp_path / "j.npz", content)
    hands = read_tracked_hands([path], Joints("ho3d"), request(side))
    assert hands.found == (0, 2)
    assert np.abs(joints_of(hands) - known.joints[[0, 2]]).max() < 0.01
    write_npz(path, content | {"frames": np.array(["000009", "frame_9"])})
    twice = read_tracked_hands([path], Joints("ho3d"), request(side))
    assert twice.found == (2,)
    assert "several" in str(twice.provenance["hands_chosen"])


def test_the_hand_stands_still_before_the_first_and_after_the_last_frame(tmp_path: Path) -> None:
    path = write_npz(tmp_path / "j.npz", {"joints": Known("right", None).joints[[0, 2]], "frames": np.array([7, 9])})
    found = replace(read_tracked_hands([path], Joints("openpose"), request("right")), found=(2, 4))
    held = found.extrapolate_to_ends(tuple("abcdefg"))
    assert held.found == (0, 1, 2, 4, 5, 6)  # d lies between two hands
    for there, at in ((found.track.T_cam_hand, held.track.T_cam_hand), (found.track.joints, held.track.joints)):
        assert there is not None
        np.testing.assert_array_equal(at, there[[0, 0, 0, 1, 1, 1]])
    assert "a guess in the frames a to b and f to g" in str(held.provenance["hands_held"])
    assert found.extrapolate_to_ends(tuple("abcde")).found == (0, 1, 2, 4)
    assert replace(found, found=(0, 1)).extrapolate_to_ends(("a", "b")).provenance == found.provenance
