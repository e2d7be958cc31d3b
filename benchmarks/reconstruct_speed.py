"""Cost of ``reconstruct`` with default options: time, time by stage, memory, and the cost of a first start."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from statistics import median

import numpy as np

from benchmarks.store import Table, of_cells
from benchmarks.timing import timed, typical
from getagrip.clip import Clip, Masks, write_clip
from getagrip.fitting.options import Options
from getagrip.geometry.mesh import Mesh
from getagrip.metrics.evaluate import evaluate
from getagrip.metrics.evaluate.metric import ADD_SYM_MM
from getagrip.reconstruct import reconstruct
from getagrip.result import Reconstruction
from getagrip.synthetic.scene import synthesise

CLIPS = (("mug", 0), ("pan", 0), ("kettle", 0), ("scissors", 0))
"""Categories and seeds: a hollow object with a handle, a large, a composite and a thin object."""
REPEATS, IN_TURN = 15, 9
DEFAULT = Options()


def tables() -> dict[str, Table]:
    """Measure."""
    times, stages = [], []
    made = [synthesise(category, seed) for category, seed in CLIPS]
    for clip, masks in made:
        call = reconstruction(clip, masks)
        call()  # compiles kernels or loads them
        timing, results = timed(call, REPEATS)
        off = evaluate(results[0], clip, masks, wanted=(ADD_SYM_MM,)).metrics[ADD_SYM_MM.name] / clip.mesh.diameter
        times.append([
            clip.name, str(len(clip.mesh.faces)), _ms(median(timing.cpu)), _ms(min(timing.cpu)),
            _ms(median(timing.wall)), f"{results[0].iou.mean():.3f}", f"{0.1 * off:.1f}",
        ])  # fmt: skip
        split = typical([result.seconds for result in results])
        stages.append([clip.name, *map(_ms, split.values())])
    columns = ["CPU median, ms", "CPU least, ms", "wall median, ms", "IOU", "ADD, % of diameter"]
    how = (
        f"{len(made[0][0])} frames, {results[0].options['inits']} initial poses, all three terms, {REPEATS} runs "
        "after one to warm up"
    )
    return {
        "reconstruct-speed": of_cells("Time of a reconstruction", ["clip", "faces", *columns], times, [how]),
        "reconstruct-speed-stages": of_cells(
            "Time of a reconstruction by stage, median CPU ms", ["clip", *split], stages, [how]
        ),
        "reconstruct-speed-process": _fresh(*made[0]),
    }


def reconstruction(
    clip: Clip, masks: Masks, options: Options = DEFAULT, threads: int = 1
) -> Callable[[], Reconstruction]:
    """Return a call that reconstructs a newly read clip, whose mesh has no cached tables.

    The ``seconds`` of its results are processor time.
    """

    def call() -> Reconstruction:
        marks = [("start", time.process_time())]
        new = replace(clip, mesh=Mesh(clip.mesh.vertices, clip.mesh.faces))
        result = reconstruct(new, masks, options, lambda stage, _: marks.append((stage, time.process_time())), threads)
        return replace(result, seconds={stage: now - before for (_, before), (stage, now) in pairwise(marks)})

    return call


def _fresh(clip: Clip, masks: Masks) -> Table:
    """Start a process twice: with an empty cache of kernels, then with the filled one."""
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = write_clip(clip, masks, Path(scratch) / "clip")
        environment = os.environ | {"NUMBA_CACHE_DIR": str(Path(scratch) / "cache")}
        for name in ("kernels compiled", "kernels from the cache"):
            timing, (measured,) = timed(lambda: in_fresh_process(folder, environment))
            seconds = [timing.wall[0], *(measured[key] for key in ("imports", "read", "first", "second"))]
            memory = [measured[key] for key in ("memory imports", "memory read", "memory")]
            rows.append([name, *(f"{s:.2f}" for s in seconds), *(f"{m:.0f}" for m in memory)])
    header = ["", "process, wall s", "imports, CPU s", "reading, CPU s", "1st reconstruction, CPU s", "2nd, CPU s"]
    header += ["peak memory after imports, MB", "after reading, MB", "at the end, MB"]
    return of_cells("A fresh process", header, rows, [f"on {clip.name}"])


def in_fresh_process(folder: Path, environment: Mapping[str, str] = os.environ) -> dict[str, float]:
    """Measure a clip's reconstruction in a new process (``benchmarks.fresh``)."""
    command = [sys.executable, "-m", "benchmarks.fresh", str(folder)]
    found = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
    return dict(json.loads(found))


def two_threads() -> dict[str, Table]:
    """Measure the gain from a second thread for a single clip, with one and two threads in turn."""
    rows = []
    for category, seed in CLIPS:
        clip, masks = synthesise(category, seed)
        calls = [reconstruction(clip, masks, threads=threads) for threads in (1, 2)]
        same = np.array_equal(*(call().T_hand_obj for call in calls))
        one, two = zip(*([timed(call)[0].wall[0] for call in calls] for _ in range(IN_TURN)), strict=True)
        ratio = median(b / a for a, b in zip(one, two, strict=True))
        times = [_ms(median(wall)) for wall in (one, two)]
        rows.append([clip.name, *times, f"{ratio:.2f}", "yes" if same else "no"])
    header = ["clip", "one thread, wall ms", "two, wall ms", "ratio", "the same to the bit"]
    return {"two-threads": of_cells("Two threads for one clip", header, rows)}


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.0f}"
