"""HaMeR's and WiLoR's hands: files written by their formulas from a known hand give that hand."""

from __future__ import annotations

import pickle
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.hands.model import SIDE_MIRROR, Side
from getagrip.provenance import is_assumed
from getagrip.readers.trackers import Request, Tracker, read_tracked_hands
from getagrip.readers.trackers.hamer import HaMeR, WiLoR
from helpers.hand_files import FRAMES, SIDES, Known, demo_files, hamer_record, joints_of, request, write_npz


@pytest.mark.parametrize("with_mano", [True, False])
@pytest.mark.parametrize("kind", ["crop", "full", "assumed", "box"])
@pytest.mark.parametrize("side", SIDES)
@pytest.mark.slow
def test_hamer(tmp_path: Path, mano_folder: Path, side: Side, kind: str, with_mano: bool) -> None:
    folder = mano_folder if with_mano else None
    known = Known(side, folder)
    paths = [write_npz(tmp_path / f"{name}_0.npz", hamer_record(known, n, kind)) for n, name in enumerate(FRAMES)]
    hands = read_tracked_hands(paths, HaMeR(), request(side, folder))
    np.testing.assert_allclose(joints_of(hands), known.joints, atol=1e-6)
    seen = se3.transform(hands.track.T_cam_hand, hands.track.vertices)
    np.testing.assert_allclose(seen, known.vertices, atol=1e-6)
    assert hands.found == (0, 1, 2)
    assert "focal" in str(hands.provenance["hands_focal"])


@pytest.mark.parametrize("side", SIDES)
def test_later_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, side: Side) -> None:
    """The ``.pt`` files of the authors' later code: both hands, boxes in 456 x 256 images; read by torch's safe way."""
    other: Side = "left" if side == "right" else "right"
    both = {side: Known(side, None), other: Known(other, None, seed=1)}
    size = (912, 512)
    K2 = np.array([[700.0, 0.0, 450.0], [0.0, 700.0, 260.0], [0.0, 0.0, 1.0]])
    contents = {}
    for n, name in enumerate(FRAMES):
        record = {}
        for which, known in both.items():
            R, fingers = known.raw(n)
            box = np.array([200.0, 100.0, 260.0, 190.0])
            side_px = max(2 * 90.0, 2 * 60.0 * 256 / 192)
            s = 2.0 * 350.0 / (side_px * known.t[n][2])  # a 456 x 256 image has half the focal length
            u = (K2[:2, 2] + 700.0 * known.t[n][:2] / known.t[n][2]) / 2.0
            cam = np.array([s, *(2.0 * (u - [230.0, 145.0]) / (side_px * s))])
            record[which] = {"pred_cam": cam, "global_orient": R[None], "hand_pose": fingers, "betas": np.zeros(10),
                             "box_xyxy_456x256": box}  # fmt: skip
        path = tmp_path / f"frame_{int(name):010d}.pt"
        with __import__("zipfile").ZipFile(path, "w") as archive:
            archive.writestr("x/data.pkl", str(n))
        contents[path.read_bytes()] = record
    fake_torch(monkeypatch, contents)
    paths = sorted(tmp_path.glob("*.pt"))
    hands = read_tracked_hands(paths, HaMeR(), Request(side, FRAMES, np.tile(K2, (3, 1, 1)), size))
    np.testing.assert_allclose(joints_of(hands), both[side].joints, atol=1e-6)


def fake_torch(monkeypatch: pytest.MonkeyPatch, contents: dict[bytes, Any]) -> None:
    """A torch whose ``load`` gives known content, and only in the safe way."""

    class Tensor:
        pass

    def load(stream: Any, map_location: str, weights_only: bool) -> Any:
        assert weights_only is True
        assert map_location == "cpu"
        return contents[stream.read()]

    torch = types.ModuleType("torch")
    torch.Tensor, torch.load = Tensor, load  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "torch", torch)


def test_torch_is_named_where_it_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    path = tmp_path / "000007.pt"
    path.write_bytes(b"PK")
    with pytest.raises(UsageError, match=r"pip install .*\[torch\]"):
        read_tracked_hands([path], HaMeR(), request("right"))


