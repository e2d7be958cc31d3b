"""What a busy neighbour costs: ``reconstruct`` alone on the machine, and beside a process that keeps one core busy."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from statistics import median

from benchmarks.page import table
from benchmarks.problem import CLIPS, make, reconstruction
from benchmarks.timing import timed

REPEATS = 9


def section() -> str:
    """Measure, alone and beside the neighbour in turn; the section's text."""
    rows = []
    for category, seed in CLIPS:
        problem = make(category, seed)
        call = reconstruction(problem.clip, problem.masks)
        call()  # compiles, or loads what was compiled
        alone, beside = list[float](), list[float]()
        for _ in range(REPEATS):
            alone += timed(call)[0].wall
            with _neighbour():
                beside += timed(call)[0].wall
        ratio = median(b / a for a, b in zip(alone, beside, strict=True))
        rows.append([problem.clip.name, f"{1e3 * median(alone):.0f}", f"{1e3 * median(beside):.0f}", f"{ratio:.2f}"])
    return table(["clip", "alone, wall ms", "beside a busy process, wall ms", "ratio"], rows)


@contextmanager
def _neighbour() -> Iterator[None]:
    """A process that computes without end, meanwhile."""
    process = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    try:
        yield
    finally:
        process.kill()
        process.wait()
