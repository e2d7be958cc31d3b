"""Jobs over processes: none takes another along, none outlives its parent."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from getagrip.batch.executor import FinishedJob, Processes, run_in_processes, run_on_executor
from getagrip.batch.scheduling import NO_LIMITS, Limits
from getagrip.errors import UsageError
from helpers.environment import import_path
from helpers.jobs import dies_once, greedy, patient, slow_start, work


def shared(work: Callable, jobs: list[Any], workers: int, limits: Limits = NO_LIMITS) -> Iterator[FinishedJob]:
    """Jobs over processes of this machine."""
    return run_on_executor(Processes(workers, work, limits, None), jobs, limits)


@pytest.mark.slow
def test_a_dying_process_takes_no_other_job_along() -> None:
    before = os.environ.get("OMP_NUM_THREADS")
    outcomes = dict(run_in_processes(work, range(8), workers=2))
    assert outcomes == {job: None if job == 3 else f"{job} 1" for job in range(8)}
    assert os.environ.get("OMP_NUM_THREADS") == before


@pytest.mark.slow
def test_a_killed_parent_leaves_no_process_behind(tmp_path: Path) -> None:
    file = tmp_path / "ticks"
    code = (
        "from getagrip.batch.executor import run_in_processes; from helpers.jobs import tick;"
        f"list(run_in_processes(tick, [{str(file)!r}], 1))"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], env=import_path(), stderr=subprocess.DEVNULL)
    try:
        assert _soon(file.exists)
    finally:
        parent.kill()
        parent.wait()
    assert _soon(lambda: not _grows(file))


def _soon(condition: Callable[[], bool]) -> bool:
    """Whether a condition holds within half a minute."""
    end = time.monotonic() + 30.0
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.05)
    return False


def _grows(file: Path) -> bool:
    """Whether a file becomes longer within half a second; jobs add to it five times."""
    before = file.stat().st_size
    time.sleep(0.5)
    return file.stat().st_size > before


@pytest.mark.slow
def test_a_job_that_takes_too_long_is_ended_and_the_others_go_on() -> None:
    ends = {ended.job: ended for ended in shared(patient, ["a", "slow", "b", "c"], 2, Limits(seconds=5.0))}
    assert {job: ended.result for job, ended in ends.items()} == {"a": "a", "b": "b", "c": "c", "slow": None}
    assert ends["slow"].why == "it took longer than 5 s (--limit-seconds)"
    assert ends["slow"].attempts == 1


@pytest.mark.slow
def test_what_a_process_does_before_its_first_job_counts_for_no_limit() -> None:
    limits = Limits(seconds=2.0)
    ends = run_on_executor(Processes(2, patient, limits, slow_start), ["a", "b", "c"], limits)
    assert sorted((ended.job, ended.result, ended.seconds < 2.0) for ended in ends) == [
        ("a", "a", True), ("b", "b", True), ("c", "c", True),
    ]  # fmt: skip


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="only Linux can limit the memory of a process so")
def test_a_job_gets_no_more_memory_than_it_may_have() -> None:
    ends = shared(greedy, [0.1, 3.0], 1, Limits(gigabytes=1.0))
    assert {ended.job: ended.result for ended in ends} == {0.1: "granted", 3.0: "refused"}


@pytest.mark.slow
def test_a_killed_process_gives_its_job_to_another_one(tmp_path: Path) -> None:
    (ended,) = shared(dies_once, [str(tmp_path / "mark")], 2)
    assert ended.attempts == 2
    assert ended.result == ended.process


@pytest.mark.parametrize(
    "given", [{"seconds": 0.0}, {"seconds": float("nan")}, {"gigabytes": -1.0}, {"gigabytes": 1e30}]
)
def test_limits_are_numbers_above_zero(given: dict[str, float]) -> None:
    with pytest.raises(UsageError, match="must be above 0"):
        Limits(**given)
