"""Plain parameters of MANO, in every encoding, give the hand that they are of."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from getagrip.geometry import se3
from getagrip.hands import mano
from getagrip.hands.model import Side
from getagrip.readers.trackers import read_tracked_hands
from getagrip.readers.trackers.mano_parameters import ManoParameters
from helpers.hand_files import PIXELS, SIDES, Known, joints_of, request, write_npz


@pytest.mark.parametrize("mean", ["flat", "mean"])
@pytest.mark.parametrize("pose", ["axis-angle", "pca", "matrix"])
@pytest.mark.parametrize("side", SIDES)
@pytest.mark.slow
def test_plain_parameters(tmp_path: Path, mano_folder: Path, side: Side, pose: Any, mean: Any) -> None:
    known = Known(side, mano_folder)
    hand = mano.load(mano_folder / f"MANO_{side.upper()}.pkl", side)
    values = known.pose - (hand.mean if mean == "mean" else 0.0)
    if pose == "pca":
        values = values @ np.linalg.inv(hand.components)
    if pose == "matrix":
        values = se3.exp_so3(values.reshape(3, 15, 3))
    content = {"global_orient": se3.log_so3(known.R), "hand_pose": values, "betas": known.betas, "transl": known.t}
    path = write_npz(tmp_path / "hands.npz", content | {"joints_2d": PIXELS})
    hands = read_tracked_hands([path], ManoParameters(pose, mean), request(side, mano_folder))
    np.testing.assert_allclose(joints_of(hands), known.joints, atol=1e-6)
    assert hands.track.joints_2d is not None
    np.testing.assert_allclose(hands.track.joints_2d, PIXELS)
    assert "guess" in str(hands.provenance["hands_focal"])
