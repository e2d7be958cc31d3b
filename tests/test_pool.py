"""Jobs over processes. Nothing heavy is imported here: each process imports this file again."""

from __future__ import annotations

import os
import time

from getagrip.run.pool import in_processes


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
