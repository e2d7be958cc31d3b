"""Hands from FrankMocap's files: written by its own formulas from a known hand, they come back as it was."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.hands import mano
from getagrip.hands.model import Side, mirrored_pose
from getagrip.readers.trackers import read_tracked_hands
from getagrip.readers.trackers.frankmocap import FrankMocap
from helpers.hand_files import FRAMES, PIXELS, SIDES, Known, frankmocap_record, joints_of, request


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.slow
def test_frankmocap(tmp_path: Path, mano_folder: Path, side: Side) -> None:
    known = Known(side, mano_folder)
    known.betas[:] = 0.0
    flat = Known.__new__(Known)
    flat.__dict__ |= known.__dict__
    model = mano.load(mano_folder / f"MANO_{side.upper()}.pkl", side).model.with_shape()
    T = se3.rigid(known.R, model.joints[0] - known.R @ model.joints[0] + known.t)
    posed = model.with_pose(known.pose)
    flat.vertices, flat.joints = se3.transform(T, posed.vertices), se3.transform(T, posed.joints)
    mean = mano.load(mano_folder / "MANO_RIGHT.pkl", "right").mean
    mean = mirrored_pose(mean) if side == "left" else mean
    paths = []
    for n, name in enumerate(FRAMES):
        paths.append(tmp_path / f"{name}_prediction_result.pkl")
        record = frankmocap_record(flat, n, mean)
        record["pred_output_list"][0][f"{side}_hand"]["joints_2d"] = PIXELS[n]
        paths[-1].write_bytes(pickle.dumps(record))
    hands = read_tracked_hands(paths, FrankMocap(), request(side, mano_folder))
    np.testing.assert_allclose(joints_of(hands), flat.joints, atol=1e-6)
    assert hands.track.joints_2d is not None
    np.testing.assert_allclose(hands.track.joints_2d, PIXELS)
    with pytest.raises(UsageError, match="--mano"):
        read_tracked_hands(paths, FrankMocap(), request(side))
    with pytest.raises(InputError, match=f"no {'left' if side == 'right' else 'right'} hand"):
        read_tracked_hands(paths, FrankMocap(), request("left" if side == "right" else "right", mano_folder))
    other = frankmocap_record(flat, 0)
    del other["pred_output_list"][0][f"{side}_hand"]["pred_vertices_smpl"]
    paths[0].write_bytes(pickle.dumps(other))
    with pytest.raises(InputError, match="--save_mesh"):
        read_tracked_hands(paths, FrankMocap(), request(side, mano_folder))
    other = frankmocap_record(flat, 0)
    other["pred_output_list"][0][f"{side}_hand"]["pred_hand_pose"] = np.full((1, 48), 1.0)
    paths[0].write_bytes(pickle.dumps(other))
    with pytest.raises(InputError, match="pred_vertices_smpl"):
        read_tracked_hands(paths, FrankMocap(), request(side, mano_folder))
