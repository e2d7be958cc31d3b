"""Hands from estimators' files: written by the estimators' own formulas from a known hand, they come back as it was."""

from __future__ import annotations

import importlib.util
import json
import pickle
import re
import struct
import sys
import types
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy import ndarray

from getagrip.clip import FINGERS
from getagrip.clip.naming import frame_of
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.hands import generic, mano
from getagrip.hands.fit import ORDERS
from getagrip.hands.model import MIRROR, PALM_REGIONS, Side, mirrored_pose
from getagrip.hands.trackers import TRACKERS, Hands, Request, choose, read
from getagrip.hands.trackers.estimates import Camera
from getagrip.hands.trackers.frankmocap import FrankMocap
from getagrip.hands.trackers.hamer import HaMeR
from getagrip.hands.trackers.hawor import HaWoR
from getagrip.hands.trackers.joints import Joints
from getagrip.hands.trackers.mano_parameters import ManoParameters
from getagrip.hands.trackers.weak_perspective import WeakPerspective
from getagrip.hands.trackers.wilor import WiLoR
from getagrip.io import arrays
from helpers.command_line import Run
from helpers.estimator_files import (
    FRAMES,
    SIZE,
    K,
    Known,
    cam_crop_to_full,
    demo_files,
    frankmocap_record,
    hamer_record,
    write_mano_files,
    write_npz,
)
from helpers.paths import ROOT

SCRIPTS = ROOT / "scripts" / "estimators"
SIDES: list[Side] = ["right", "left"]