@pytest.mark.parametrize("flipped", [False, True])
@pytest.mark.parametrize("side", SIDES)
def test_keypoints_serve_where_there_is_no_mano(tmp_path: Path, side: Side, flipped: bool) -> None:
    """The generic hand is fitted to HaMeR's keypoints; those of a left hand may or may not have been mirrored."""
    known = Known(side, None)
    paths = []
    for n, name in enumerate(FRAMES):
        joints = known.joints[n] - known.t[n]
        if side == "left" and flipped:
            joints = joints * SIDE_MIRROR
        record = hamer_record(known, n, "crop") | {"pred_keypoints_3d": joints}
        paths.append(write_npz(tmp_path / f"{name}.npz", record))
    hands = read_tracked_hands(paths, HaMeR(), request(side))
    assert np.abs(joints_of(hands) - known.joints).max() < 0.01
    assert "fitted" in str(hands.provenance["hands"])


def test_several_hands_in_one_record(tmp_path: Path) -> None:
    """Rows are hands; the other side's are passed over, of two of one side one is taken."""
    right, left = Known("right", None), Known("left", None, seed=3)
    records = [hamer_record(right, 0, "crop"), hamer_record(left, 0, "crop")]
    both = {key: np.stack([r[key] for r in records]) for key in records[0]}
    path = write_npz(tmp_path / "000007.npz", both)
    for side, known in (("right", right), ("left", left)):
        hands = read_tracked_hands([path], HaMeR(), request(side))  # type: ignore[arg-type]
        np.testing.assert_allclose(joints_of(hands), known.joints[:1], atol=1e-6)
    write_npz(path, both | {"right": np.ones(2)})
    chosen = read_tracked_hands([path], HaMeR(), request("right")).provenance["hands_chosen"]
    assert "several right hands in 1 of 1 frames" in str(chosen)
    assert is_assumed(chosen)


def test_img_size_as_height_and_width(tmp_path: Path) -> None:
    """It is read the other way round where the clip's images say so; other proportions are refused."""
    known = Known("right", None)
    record = hamer_record(known, 0, "full")
    path = write_npz(tmp_path / "000007.npz", record | {"img_size": record["img_size"][::-1]})
    hands = read_tracked_hands([path], HaMeR(), request("right"))
    np.testing.assert_allclose(joints_of(hands), known.joints[:1], atol=1e-6)
    assert "img_size read as height and width, a guess" in str(hands.provenance["hands_focal"])
    write_npz(path, record | {"img_size": np.array([480.0, 480.0])})
    with pytest.raises(InputError, match=r"must be width and height like the clip's images, 640 x 480.*got 480 x 480"):
        read_tracked_hands([path], HaMeR(), request("right"))


def test_one_file_of_many_images(tmp_path: Path) -> None:
    """Pickles keyed by the path of the image: a record each, a list of records, or lists of parameters."""
    known = Known("left", None)
    records = [hamer_record(known, n, "full") for n in range(3)]
    keys = [f"/data/video/{name}.jpg" for name in FRAMES]
    other = hamer_record(Known("right", None, seed=1), 0, "full")
    mano = [{k: r[k] for k in ("global_orient", "hand_pose", "betas")} | {"is_right": 0} for r in records]
    for content in (
        dict(zip(keys, records, strict=True)),
        {key: [other, record] for key, record in zip(keys, records, strict=True)},
        {k: {"mano": [m], "cam_trans": [r["pred_cam_t_full"]], "shot": 0}
         for k, m, r in zip(keys, mano, records, strict=True)},
    ):  # fmt: skip
        path = tmp_path / "results.pkl"
        path.write_bytes(pickle.dumps(content))
        hands = read_tracked_hands([path], HaMeR(), request("left"))
        np.testing.assert_allclose(joints_of(hands), known.joints, atol=1e-6)
    path.write_bytes(pickle.dumps({"/data/video/000010.jpg": records[0]}))
    with pytest.raises(InputError, match=r"no name of a frame \(/data/video/000010.jpg"):
        read_tracked_hands([path], HaMeR(), request("left"))


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
        (text.replace("f 93 39 235", "f 93 39 236"), "which tells the side"),
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
