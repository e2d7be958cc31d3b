"""The HO-3D reader: on small files of its layout, with known answers, and on broken ones; it has met no real file."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from getagrip.batch.import_dataset import import_clips
from getagrip.clip import read_clip, read_masks
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.hands import generic
from getagrip.hands.mano import load
from getagrip.readers.datasets import cutting, tracks
from getagrip.readers.datasets.ho3d import Ho3d
from getagrip.readers.datasets.tracks import GRASPS_WITHIN_10_MM
from helpers.hand_object_files import HELD, LOST, save, write_ho3d
from helpers.held_ball import AT, BETAS, FRAMES, TAKEN, Hostile, bent, motion


@pytest.fixture
def root(tmp_path: Path, mano: Path) -> Path:
    return write_ho3d(tmp_path, mano)


def read(root: Path, mano: Path | None) -> list[tracks.Track]:
    """The tracks of both sequences."""
    return [track for source in Ho3d(root=root, mano=mano).sources() for track in source.read(lambda _: None)]


@pytest.mark.slow
def test_axes_of_opengl_are_turned(root: Path, mano: Path) -> None:
    _, T_cam_obj = motion()
    known = np.arange(FRAMES) != LOST
    for folder in (None, mano):
        (track,) = read(root, folder)
        assert (track.name, track.side) == (f"ABF--ABF12--{HELD}--right", "right")
        np.testing.assert_allclose(track.T_cam_obj, T_cam_obj[known], atol=1e-9)
        np.testing.assert_allclose(track.K, [[614.6, 0.0, 320.6], [0.0, 614.5, 241.9], [0.0, 0.0, 1.0]])
        np.testing.assert_array_equal(track.numbers, np.flatnonzero(known))


@pytest.mark.slow
def test_hands_are_mano_s_or_fitted_to_the_joints(root: Path, mano: Path) -> None:
    T_cam_hand, _ = motion()
    known = np.arange(FRAMES) != LOST
    (by_mano,) = read(root, mano)
    np.testing.assert_allclose(by_mano.hand.T_cam_hand, T_cam_hand[known], atol=1e-9)
    true = load(mano / "MANO_RIGHT.pkl", "right").model.with_shape(BETAS).with_pose(bent())
    np.testing.assert_allclose(by_mano.hand.vertices[0], true.vertices, atol=1e-9)
    (fitted,) = read(root, None)
    joints = generic.load("right").with_shape().with_pose(bent()).joints
    seen = se3.transform(fitted.hand.T_cam_hand, fitted.hand.joints)
    assert np.linalg.norm(seen - se3.transform(T_cam_hand[known], joints), axis=-1).max() < 0.003


@pytest.mark.slow
def test_a_grasp_ends_where_nothing_is_known(root: Path) -> None:
    notes: list[str] = []
    (piece,) = cutting.cut_into_grasps(read(root, None), notes.append, GRASPS_WITHIN_10_MM.cut(print))
    np.testing.assert_array_equal(piece.track.numbers, np.arange(TAKEN, LOST))
    clip, masks = cutting.clip_of_piece(piece, 20, notes.append)
    assert clip.frames[0] == f"{TAKEN:04d}"
    assert clip.truth.articulation is None
    assert "0.9" in clip.provenance["clip"] or "1.000" in clip.provenance["clip"]
    hand = se3.inverse(clip.truth.T_cam_hand) @ clip.truth.T_cam_obj
    np.testing.assert_allclose(hand[:, :3, 3], np.tile(AT, (len(clip), 1)), atol=0.01)
    assert masks.object.any(axis=(1, 2)).all()


def test_hands_of_the_evaluation_split_are_not_known(root: Path) -> None:
    notes: list[str] = []
    for source in Ho3d(root=root).sources():
        list(source.read(notes.append))
    assert notes == [
        f"evaluation/SM1: {FRAMES} frames without the pose of the hand or of the object: skipped",
        "train/ABF12: 1 frame without the pose of the hand or of the object: skipped",
    ]


def list_joints(root: Path) -> np.ndarray:
    """The list that was published later, of the joints that the other split has; in the gap those of its neighbour."""
    names, joints = [f"SM1/{n:04d}" for n in range(FRAMES)], []
    for n in range(FRAMES):
        content = pickle.loads((root / "train/ABF12/meta" / f"{n - (n == LOST):04d}.pkl").read_bytes())
        joints.append(content["handJoints3D"])
    (root / "evaluation.txt").write_text("\n".join(names) + "\n")
    (root / "evaluation_xyz.json").write_text(json.dumps(np.array(joints).tolist()))
    return np.array(joints)


def test_joints_that_were_published_later_make_hands(root: Path, mano: Path) -> None:
    list_joints(root)
    evaluation, train = read(root, None)
    assert evaluation.sequence == "SM1"
    np.testing.assert_array_equal(evaluation.numbers, train.numbers)
    np.testing.assert_allclose(evaluation.hand.T_cam_hand, train.hand.T_cam_hand, atol=1e-9)
    np.testing.assert_allclose(evaluation.T_cam_obj, train.T_cam_obj)
    assert "generic hand" in read(root, mano)[0].provenance["hands"]


@pytest.mark.parametrize(
    ("shift", "count", "named"), [(0.02, FRAMES, "handJoints3D"), (0.0, FRAMES - 1, "evaluation_xyz")]
)
def test_joints_of_other_frames_are_refused(root: Path, shift: float, count: int, named: str) -> None:
    joints = list_joints(root) + shift
    (root / "evaluation_xyz.json").write_text(json.dumps(joints[:count].tolist()))
    with pytest.raises(InputError, match=named):
        read(root, None)


@pytest.mark.slow
def test_import_writes_clips(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    assert import_clips(Ho3d(root=root), tmp_path / "out", debug=False) == 0
    clip = read_clip(tmp_path / "out" / f"ABF--ABF12--{HELD}--right")
    assert clip.provenance["subject"] == "ABF"
    assert read_masks(clip).object.any()
    assert import_clips(Ho3d(root=root, whole=True), tmp_path / "whole", debug=False) == 0
    assert len(read_clip(tmp_path / "whole" / f"ABF--ABF12--{HELD}--right")) == LOST
    save(root / "train" / "ABF12" / "meta" / "0003.pkl", {})
    assert import_clips(Ho3d(root=root), tmp_path / "again", debug=False) == 1
    assert "0003.pkl: objName" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("key", "value", "named"),
    [
        ("objName", "../../etc", "objName"),
        ("objName", 3, "objName"),
        ("objName", "003_cracker_box", "another"),
        ("objRot", np.full(3, np.nan), "objRot"),
        ("objRot", np.zeros(4), "objRot"),
        ("objTrans", "here", "objTrans"),
        ("camMat", np.eye(3)[:2], "camMat"),
        ("camMat", np.zeros((3, 3)), "camMat"),
        ("handJoints3D", np.zeros((20, 3)), "handJoints3D"),
        ("handJoints3D", np.zeros((21, 3)), "handJoints3D"),
        ("handJoints3D", Hostile(), "nothing in it was run"),
        ("handPose", np.zeros(45), "handPose"),
        ("handBeta", None, "handBeta"),
    ],
)
@pytest.mark.slow
def test_broken_labels_are_named(root: Path, mano: Path, key: str, value: Any, named: str) -> None:
    path = root / "train" / "ABF12" / "meta" / "0007.pkl"
    save(path, pickle.loads(path.read_bytes()) | {key: value})
    with pytest.raises(InputError, match=named):
        read(root, mano if key in ("handPose", "handBeta") else None)


@pytest.mark.slow
def test_damaged_and_missing_files_are_named(root: Path, tmp_path: Path) -> None:
    path = root / "train" / "ABF12" / "meta" / "0007.pkl"
    content = path.read_bytes()
    for damaged in (b"", content[: len(content) // 2], b"\x80\x02]."):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match=r"0007\.pkl"):
            read(root, None)
    path.write_bytes(content)
    with pytest.raises(UsageError, match="--meshes"):
        Ho3d(root=root, meshes=root / "nowhere").sources()
    with pytest.raises(InputError, match="no <split>"):
        Ho3d(root=tmp_path / "mano", meshes=root / "models").sources()
    next((root / "models" / HELD).iterdir()).unlink()
    with pytest.raises(InputError, match=HELD):
        read(root, None)