@pytest.fixture(scope="module")
def mano_files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """MANO files of the published layout, the left hand the right one's mirror image, its fault included."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        return write_mano_files(tmp_path_factory.mktemp("mano"), monkeypatch)


@pytest.fixture
def mano_folder(mano_files: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Nothing may be changed in it."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(mano_files / "cache"))
    return mano_files


def request(side: Side, folder: Path | None = None) -> Request:
    return Request(side, FRAMES, np.tile(K, (3, 1, 1)), SIZE, folder)


def joints_of(hands: Hands) -> ndarray:
    assert hands.track.joints is not None
    return se3.transform(hands.track.T_cam_hand, hands.track.joints)


@pytest.mark.parametrize("with_mano", [True, False])
@pytest.mark.parametrize("kind", ["crop", "full", "assumed", "box"])
@pytest.mark.parametrize("side", SIDES)
@pytest.mark.slow
def test_hamer(tmp_path: Path, mano_folder: Path, side: Side, kind: str, with_mano: bool) -> None:
    folder = mano_folder if with_mano else None
    known = Known(side, folder)
    paths = [write_npz(tmp_path / f"{name}_0.npz", hamer_record(known, n, kind)) for n, name in enumerate(FRAMES)]
    hands = read(paths, HaMeR(), request(side, folder))
    np.testing.assert_allclose(joints_of(hands), known.joints, atol=1e-6)
    seen = se3.transform(hands.track.T_cam_hand, hands.track.vertices)
    np.testing.assert_allclose(seen, known.vertices, atol=1e-6)
    assert hands.found == (0, 1, 2)
    assert "focal" in hands.provenance["hands_focal"]


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
    hands = read(paths, HaMeR(), Request(side, FRAMES, np.tile(K2, (3, 1, 1)), size))
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
    with pytest.raises(UsageError, match=r"getagrip\[torch\]"):
        read([path], HaMeR(), request("right"))


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.slow
def test_wilor_mini(tmp_path: Path, mano_folder: Path, side: Side) -> None:
    """Rotations are vectors, of left hands turned back already."""
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
        path.write_bytes(pickle.dumps({"is_right": float(side == "right"), "wilor_preds": inner}))
        paths.append(path)
    hands = read(paths, WiLoR(), request(side, mano_folder))
    np.testing.assert_allclose(joints_of(hands), known.joints, atol=1e-6)


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
    }
    for name, first in (("6_8.json", 1), ("0_2.json", 7)):  # it counts from 0
        path = tmp_path / name
        path.write_text(json.dumps({key: value.tolist() for key, value in record.items()}))
        hands = read([path], HaWoR(focal, first), request(side, mano_folder))
        np.testing.assert_allclose(joints_of(hands), known.joints, atol=1e-6)
    with pytest.raises(UsageError, match="--estimator-focal"):
        read([path], HaWoR(first=7), request(side, mano_folder))


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
        paths[-1].write_bytes(pickle.dumps(frankmocap_record(flat, n, mean)))
    hands = read(paths, FrankMocap(), request(side, mano_folder))
    np.testing.assert_allclose(joints_of(hands), flat.joints, atol=1e-6)
    with pytest.raises(UsageError, match="--mano"):
        read(paths, FrankMocap(), request(side))
    with pytest.raises(InputError, match=f"no {'left' if side == 'right' else 'right'} hand"):
        read(paths, FrankMocap(), request("left" if side == "right" else "right", mano_folder))
    other = frankmocap_record(flat, 0)
    del other["pred_output_list"][0][f"{side}_hand"]["pred_vertices_smpl"]
    paths[0].write_bytes(pickle.dumps(other))
    with pytest.raises(InputError, match="--save_mesh"):
        read(paths, FrankMocap(), request(side, mano_folder))
    other = frankmocap_record(flat, 0)
    other["pred_output_list"][0][f"{side}_hand"]["pred_hand_pose"] = np.full((1, 48), 1.0)
    paths[0].write_bytes(pickle.dumps(other))
    with pytest.raises(InputError, match="pred_vertices_smpl"):
        read(paths, FrankMocap(), request(side, mano_folder))


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
    path = write_npz(tmp_path / "hands.npz", content)
    hands = read([path], ManoParameters(pose, mean), request(side, mano_folder))
    np.testing.assert_allclose(joints_of(hands), known.joints, atol=1e-6)
    assert "guess" in hands.provenance["hands_focal"]


def test_what_no_file_states_is_asked_for(tmp_path: Path) -> None:
    path = write_npz(tmp_path / "hands.npz", {"transl": np.zeros((3, 3))})
    for tracker, word in [
        (ManoParameters(mean="flat"), "--pose"),
        (ManoParameters(pose="pca"), "--mean"),
        (Joints(), "--order"),
    ]:
        with pytest.raises(UsageError, match=word):
            read([path], tracker, request("right"))


def test_trackers_are_chosen_by_name() -> None:
    for name, tracker in TRACKERS.items():
        assert choose(name) is tracker
    with pytest.raises(UsageError, match="'hammer', expected one of hamer, wilor, hawor, frankmocap, mano, joints"):
        choose("hammer")


@pytest.mark.slow
def test_the_command_takes_what_the_table_lists(run: Run) -> None:
    status, out, _ = run("import", "hands", "--help")
    assert status == 0
    assert f"--from {{{','.join(TRACKERS)}}}" in out
    for tracker in TRACKERS.values():
        for option in vars(tracker):
            assert f"--{option.replace('_', '-')} " in out
    status, _, err = run("import", "hands", "x.npz", "--from", "hammer", "--clip", "x")
    assert status == 2
    assert all(name in err for name in TRACKERS)


def test_options_of_another_tracker_are_refused() -> None:
    given = TRACKERS | {"hawor": HaWoR(estimator_focal=600.0)}
    assert choose("hawor", given) == HaWoR(600.0)
    with pytest.raises(UsageError, match=r"--estimator-focal: got 600\.0, expected none: it belongs to --from hawor"):
        choose("hamer", given)


@pytest.mark.parametrize("side", SIDES)
def test_joints(tmp_path: Path, side: Side) -> None:
    """Joints of a generic hand give that hand back but for what the prior takes, in whatever order the frames are."""
    known = Known(side, None)
    given_joints = np.empty_like(known.joints)
    given_joints[:, ORDERS["ho3d"]] = known.joints
    content = {"joints": given_joints[[2, 0]], "frames": np.array(["000009", "frame_7"])}
    path = write_npz(tmp_path / "j.npz", content)
    hands = read([path], Joints("ho3d"), request(side))
    assert hands.found == (0, 2)
    assert np.abs(joints_of(hands) - known.joints[[0, 2]]).max() < 0.01
    write_npz(path, content | {"frames": np.array(["000009", "frame_9"])})
    with pytest.raises(InputError, match="a second hand in frame 000009"):
        read([path], Joints("ho3d"), request(side))


def test_the_hand_stands_still_before_the_first_and_after_the_last_frame(tmp_path: Path) -> None:
    path = write_npz(tmp_path / "j.npz", {"joints": Known("right", None).joints[[0, 2]], "frames": np.array([7, 9])})
    found = replace(read([path], Joints("openpose"), request("right")), found=(2, 4))
    held = found.held_at_ends(tuple("abcdefg"))
    assert held.found == (0, 1, 2, 4, 5, 6)  # d lies between two hands
    for there, at in ((found.track.T_cam_hand, held.track.T_cam_hand), (found.track.joints, held.track.joints)):
        assert there is not None
        np.testing.assert_array_equal(at, there[[0, 0, 0, 1, 1, 1]])
    assert "a guess in the frames a to b and f to g" in held.provenance["hands_held"]
    assert found.held_at_ends(tuple("abcde")).found == (0, 1, 2, 4)
    assert replace(found, found=(0, 1)).held_at_ends(("a", "b")).provenance == found.provenance


@pytest.mark.parametrize("flipped", [False, True])
@pytest.mark.parametrize("side", SIDES)
def test_keypoints_serve_where_there_is_no_mano(tmp_path: Path, side: Side, flipped: bool) -> None:
    """The generic hand is fitted to HaMeR's keypoints; those of a left hand may or may not have been mirrored."""
    known = Known(side, None)
    paths = []
    for n, name in enumerate(FRAMES):
        joints = known.joints[n] - known.t[n]
        if side == "left" and flipped:
            joints = joints * MIRROR
        record = hamer_record(known, n, "crop") | {"pred_keypoints_3d": joints}
        paths.append(write_npz(tmp_path / f"{name}.npz", record))
    hands = read(paths, HaMeR(), request(side))
    assert np.abs(joints_of(hands) - known.joints).max() < 0.01
    assert "fitted" in hands.provenance["hands"]


