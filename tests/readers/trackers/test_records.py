"""Files of every tracker, written as by the tracker: recognised without --from, and read as the hand they are of."""

from __future__ import annotations

import json
import pickle
import sys
import types
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.hands import generic
from getagrip.hands.model import Side
from getagrip.io import arrays
from getagrip.readers.trackers import TRACKERS, Request, TrackedHands, Tracker, read_tracked_hands, recognise
from getagrip.readers.trackers.egodex import EGODEX_FINGER_JOINTS, EGODEX_FINGERS
from getagrip.readers.trackers.joints import Joints
from getagrip.readers.trackers.landmarks_2d import Landmarks
from getagrip.readers.trackers.lerobot_hands import LeRobot
from getagrip.readers.trackers.records import HAWOR_CONVERSION_COMMAND
from helpers import hand_files as forged
from helpers.hand_files import (
    FRAMES,
    SIDES,
    SIZE,
    K,
    Known,
    frankmocap_record,
    hamer_record,
    joints_of,
    request,
    write_npz,
)

Write = Callable[[Path, Known, Path], Path]


def of_mini(key: str) -> Write:
    def write(place: Path, known: Known, _: Path) -> Path:
        for n, frame in enumerate(FRAMES[: len(known.R)]):
            record = hamer_record(known, n, "full")
            record |= {"global_orient": se3.log_so3(known.R[n])[None], "hand_pose": known.pose[n].reshape(15, 3)[None]}
            side = {"is_right": record.pop("right"), "hand_bbox": [0, 0, 9, 9]}
            forged.write_json(place / f"{frame}.json", [{**side, key: record}])
        return place

    return write


def hamer_files(place: Path, known: Known, _: Path) -> Path:
    for n, frame in enumerate(FRAMES[: len(known.R)]):
        write_npz(place / f"{frame}_0.npz", hamer_record(known, n, "full"))
    return place


WITH_MANO: dict[str, tuple[str, str, Write]] = {
    "HaMeR": ("hamer", "HaMeR's", hamer_files),
    "hamer-mini": ("hamer", "hamer-mini", of_mini("hamer_preds")),
    "WiLoR-mini": ("wilor", "WiLoR-mini", of_mini("wilor_preds")),
    "fasthamer": ("hamer", "fasthamer", lambda place, known, _: forged.fasthamer_files(place, known)),
    "V2D": ("hamer", "V2D", lambda place, known, _: forged.v2d_tracks(place, known)),
    "V2D's result": ("v2d", "V2D's result", lambda place, known, _: forged.v2d_result(place, known)),
    "EgoHandKit": ("egohandkit", "results", lambda place, known, _: forged.egohandkit_pickle(place, known)),
    "EgoHandKit, v1": ("egohandkit", "results", lambda place, known, _: forged.egohandkit_results(place, known)),
    "HaWoR, cam_space": ("hawor", "cam_space", lambda place, known, _: forged.hawor_cam_space(place, known)),
    "HaWoR, world": ("hawor", "in the world", forged.hawor_folder),
    "Dyn-HaMR": ("dynhamr", "Dyn-HaMR", forged.dynhamr_file),
}


def told_and_read(path: Path, name: str, words: str, side: Side, folder: Path | None, frames: int = 3) -> TrackedHands:
    """The hands of files that are taken for those of the right program."""
    told, text = recognise([path], dict(TRACKERS.items()))
    assert told == name
    assert words in text
    asked = request(side, folder)
    return read_tracked_hands([path], TRACKERS[told], replace(asked, frames=asked.frames[:frames], K=asked.K[:frames]))


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("source", WITH_MANO)
@pytest.mark.slow
def test_parameters_of_mano(tmp_path: Path, mano_folder: Path, source: str, side: Side) -> None:
    name, words, write = WITH_MANO[source]
    frames = 1 if source in ("Dyn-HaMR", "V2D's result") else 3  # which have one shape for all frames
    known = Known(side, mano_folder, frames)
    hands = told_and_read(write(tmp_path, known, mano_folder), name, words, side, mano_folder, frames)
    np.testing.assert_allclose(joints_of(hands), known.joints, atol=2e-6)


