"""Joints in another order than stated, of the other side, relative to the wrist, or of no hand; dumps of joblib."""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path

import numpy as np
import pytest

from getagrip.errors import InputError, UsageError
from getagrip.hands import generic
from getagrip.hands.fit_joints import JOINT_ORDERS
from getagrip.hands.model import SIDE_MIRROR
from getagrip.readers.trackers import read_tracked_hands, records
from getagrip.readers.trackers.joints import Joints
from getagrip.readers.trackers.read_hands import check_before_camera, reorder_joints
from helpers.hand_files import SIDES, Known, joints_of, request, write_npz

PATH = Path("j.npz")
HAND = generic.load("right").with_shape().with_pose(np.zeros(45))
JOINTS = np.tile(np.reshape(HAND.joints, (1, 21, 3)) + np.array([0.0, 0.0, 0.6]), (3, 1, 1))
HO3D = np.argsort(JOINT_ORDERS["ho3d"])


@pytest.mark.parametrize("noise", [0.0, 0.005, 0.015])
def test_the_order_that_fits_is_named(noise: float) -> None:
    """Noise alone is no reason to refuse joints."""
    joints = JOINTS + np.random.default_rng(0).normal(scale=noise, size=JOINTS.shape)
    assert reorder_joints(PATH, joints, "openpose", "right") == (pytest.approx(joints), "", "")
    with pytest.raises(InputError, match="--order ho3d fits"):
        reorder_joints(PATH, joints[:, HO3D], "openpose", "right")
    with pytest.raises(InputError, match="--order openpose fits"):
        reorder_joints(PATH, joints, "ho3d", "right")


@pytest.mark.parametrize("side", SIDES)
def test_order_auto(tmp_path: Path, side: str) -> None:
    known = Known(side, None)  # type: ignore[arg-type]
    for order, joints in (("openpose", known.joints), ("ho3d", known.joints[:, HO3D])):
        path = write_npz(tmp_path / "j.npz", {"joints": joints})
        hands = read_tracked_hands([path], Joints("auto"), request(side))  # type: ignore[arg-type]
        assert np.abs(joints_of(hands) - known.joints).max() < 0.01
        assert f"order {order}, a guess" in str(hands.provenance["hands_scale"])
    write_npz(path, {"joints": known.joints[:, np.random.default_rng(0).permutation(21)]})
    with pytest.raises(InputError, match="must be one order that fits"):
        read_tracked_hands([path], Joints("auto"), request(side))  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="openpose, ho3d or auto"):
        read_tracked_hands([path], Joints(), request(side))  # type: ignore[arg-type]


@pytest.mark.parametrize("axis", range(3))
def test_mirrored_joints_are_said_to_be_the_other_hands(axis: int) -> None:
    centre = JOINTS.mean(axis=1, keepdims=True)
    turned = (JOINTS - centre) * np.roll(SIDE_MIRROR, axis) + centre
    with pytest.raises(InputError, match=r"a left hand fits, .*: are they the other hand's, or mirrored"):
        reorder_joints(PATH, turned, "openpose", "right")
    with pytest.raises(InputError, match="a left hand in --order openpose fits"):
        reorder_joints(PATH, turned, "ho3d", "right")
    noisy = turned + np.random.default_rng(0).normal(scale=0.005, size=turned.shape)
    assert "a left hand fits" in reorder_joints(PATH, noisy, "openpose", "right").warning


def test_joints_that_fit_no_hand_are_flagged(tmp_path: Path) -> None:
    known = Known("right", None)
    path = write_npz(tmp_path / "j.npz", {"joints": known.joints})
    assert read_tracked_hands([path], Joints("openpose"), request("right")).warnings == ()
    swapped = known.joints.copy()
    swapped[:, [4, 20]] = swapped[:, [20, 4]]
    write_npz(path, {"joints": swapped})
    assert "mm off every pose of a hand" in read_tracked_hands([path], Joints("openpose"), request("right")).warnings[0]


@pytest.mark.parametrize("about", [[0], [9], range(21)])
def test_joints_relative_to_the_hand_are_refused(about: list[int]) -> None:
    check_before_camera(PATH, JOINTS)
    ahead = JOINTS[..., [2, 0, 1]]  # fingers that point away from the camera
    for joints in (JOINTS, ahead, -ahead):
        with pytest.raises(InputError, match="relative to the wrist"):
            check_before_camera(PATH, joints - joints[:, about].mean(axis=1, keepdims=True))


def test_a_dump_of_joblib_is_named(tmp_path: Path) -> None:
    path = tmp_path / "world.pth"
    named = b"\x80\x04\x8c\x13joblib.numpy_pickle\x94."
    for content in (named, zlib.compress(named), gzip.compress(named)):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"joblib\.load"):
            records.read_tracker_record(path)
