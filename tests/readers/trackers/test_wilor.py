"""Hands from WiLoR-mini and hamer-mini: written by its own formulas from a known hand, they come back as it was."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

from getagrip.geometry import se3
from getagrip.hands.model import Side
from getagrip.readers.trackers import Tracker, read_tracked_hands
from getagrip.readers.trackers.hamer import HaMeR, WiLoR
from helpers.hand_files import FRAMES, SIDES, Known, hamer_record, joints_of, request


@pytest.mark.parametrize(("tracker", "key"), [(WiLoR(), "wilor_preds"), (HaMeR(), "hamer_preds")])
@pytest.mark.parametrize("side", SIDES)
@pytest.mark.slow
def test_mini(tmp_path: Path, mano_folder: Path, side: Side, tracker: Tracker, key: str) -> None:
    """Lists of hands. Rotations are vectors, of left hands turned back already."""
    known = Known(side, mano_folder)
    paths = []
    for n, name in enumerate(FRAMES):
        full = hamer_record(known, n, "full")
        inner = {
            "global_orient": se3.log_so3(known.R[n])[None, None],
            "hand_pose": known.pose[n].reshape(1, 15, 3),
            "betas": known.betas[n][None],
            "pred_cam_t_full": full["pred_cam_t_full"][None],
            "scaled_focal_length": full["scaled_focal_length"],
        }
        path = tmp_path / f"{name}.pkl"
        path.write_bytes(pickle.dumps([{"is_right": float(side == "right"), key: inner}]))
        paths.append(path)
    hands = read_tracked_hands(paths, tracker, request(side, mano_folder))
    np.testing.assert_allclose(joints_of(hands), known.joints, atol=1e-6)