def test_without_mano_the_generic_hand_is_near(tmp_path: Path) -> None:
    known = Known("right", None)
    hands = told_and_read(forged.hawor_folder(tmp_path, known, None), "hawor", "in the world", "right", None)
    assert np.linalg.norm(joints_of(hands) - known.joints, axis=-1).max() < 0.01


def test_frankmocap(tmp_path: Path) -> None:
    (tmp_path / "000007_prediction_result.pkl").write_bytes(pickle.dumps(frankmocap_record(Known("right", None), 0)))
    assert recognise([tmp_path], dict(TRACKERS.items()))[0] == "frankmocap"


def as_plain_joints(place: Path, known: Known) -> np.ndarray:
    """The hand that is fitted to the 21 joints alone."""
    path = write_npz(place / "joints.npz", {"joints": known.joints})
    return joints_of(read_tracked_hands([path], Joints(order="openpose"), request(known.side)))


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.slow
def test_joints_in_somas_layout(tmp_path: Path, side: Side) -> None:
    known = Known(side, None)
    path = write_npz(tmp_path / "egohand.npz", {"joints": forged.soma_joints(known.joints)})
    hands = told_and_read(path, "soma", "SOMA", side, None)
    np.testing.assert_allclose(joints_of(hands), as_plain_joints(tmp_path, known), atol=1e-9)


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.slow
def test_egovision(tmp_path: Path, side: Side) -> None:
    known = Known(side, None)
    path = forged.egovision_file(tmp_path, known)
    hands = told_and_read(path, "egovision", "ego-vision", side, None)
    np.testing.assert_allclose(joints_of(hands), as_plain_joints(tmp_path, known), atol=1e-6)
    assert "filled in" in str(hands.provenance["hands_focal"])  # the second frame's, a guess of a network
    with pytest.raises(InputError, match=r"no (left|right) hand in the clip's frames"):
        read_tracked_hands([path], TRACKERS["egovision"], request("left" if side == "right" else "right"))


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.slow
def test_joints_of_egohandkit(tmp_path: Path, side: Side) -> None:
    pa = pytest.importorskip("pyarrow", reason="the extra lerobot is not installed")
    from pyarrow import parquet

    known = Known(side, None)
    joints = pa.list_(pa.list_(pa.float32(), 3), 21)
    rows = [None, *known.joints.astype(np.float32).tolist()]
    columns = {f"{one}_joints_3d": pa.array(rows if one == side else [None] * 4, joints) for one in SIDES}
    path = tmp_path / "hand_tracking.parquet"
    parquet.write_table(pa.table({"frame_idx": [5, 6, 7, 8], **columns}), path)
    hands = told_and_read(path, "egohandkit", "joints", side, None)
    np.testing.assert_allclose(joints_of(hands), as_plain_joints(tmp_path, known), atol=1e-5)


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("source", ["MediaPipe", "MMPose"])
@pytest.mark.slow
def test_landmarks(tmp_path: Path, source: str, side: Side) -> None:
    known = Known(side, None)
    write = forged.mediapipe_files if source == "MediaPipe" else forged.mmpose_file
    hands = told_and_read(write(tmp_path, known), "landmarks", source, side, None)
    assert hands.track.joints_2d is not None
    np.testing.assert_allclose(hands.track.joints_2d, forged.landmarks(known), atol=1e-3)
    assert ("is a guess" in str(hands.provenance["hands_scale"])) == (source == "MediaPipe")


def test_mediapipes_sides_are_asked_for_where_both_are_there(tmp_path: Path) -> None:
    known = Known("right", None)
    folder = forged.mediapipe_files(tmp_path, known)
    for path in folder.iterdir():
        content = json.loads(path.read_text())
        other = [{"x": point["x"] / 2, "y": point["y"]} for point in content["hand_landmarks"][0]]
        content["hand_landmarks"].append(other)
        content["handedness"].append([{"category_name": "Right"}])
        forged.write_json(path, content)
    with pytest.raises(UsageError, match="missing --sides"):
        read_tracked_hands([folder], Landmarks(), request("right"))
    for sides, factor in (("swapped", 1.0), ("named", 0.5)):
        hands = read_tracked_hands([folder], Landmarks(sides=sides), request("right"))  # type: ignore[arg-type]
        assert hands.track.joints_2d is not None
        expected = forged.landmarks(known) * [factor, 1.0]
        np.testing.assert_allclose(hands.track.joints_2d, expected, atol=1e-3)