def test_several_hands_in_one_record(tmp_path: Path) -> None:
    """Rows are hands; the other side's are passed over, two of one side are refused."""
    right, left = Known("right", None), Known("left", None, seed=3)
    records = [hamer_record(right, 0, "crop"), hamer_record(left, 0, "crop")]
    both = {key: np.stack([r[key] for r in records]) for key in records[0]}
    path = write_npz(tmp_path / "000007.npz", both)
    for side, known in (("right", right), ("left", left)):
        hands = read([path], HaMeR(), request(side))  # type: ignore[arg-type]
        np.testing.assert_allclose(joints_of(hands), known.joints[:1], atol=1e-6)
    write_npz(path, both | {"right": np.ones(2)})
    with pytest.raises(InputError, match="2 right hands"):
        read([path], HaMeR(), request("right"))


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.slow
def test_what_hamers_demo_saves(tmp_path: Path, mano_folder: Path, side: Side) -> None:
    """Meshes come back as they were, their wrist and joints nearly: what these rest on changes with shape."""
    known, folder = Known(side, mano_folder), tmp_path / "out_demo"
    folder.mkdir()
    for n in range(3):
        demo_files(folder, known, n)
    (folder / "000007_0.png").touch()
    hands = read([folder], HaMeR(), request(side, mano_folder))
    assert hands.found == (0, 1, 2)
    seen = se3.transform(hands.track.T_cam_hand, hands.track.vertices)
    off = seen - known.vertices
    assert np.ptp(off, axis=1).max() < 1e-5
    assert np.abs(off[..., :2]).max() < 1e-4
    assert np.abs(off[..., 2]).max() < 0.003  # as far as the wrist is off
    assert np.abs(joints_of(hands) - known.joints).max() < 0.006
    wilor = read([folder / "*.obj"], WiLoR(), request(side, mano_folder))
    np.testing.assert_array_equal(wilor.track.vertices, hands.track.vertices)
    with pytest.raises(InputError, match=f"no {'left' if side == 'right' else 'right'} hand"):
        read([folder], HaMeR(), request("left" if side == "right" else "right", mano_folder))


@pytest.mark.parametrize("side", SIDES)
def test_joints_of_hamers_demo(tmp_path: Path, side: Side) -> None:
    """Without MANO the generic hand is fitted; left hands' joints are turned back, of which the mesh beside tells."""
    known = Known(side, None)
    for n in range(3):
        demo_files(tmp_path, known, n, mesh=False)
    with pytest.raises(UsageError, match="--save_mesh"):
        read([tmp_path], HaMeR(), request(side))
    stated = read([tmp_path], HaMeR(joints_of=side), request(side))
    assert np.abs(joints_of(stated) - known.joints).max() < 0.006  # the generic hand's wrist is not MANO's
    known.vertices = known.vertices[:, :778]
    for n in range(3):
        demo_files(tmp_path, known, n, joints=False)
    found = read([tmp_path], HaMeR(), request(side))
    np.testing.assert_array_equal(joints_of(found), joints_of(stated))


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
        hands = read([path], HaMeR(), request("left"))
        np.testing.assert_allclose(joints_of(hands), known.joints, atol=1e-6)
    path.write_bytes(pickle.dumps({"/data/video/000010.jpg": records[0]}))
    with pytest.raises(InputError, match=r"no name of a frame \(/data/video/000010.jpg"):
        read([path], HaMeR(), request("left"))


