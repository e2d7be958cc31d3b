"""Jobs over processes. Nothing heavy is imported here: each process imports this file again."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from getagrip.batch.pool import in_processes


def work(job: int) -> str:
    """Runs in another process: dies for job 3, and tells the threads that numpy may use."""
    if job == 3:
        os._exit(1)
    time.sleep(0.01)
    return f"{job} {os.environ['OMP_NUM_THREADS']}"


def test_a_dying_process_takes_no_other_job_along() -> None:
    before = os.environ.get("OMP_NUM_THREADS")
    outcomes = dict(in_processes(work, range(8), workers=2))
    assert outcomes == {job: None if job == 3 else f"{job} 1" for job in range(8)}
    assert os.environ.get("OMP_NUM_THREADS") == before


def tick(file: str) -> None:
    """Runs in another process: lengthens a file as long as it lives, a minute at most."""
    for _ in range(600):
        with Path(file).open("a") as out:
            out.write(".")
        time.sleep(0.1)


def test_a_killed_parent_leaves_no_process_behind(tmp_path: Path) -> None:
    file = tmp_path / "ticks"
    code = f"import test_pool as t; list(t.in_processes(t.tick, [{str(file)!r}], 1))"
    parent = subprocess.Popen([sys.executable, "-c", code], cwd=Path(__file__).parent, stderr=subprocess.DEVNULL)
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
