"""``getagrip init learn``, and what reconstruct and bench do with its file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from getagrip.cli import main
from getagrip.clip import read_clip, write_clip
from getagrip.fitting.options import Options, PriorsFile
from getagrip.fitting.solver.cluster_poses import LearntGrasps
from getagrip.fitting.solver.initial_poses import read_initial_poses, read_learnt
from helpers.clips import small_clip
from helpers.measures import held, old_file


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Clips of two subjects, of nobody in particular, and one without truth."""
    for clip in (held("a", "Ann"), held("b", "Bob", 1), held("c", "", 2), replace(held("d", "Ann"), truth=None)):
        write_clip(clip, small_clip()[1], tmp_path / "clips" / clip.name)
    return tmp_path / "clips"


def test_learning_from_folders(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "new" / "poses.npz"
    assert main(["init", "learn", str(folder), "--out", str(out), "--leave-out", "Bob"]) == 1
    printed = capsys.readouterr()
    assert "truth.npz" in printed.err
    assert "1 clip names no subject" in printed.err
    assert "box, right: 2 poses from 2 grasps" in printed.out
    learnt = read_learnt(out)
    assert isinstance(learnt, LearntGrasps)
    assert [(h.clip, h.subject) for h in learnt.holds] == [("a", "Ann"), ("c", "")]
    clip = read_clip(folder / "b")
    assert len(read_initial_poses(clip, Options(init="clusters", priors=PriorsFile(out)))[0]) == 2


def test_poses_as_a_folder_are_those_of_all_grasps(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call = ["init", "learn", *map(str, (folder / "a", folder / "b", "--out", tmp_path / "poses.npz"))]
    assert main([*call, "--as-folder", str(tmp_path / "poses")]) == 0
    assert "does not say what they were learnt from" in capsys.readouterr().out
    options = Options(init="priors", priors=PriorsFile(tmp_path / "poses"))
    assert len(read_initial_poses(read_clip(folder / "a"), options)[0]) == 2
    assert main([*call, "--as-folder", str(tmp_path / "poses")]) == 2
    assert "exists already" in capsys.readouterr().err


@pytest.mark.slow
def test_a_clip_without_poses_fails_where_they_stand_alone(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["init", "learn", str(folder / "a"), "--out", str(tmp_path / "poses.npz")]) == 0
    args = ["--out", tmp_path / "out", "--init", "clusters", "--priors", tmp_path / "poses.npz", "--priors-only"]
    assert main(["reconstruct", *map(str, (folder / "a", *args))]) == 1
    printed = capsys.readouterr().err
    assert "no poses of box in a right hand without 1 grasp of its own subject" in printed
    assert main(["reconstruct", str(folder / "a"), "--out", str(tmp_path / "out"), "--priors-only"]) == 2
    assert "--priors-only" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("args", "status", "word"),
    [(("--leave-out", "Dan"), 2, "Ann, Bob"), (("--k", "0"), 2, "--k"), (("--out", "/dev/null/poses.npz"), 2, "--out")],
)
def test_wrong_calls_of_learning_are_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], args: tuple[str, ...], status: int, word: str
) -> None:
    assert main(["init", "learn", str(folder), "--out", str(tmp_path / "poses.npz"), *args]) == status
    assert word in capsys.readouterr().err
    assert not (tmp_path / "poses.npz").exists()


@pytest.mark.slow
def test_reconstruct_and_bench_refuse_a_file_without_a_way_to_use_it(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for command in ("reconstruct", "bench"):
        calls: tuple[list[Any], ...] = (["--init", "clusters"], ["--init", "priors"], ["--priors", tmp_path])
        for args in calls:
            assert main([command, str(folder), "--out", str(tmp_path / "out"), *map(str, args)]) == 2
            assert "--priors" in capsys.readouterr().err


def test_own_grasps_are_refused_clip_by_clip(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    old_file(tmp_path / "poses.npz", held("a", "Ann"))
    args = ["--out", tmp_path / "out", "--init", "clusters", "--priors", tmp_path / "poses.npz"]
    assert main(["reconstruct", *map(str, (folder / "a", *args))]) == 1
    assert "learnt from a itself" in capsys.readouterr().err
