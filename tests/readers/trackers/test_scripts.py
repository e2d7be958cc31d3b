"""The scripts for the estimators' own environments write what the importer makes."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from getagrip.clip import FINGERS
from getagrip.geometry import se3
from getagrip.hands import generic, mano
from getagrip.hands.model import PALM_REGIONS, Side
from getagrip.io import arrays
from getagrip.readers.trackers import read_tracked_hands
from getagrip.readers.trackers.hamer import HaMeR
from helpers.environment import ROOT
from helpers.hand_files import FRAMES, SIDES, K, Known, hamer_record, request, write_npz

SCRIPTS = ROOT / "scripts" / "estimators"


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.slow
def test_scripts_write_what_the_importer_makes(tmp_path: Path, mano_folder: Path, side: Side) -> None:
    """The hand file that the estimators' scripts write, in plain numpy, is that of ``import hands``."""
    known = Known(side, mano_folder)
    spec = importlib.util.spec_from_file_location("hand_file", SCRIPTS / "hand_file.py")
    assert spec is not None
    assert spec.loader is not None
    hand_file = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hand_file)
    records = [hamer_record(known, n, "crop") for n in range(3)]
    paths = [write_npz(tmp_path / f"{name}.npz", r) for name, r in zip(FRAMES, records, strict=True)]
    expected = read_tracked_hands(paths, HaMeR(), request(side, mano_folder)).track
    right = mano.load(mano_folder / "MANO_RIGHT.pkl", "right").model
    vertices, joints, poses = [], [], []
    for n, record in enumerate(records):
        R, fingers = known.raw(n)
        shaped = right.with_shape(known.betas[n])
        posed = shaped.with_pose(se3.log_so3(fingers).reshape(45))
        root = shaped.joints[0]
        t = hand_file.translation(record["pred_cam"], record["box_center"], record["box_size"], K)
        seen = [(x - root) @ R.T + root for x in (posed.vertices, posed.joints)]
        flat, T = hand_file.hand_frame(seen[0], root, R, t, side)
        vertices.append(flat)
        joints.append(hand_file.hand_frame(seen[1], root, R, t, side)[0])
        poses.append(T)
    regions = hand_file.contact_regions(right.template, right.joints, right.faces, right.weights)
    path = tmp_path / "hand.npz"
    hand_file.write(path, vertices, joints, poses, right.faces, regions, side, [7, 8, 9], K, "known")
    written = arrays.read(path, lambda _: True)  # the synthetic faces are no surface's, so not by read_hand
    for field in ("vertices", "T_cam_hand", "joints", "faces"):
        np.testing.assert_allclose(written[field], getattr(expected, field), atol=1e-6)
    hand = generic.load("right")  # a surface, on which normals weighted by area and by angle agree
    regions = mano.mano_contact_regions(hand.template, hand.faces, hand.joints, hand.weights)
    by_script = hand_file.contact_regions(hand.template, hand.joints, hand.faces, hand.weights)
    assert set(by_script) == set(regions) == {*FINGERS, *PALM_REGIONS} == {*expected.regions}
    for name, ids in regions.items():
        assert f"region_{name}" in written
        both = np.intersect1d(by_script[name], ids)
        assert len(both) > 0.9 * max(len(by_script[name]), len(ids)) > 0
