"""Several drivers on one folder: each task is done once, whoever is killed."""

from __future__ import annotations

import signal
import subprocess
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import pytest

from getagrip.batch import ledger as ledger_module
from getagrip.batch.ledger import Ledger, LedgerEntry
from helpers.jobs import drive, start_driver, wait_for_tasks

COUNT = 24


def start(out: Path, seconds: float = 0.05, workers: int = 1) -> subprocess.Popen[str]:
    return start_driver(out, COUNT, seconds, workers)


def runs(out: Path) -> Counter[str]:
    """How often each task was run."""
    return Counter((out / "runs").read_text().splitlines()) if (out / "runs").exists() else Counter()


@pytest.mark.slow
def test_two_drivers_at_once_share_the_tasks_and_neither_repeats_nor_fails(tmp_path: Path) -> None:
    both = [start(tmp_path, workers=1), start(tmp_path, workers=2)]
    said = [driver.communicate(timeout=60) for driver in both]
    assert [driver.returncode for driver in both] == [0, 0], said
    assert [err for _, err in said] == ["", ""]
    assert runs(tmp_path) == {f"task-{n:02d}": 1 for n in range(COUNT)}
    states = [dict(line.split() for line in out.splitlines()) for out, _ in said]
    assert all(len(state) == COUNT for state in states)  # both have waited for all of them
    assert sum(state == "done" for each in states for state in each.values()) == COUNT


def test_drivers_that_begin_at_the_same_moment_wait_for_each_other(tmp_path: Path) -> None:
    """One in thirty did not, of several that found no ledger."""

    def opened(folder: Path, together: Barrier) -> None:
        together.wait()
        Ledger(folder).__exit__()

    with ThreadPoolExecutor(4) as pool:
        for n in range(40):
            together = Barrier(4)
            for future in [pool.submit(opened, tmp_path / f"{n}", together) for _ in range(4)]:
                future.result()


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_a_killed_driver_is_continued_at_once_and_only_what_was_at_work_is_done_again(
    tmp_path: Path, workers: int
) -> None:
    driver = start(tmp_path, workers=workers)
    wait_for_tasks(tmp_path, 5)
    driver.send_signal(signal.SIGKILL)
    driver.communicate()
    before = {path.name for path in tmp_path.glob("task-??")}
    since = time.monotonic()
    states = dict(line.split() for line in drive(tmp_path, COUNT, 0.0, 1))
    assert time.monotonic() - since < ledger_module.HEARTBEAT_TIMEOUT_S / 2  # its claims do not wait for heartbeats
    assert {name for name, state in states.items() if state == "kept"} >= before
    again = {name for name, count in runs(tmp_path).items() if count > 1}
    assert len(again) <= workers
    assert len(runs(tmp_path)) == COUNT
    assert not again & before


def test_claims_of_a_driver_that_is_silent_pass_on_whatever_clocks_say(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Drivers on other machines are known by their heartbeats only; these are counted, not timed."""
    now = [0.0]
    monkeypatch.setattr(ledger_module.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(ledger_module, "_machine_id", lambda: "there")
    with Ledger(tmp_path) as there:
        monkeypatch.setattr(ledger_module, "_machine_id", lambda: "here")
        with Ledger(tmp_path) as here:
            assert there.claim("a", "options", "code") is not None
            monkeypatch.setattr(time, "time", lambda: 1e12)  # a clock that jumps ten thousand years
            for now[0] in (0.0, 20.0, 29.0):
                assert here.claim("a", "options", "code") is None
            there._db.execute("UPDATE drivers SET beats = beats + 1")
            for now[0] in (31.0, 60.0):
                assert here.claim("a", "options", "code") is None
            now[0] = 62.0
            assert here.claim("a", "options", "code") is not None
            there.end(LedgerEntry("a", "failed", "too late", options="options", code="code"))
            here.end(LedgerEntry("a", "done", "in time", options="options", code="code"))
            assert [entry.why for entry in here.entries()] == ["in time"]


def test_what_has_failed_is_tried_again_by_the_next_driver_but_not_by_one_that_runs_beside(tmp_path: Path) -> None:
    with Ledger(tmp_path) as one, Ledger(tmp_path) as other:
        one.claim("a", "options", "code")
        one.end(LedgerEntry("a", "failed", "no hand", options="options", code="code"))
        beside = other.claim("a", "options", "code")
        assert beside is not None
        assert (beside.state, beside.why) == ("failed", "no hand")
        changed = other.claim("a", "other options", "code")
        assert changed is not None
        assert changed.state == "open"
        other.end(LedgerEntry("a", "failed", "no hand", options="options", code="code"))
    with Ledger(tmp_path) as later:
        entry = later.claim("a", "options", "code")
        assert entry is not None
        assert entry.state == "open"


def test_killed_drivers_leave_no_rows(tmp_path: Path) -> None:
    with Ledger(tmp_path) as ledger:
        for n in range(5):
            row = (f"gone{n}", ledger._drivers._machine, 2**22 + n, "1")
            ledger._db.execute("INSERT INTO drivers VALUES (?, ?, ?, ?, 7)", row)
    with Ledger(tmp_path) as ledger:
        assert ledger._db.execute("SELECT id FROM drivers").fetchall() == [(ledger._drivers.id,)]


def test_a_failure_of_any_length_fits_into_the_ledger(tmp_path: Path) -> None:
    with Ledger(tmp_path) as ledger:
        assert ledger.claim("a", "", "") is not None
        ledger.end(LedgerEntry("a", "failed", "ß" * 2**21))
        (entry,) = ledger.entries()
    assert (entry.state, {*entry.why}) == ("failed", {"ß"})