@pytest.mark.parametrize("side", SIDES)
def test_egodex(tmp_path: Path, side: Side) -> None:
    h5py = pytest.importorskip("h5py", reason="the extra egodex is not installed")
    known = Known(side, None)
    rng = np.random.default_rng(0)
    T_world_cam = se3.rigid(se3.exp_so3(rng.normal(size=(3, 3))), rng.normal(size=(3, 3)))
    names = ["Hand", *(f"{finger}{part}" for finger in EGODEX_FINGERS for part in EGODEX_FINGER_JOINTS)]
    with h5py.File(tmp_path / "0.hdf5", "w") as episode:
        episode["transforms/camera"] = T_world_cam.astype(np.float32)
        for row, name in enumerate(names):
            T = np.tile(np.eye(4), (3, 1, 1))
            T[:, :3, 3] = se3.transform(T_world_cam, known.joints[:, row : row + 1])[:, 0]
            episode[f"transforms/{side}{name}"] = T.astype(np.float32)
    hands = told_and_read(tmp_path / "0.hdf5", "egodex", "EgoDex", side, None)
    np.testing.assert_allclose(joints_of(hands), as_plain_joints(tmp_path, known), atol=1e-4)
    with h5py.File(tmp_path / "0.hdf5", "a") as episode:
        del episode["transforms/camera"]
        episode["transforms/camera"] = h5py.ExternalLink("/etc/other.hdf5", "camera")
    with pytest.raises(InputError, match="transforms/camera"):
        read_tracked_hands([tmp_path / "0.hdf5"], TRACKERS["egodex"], request(side))


@pytest.mark.slow
def test_columns_of_lerobot(tmp_path: Path) -> None:
    pa = pytest.importorskip("pyarrow", reason="the extra lerobot is not installed")
    from pyarrow import parquet

    known = Known("right", None)
    both = np.concatenate([np.zeros((3, 63)), known.joints.reshape(3, 63)], axis=1)
    columns = {
        "observation.hands": both.tolist(), "observation.landmarks": forged.landmarks(known).reshape(3, 42).tolist(),
        "episode_index": [4, 4, 4], "frame_index": [0, 1, 2],
    }  # fmt: skip
    (tmp_path / "data" / "chunk-000").mkdir(parents=True)
    parquet.write_table(pa.table(columns), tmp_path / "data" / "chunk-000" / "file-000.parquet")
    assert recognise([tmp_path], dict(TRACKERS.items()))[0] == "lerobot"
    hands = read_tracked_hands([tmp_path], LeRobot("observation.hands", 4), request("right"))
    np.testing.assert_allclose(joints_of(hands), as_plain_joints(tmp_path, known), atol=1e-9)
    seen = read_tracked_hands([tmp_path], LeRobot("observation.landmarks", 4), request("right")).track.joints_2d
    np.testing.assert_allclose(seen, forged.landmarks(known), atol=1e-9)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match=r"missing --column: .*observation\.hands, observation\.landmarks"):
        read_tracked_hands([tmp_path], LeRobot(), request("right"))
    with pytest.raises(InputError, match="no row of episode 5"):
        read_tracked_hands([tmp_path], LeRobot("observation.hands", 5), request("right"))
    with pytest.raises(InputError, match="42, 63, 84 or 126"):
        read_tracked_hands([tmp_path], LeRobot("frame_index", 4), request("right"))


def test_what_nobody_knows_is_refused_with_what_was_looked_for(tmp_path: Path) -> None:
    path = write_npz(tmp_path / "x.npz", {"thing": np.zeros(3), "other": np.ones(2)})
    with pytest.raises(InputError, match=r"keys other, thing.*looked for hamer: .*wilor_preds.*hawor: .*landmarks: "):
        recognise([path], dict(TRACKERS.items()))


def test_what_two_know_is_asked(tmp_path: Path) -> None:
    class Greedy(Tracker):
        def recognises(self, sample: object) -> str:
            return "mine"

    path = write_npz(tmp_path / "x.npz", {"joints": np.zeros((3, 25, 3))})
    with pytest.raises(UsageError, match=r"missing --from: .*--from soma \(SOMA's 25 joints\), --from greedy \(mine\)"):
        recognise([path], dict(TRACKERS.items()) | {"greedy": Greedy()})


