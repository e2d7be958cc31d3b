"""Jobs for other processes. Nothing heavy is imported here: each process imports this file again."""

from __future__ import annotations

import os
import time
from pathlib import Path


def work(job: int) -> str:
    """Runs in another process: dies for job 3, and returns the number of threads that numpy may use."""
    if job == 3:
        os._exit(1)
    time.sleep(0.01)
    return f"{job} {os.environ['OMP_NUM_THREADS']}"


def tick(file: str) -> None:
    """Runs in another process: lengthens a file as long as it lives, a minute at most."""
    for _ in range(600):
        with Path(file).open("a") as out:
            out.write(".")
        time.sleep(0.1)
