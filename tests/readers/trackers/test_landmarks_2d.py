"""2D landmarks give the hand that they are of, from files of every kind."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from getagrip.clip.read_arrays import read_hand
from getagrip.clip.write import write_hand
from getagrip.errors import InputError
from getagrip.geometry.camera import project
from getagrip.provenance import is_assumed
from getagrip.readers.trackers import read_tracked_hands
from getagrip.readers.trackers.joints import Joints
from getagrip.readers.trackers.landmarks_2d import Landmarks
from helpers.hand_files import FRAMES, SIZE, K, Known, joints_of, request, write_npz

KNOWN = Known("right", None)
POINTS = project(K, KNOWN.joints)


def files(folder: Path) -> dict[str, list[Path]]:
    """The same landmarks in every kind of file."""
    write_npz(folder / "a.npz", {"joints_2d": POINTS, "frames": np.array(FRAMES)})
    (folder / "a.json").write_text(json.dumps({"joints_2d": POINTS.tolist(), "frames": list(FRAMES)}))
    (folder / "shares.json").write_text(json.dumps({"joints_2d": (POINTS / SIZE).tolist(), "frames": list(FRAMES)}))
    heads = ["frame", *(f"{axis}{k}" for k in range(21) for axis in "xy")]
    rows = [",".join([name, *map(str, hand.ravel())]) for name, hand in zip(FRAMES, POINTS, strict=True)]
    (folder / "a.csv").write_text("\n".join([",".join(heads), *rows]) + "\n")
    openpose = []
    for name, hand in zip(FRAMES, POINTS, strict=True):
        values = np.column_stack([hand, np.full(21, 0.8)]).ravel().tolist()
        person = {"hand_right_keypoints_2d": values, "hand_left_keypoints_2d": [0.0] * 63}
        openpose.append(folder / f"{name}_keypoints.json")
        openpose[-1].write_text(json.dumps({"people": [{}, person]}))
    single = {name: [folder / name] for name in ("a.npz", "a.json", "shares.json", "a.csv")}
    return single | {"openpose": openpose}


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["a.npz", "a.json", "shares.json", "a.csv", "openpose"])
def test_landmarks_become_the_hand(tmp_path: Path, kind: str) -> None:
    hands = read_tracked_hands(files(tmp_path)[kind], Landmarks(), request("right"))
    assert hands.found == (0, 1, 2)
    apart = np.linalg.norm(project(K, joints_of(hands)) - POINTS, axis=-1)
    assert np.median(apart) < 0.05 * np.ptp(POINTS[0], axis=0).max()
    assert hands.track.joints_2d is not None
    np.testing.assert_allclose(hands.track.joints_2d, POINTS, atol=1e-6)
    assert "generic hand has the size of a mean one" in str(hands.provenance["hands_scale"])
    assert is_assumed(hands.provenance["hands_scale"])


def media_pipe(depths: np.ndarray, older: bool) -> dict[str, object]:
    """An image's results, with world landmarks."""
    shares = [{"x": x / SIZE[0], "y": y / SIZE[1], "z": 0.0} for x, y in POINTS[0]]
    world = [{"x": 0.0, "y": 0.0, "z": z} for z in depths]
    label = [{"classification": [{"label": "Right"}]}] if older else [[{"categoryName": "Right"}]]
    if older:
        hands = {"multi_hand_landmarks": [{"landmark": shares}], "multi_hand_world_landmarks": [{"landmark": world}]}
        return {**hands, "multi_handedness": label}
    return {"landmarks": [shares], "worldLandmarks": [world], "handedness": label}


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["joints_2d", "MediaPipe", "older MediaPipe"])
def test_world_landmarks_turn_the_hand(tmp_path: Path, kind: str) -> None:
    """Depths of a hand that is mirrored in depth, whose joints look the same from afar, turn it the other way."""
    off = []
    for mirrored in (1.0, -1.0):
        world = (KNOWN.joints - KNOWN.joints.mean(axis=1, keepdims=True)) * [1.0, 1.0, mirrored]
        path = tmp_path / f"{FRAMES[0]}.json"
        if kind == "joints_2d":
            path.write_text(
                json.dumps({"joints_2d": POINTS.tolist(), "world_landmarks": world.tolist(), "frames": list(FRAMES)})
            )
        else:
            path.write_text(json.dumps(media_pipe(world[0, :, 2], kind.startswith("older"))))
        found = joints_of(read_tracked_hands([path], Landmarks("named"), request("right")))[0]
        z, true = found[:, 2] - found[:, 2].mean(), KNOWN.joints[0, :, 2] - KNOWN.joints[0, :, 2].mean()
        off.append(np.sqrt(np.mean((z - true) ** 2)))
    assert off[0] < 0.5 * off[1]


@pytest.mark.parametrize("bad", [np.zeros((3, 21, 2)), np.array("text"), 1e3 * KNOWN.joints])
def test_other_world_landmarks_are_refused(tmp_path: Path, bad: np.ndarray) -> None:
    content = {"joints_2d": POINTS, "world_landmarks": bad, "frames": np.array(FRAMES)}
    with pytest.raises(InputError, match="world_landmarks"):
        read_tracked_hands([write_npz(tmp_path / "a.npz", content)], Landmarks(), request("right"))


@pytest.mark.parametrize(
    "world", [{}, [], [[{"z": 0.0}] * 20], [[{"x": 0.0}] * 21], [[{"z": 4.0}] * 20 + [{"z": 0.0}]]]
)
def test_world_landmarks_of_no_hand_are_refused(tmp_path: Path, world: object) -> None:
    path = tmp_path / f"{FRAMES[0]}.json"
    path.write_text(json.dumps(media_pipe(np.zeros(21), False) | {"worldLandmarks": world}))
    with pytest.raises(InputError, match="world"):
        read_tracked_hands([path], Landmarks("named"), request("right"))


def test_joints_of_another_reader_keep_theirs(tmp_path: Path) -> None:
    confidence = np.linspace(0.0, 1.0, 63).reshape(3, 21)
    content = {"joints": KNOWN.joints, "joints_2d": POINTS, "joints_2d_confidence": confidence}
    path = write_npz(tmp_path / "j.npz", content | {"frames": np.array(FRAMES)})
    hand = read_tracked_hands([path], Joints("openpose"), request("right")).track
    write_hand(hand, tmp_path / "hand.npz")
    again = read_hand(tmp_path / "hand.npz", 3).take(np.array([2, 0]))
    assert again.joints_2d is not None
    assert again.joints_2d_confidence is not None
    np.testing.assert_allclose(again.joints_2d, POINTS[[2, 0]])
    np.testing.assert_allclose(again.joints_2d_confidence, confidence[[2, 0]])


@pytest.mark.parametrize("bad", [np.zeros((3, 20, 2)), np.full((3, 21, 2), 1e9), np.array("text")])
def test_other_arrays_are_refused(tmp_path: Path, bad: np.ndarray) -> None:
    path = write_npz(tmp_path / "a.npz", {"joints_2d": bad, "frames": np.array(FRAMES)})
    with pytest.raises(InputError, match="joints_2d"):
        read_tracked_hands([path], Landmarks(), request("right"))