def test_paths_that_are_wrong_are_named(tmp_path: Path, refused: Callable[..., str]) -> None:
    (tmp_path / "empty").mkdir()
    right = write_npz(tmp_path / "000007.npz", hamer_record(Known("right", None), 0, "crop"))
    other = write_npz(tmp_path / "000001.npz", hamer_record(Known("right", None), 0, "crop"))
    for path, words in (
        (tmp_path / "none.npz", "no such file or folder"),
        (tmp_path / "none*.npz", "a pattern that matches no file"),
        (tmp_path / "empty", "a folder without such a file"),
        (other, "no name of a frame"),
    ):
        refused(lambda path=path: read([path], HaMeR(), request("right")), str(path), words)
    refused(lambda: read([right], HaMeR(), request("left")), str(right), "no left hand", "is it the right hand")


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
        refused(lambda: read([path], HaMeR(), request("right", mano_folder)), str(path), words)
    path.write_text(text)
    with pytest.raises(UsageError, match="--mano"):
        read([path], HaMeR(), request("right"))
    joints = tmp_path / "000007_9_3dkeypoints.npy"  # the second of its batch
    np.save(joints, known.joints[:1])
    refused(lambda: read([joints], HaMeR("right"), request("right")), "1 hands", "hand 9")


def test_weak_perspective_keeps_the_projection() -> None:
    """Whatever the focal lengths, the hand's origin stays in its pixel, and its size in pixels the same."""
    rng = np.random.default_rng(0)
    K2 = np.array([[500.0, 0.0, 300.0], [0.0, 505.0, 260.0], [0.0, 0.0, 1.0]])
    for _ in range(20):
        centre, side = rng.uniform(100, 500, 2), rng.uniform(50, 400)
        cam = np.array([rng.uniform(0.5, 10), *rng.normal(scale=0.1, size=2)])
        weak = WeakPerspective.of_crop(centre, side, cam)
        t = weak.before(Camera(K2, SIZE))
        np.testing.assert_allclose(project(K2, t[None])[0], centre + side * cam[0] / 2 * cam[1:])
        np.testing.assert_allclose(K2[0, 0] / t[2], side * cam[0] / 2)
        full = cam_crop_to_full(cam, centre, side, SIZE, 1234.0)
        other = WeakPerspective.of_translation(full, 1234.0, np.array(SIZE) / 2.0)
        np.testing.assert_allclose(other.origin, weak.origin, rtol=1e-6)
        np.testing.assert_allclose(other.pixels_per_metre, weak.pixels_per_metre, rtol=1e-6)


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
    expected = read(paths, HaMeR(), request(side, mano_folder)).track
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
    regions = mano.regions(hand.template, hand.faces, hand.joints, hand.weights)
    by_script = hand_file.contact_regions(hand.template, hand.joints, hand.faces, hand.weights)
    assert set(by_script) == set(regions) == {*FINGERS, *PALM_REGIONS} == {*expected.regions}
    for name, ids in regions.items():
        assert f"region_{name}" in written
        both = np.intersect1d(by_script[name], ids)
        assert len(both) > 0.9 * max(len(by_script[name]), len(ids)) > 0


def test_names_of_frames() -> None:
    frames = ("000743", "000744", "7_1")
    assert frame_of("000743", frames) == 0
    assert frame_of("000744_0", frames) == 1
    assert frame_of("000744_prediction_result", frames) == 1
    assert frame_of("frame_0000000743", frames) == 0
    assert frame_of("7_1", frames) == 2
    assert frame_of("000745", frames) is None
    assert frame_of("nothing", frames) is None


# ---------------------------------------------------------------------------------------------- files from strangers

BROKEN: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
    "global_orient": lambda r: r | {"global_orient": np.full((1, 3, 3), np.nan)},
    "hand_pose": lambda r: r | {"hand_pose": np.zeros((14, 3, 3))},
    "betas": lambda r: r | {"betas": np.full(10, np.inf)},
    "pred_cam": lambda r: r | {"pred_cam": np.array([-1.0, 0.0, 0.0])},
    "box_size": lambda r: r | {"box_size": np.nan},
    "box_center": lambda r: {key: value for key, value in r.items() if key != "box_center"},
    "img_size": lambda r: r | {"img_size": np.zeros(2)},
    "right": lambda r: {key: value for key, value in r.items() if key != "right"},
}


@pytest.mark.parametrize("key", BROKEN)
def test_what_is_wrong_is_named(tmp_path: Path, refused: Callable[..., str], key: str) -> None:
    record = BROKEN[key](hamer_record(Known("right", None), 0, "crop"))
    path = write_npz(tmp_path / "000007.npz", record)
    refused(lambda: read([path], HaMeR(), request("right")), str(path), key)


