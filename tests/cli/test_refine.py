"""`refine`: another system's poses are where the joint fit starts, and come back in their own format."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from getagrip.cli.refine import REFINED_POSES_FOLDER, Change, PoseProbabilities, Refine, _print_changes
from getagrip.clip import Clip, Masks, write_clip
from getagrip.fitting.options import Options, PriorsFile
from getagrip.fitting.solver.initial_poses import REPRESENTATIVE_DISTANCE_DIAMETERS, read_initial_poses
from getagrip.geometry import se3
from getagrip.metrics.evaluate import evaluate
from getagrip.metrics.evaluate.external import read_external_poses
from getagrip.result import Reconstruction, write_result
from getagrip.result.findings import Probability
from helpers.environment import Run
from helpers.scenes import SMALL, scene


@pytest.fixture(scope="module")
def mug() -> tuple[Clip, Masks]:
    return scene("mug", 1, SMALL)


def flipped(clip: Clip) -> np.ndarray:
    """The true poses, every other one turned by half a turn about the mug's middle."""
    assert clip.truth is not None
    T = clip.truth.T_cam_obj.copy()
    R = se3.exp_so3(np.array([0.0, 0.0, np.pi]))
    T[::2] = T[::2] @ se3.rigid(R, clip.mesh.centre - R @ clip.mesh.centre)
    return T


def options(path: Path) -> Options:
    return Options(init="poses", priors=PriorsFile(path), priors_only=True)


def test_poses_alike_are_represented_by_one_and_each_other_kind_too(tmp_path: Path, mug: tuple[Clip, Masks]) -> None:
    clip, _ = mug
    np.savez(tmp_path / "poses.npz", T_cam_obj=flipped(clip), frames=np.array(clip.frames))
    T, notes = read_initial_poses(clip, options(tmp_path / "poses.npz"))
    assert 2 <= len(T) < len(clip)
    assert any("represent the others" in note for note in notes)
    points = clip.mesh.vertices / clip.mesh.diameter
    given = se3.transform(se3.inverse(clip.hand.T_cam_hand) @ flipped(clip), clip.mesh.vertices) / clip.mesh.diameter
    chosen = se3.transform(T, clip.mesh.diameter * points) / clip.mesh.diameter
    apart = np.sqrt(np.mean(np.sum((given[:, None] - chosen) ** 2, axis=-1), axis=-1))
    assert apart.min(axis=1).max() < 1.2 * REPRESENTATIVE_DISTANCE_DIAMETERS  # the choice looks at some of the vertices


def test_a_file_that_changed_is_refused(tmp_path: Path, mug: tuple[Clip, Masks]) -> None:
    clip, _ = mug
    np.savez(tmp_path / "poses.npz", T_cam_obj=flipped(clip), frames=np.array(clip.frames))
    stale = replace(options(tmp_path / "poses.npz"), priors=PriorsFile(tmp_path / "poses.npz", "0" * 64))
    with pytest.raises(Exception, match="has changed since"):
        read_initial_poses(clip, stale)


@pytest.mark.slow
def test_flips_are_mended_and_written_in_the_same_format(tmp_path: Path, run: Run, mug: tuple[Clip, Masks]) -> None:
    clip, masks = mug
    write_clip(clip, masks, tmp_path / "clips" / clip.name)
    (tmp_path / "theirs").mkdir()
    file = tmp_path / "theirs" / f"{clip.name}.npy"
    np.save(file, flipped(clip))
    status, out, err = run("refine", tmp_path / "theirs", "--clips", tmp_path / "clips", "--out", tmp_path / "out")
    assert status == 0, err
    assert "IOU before" in out
    before, after = (
        evaluate(read_external_poses(each, "x", clip, masks), clip, masks).metrics["add_sym_success"]
        for each in (file, tmp_path / "out" / REFINED_POSES_FOLDER / clip.name / file.name)
    )
    assert (before, after) == (0.0, 1.0)
    assert " ".join(out.split()).count("before") == 3  # IOU, and how probable it is in hand and camera
    (line,) = csv.DictReader((tmp_path / "out" / "changes.csv").read_text().splitlines())
    assert line["clip"] == clip.name
    assert float(line["iou_before"]) < float(line["iou_after"])
    assert 0.0 < float(line["right_in_hand_after"]) < 1.0
    assert all(not cell or np.isfinite(float(cell)) for head, cell in line.items() if head != "clip")


def test_given_poses_are_as_probable_as_ours_if_they_are_the_same_and_else_at_most_the_rest() -> None:
    ours, own = Probability(0.9, ""), Probability(0.3, "")
    assert PoseProbabilities.of(None, ours, 0.02).said == ("90 %", "90 %")
    assert PoseProbabilities.of(None, ours, 0.1).said == ("-", "90 %")  # both may be right, or one of them
    assert PoseProbabilities.of(None, ours, 0.3).said == ("at most 10 %", "90 %")
    assert PoseProbabilities.of(None, ours, 0.3) == PoseProbabilities(None, pytest.approx(0.1), 0.9)
    assert PoseProbabilities.of(None, Probability(0.999, ""), 0.3).said == ("< 1 %", "> 99 %")
    assert PoseProbabilities.of(own, ours, 0.3).said == ("30 %", "90 %")  # of a result of ours it is known
    assert PoseProbabilities.of(None, None, 0.3).said == ("-", "-")


def test_poses_of_another_frame_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    _print_changes([Change("mug", (0.0, 0.9), 0.1, 1.0), Change("cup", (0.1, 0.9), 0.1, 1.0)])
    told = "".join(capsys.readouterr())
    assert "mug: no given pose meets the masks" in told
    assert "cup: no given pose" not in told


def test_poses_in_the_hand_come_back_in_the_clip_s_hand(tmp_path: Path, mug: tuple[Clip, Masks]) -> None:
    clip, masks = mug
    write_clip(clip, masks, tmp_path / "clips" / clip.name)
    T_hand_obj = se3.inverse(clip.hand.T_cam_hand) @ clip.truth.T_cam_obj
    np.savez(tmp_path / "poses.npz", T_hand_obj=T_hand_obj, frames=np.array(clip.frames))
    moved = clip.hand.T_cam_hand @ se3.rigid(None, np.array([0.01, 0.0, 0.02]))  # the refined hand
    result = replace(
        Reconstruction.external(clip.name, "x", clip.frames, se3.inverse(moved) @ clip.truth.T_cam_obj, 1.0),
        T_cam_hand=moved, iou=np.ones(len(clip)),
    )  # fmt: skip
    write_result(result, tmp_path / "out" / clip.name)
    refine = Refine(poses=tmp_path / "poses.npz", clips=(tmp_path / "clips",), out=tmp_path / "out")
    change = refine._written(clip.name, tmp_path / "clips" / clip.name, tmp_path / "out" / REFINED_POSES_FOLDER)
    assert change is not None
    with np.load(tmp_path / "out" / REFINED_POSES_FOLDER / clip.name / "poses.npz") as written:
        np.testing.assert_allclose(written["T_hand_obj"], T_hand_obj, atol=1e-9)


def test_another_start_cannot_be_named(tmp_path: Path, run: Run) -> None:
    np.save(tmp_path / "poses.npy", np.tile(np.eye(4), (3, 1, 1)))
    poses = ("--init", "poses", "--priors", tmp_path / "poses.npy")
    status, _, err = run("refine", tmp_path, "--clips", tmp_path, "--out", tmp_path / "out", *poses)
    assert status == 2
    assert "--init poses cannot be used with refine" in err
