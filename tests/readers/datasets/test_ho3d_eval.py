"""``bench ho3d-eval`` on a forged sequence: whole, masks given and estimated, with and without the scene's depth."""

from __future__ import annotations

import csv
import json
import pickle
from pathlib import Path

import cv2
import numpy as np
import pytest

from getagrip.bench.inputs.estimated_masks import WithMasks, without_depth
from getagrip.bench.sources.ho3d_sequences import Ho3dEval
from getagrip.bench.tables import ALL_PARTS_LABEL, read_published_results
from getagrip.clip import read_clip, read_masks
from getagrip.metrics.evaluate.metric import METRICS
from getagrip.readers.depth_files import HO3D_DEPTH_UNIT_M
from helpers.environment import Run
from helpers.hand_object_files import HELD, LOST, write_ho3d
from helpers.held_ball import FRAMES

CLIP = f"SM--SM1--{HELD}--right"


@pytest.fixture
def root(tmp_path: Path, mano: Path) -> Path:
    """HO-3D's folder, its list of joints, and 0.9 m as the depth of everything."""
    root = write_ho3d(tmp_path, mano)
    joints = [
        pickle.loads((root / "train/ABF12/meta" / f"{n - (n == LOST):04d}.pkl").read_bytes())["handJoints3D"]
        for n in range(FRAMES)
    ]
    (root / "evaluation.txt").write_text("".join(f"SM1/{n:04d}\n" for n in range(FRAMES)))
    (root / "evaluation_xyz.json").write_text(json.dumps(np.array(joints).tolist()))
    depth = root / "evaluation" / "SM1" / "depth"
    depth.mkdir()
    number = round(0.9 / HO3D_DEPTH_UNIT_M)
    image = np.full((480, 640, 3), [0, number // 256, number % 256], np.uint8)
    for n in range(FRAMES):
        cv2.imwrite(str(depth / f"{n:04d}.png"), image)
    return root


@pytest.mark.slow
def test_rows_are_masks_and_columns_the_field_s(
    root: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "getagrip.metrics.pose.N_RECALL_BALL_ROTATIONS", 20
    )  # of 500: how good poses are is not looked at
    out, masks = tmp_path / "out", tmp_path / "masks"
    source = Ho3dEval(root=root)
    (sample,), failed = source.samples(out / "clips", False)
    assert (sample.name, failed) == (CLIP, [])
    clip = read_clip(sample.folder)
    assert clip.frames == tuple(f"{n:04d}" for n in range(FRAMES) if n != LOST)  # whole, not cut to a grasp
    (masks / "SM1").mkdir(parents=True)
    for frame, mask in zip(clip.frames, read_masks(clip).object, strict=True):  # numbered as XMem does
        cv2.imwrite(str(masks / "SM1" / f"{int(frame):05d}.png"), 255 * mask.astype(np.uint8))
    call = ("bench", "ho3d-eval", "--root", root, "--masks", masks, "--out", out, "--workers", "1", "--inits", "1")
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
def test_masks_are_those_of_the_folder_and_the_hand_s_are_ignored(root: Path, tmp_path: Path) -> None:
    (sample,), _ = Ho3dEval(root=root).samples(tmp_path / "clips", False)
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


def test_the_list_of_joints_and_the_one_split_are_needed(root: Path, tmp_path: Path, run: Run) -> None:
    (root / "evaluation.txt").unlink()
    status, _, err = run("bench", "ho3d-eval", "--root", root, "--out", tmp_path / "out")
    assert status != 0
    assert "evaluation.txt" in err
    status, _, err = run("bench", "ho3d-eval", "--root", root, "--split", "train", "--out", tmp_path / "out")
    assert (status, "which is one split" in err) == (2, True)
