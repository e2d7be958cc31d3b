"""The whole ``reconstruct`` with default options: time, its split by stage, memory, and what a first start costs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median

from benchmarks.problem import CLIPS, Problem, make, reconstruction
from benchmarks.store import Table, of_cells
from benchmarks.timing import timed, typical
from getagrip.clip import write_clip

REPEATS = 15


def tables() -> dict[str, Table]:
    """Measure."""
    times, stages = [], []
    problems = [make(category, seed) for category, seed in CLIPS]
    for problem in problems:
        call = reconstruction(problem.clip, problem.masks)
        call()  # compiles, or loads what was compiled
        timing, results = timed(call, REPEATS)
        name, faces = problem.clip.name, len(problem.clip.mesh.faces)
        times.append([
            name, str(faces), _ms(median(timing.cpu)), _ms(min(timing.cpu)), _ms(median(timing.wall)),
            f"{results[0].iou.mean():.3f}", f"{100 * problem.add(results[0].T_hand_obj):.1f}",
        ])  # fmt: skip
        split = typical([result.seconds for result in results])
        stages.append([name, *map(_ms, split.values())])
    columns = ["CPU median, ms", "CPU least, ms", "wall median, ms", "IOU", "ADD, % of diameter"]
    how = (
        f"{len(problems[0].clip)} frames, {results[0].options['inits']} initial poses, all three terms, {REPEATS} runs "
        "after one to warm up"
    )
    return {
        "reconstruct-speed": of_cells("Time of a reconstruction", ["clip", "faces", *columns], times, [how]),
        "reconstruct-speed-stages": of_cells(
            "Time of a reconstruction by stage, median CPU ms", ["clip", *split], stages, [how]
        ),
        "reconstruct-speed-process": _fresh(problems[0]),
    }


def _fresh(problem: Problem) -> Table:
    """Start a process twice: with an empty cache of compiled kernels, then with the one that left behind."""
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = write_clip(problem.clip, problem.masks, Path(scratch) / "clip")
        environment = os.environ | {"NUMBA_CACHE_DIR": str(Path(scratch) / "cache")}
        for name in ("kernels compiled", "kernels from the cache"):
            timing, (output,) = timed(lambda: _child(folder, environment))
            measured = json.loads(output)
            seconds = [timing.wall[0], *(measured[key] for key in ("imports", "read", "first", "second"))]
            memory = [measured[key] for key in ("memory imports", "memory read", "memory")]
            rows.append([name, *(f"{s:.2f}" for s in seconds), *(f"{m:.0f}" for m in memory)])
    header = ["", "process, wall s", "imports, CPU s", "reading, CPU s", "1st reconstruction, CPU s", "2nd, CPU s"]
    header += ["peak memory after imports, MB", "after reading, MB", "at the end, MB"]
    return of_cells("A fresh process", header, rows, [f"on {problem.clip.name}"])


def _child(folder: Path, environment: dict[str, str]) -> str:
    command = [sys.executable, "-m", "benchmarks.fresh", str(folder)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.0f}"
