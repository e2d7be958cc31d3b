"""A batch in array jobs, on scripts that take the place of Slurm's commands."""

from __future__ import annotations

import os
import shutil
import sys
from collections import Counter
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import pytest

from getagrip.batch import clusters
from getagrip.batch.clusters import SlurmExecutor
from getagrip.batch.executor import run_on_executor
from getagrip.batch.import_dataset import import_clips
from getagrip.batch.scheduling import NO_LIMITS, Limits, SchedulingOptions
from getagrip.clip import write_clip
from getagrip.errors import GetagripError
from getagrip.io import plugins
from helpers.clusters import write_slurm
from helpers.environment import Library, Run, Shelf, import_path
from helpers.jobs import dies_once, drive, loses_its_task, patient
from helpers.scenes import from_table

needs_submitit = pytest.mark.skipif(find_spec("submitit") is None, reason="needs submitit: pip install -e '.[slurm]'")


@pytest.fixture
def slurm(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Tasks are processes of this machine; the folder of the commands."""
    folder = write_slurm(tmp_path / "slurm")
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setattr(clusters, "SLURM_POLL_S", 0.05)
    submitit = pytest.importorskip("submitit")
    monkeypatch.setattr(submitit.Job, "_results_timeout_s", 0.2)  # patience with slow file systems
    monkeypatch.setattr(submitit.SlurmJob.watcher, "_delay_s", 0.2)  # and with sacct
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("PYTHONPATH", import_path()["PYTHONPATH"])
    return folder


@needs_submitit
@pytest.mark.slow
def test_each_task_of_the_ledger_is_done_once(slurm: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    states = [line.split()[1] for line in drive(out, 7, 0.0, 1, partial(SlurmExecutor, 2))]
    assert states == ["done"] * 7
    assert Counter((out / "runs").read_text().splitlines()) == {f"task-{n:02d}": 1 for n in range(7)}
    assert list((tmp_path / "state" / "getagrip" / "slurm").iterdir()) == []
    (script,) = (slurm / "jobs").glob("*/script")
    for words in ("--array=0-1%2", "--cpus-per-task=1", "--mem=4GB", "--time=240", "--job-name=getagrip"):
        assert words in script.read_text()


@needs_submitit
@pytest.mark.slow
def test_a_lost_task_is_given_out_again_and_a_process_that_dies_is_its_own_matter(slurm: Path, tmp_path: Path) -> None:
    executor = SlurmExecutor(1, loses_its_task, NO_LIMITS, None)
    (ended,) = run_on_executor(executor, [str(tmp_path / "lost")])
    assert (ended.result, ended.attempts) == ("done", 1)
    (ended,) = run_on_executor(SlurmExecutor(1, dies_once, NO_LIMITS, None), [str(tmp_path / "dies")])
    assert (ended.result, ended.attempts) == (ended.process, 2)


@needs_submitit
@pytest.mark.slow
def test_an_import_has_its_parts_read_there(slurm: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    library = Library(shelves=(Shelf("torn"), Shelf("fine")))
    assert import_clips(library, tmp_path / "out", debug=False, share=SchedulingOptions(engine="slurm", workers=1)) == 1
    assert {path.parent.name for path in tmp_path.glob("out/*/clip.json")} == {"torn-0", "torn-3", "fine-0", "fine-3"}
    assert capsys.readouterr().out.splitlines()[-1] == "4 clips, 0 already there, 2 of 2 shelves failed"


@needs_submitit
@pytest.mark.slow
def test_grasps_are_found_there(slurm: Path, tmp_path: Path, run: Run) -> None:
    write_clip(*from_table(), tmp_path / "whole")
    call = ("reconstruct", "--cut-grasps", tmp_path / "whole", "--inits", 2, "--workers", 1)
    here, there = (
        run(*call, "--out", tmp_path / of, "--engine", engine) for of, engine in (("here", "local"), ("there", "slurm"))
    )
    assert (here[0], there[0]) == (0, 0)
    found = [tmp_path / of / "clips" / "from-table.grasps.json" for of in ("here", "there")]
    assert found[0].read_bytes() == found[1].read_bytes()
    poses = [tmp_path / of / "from-table--1" / "result.npz" for of in ("here", "there")]
    assert poses[0].read_bytes() == poses[1].read_bytes()


@needs_submitit
@pytest.mark.slow
def test_limits_hold_there_as_well(slurm: Path) -> None:
    limits = Limits(seconds=5.0)
    ends = {
        ended.job: ended for ended in run_on_executor(SlurmExecutor(1, patient, limits, None), ["a", "slow"], limits)
    }
    assert ends["a"].result == "a"
    assert ends["slow"].why == "it took longer than 5 s (--limit-seconds)"


@needs_submitit
@pytest.mark.slow
def test_a_machine_with_other_code_is_named(slurm: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plugins, "fingerprint", lambda: "0123456789abcdef")
    with pytest.raises(GetagripError, match=r"must be the same on every machine.*got getagrip of other code "):
        list(run_on_executor(SlurmExecutor(1, patient, NO_LIMITS, None), ["a"]))


@needs_submitit
def test_what_sbatch_refuses_is_said(
    slurm: Path, clip_folder: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("REFUSED", "1")
    status, _, err = run("reconstruct", clip_folder, "--out", tmp_path / "out", "--engine", "slurm")
    assert status == 1
    said = "getagrip: --engine slurm: sbatch has refused the jobs (sbatch: error: invalid partition specified: none)\n"
    assert err.endswith(said)
    assert "Traceback" not in err


@pytest.mark.parametrize("missing", ["submitit", "sbatch"])
def test_what_is_missing_is_named(
    clip_folder: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch, missing: str
) -> None:
    if missing == "submitit":
        monkeypatch.setitem(sys.modules, "submitit", None)
    else:
        pytest.importorskip("submitit", reason="needs submitit: pip install -e '.[slurm]'")
        monkeypatch.setattr(shutil, "which", lambda _: None)
    status, _, err = run("reconstruct", clip_folder, "--out", tmp_path / "out", "--engine", "slurm")
    assert status == 2
    assert err.startswith("getagrip: missing ")
    assert ": --engine slurm needs " in err
    assert missing in err
    assert err.count("\n") == 1
