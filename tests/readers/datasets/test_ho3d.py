"""The HO-3D reader and ``bench ho3d-eval``, on small files of its layout with known answers, and on broken files."""

from __future__ import annotations

import csv
import json
import pickle
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from getagrip.batch.import_dataset import import_clips
from getagrip.bench.inputs.estimated_masks import WithMasks, without_depth
from getagrip.bench.sources.ho3d_sequences import Ho3dEval
from getagrip.bench.tables import ALL_PARTS_LABEL, read_published_results
from getagrip.clip import read_clip, read_masks
from getagrip.errors import InputError, UsageError
from getagrip.geometry import se3
from getagrip.hands import generic
from getagrip.hands.mano import load
from getagrip.metrics.evaluate.metric import METRICS
from getagrip.readers.datasets import cutting, tracks
from getagrip.readers.datasets.ho3d import Ho3d
from getagrip.readers.datasets.tracks import GRASPS_WITHIN_10_MM
from getagrip.readers.depth_files import HO3D_DEPTH_UNIT_M
from helpers.environment import Run
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


CLIP = f"SM--SM1--{HELD}--right"


@pytest.fixture
def evaluation_root(tmp_path: Path, mano: Path) -> Path:
    """HO-3D's folder, its list of joints, and 0.9 m as the depth of everything."""
    evaluation_root = write_ho3d(tmp_path, mano)
    joints = [
        pickle.loads((evaluation_root / "train/ABF12/meta" / f"{n - (n == LOST):04d}.pkl").read_bytes())["handJoints3D"]
        for n in range(FRAMES)
    ]
    (evaluation_root / "evaluation.txt").write_text("".join(f"SM1/{n:04d}\n" for n in range(FRAMES)))
    (evaluation_root / "evaluation_xyz.json").write_text(json.dumps(np.array(joints).tolist()))
    depth = evaluation_root / "evaluation" / "SM1" / "depth"
    depth.mkdir()
    number = round(0.9 / HO3D_DEPTH_UNIT_M)
    image = np.full((480, 640, 3), [0, number // 256, number % 256], np.uint8)
    for n in range(FRAMES):
        cv2.imwrite(str(depth / f"{n:04d}.png"), image)
    return evaluation_root


@pytest.mark.slow
def test_rows_are_masks_and_columns_the_field_s(
    evaluation_root: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "getagrip.metrics.pose.N_RECALL_BALL_ROTATIONS", 20
    )  # of 500: how good poses are is not looked at
    out, masks = tmp_path / "out", tmp_path / "masks"
    source = Ho3dEval(root=evaluation_root)
    (sample,), failed = source.samples(out / "clips", False)
    assert (sample.name, failed) == (CLIP, [])
    clip = read_clip(sample.folder)
    assert clip.frames == tuple(f"{n:04d}" for n in range(FRAMES) if n != LOST)  # whole, not cut to a grasp
    (masks / "SM1").mkdir(parents=True)
    for frame, mask in zip(clip.frames, read_masks(clip).object, strict=True):  # numbered as XMem does
        cv2.imwrite(str(masks / "SM1" / f"{int(frame):05d}.png"), 255 * mask.astype(np.uint8))
    call = (
        "bench",
        "ho3d-eval",
        "--root",
        evaluation_root,
        "--masks",
        masks,
        "--out",
        out,
        "--workers",
        "1",
        "--inits",
        "1",
    )
    assert run(*call)[0] == 0
    rows = list(csv.DictReader((out / "ho3d-eval-clips.csv").read_text().splitlines()))
    settings = ["given masks", "given masks, no depth", "estimated masks", "estimated masks, no depth"]
    assert [row["setting"] for row in rows] == settings
    for row in rows:
        assert 0.0 <= float(row["vsd_cam_recall"]) <= 1.0
        parts = [float(row[f"{name}_cam_recall"]) for name in ("mssd", "mspd", "vsd")]
        assert float(row["ar_cam"]) == pytest.approx(np.mean(parts))
    page = (out / "ho3d-eval.md").read_text()
    assert "| ADD AUC | ADD-S AUC | AR | AR without VSD | MSSD | MSPD | VSD |" in page
    assert "SCA" not in page.split("<details>")[0]
    beside = [line.split(" | ") for line in page.split("Beside printed numbers:")[1].splitlines()]
    last = {row[0].removeprefix("| "): row[-2:] for row in beside}  # SM1, and the mean over all
    assert last["ADD AUC: soft-hinge, given masks"] == [f"{100 * float(rows[0]['add_cam_auc']):.1f}", "– |"]
    assert last["ADD AUC: Point2Pose"] == ["63.2", "80.6 |"]


def test_printed_numbers_are_of_columns_of_ours_and_their_means_are_right() -> None:
    labels = {metric.label for metric in METRICS.working().values() if metric.group == "recall"}
    for system in read_published_results("ho3d_published.json").values():
        assert {*system.columns} <= labels
        assert system.source
        assert system.given
        assert all(len(row) == len(system.columns) for row in system.rows.values())
        for column in system.columns:
            numbers = [system.number(part, column) for part in system.rows if part != ALL_PARTS_LABEL]
            if numbers and not np.isnan(numbers).any():
                assert system.number(ALL_PARTS_LABEL, column) == pytest.approx(np.mean(numbers), abs=0.11)


@pytest.mark.slow
def test_masks_are_those_of_the_folder_and_the_hand_s_are_ignored(evaluation_root: Path, tmp_path: Path) -> None:
    (sample,), _ = Ho3dEval(root=evaluation_root).samples(tmp_path / "clips", False)
    clip = read_clip(sample.folder)
    given = read_masks(clip)
    for name, corner in (("SM1", slice(0, 40)), ("SM1_hand", slice(30, 60))):
        (tmp_path / "masks" / name).mkdir(parents=True)
        image = np.zeros((480, 640), np.uint8)
        image[corner, corner] = 255
        for frame in clip.frames[1:]:
            cv2.imwrite(str(tmp_path / "masks" / name / f"{frame}.png"), image)
    change = WithMasks(tmp_path / "masks")
    _, masks = change(clip, given, 0)
    assert not masks.known[0]
    assert masks.object[1].sum() == 40 * 40
    assert masks.ignore[1].sum() == 30 * 30 - 10 * 10
    assert len(change.inputs(clip.name)) == 2 * (len(clip) - 1)
    assert without_depth(change, False)(clip, given, 0)[0].evidence["depth"] is None


def test_the_list_of_joints_and_the_one_split_are_needed(evaluation_root: Path, tmp_path: Path, run: Run) -> None:
    (evaluation_root / "evaluation.txt").unlink()
    status, _, err = run("bench", "ho3d-eval", "--root", evaluation_root, "--out", tmp_path / "out")
    assert status != 0
    assert "evaluation.txt" in err
    status, _, err = run("bench", "ho3d-eval", "--root", evaluation_root, "--split", "train", "--out", tmp_path / "out")
    assert (status, "which is one split" in err) == (2, True)
