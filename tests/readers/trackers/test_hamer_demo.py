"""What the demos of HaMeR and WiLoR save of a known hand comes back as it was; damaged files are named."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.hands.model import Side
from getagrip.readers.trackers import read_tracked_hands
from getagrip.readers.trackers.hamer import HaMeR, WiLoR
from helpers.hand_files import SIDES, Known, demo_files, joints_of, request


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.slow
def test_what_hamers_demo_saves(tmp_path: Path, mano_folder: Path, side: Side) -> None:
    """Meshes come back as they were, their wrist and joints nearly: what these rest on changes with shape."""
    known, folder = Known(side, mano_folder), tmp_path / "out_demo"
    folder.mkdir()
    for n in range(3):
        demo_files(folder, known, n)
    (folder / "000007_0.png").touch()
    hands = read_tracked_hands([folder], HaMeR(), request(side, mano_folder))
    assert hands.found == (0, 1, 2)
    seen = se3.transform(hands.track.T_cam_hand, hands.track.vertices)
    off = seen - known.vertices
    assert np.ptp(off, axis=1).max() < 1e-5
    assert np.abs(off[..., :2]).max() < 1e-4
    assert np.abs(off[..., 2]).max() < 0.003  # as far as the wrist is off
    assert np.abs(joints_of(hands) - known.joints).max() < 0.006
    wilor = read_tracked_hands([folder / "*.obj"], WiLoR(), request(side, mano_folder))
    np.testing.assert_array_equal(wilor.track.vertices, hands.track.vertices)
    with pytest.raises(InputError, match=f"no {'left' if side == 'right' else 'right'} hand"):
        read_tracked_hands([folder], HaMeR(), request("left" if side == "right" else "right", mano_folder))


@pytest.mark.parametrize("side", SIDES)
def test_joints_of_hamers_demo(tmp_path: Path, side: Side) -> None:
    """Without MANO the generic hand is fitted; left hands' joints are turned back, of which the mesh beside tells."""
    known = Known(side, None)
    for n in range(3):
        demo_files(tmp_path, known, n, mesh=False)
    with pytest.raises(UsageError, match="--save_mesh"):
        read_tracked_hands([tmp_path], HaMeR(), request(side))
    stated = read_tracked_hands([tmp_path], HaMeR(joints_of=side), request(side))
    assert np.abs(joints_of(stated) - known.joints).max() < 0.006  # the generic hand's wrist is not MANO's
    known.vertices = known.vertices[:, :778]
    for n in range(3):
        demo_files(tmp_path, known, n, joints=False)
    found = read_tracked_hands([tmp_path], HaMeR(), request(side))
    np.testing.assert_array_equal(joints_of(found), joints_of(stated))


def test_damaged_files_of_the_demo(tmp_path: Path, mano_folder: Path, refused: Callable[..., str]) -> None:
    known = Known("right", mano_folder)
    demo_files(tmp_path, known, 0)
    path = tmp_path / "000007_0.obj"
    text = path.read_text()
    for bad, words in (
        (text.replace("f 93 39 235", "f 93 39 236"), "which say which hand"),
        (text.replace("v ", "v nan ", 1), "NaN"),
        (text.replace("v ", "v 1 2 3\nv ", 1), "779 vertices"),
    ):
        path.write_text(bad)
        refused(lambda: read_tracked_hands([path], HaMeR(), request("right", mano_folder)), str(path), words)
    path.write_text(text)
    with pytest.raises(UsageError, match="--mano"):
        read_tracked_hands([path], HaMeR(), request("right"))
    joints = tmp_path / "000007_9_3dkeypoints.npy"  # the second of its batch
    np.save(joints, known.joints[:1])
    refused(lambda: read_tracked_hands([joints], HaMeR("right"), request("right")), "1 hands", "hand 9")
