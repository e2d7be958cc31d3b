"""Ray and Slurm: results as on one machine, whatever dies; progress is printed where the driver dies."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
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
from getagrip.io.plugins import install_command
from helpers.clusters import RayCluster, ray_cluster, write_slurm
from helpers.environment import Library, Run, Shelf, import_path
from helpers.folders import results_in
from helpers.jobs import dies_once, drive, loses_its_task, patient, start_driver, wait_for_tasks
from helpers.scenes import SHORT, from_table, scene

COUNT = 18
needs_ray = pytest.mark.skipif(find_spec("ray") is None, reason="needs Ray: pip install -e '.[ray]'")


def start(out: Path, address: str) -> subprocess.Popen[str]:
    return start_driver(out, COUNT, 0.4, 1, f"partial(RayExecutor, None, {address!r})")


@needs_ray
@pytest.mark.slow
@pytest.mark.long
def test_whoever_is_killed_each_task_is_done_once_and_results_are_those_of_one_machine(
    tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    with ray_cluster(nodes=1) as cluster:
        _a_node_and_then_the_driver_are_killed(cluster, tmp_path)
        monkeypatch.chdir(tmp_path)
        _results_are_the_same(cluster, tmp_path, run)  # on the node that is left


def _a_node_and_then_the_driver_are_killed(cluster: RayCluster, tmp_path: Path) -> None:
    driver = start(tmp_path, cluster.address)
    wait_for_tasks(tmp_path, 6)
    cluster.kill_node()
    wait_for_tasks(tmp_path, 12)
    driver.send_signal(signal.SIGKILL)
    driver.communicate()
    before = {path.name for path in tmp_path.glob("task-??")}
    assert len(before) < COUNT
    out, err = start(tmp_path, cluster.address).communicate(timeout=120)
    states = dict(line.split() for line in out.splitlines() if line.startswith("task-"))  # Ray may say something, too
    assert len(states) == COUNT, err
    assert set(states.values()) <= {"done", "kept"}
    assert {name for name, state in states.items() if state == "kept"} >= before
    runs = Counter((tmp_path / "runs").read_text().splitlines())
    assert len(runs) == COUNT
    again = {name for name, count in runs.items() if count > 1}
    assert len(again) <= 1 + 2  # what was at work on the node, and what the driver had given out


def _results_are_the_same(cluster: RayCluster, tmp_path: Path, run: Run) -> None:
    for n, category in enumerate(("can", "mug")):
        write_clip(*scene(category, n, SHORT), tmp_path / "clips" / category)
    write_clip(*from_table(), tmp_path / "whole")
    calls = [
        ["reconstruct", "clips", "--inits", "6", "--out", "{}"],
        ["bench", "clips", "--inits", "2", "--clips", "1", "--methods", "static", "--out", "{}/bench"],
        ["reconstruct", "whole", "--cut-grasps", "--inits", "2", "--out", "{}/found"],
    ]
    on_ray = ["--engine", "ray", "--address", cluster.address]
    for words in calls:
        assert run(*[word.format("here") for word in words], "--workers", "1")[0] == 0
    code = f"from getagrip.cli import main\nfor words in {calls}:\n"
    code += f"    assert main([word.format('there') for word in words] + {on_ray}) == 0"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path, env=import_path(), capture_output=True)
    kinds = "", "bench/results/static", "found"
    folders = [[folder for kind in kinds for folder in results_in(tmp_path / of / kind)] for of in ("here", "there")]
    pairs = list(zip(*folders, strict=True))
    assert len(pairs) == 4
    for here, there in pairs:
        assert here.name == there.name
        assert (here / "result.npz").read_bytes() == (there / "result.npz").read_bytes()
        records = [json.loads((folder / "result.json").read_text()) for folder in (here, there)]
        for record in records:
            del record["seconds"], record["clip_folder"]  # what they took, and of what was found, where its clip lies
        assert records[0] == records[1]
    found = [tmp_path / of / "found" / "clips" / "from-table.grasps.json" for of in ("here", "there")]
    assert found[0].read_bytes() == found[1].read_bytes()


def test_without_ray_the_call_says_how_to_get_it(
    clip_folder: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    status, _, err = run("reconstruct", clip_folder, "--out", tmp_path / "out", "--engine", "ray")
    assert status == 2
    assert err.startswith("getagrip: missing module 'ray' (")
    assert err.endswith(f"--engine ray needs it; {install_command('ray')}\n")


@needs_ray
@pytest.mark.slow
@pytest.mark.parametrize("address", ["127.0.0.1:{}", "ray://127.0.0.1:{}", "localhost:x", "nonsense"])
def test_an_address_that_does_not_answer_is_named(clip_folder: Path, tmp_path: Path, run: Run, address: str) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = address.format(free.getsockname()[1])
    call = ("reconstruct", clip_folder, "--out", tmp_path / "out", "--engine", "ray", "--address", address)
    status, _, err = run(*call)
    assert status == 2
    assert err.startswith("getagrip: --address must be the address of a running Ray cluster")
    assert err.count("\n") == 1


def test_an_address_belongs_to_ray(clip_folder: Path, tmp_path: Path, run: Run) -> None:
    status, _, err = run("reconstruct", clip_folder, "--out", tmp_path / "out", "--address", "auto")
    assert status == 2
    assert err == "getagrip: --address cannot be used without --engine ray\n"


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


CODE = """
import os, sys
from pathlib import Path
from getagrip.batch.ledger import LedgerEntry
from getagrip.batch.clusters import report_on_death
from getagrip.batch.ledger import Ledger
sys.argv = ["/usr/bin/getagrip", "reconstruct", "my clips", "--engine", "ray"]
with Ledger(Path({0!r})) as ledger:
    ledger.expect([f"c{{n}}" for n in range(5)], [])
    for name, state in (("c0", "done"), ("c1", "done"), ("c2", "failed"), ("c3", "open")):
        ledger.claim(name, "options", "code")
        if state != "open":
            ledger.end(LedgerEntry(name, state, options="options", code="code"))
    with report_on_death(ledger.path.parent, "clips"):
        {1}
"""


@pytest.mark.slow
def test_where_a_process_ends_at_once_another_says_what_is_left(tmp_path: Path) -> None:
    code = CODE.format(str(tmp_path), "os._exit(1)")
    done = subprocess.run([sys.executable, "-c", code], env=import_path(), capture_output=True, text=True, check=False)
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert line.startswith("getagrip: Ray's cluster has died")
    assert "2 of 5 clips are done, 1 failed, 2 are left" in line
    assert line.endswith("this continues: getagrip reconstruct 'my clips' --engine ray")


@pytest.mark.slow
@pytest.mark.parametrize("end", ["pass", "raise SystemExit(3)"])
def test_where_it_ends_by_itself_nothing_is_said(tmp_path: Path, end: str) -> None:
    code = CODE.format(str(tmp_path), end)
    done = subprocess.run([sys.executable, "-c", code], env=import_path(), capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (3 if end != "pass" else 0, "")
