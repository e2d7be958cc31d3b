"""Joints in another order than stated, about the wrist, and dumps of joblib."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from getagrip.errors import InputError
from getagrip.hands import generic
from getagrip.hands.fit import ORDERS
from getagrip.hands.trackers import records
from getagrip.hands.trackers.joint_checks import check_before_camera, check_order

HAND = generic.load("right").with_shape().with_pose(np.zeros(45))
JOINTS = np.tile(np.reshape(HAND.joints, (1, 21, 3)) + np.array([0.0, 0.0, 0.6]), (3, 1, 1))


def test_the_order_that_fits_is_named() -> None:
    check_order(Path("j.npz"), JOINTS, "openpose", "right")
    with pytest.raises(InputError, match="--order ho3d fits"):
        check_order(Path("j.npz"), JOINTS[:, np.argsort(ORDERS["ho3d"])], "openpose", "right")


def test_joints_about_the_hands_middle_are_refused() -> None:
    check_before_camera(Path("j.npz"), JOINTS)
    with pytest.raises(InputError, match="at or behind the camera"):
        check_before_camera(Path("j.npz"), JOINTS - JOINTS.mean(axis=1, keepdims=True))


def test_a_dump_of_joblib_is_named(tmp_path: Path) -> None:
    path = tmp_path / "world.pth"
    path.write_bytes(b"\x80\x04\x8c\x13joblib.numpy_pickle\x94.")
    with pytest.raises(InputError, match=r"joblib\.load"):
        records.read(path)
