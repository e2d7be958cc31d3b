"""Whatever goes wrong: nothing broken is called done, and the next call does what is left."""

from __future__ import annotations

import json
import os
import random
import signal
import sqlite3
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import asdict, replace
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

from getagrip import cli
from getagrip.batch.ledger import LEDGER_FILE
from getagrip.cli import _parse_command
from getagrip.clip import Clip, write_clip
from getagrip.errors import InputError
from getagrip.fitting.options import Options
from getagrip.io import files
from getagrip.io.files import to_json
from getagrip.result import Reconstruction, read_result
from helpers.clips import small_clip
from helpers.environment import Run, import_path
from helpers.folders import FailingDisk, results_in
from helpers.jobs import drive
from helpers.scenes import perfect

NAMES = ("a", "Tasse \u6531\u308b \U0001f36b", "ß" * 100)
"""The last has 200 bytes: as long as a name may be."""


@pytest.fixture
def clips(tmp_path: Path) -> Path:
    """Three clips."""
    clip, masks = small_clip()
    for name in NAMES:
        write_clip(replace(clip, name=name), masks, tmp_path / "clips" / name)
    return tmp_path / "clips"


@pytest.fixture(autouse=True)
def fitted(monkeypatch: pytest.MonkeyPatch) -> list[Callable[[Clip], None]]:
    """Instead of the method, the truth; what is to happen while a clip is fitted."""
    meanwhile: list[Callable[[Clip], None]] = []

    def fit(clip: Clip, masks: object, options: Options, *_: object) -> Reconstruction:
        for happen in meanwhile:
            happen(clip)
        given = json.loads(to_json(asdict(options)))
        return replace(perfect(clip), clip=clip.name, options=given, method=options.method, seed=options.seed)

    monkeypatch.setattr(import_module("getagrip.reconstruct"), "reconstruct", fit)
    return meanwhile


def done(out: Path) -> set[str]:
    """The clips that the ledger calls done, as far as there is one."""
    if not (out / LEDGER_FILE).exists():
        return set()
    with closing(sqlite3.connect(out / LEDGER_FILE)) as db, suppress(sqlite3.OperationalError):  # no tables yet
        return {name for (name,) in db.execute("SELECT name FROM tasks WHERE state = 'done'")}
    return set()


def sound(out: Path) -> set[str]:
    """The clips that have a result, all of which can be read."""
    return {read_result(folder)[0].clip for folder in results_in(out)}