def test_the_line_that_the_error_about_joblib_shows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "world_space_res.pth"
    path.write_bytes(b"\x80\x04joblib.numpy_pickle")
    with pytest.raises(InputError) as error:
        recognise([path], dict(TRACKERS.items()))
    assert HAWOR_CONVERSION_COMMAND in str(error.value)
    known = generic.load("right").with_shape().joints
    fake = types.ModuleType("joblib")
    fake.load = lambda _: [known, known, known, known, known > 0]  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "joblib", fake)
    monkeypatch.chdir(tmp_path)
    exec(HAWOR_CONVERSION_COMMAND, {})
    found = arrays.read(tmp_path / "world_space_res.npz", lambda _: True)
    assert sorted(found) == ["pred_betas", "pred_hand_pose", "pred_rot", "pred_trans", "pred_valid"]


def dataset(folder: Path, rows: np.ndarray, fps: float, names: list[str] | None = None) -> Path:
    """A dataset of LeRobot with one episode and a column of hands."""
    pa = pytest.importorskip("pyarrow", reason="the extra lerobot is not installed")
    from pyarrow import parquet

    (folder / "data" / "chunk-000").mkdir(parents=True)
    (folder / "meta").mkdir()
    columns = {"hands": rows.tolist(), "episode_index": [0] * len(rows), "timestamp": np.arange(len(rows)) / fps}
    parquet.write_table(pa.table(columns), folder / "data" / "chunk-000" / "file-000.parquet")
    features = {"hands": {"names": names}}
    (folder / "meta" / "info.json").write_text(json.dumps({"fps": fps, "features": features}))
    return folder


@pytest.mark.parametrize("every", [1, 3])
def test_rows_of_lerobot_are_matched_by_their_times(tmp_path: Path, every: int) -> None:
    known = Known("right", None)
    joints = np.repeat(known.joints[:1], 7, axis=0) + np.arange(7)[:, None, None] * [0.01, 0.0, 0.0]
    folder = dataset(tmp_path / "set", joints[::every].reshape(-1, 63), 30.0 / every)
    asked = Request(
        "right", tuple(f"{n:06d}" for n in range(1, 8)), np.tile(K, (7, 1, 1)), SIZE, times=np.arange(7) / 30
    )
    hands = read_tracked_hands([folder], LeRobot("hands"), asked)
    assert hands.found == tuple(range(0, 7, every))
    assert np.abs(joints_of(hands) - joints[::every]).max() < 0.02
    assert ("matched by timestamp" in str(hands.provenance["hands_scale"])) == (every == 3)


@pytest.mark.parametrize("first", ["left", "right"])
def test_halves_of_both_hands_are_tested_named_or_asked_for(tmp_path: Path, first: Side) -> None:
    right = Known("right", None).joints
    left = right * [-1.0, 1.0, 1.0]
    order = (left, right) if first == "left" else (right, left)
    both = np.concatenate([each.reshape(3, 63) for each in order], axis=1)
    hands = read_tracked_hands([dataset(tmp_path / "a", both, 30.0)], LeRobot("hands"), request("right"))
    assert np.abs(joints_of(hands) - right).max() < 0.01
    assert f"the {first} hand first" in str(hands.provenance["hands_scale"])
    flat = np.concatenate([(each @ K.T)[..., :2] / (each @ K.T)[..., 2:] for each in order], axis=1).reshape(3, 84)
    with pytest.raises(UsageError, match="--halves left-first or right-first"):
        read_tracked_hands([dataset(tmp_path / "b", flat, 30.0)], LeRobot("hands"), request("right"))
    names = [f"{side}_{n}" for side in (first, "right" if first == "left" else "left") for n in range(42)]
    named = read_tracked_hands(
        [dataset(tmp_path / "c", flat, 30.0, names)], LeRobot("hands"), request("right")
    ).track.joints_2d
    stating = replace(LeRobot("hands"), halves=f"{first}-first")
    stated = read_tracked_hands([tmp_path / "b"], stating, request("right")).track.joints_2d
    for each in (named, stated):
        np.testing.assert_allclose(each, ((right @ K.T)[..., :2] / (right @ K.T)[..., 2:]), atol=1e-6)  # type: ignore[arg-type]
