"""Jobs over processes: none takes another along, none outlives its parent."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from getagrip.batch.pool import in_processes
from helpers.jobs import work
from helpers.paths import ROOT


@pytest.mark.slow
def test_a_dying_process_takes_no_other_job_along() -> None:
    before = os.environ.get("OMP_NUM_THREADS")
    outcomes = dict(in_processes(work, range(8), workers=2))
    assert outcomes == {job: None if job == 3 else f"{job} 1" for job in range(8)}
    assert os.environ.get("OMP_NUM_THREADS") == before


def test_a_killed_parent_leaves_no_process_behind(tmp_path: Path) -> None:
    file = tmp_path / "ticks"
    code = (
        "from getagrip.batch.pool import in_processes; from helpers.jobs import tick;"
        f"list(in_processes(tick, [{str(file)!r}], 1))"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT / "tests", stderr=subprocess.DEVNULL)
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
    """Whether a file becomes longer within a second."""
    before = file.stat().st_size
    time.sleep(1.0)
    return file.stat().st_size > before
