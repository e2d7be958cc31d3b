"""As many clips as the paper has, 2,431, in one run: ``python -m benchmarks.many CLIPS OUT [--write]``.

Synthetic clips are written into CLIPS, those that are not there yet; then ``getagrip reconstruct`` reads them and
writes results into OUT, which must not exist. ``--write`` puts time, memory and files into docs/batch.md.
"""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

from benchmarks import page
from benchmarks.batch import SCENE
from getagrip.batch.pool import cores
from getagrip.clip import write_clip
from getagrip.datasets.synthetic.categories import CATEGORIES
from getagrip.datasets.synthetic.scene import synthesise
from getagrip.result import read_result

CLIPS = 2431
PERIOD = 2.0
"""Seconds between two looks at the memory."""


def made(folder: Path) -> None:
    """Write the clips that are missing; an interrupted run goes on."""
    names = list(CATEGORIES)
    for n in range(CLIPS):
        if not (folder / f"{n:04d}" / "clip.json").exists():
            clip, masks = synthesise(names[n % len(names)], n, SCENE)
            write_clip(clip, masks, folder / f"{n:04d}")


def section(clips: Path, out: Path) -> str:
    """Measure; the section's text."""
    since, most = time.perf_counter(), 0.0
    words = [sys.executable, "-m", "getagrip", "reconstruct", str(clips), "--out", str(out), "--quiet"]
    with subprocess.Popen(words) as run:
        while run.poll() is None:
            time.sleep(PERIOD)
            most = max(most, resident(run.pid))
    minutes = (time.perf_counter() - since) / 60.0
    endings = [read_result(path.parent)[0].status for path in out.glob("*/result.json")]
    failed = sum(status.startswith("failed") for status in endings)
    files = [path for path in out.rglob("*") if path.is_file()]
    rows = [
        ["minutes, reading and writing included", f"{minutes:.1f}"],
        ["clips a minute", f"{CLIPS / minutes:.0f}"],
        ["memory of all its processes together, at most, MB", f"{most:.0f}"],
        ["results", f"{len(endings)}"],
        ["of these failed", f"{failed}"],
        ["files written", f"{len(files)}"],
        ["bytes written, MB", f"{sum(path.stat().st_size for path in files) / 1e6:.0f}"],
        ["exit status", f"{run.returncode}"],
    ]
    title = f"{CLIPS} clips of {SCENE.frames} frames, {SCENE.size[0]} x {SCENE.size[1]}, {cores()} workers"
    return page.table([title, ""], rows)


def resident(pid: int) -> float:
    """Memory of a process and of those that it has started, what they share counted once [MB]; Linux."""
    total = 0.0
    for each in (pid, *_descendants(pid)):
        try:
            for line in Path(f"/proc/{each}/smaps_rollup").read_text(encoding="utf-8").splitlines():
                if line.startswith("Pss:"):
                    total += int(line.split()[1]) * 1024 / 1e6
        except (OSError, ProcessLookupError):
            continue  # it has ended meanwhile
    return total


def _descendants(pid: int) -> list[int]:
    """Processes that a process has started, and theirs."""
    found: list[int] = []
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            children = [int(word) for word in task.read_text(encoding="utf-8").split()]
        except OSError:
            continue
        for child in children:
            found += [child, *_descendants(child)]
    return found


if __name__ == "__main__":
    clips, out = map(Path, sys.argv[1:3])
    if out.exists():
        sys.exit(f"{out}: there already, expected a new folder")
    made(clips)
    before = page.circumstances()
    text = section(clips, out)
    print(f"{before}\n\n{text}")
    if "--write" in sys.argv[3:]:
        page.write("many", f"{before}\n\n{text}")
