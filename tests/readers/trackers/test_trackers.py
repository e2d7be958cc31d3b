"""The table of trackers, and the hands of HaWoR, FrankMocap, plain joints and plain MANO parameters."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from getagrip.clip.match_frames import renumber_frames
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.hands import mano
from getagrip.hands.fit_joints import JOINT_ORDERS
from getagrip.hands.model import Side, mirrored_pose
from getagrip.readers.trackers import TRACKERS, Request, choose_tracker, read_tracked_hands
from getagrip.readers.trackers.frankmocap import FrankMocap
from getagrip.readers.trackers.hawor import HaWoR
from getagrip.readers.trackers.joints import Joints
from getagrip.readers.trackers.mano_parameters import ManoParameters
from helpers.environment import Run
from helpers.hand_files import FRAMES, PIXELS, SIDES, SIZE, K, Known, frankmocap_record, joints_of, request, write_npz


def test_what_no_file_states_is_asked_for(tmp_path: Path) -> None:
    path = write_npz(tmp_path / "hands.npz", {"transl": np.zeros((3, 3))})
    for tracker, word in [
        (ManoParameters(mean="flat"), "--pose"),
        (ManoParameters(pose="pca"), "--mean"),
        (Joints(), "--order"),
    ]:
        with pytest.raises(UsageError, match=word):
            read_tracked_hands([path], tracker, request("right"))


def test_trackers_are_chosen_by_name() -> None:
    for name, tracker in TRACKERS.items():
        assert choose_tracker(name) is tracker
    with pytest.raises(UsageError, match="unknown --from 'hammer'; choose from hamer, wilor, hawor, frankmocap, mano,"):
        choose_tracker("hammer")


@pytest.mark.slow
def test_the_command_takes_what_the_table_lists(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "300")
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
    given = {**TRACKERS, "hawor": HaWoR(estimator_focal=600.0)}
    assert choose_tracker("hawor", given) == HaWoR(600.0)
    with pytest.raises(UsageError, match=r"--estimator-focal cannot be used with .*: it belongs to --from hawor"):
        choose_tracker("hamer", given)


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


@pytest.mark.parametrize("side", SIDES)
def test_joints(tmp_path: Path, side: Side) -> None:
    """Joints of a generic hand give that hand back but for what the prior takes, in whatever order the frames are."""
    known = Known(side, None)
    input_joints = np.empty_like(known.joints)
    input_joints[:, JOINT_ORDERS["ho3d"]] = known.joints
    content = {"joints": input_joints[[2, 0]], "frames": np.array(["000009", "frame_7"])}
    path = write_npz(tmp_path / "j.npz", content)
    hands = read_tracked_hands([path], Joints("ho3d"), request(side))
    assert hands.found == (0, 2)
    assert np.abs(joints_of(hands) - known.joints[[0, 2]]).max() < 0.01
    write_npz(path, content | {"frames": np.array(["000009", "frame_9"])})
    twice = read_tracked_hands([path], Joints("ho3d"), request(side))
    assert twice.found == (2,)
    assert "several" in str(twice.provenance["hands_chosen"])


def test_the_hand_stands_still_before_the_first_and_after_the_last_frame(tmp_path: Path) -> None:
    path = write_npz(tmp_path / "j.npz", {"joints": Known("right", None).joints[[0, 2]], "frames": np.array([7, 9])})
    found = replace(read_tracked_hands([path], Joints("openpose"), request("right")), found=(2, 4))
    held = found.extrapolate_to_ends(tuple("abcdefg"))
    assert held.found == (0, 1, 2, 4, 5, 6)  # d lies between two hands
    for there, at in ((found.track.T_cam_hand, held.track.T_cam_hand), (found.track.joints, held.track.joints)):
        assert there is not None
        np.testing.assert_array_equal(at, there[[0, 0, 0, 1, 1, 1]])
    assert "a guess in the frames a to b and f to g" in str(held.provenance["hands_held"])
    assert found.extrapolate_to_ends(tuple("abcde")).found == (0, 1, 2, 4)
    assert replace(found, found=(0, 1)).extrapolate_to_ends(("a", "b")).provenance == found.provenance


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
