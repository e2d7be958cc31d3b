"""A found hand is lifted again with the masks: same frames and landmarks, fingers off the background; or stays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from getagrip.clip import HandTrack
from getagrip.clip.read_arrays import read_hand
from getagrip.clip.write import write_hand
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.geometry.camera import project
from getagrip.hands import generic
from getagrip.hands.fit_joints import PosePrior
from getagrip.hands.from_2d.clicks import model_pose
from getagrip.hands.model import hand_track
from getagrip.provenance import Provenance, Source, assumed, estimated, measured, provenance_to_arrays
from getagrip.studio.hands import relift_hands
from getagrip.studio.hands.relift_hands import JOINTS_DEPTH_KEY, LabelMaps, relift_hand, write_relifted_hands
from getagrip.studio.store.export_clip import new_clip_call
from getagrip.studio.store.labels import HAND_LABEL, OBJECT_LABEL, Labels

K = np.array([[500.0, 0.0, 160.0], [0.0, 500.0, 160.0], [0.0, 0.0, 1.0]])
SIZE = (320, 320)
FRAMES = np.array([3, 4, 5, 9, 10])


def found_hand(turn: Sequence[float] = (-0.5 * np.pi, 0.0, 0.0), tilt: Sequence[float] = (0.0, 0.0, 0.0)) -> HandTrack:
    """A hand at rest, turned and then tilted, with its landmarks."""
    model = generic.load("left")
    q = np.tile(PosePrior.of(model).mean, (len(FRAMES), 1, 1, 1))
    T = se3.rigid(se3.exp_so3(np.array(tilt)) @ se3.exp_so3(np.array(turn)), np.array([0.0, 0.0, 0.35]))
    hand = hand_track(
        model.with_shape(np.zeros(len(model.shape_names))).with_pose(model_pose(q)), np.tile(T, (5, 1, 1))
    )
    assert hand.joints is not None
    points = project(K, se3.transform(hand.T_cam_hand, hand.joints))
    return HandTrack(
        hand.vertices, hand.faces, hand.T_cam_hand, hand.regions, hand.joints, points, np.ones(points.shape[:2])
    )


def numbers(first: int, last: int) -> dict[int, int]:
    """Of frames whose images are numbered otherwise than by place."""
    return {n: 2 * n + 25 for n in range(first, last + 1)}


def maps_of(value: int) -> LabelMaps:
    """All that is drawn is one thing, the same in all frames."""
    maps = LabelMaps(SIZE)
    for frame in FRAMES:
        maps.add(int(frame), np.full(SIZE[::-1], value, np.uint8))
    return maps


@pytest.mark.slow
@pytest.mark.parametrize("value", [HAND_LABEL, OBJECT_LABEL])
def test_frames_and_landmarks_stay(value: int) -> None:
    hand = found_hand()
    assert hand.joints is not None
    lifted, rows = relift_hand(hand, FRAMES, K, "left", maps_of(value))
    np.testing.assert_array_equal(rows, np.arange(len(FRAMES)))
    np.testing.assert_array_equal(lifted.joints_2d, hand.joints_2d)
    assert lifted.joints is not None
    there = project(K, se3.transform(lifted.T_cam_hand, lifted.joints))
    assert np.median(np.linalg.norm(there - hand.joints_2d, axis=-1)) < 6.0


def test_depths_of_hands_that_are_largely_guessed_are_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    true = found_hand()
    assert true.joints_2d is not None
    turned = se3.rigid(se3.exp_so3(np.array([0.0, 0.9, 0.0])), np.zeros(3))
    points = true.joints_2d.copy()
    points[:, 12:] = [-400.0, 200.0]  # three fingers beside the image
    wrong = replace(true, T_cam_hand=true.T_cam_hand @ turned, joints_2d=points)
    off = []
    for guessed in (relift_hands.MAX_GUESSED_FRACTION, 1.0):
        monkeypatch.setattr(relift_hands, "MAX_GUESSED_FRACTION", guessed)
        found, _ = relift_hand(wrong, FRAMES, K, "left", maps_of(HAND_LABEL))
        off.append(np.degrees(se3.angle_between(found.T_cam_hand[:, :3, :3], true.T_cam_hand[:, :3, :3])).max())
    assert off[0] < 15.0
    assert off[1] > 2.0 * off[0]


@pytest.mark.slow
def test_depths_that_the_network_saw_count_and_not_those_of_the_first_fit(tmp_path: Path) -> None:
    true = found_hand(tilt=[0.0, 0.6, 0.0])
    assert true.joints is not None
    X = se3.transform(true.T_cam_hand, true.joints)
    wrong = replace(true, T_cam_hand=true.T_cam_hand @ se3.rigid(se3.exp_so3(np.array([0.0, 0.0, -0.9])), np.zeros(3)))
    known = provenance_to_arrays({"hands_scale": assumed("a mean hand's"), "hands_side": measured("left, as stated")})
    found = {"frames": FRAMES + 1, "K": K, "side": np.array("left")} | known
    off = []
    for depth in ({}, {JOINTS_DEPTH_KEY: X[..., 2]}):
        write_hand(wrong, tmp_path / "found.npz", found | depth)
        write_relifted_hands(tmp_path / "found.npz", tmp_path / "out.npz", "left", numbers(3, 10), maps_of(HAND_LABEL))
        with np.load(tmp_path / "out.npz") as written:
            assert JOINTS_DEPTH_KEY not in written
            there = se3.transform(written["T_cam_hand"], written["joints"])
        off.append(np.abs(there[..., 2] - there[..., 2].mean() - X[..., 2] + X[..., 2].mean()).mean())
    assert off[1] < 0.5 * off[0]


def held_from_behind(tmp_path: Path, provenance: Provenance) -> tuple[Path, LabelMaps]:
    """A left hand that the network takes for a right one, the farthest of whose joints an object hides: file, masks."""
    true = found_hand(tilt=[0.0, 0.9, 0.0])
    assert true.joints is not None
    assert true.joints_2d is not None
    X = se3.transform(true.T_cam_hand, true.joints)
    far, maps = np.argsort(X[0, :, 2]), LabelMaps(SIZE)
    for frame, points in zip(FRAMES, true.joints_2d, strict=True):
        drawn = np.zeros(SIZE[::-1], np.uint8)
        for joints, value in ((far[:9], HAND_LABEL), (far[-9:], OBJECT_LABEL)):
            for x, y in points[joints].round().astype(int):
                drawn[max(0, y - 14) : y + 15, max(0, x - 14) : x + 15] = value
        maps.add(int(frame), drawn)
    mirrored = X * [1.0, 1.0, -1.0] + [0.0, 0.0, 2.0 * X[..., 2].mean()]
    seen = replace(true, joints=se3.transform(se3.inverse(true.T_cam_hand), mirrored))
    write_hand(
        seen,
        tmp_path / "found.npz",
        {"frames": FRAMES + 1, "K": K, "side": np.array("right")} | provenance_to_arrays(provenance),
    )
    return tmp_path / "found.npz", maps


@pytest.mark.slow
@pytest.mark.parametrize(
    "side", [assumed("right, a guess"), estimated("right: it looks like one"), measured("right, as stated")]
)
def test_the_object_decides_on_the_side_where_that_is_a_guess(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], side: Source
) -> None:
    found, maps = held_from_behind(tmp_path, {"hands_scale": assumed("a mean hand's"), "hands_side": side})
    write_relifted_hands(found, tmp_path / "out.npz", "right", numbers(3, 10), maps)
    written = np.load(tmp_path / "out.npz")
    assert str(written["side"]) == ("left" if side.basis == "assumed" else "right")
    said = "".join(capsys.readouterr())
    assert ("--side right overrules this" in said) == (side.basis == "assumed")
    labels = Labels("a.mp4", SIZE, "right", 30.0, 3, 10, {})
    assert new_clip_call(labels, tmp_path, "a.mp4").side == "right"  # there is no hand.npz yet
    (tmp_path / "out.npz").rename(tmp_path / "hand.npz")
    assert new_clip_call(labels, tmp_path, "a.mp4").side == str(written["side"])
    order, frames = relift_hands.joint_depth_order(read_hand(tmp_path / "hand.npz", 5), FRAMES, K, maps)
    assert frames == len(FRAMES)
    assert (order > 0.0) == (side.basis == "assumed")


@pytest.mark.slow
def test_a_side_that_is_chosen_later_is_obeyed_or_refused(tmp_path: Path) -> None:
    looks = {"hands_side": estimated("right: it looks like one")}
    found, maps = held_from_behind(tmp_path, looks | {"hands_scale": assumed("a mean hand's")})
    write_relifted_hands(found, tmp_path / "out.npz", "left", numbers(3, 10), maps)
    written = np.load(tmp_path / "out.npz")
    assert str(written["side"]) == "left"
    assert str(written["provenance_hands_side"]) == "left, as stated"
    found, maps = held_from_behind(tmp_path, looks | {"hands_scale": estimated("by a network")})
    with pytest.raises(UsageError, match="draft again with --side left"):
        write_relifted_hands(found, tmp_path / "other.npz", "left", numbers(3, 10), maps)


def test_a_frame_without_a_map_is_empty() -> None:
    assert maps_of(HAND_LABEL).at(np.array([4, 7])).any(axis=(1, 2)).tolist() == [True, False]


def test_a_hand_without_landmarks_is_refused() -> None:
    hand = found_hand()
    bare = HandTrack(hand.vertices, hand.faces, hand.T_cam_hand, hand.regions, hand.joints)
    with pytest.raises(UsageError, match="joints_2d"):
        relift_hand(bare, FRAMES, K, "left", maps_of(HAND_LABEL))


def test_files_keep_what_cannot_be_lifted_and_say_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    hand = found_hand()
    bare = HandTrack(hand.vertices, hand.faces, hand.T_cam_hand, hand.regions, hand.joints)
    write_hand(bare, tmp_path / "found.npz", {"frames": FRAMES + 1, "K": K})
    write_relifted_hands(tmp_path / "found.npz", tmp_path / "out.npz", "left", numbers(4, 9), maps_of(HAND_LABEL))
    assert "hands: unchanged" in "".join(capsys.readouterr())
    assert np.load(tmp_path / "out.npz")["frames"].tolist() == [33, 35, 43]
    np.testing.assert_array_equal(read_hand(tmp_path / "out.npz", 3).vertices, hand.vertices[1:4])


def test_a_file_without_frames_is_refused(tmp_path: Path) -> None:
    write_hand(found_hand(), tmp_path / "found.npz", {"K": K})
    with pytest.raises(InputError, match="frames"):
        write_relifted_hands(tmp_path / "found.npz", tmp_path / "out.npz", "left", numbers(0, 9), maps_of(HAND_LABEL))
