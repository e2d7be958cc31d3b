"""The whole ``reconstruct`` with default options: time, its split by stage, memory, and what a first start costs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np

from benchmarks.problem import CLIPS, Problem, make, reconstruction
from benchmarks.store import Table, of_cells
from benchmarks.timing import timed, typical
from getagrip.clip import write_clip
from getagrip.geometry.mesh import Mesh
from getagrip.result import Reconstruction
from getagrip.timelines.reconstruct import reconstruct

REPEATS, IN_TURN = 15, 9


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


def two_threads() -> dict[str, Table]:
    """What a second thread gains for a clip that is waited for: with one and with two, in turn."""
    rows = []
    for category, seed in CLIPS:
        problem = make(category, seed)

        def call(threads: int, problem=problem) -> Reconstruction:
            mesh = Mesh(problem.clip.mesh.vertices, problem.clip.mesh.faces)  # has no tables yet
            return reconstruct(replace(problem.clip, mesh=mesh), problem.masks, threads=threads)

        same = np.array_equal(call(1).T_hand_obj, call(2).T_hand_obj)
        one, two = list[float](), list[float]()
        for _ in range(IN_TURN):
            one += timed(lambda: call(1))[0].wall
            two += timed(lambda: call(2))[0].wall
        ratio = median(b / a for a, b in zip(one, two, strict=True))
        times = [f"{1e3 * median(wall):.0f}" for wall in (one, two)]
        rows.append([problem.clip.name, *times, f"{ratio:.2f}", "yes" if same else "no"])
    header = ["clip", "one thread, wall ms", "two, wall ms", "ratio", "the same to the bit"]
    return {"two-threads": of_cells("Two threads for one clip", header, rows)}


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.0f}"