def test_no_code_is_run(tmp_path: Path, mano_folder: Path, refused: Callable[..., str]) -> None:
    class Hostile:
        def __reduce__(self) -> tuple[Any, ...]:
            return Path.touch, (tmp_path / "was-run",)

    path = tmp_path / "000007_prediction_result.pkl"
    for content in (Hostile(), {"pred_output_list": [Hostile()]}):
        path.write_bytes(pickle.dumps(content))
        refused(lambda: read([path], FrankMocap(), request("right", mano_folder)), str(path), "nothing in it was run")
    np.save(tmp_path / "j.npy", np.array([Hostile()], dtype=object), allow_pickle=True)
    refused(lambda: read([tmp_path / "j.npy"], Joints("openpose"), request("right")), "j.npy")
    assert not (tmp_path / "was-run").exists()


def test_nested_and_lying_files(tmp_path: Path, mano_folder: Path, refused: Callable[..., str]) -> None:
    bomb = tmp_path / "6_8.json"
    bomb.write_text('{"init_trans":' + "[" * 100_000 + "]" * 100_000 + "}")
    refused(lambda: read([bomb], HaWoR(600.0), request("right")), str(bomb))
    itself: dict[str, Any] = {}
    itself["pred_output_list"] = [itself]
    path = tmp_path / "000007.pkl"
    path.write_bytes(pickle.dumps(itself))
    refused(lambda: read([path], FrankMocap(), request("right", mano_folder)), str(path))
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (99999999, 21, 3), }".ljust(117) + b"\n"
    lying = tmp_path / "j.npy"
    lying.write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + b"\0" * 64)
    refused(lambda: read([lying], Joints("openpose"), request("right")), str(lying))


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
@pytest.mark.slow
def test_damaged_files_are_refused_or_read(tmp_path: Path, mano_folder: Path, data: st.DataObject) -> None:
    """Truncated files and swapped bytes: an error of this package's that names the file, or plausible numbers."""
    known = Known("right", None)
    source, name = data.draw(
        st.sampled_from([("hamer", "000007.npz"), ("hawor", "6_8.json"), ("frankmocap", "000007.pkl")])
    )
    path = tmp_path / name
    if source == "hamer":
        write_npz(path, hamer_record(known, 0, "crop"))
    elif source == "hawor":
        path.write_text(json.dumps({"init_root_orient": known.R.tolist(), "init_hand_pose": known.pose.tolist(),
                                    "init_betas": known.betas.tolist(), "init_trans": known.t.tolist()}))  # fmt: skip
    else:
        known.vertices = known.vertices[:, :778]
        path.write_bytes(pickle.dumps(frankmocap_record(known, 0)))
    content = bytearray(path.read_bytes())
    if data.draw(st.booleans()):
        content = content[: data.draw(st.integers(0, len(content) - 1))]
    else:
        for _ in range(data.draw(st.integers(1, 8))):
            a, b = (data.draw(st.integers(0, len(content) - 1)) for _ in range(2))
            content[a], content[b] = content[b], content[a]
    path.write_bytes(bytes(content))
    try:
        tracker = {"hamer": HaMeR(), "hawor": HaWoR(600.0), "frankmocap": FrankMocap()}[source]
        hands = read([path], tracker, request("right", mano_folder if source == "frankmocap" else None))
    except InputError as error:
        assert path.name in str(error)  # noqa: PT017
    else:
        assert np.isfinite(hands.track.vertices).all()
        assert se3.is_rigid(hands.track.T_cam_hand).all()


@pytest.mark.slow
def test_small_pickles_that_are_large_in_memory(tmp_path: Path, mano_folder: Path, refused: Callable[..., str]) -> None:
    """A list that holds another twice, which holds ...; an array that has a size and no contents."""

    class Vast:
        def __reduce__(self) -> tuple[Any, ...]:
            return np.zeros(0).__reduce__()[0], (np.ndarray, (10**10,), b"d")

    twice: list[Any] = [1.0, 1.0]
    for _ in range(28):
        twice = [twice, twice]
    path = tmp_path / "000007.pkl"
    for value, words in (
        (twice, "5.37e\\+08 values"),
        (Vast(), "_reconstruct with other arguments"),
        ([[[twice] * 2] * 2], ""),
    ):
        hand = frankmocap_record(Known("right", mano_folder), 0)
        hand["pred_output_list"][0]["right_hand"]["pred_camera"] = value
        path.write_bytes(pickle.dumps(hand))
        printed = refused(lambda: read([path], FrankMocap(), request("right", mano_folder)), str(path))
        assert re.search(words, printed)
