"""Clips per minute of ``getagrip reconstruct`` including files, and the gain from a second worker.

Each run is the command in a process of its own, so start and imports count.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.store import Table, of_cells
from getagrip.clip import write_clip
from getagrip.synthetic.categories import SYNTHETIC_CATEGORIES
from getagrip.synthetic.scene import synthesise
from getagrip.synthetic.scene_options import SceneOptions

CLIPS = 120
SCENE = SceneOptions(frames=30, size=(854, 480))
RUNS = {
    "one worker": ("--workers", "1"),
    "two workers": ("--workers", "2"),
    "two workers, all done before": ("--workers", "2"),
}


def tables() -> dict[str, Table]:
    """Measure."""
    with tempfile.TemporaryDirectory() as folder:
        clips = Path(folder) / "clips"
        for n in range(CLIPS):
            clip, masks = synthesise(list(SYNTHETIC_CATEGORIES)[n % len(SYNTHETIC_CATEGORIES)], n, SCENE)
            write_clip(clip, masks, clips / str(n))
        _run(clips, Path(folder) / "warm", ("--shard", f"1/{CLIPS}"))  # compiles
        took = {}
        for name, options in RUNS.items():
            took[name] = _run(clips, Path(folder) / options[1], options)
    one, two = took["one worker"], took["two workers"]
    rows = [[name, f"{seconds:.1f}", f"{60.0 * CLIPS / seconds:.0f}"] for name, seconds in took.items()]
    title = f"Clips a minute of reconstruct: {CLIPS} clips of {SCENE.frames} frames, {SCENE.size[0]} x {SCENE.size[1]}"
    notes = [f"efficiency from one worker to two: {one / two / 2.0:.2f}"]
    return {"batch": of_cells(title, ["", "s", "clips/min"], rows, notes)}


def _run(clips: Path, out: Path, options: tuple[str, ...]) -> float:
    """Return the command's wall time [s]."""
    words = [sys.executable, "-m", "getagrip", "reconstruct", str(clips), "--out", str(out), "--quiet", *options]
    since = time.perf_counter()
    subprocess.run(words, check=True, env=os.environ)
    return time.perf_counter() - since
