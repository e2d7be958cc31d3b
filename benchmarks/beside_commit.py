"""The same clips by the code of an earlier commit and by this one, in turn: processor time as a whole and by stage."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.page import table

BEFORE = "9336a75"
"""The last commit before clips were made cheaper."""
REPEATS = 7
ROOT = Path(__file__).resolve().parents[1]
CHILD = """
import json, sys, time
from benchmarks.problem import CLIPS, make
from getagrip.fitting.reconstruct import reconstruct

problems = [make(*clip) for clip in CLIPS]
for problem in problems:
    reconstruct(problem.clip, problem.masks)
print(flush=True)  # all is compiled
for _ in sys.stdin:
    found = {}
    for problem in problems:
        spent, since = {}, time.process_time()

        def on_stage(stage, _):
            spent[stage] = time.process_time() - sum(spent.values()) - since

        result = reconstruct(problem.clip, problem.masks, progress=on_stage)
        found[problem.clip.name] = {"stages": spent, "iou": result.mean_iou, "off": problem.add(result.T_hand_obj)}
    print(json.dumps(found), flush=True)
"""
Runs = list[dict[str, dict[str, Any]]]


def section() -> str:
    """Measure; the section's text."""
    with tempfile.TemporaryDirectory() as scratch:
        archive = subprocess.run(
            ["git", "archive", BEFORE, "src", "benchmarks"], cwd=ROOT, capture_output=True, check=True
        )
        subprocess.run(["tar", "-x", "-C", scratch], input=archive.stdout, check=True)
        children = [_child(Path(scratch)), _child(ROOT)]
        runs: tuple[Runs, Runs] = [], []
        for _ in range(REPEATS):
            for child, found in zip(children, runs, strict=True):
                found.append(_next(child))
        for child in children:
            child.communicate()
    clips = [[clip, *_row(runs, clip)] for clip in runs[0][0]]
    stages = [[stage, *_times(runs, stage)] for stage in next(iter(runs[1][0].values()))["stages"]]
    head = ["IOU then", "IOU now", "ADD then, % of diameter", "now"]
    return "\n\n".join([
        f"Median processor time of {REPEATS} runs, in turn with those of commit {BEFORE}:",
        table(["clip", "then, ms", "now, ms", "ratio", *head], clips),
        "The same by stage, all clips together:",
        table(["stage", "then, ms", "now, ms", "ratio"], stages),
    ])  # fmt: skip


def _child(root: Path) -> subprocess.Popen[str]:
    """A process that runs the code below ``root``, ready."""
    environment = os.environ | {"PYTHONPATH": f"{root / 'src'}{os.pathsep}{root}"}
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
        cwd=root,
    )
    assert child.stdout is not None
    child.stdout.readline()
    return child


def _next(child: subprocess.Popen[str]) -> dict[str, dict[str, Any]]:
    """What a process finds, and how long it takes, once more."""
    assert child.stdin is not None
    assert child.stdout is not None
    child.stdin.write("\n")
    child.stdin.flush()
    found: dict[str, dict[str, Any]] = json.loads(child.stdout.readline())
    return found


def _row(runs: tuple[Runs, Runs], clip: str) -> list[str]:
    """Of a clip."""
    then, now = ([sum(run[clip]["stages"].values()) for run in found] for found in runs)
    (before, *_), (after, *_) = runs
    quality = [before[clip]["iou"], after[clip]["iou"], 100.0 * before[clip]["off"], 100.0 * after[clip]["off"]]
    return [
        *_compared(then, now),
        *(f"{value:.{digits}f}" for value, digits in zip(quality, (3, 3, 1, 1), strict=True)),
    ]


def _times(runs: tuple[Runs, Runs], stage: str) -> list[str]:
    """Of a stage."""
    then, now = ([sum(clip["stages"].get(stage, 0.0) for clip in run.values()) for run in found] for found in runs)
    return _compared(then, now)


def _compared(then: list[float], now: list[float]) -> list[str]:
    """Medians, and the median ratio of runs that followed one another."""
    ratio = median(b / max(a, 1e-9) for a, b in zip(then, now, strict=True))
    return [f"{1e3 * median(then):.0f}", f"{1e3 * median(now):.0f}", f"{ratio:.2f}"]