@pytest.mark.slow
def test_a_disk_that_is_full_at_any_write(
    clips: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From then on or, at some, for this write alone."""
    parsed = cache(_parse_command)  # the call is the same one, in many folders
    monkeypatch.setattr(cli, "_parse_command", lambda args: parsed(tuple(args)))

    def with_disk(out: Path, first: int, last: int) -> tuple[int, int, str]:
        out.parent.mkdir(exist_ok=True)
        monkeypatch.chdir(out.parent)
        with monkeypatch.context() as patch:
            disk = FailingDisk(patch, first, last)
            status, _, err = run("reconstruct", clips / "a", clips / NAMES[2], "--out", out.name)
        return disk.writes, status, err

    wanted = {"a", NAMES[2]}
    count, status, _ = with_disk(tmp_path / "all" / "out", 1, 0)
    assert status == 0
    assert count > 30
    for k in range(1, count + 1):
        for last in [10**9] + [k] * (k % 3 == 0):
            out = tmp_path / f"{k}-{last}" / "out"
            _, status, err = with_disk(out, k, last)
            assert (status != 0 and err) or sound(out) == wanted, k  # without the last, the ledger's, all is done
            assert done(out) <= sound(out), k
            assert not [*out.glob(f"{files.TEMPORARY_FOLDER_PREFIX}*")], k
    for k in range(1, count + 1, 6):
        out = tmp_path / f"{k}-{10**9}" / "out"
        assert with_disk(out, 1, 0)[1] == 0
        assert done(out) == sound(out) == wanted


@pytest.mark.parametrize("what", ["hand.npz", "clip.json", "object.obj", "masks/object/0001.png"])
@pytest.mark.parametrize("how", ["truncated", "edited", "removed"])
@pytest.mark.slow
def test_inputs_that_change_while_they_are_read(
    clips: Path, tmp_path: Path, run: Run, fitted: list[Callable[[Clip], None]], what: str, how: str
) -> None:
    def happen(clip: Clip) -> None:
        path = clips / clip.name / what
        if clip.name == "a":
            content = path.read_bytes()
            path.write_bytes(content[: len(content) // 2] if how == "truncated" else content + b"\n")
            if how == "removed":
                path.unlink()

    fitted.append(happen)
    status, printed, err = run("reconstruct", clips, "--out", tmp_path / "out")
    assert status == 1
    assert "2 done, 0 already done, 1 failed" in printed
    assert str(clips / "a") in err
    assert sound(tmp_path / "out") == done(tmp_path / "out") == {*NAMES[1:]}


@pytest.mark.slow
def test_the_clock_may_jump(
    clips: Path, tmp_path: Path, run: Run, fitted: list[Callable[[Clip], None]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """To and fro by years while clips are fitted: results, durations and what is done are the same."""
    now = [4e9, 0.0, 1e9]
    monkeypatch.setattr(time, "time", lambda: now[0])
    fitted.append(lambda _: now.append(now.pop(0)))
    out = tmp_path / "out"
    assert run("reconstruct", clips, "--out", out)[0] == 0
    with closing(sqlite3.connect(out / LEDGER_FILE)) as db:
        assert all(0.0 <= seconds < 60.0 for (seconds,) in db.execute("SELECT seconds FROM tasks"))
    monkeypatch.setattr(time, "time", lambda: -1e9)
    assert "0 done, 3 already done" in run("reconstruct", clips, "--out", out)[1]


COUNT = 40


def children(pid: int) -> list[int]:
    """The processes that a process has started."""
    with suppress(OSError):
        return [int(word) for word in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    return []


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="who a process's children are is not known")
@pytest.mark.parametrize("seed", [0, 1])
def test_drivers_and_workers_killed_at_random_times(tmp_path: Path, seed: int) -> None:
    """Six deaths in two drivers and their workers; then each task is done, and only what was at work was repeated."""
    rng = random.Random(seed)
    code = (
        "from pathlib import Path; from helpers.jobs import drive\n"
        f"if __name__ == '__main__': drive(Path({str(tmp_path)!r}), {COUNT}, 0.05, 2)"
    )

    def start() -> subprocess.Popen[bytes]:
        return subprocess.Popen([sys.executable, "-c", code], env=import_path(), stderr=subprocess.DEVNULL)

    running, deaths = [start(), start()], 0
    end = time.monotonic() + 60.0
    while deaths < 6 and any(driver.poll() is None for driver in running) and time.monotonic() < end:
        time.sleep(rng.uniform(0.05, 0.4))
        driver = rng.choice(running)
        victim = rng.choice([driver.pid, *children(driver.pid)])
        if driver.poll() is None and (tmp_path / "runs").exists():
            with suppress(ProcessLookupError):
                os.kill(victim, signal.SIGKILL)
                deaths += 1
        if driver.poll() is not None:
            running[running.index(driver)] = start()
    for driver in running:
        driver.kill()
        driver.wait()
    assert deaths
    states = dict(line.split() for line in drive(tmp_path, COUNT, 0.0, 1))
    assert {*states.values()} <= {"done", "kept"}
    assert len([*tmp_path.glob("task-??")]) == COUNT == len(states)
    runs = Counter((tmp_path / "runs").read_text().splitlines())
    assert sum(runs.values()) <= COUNT + 2 * (deaths + 2)  # each death ends two tasks at most
    assert done(tmp_path) == {*states}


@pytest.mark.slow
def test_a_torn_ledger_is_named_and_results_do_without(clips: Path, tmp_path: Path, run: Run) -> None:
    out = tmp_path / "out"
    run("reconstruct", clips, "--out", out)
    whole = (out / LEDGER_FILE).read_bytes()
    (out / LEDGER_FILE).write_bytes(whole[: len(whole) // 2])
    status, printed, err = run("reconstruct", clips, "--out", out)
    assert (status, err.count("\n")) == (1, 1)
    assert "results do without" in err
    for path in out.glob(f"{LEDGER_FILE}*"):
        path.unlink()
    assert "0 done, 3 already done" in run("reconstruct", clips, "--out", out)[1], printed
    with pytest.raises(InputError):
        read_result(out)
