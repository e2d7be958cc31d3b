"""Hands from HaWoR's files: written by its own formulas from a known hand, they come back as it was."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from getagrip.clip.match_frames import renumber_frames
from getagrip.errors import UsageError
from getagrip.geometry import se3
from getagrip.hands.model import Side
from getagrip.readers.trackers import Request, read_tracked_hands
from getagrip.readers.trackers.hawor import HaWoR
from helpers.hand_files import PIXELS, SIDES, SIZE, K, Known, joints_of, request


def from_0(side: Side, folder: Path) -> Request:
    """What is asked for where --first 0 is given."""
    asked = request(side, folder)
    return replace(asked, frames=renumber_frames(asked.frames, 0, "--first"), ask_first="")


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.slow
def test_hawor(tmp_path: Path, mano_folder: Path, side: Side) -> None:
    """A focal length other than the clip's is divided out: the hand is seen where it was, at the clip's own depth."""
    known = Known(side, mano_folder)
    focal, centre = 900.0, np.array(SIZE) / 2.0
    u = K[:2, 2] + K[0, 0] * known.t[:, :2] / known.t[:, 2:]
    z = known.t[:, 2] * focal / K[0, 0]
    record = {
        "init_root_orient": known.R[None],
        "init_hand_pose": se3.exp_so3(known.pose.reshape(3, 15, 3))[None],
        "init_betas": known.betas[None],
        "init_trans": np.column_stack([z[:, None] * (u - centre) / focal, z])[None],
        "joints_2d": PIXELS,
    }
    for name, asked in (("6_8.json", request(side, mano_folder)), ("0_2.json", from_0(side, mano_folder))):
        path = tmp_path / name
        path.write_text(json.dumps({key: value.tolist() for key, value in record.items()}))
        hands = read_tracked_hands([path], HaWoR(focal), asked)
        np.testing.assert_allclose(joints_of(hands), known.joints, atol=1e-6)
        assert hands.track.joints_2d is not None
        np.testing.assert_allclose(hands.track.joints_2d, PIXELS)
    with pytest.raises(UsageError, match="--first 0 if the clip's images were its input"):
        read_tracked_hands(
            [path], HaWoR(focal), replace(request(side, mano_folder), frames=("000003", "000004", "000005"))
        )
    with pytest.raises(UsageError, match="--estimator-focal"):
        read_tracked_hands([path], HaWoR(), request(side, mano_folder))
