"""What a batch's driver does for each clip, measured without any clip: ledger, Ray, listing (``benchmarks.scale``)."""

from __future__ import annotations

import os
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from getagrip.batch.crew import Ended
from getagrip.batch.engine import Engine
from getagrip.batch.entries import Entry
from getagrip.batch.ledger import Ledger
from getagrip.batch.limits import NONE
from getagrip.batch.on_ray import RayCrew
from getagrip.batch.pool import shared_out
from getagrip.io.storage import Remote

TASKS, FOLDERS = 1500, 1500


def ledger_cost(folder: Path) -> dict[str, float]:
    """Processor seconds and bytes of a claim and an entry."""
    engine = Engine(work=_named, lost=lambda task, why: task, entry=_entry, options=None, crew=_Instant)
    with Ledger(folder / "ledger") as ledger:
        since = time.process_time()
        for _ in engine.run(map(_Named, range(TASKS)), ledger):
            pass
        took = time.process_time() - since
    # closed, so that the log of changes is in the file
    return {"seconds": took / TASKS, "bytes": (folder / "ledger" / "ledger.sqlite").stat().st_size / TASKS}


def ray_cost() -> dict[str, float]:
    """Processor seconds of the driver for a Ray task that does nothing, and tasks a second."""
    crew = RayCrew(os.cpu_count(), None, _named, NONE, None)
    ends = shared_out(crew, map(_Named, range(TASKS + 100)))
    for _ in range(100):  # workers start
        next(ends)
    since, wall = time.process_time(), time.perf_counter()
    for _ in range(TASKS):
        next(ends)
    took, passed = time.process_time() - since, time.perf_counter() - wall
    ends.close()
    return {"seconds": took / TASKS, "tasks a second": TASKS / passed}


def listing_cost() -> dict[str, float]:
    """Processor seconds and memory of a folder among many that are listed."""
    there = Remote("s3://bucket/many")
    for n in range(FOLDERS):
        (there / f"clip-{n:06d}" / "clip.json").write(b"{}")
    tracemalloc.start()
    there.children()
    bytes_each = tracemalloc.get_traced_memory()[1] / FOLDERS
    tracemalloc.stop()
    since = time.process_time()
    there.children()
    return {"seconds": (time.process_time() - since) / FOLDERS, "bytes": bytes_each}


class _Instant:
    """A crew that does everything at once."""

    room = 1

    def __init__(self, work: Callable[[Any], Any], *_: Any) -> None:
        self._work, self._done = work, list[Any]()

    @property
    def busy(self) -> int:
        return len(self._done)

    def give(self, job: Any, attempt: int) -> None:
        self._done.append(Ended(job, self._work(job), attempts=attempt))
        self.room = 0

    def wait(self, nap: float | None) -> list[Any]:
        done, self._done, self.room = self._done, [], 1
        return done

    def close(self) -> None:
        pass


@dataclass(frozen=True)
class _Named:
    number: int

    @property
    def name(self) -> str:
        return f"clip-{self.number:07d}"


def _named(task: _Named) -> _Named:
    return task


def _entry(task: _Named) -> Entry:
    """As long as a clip's."""
    return Entry(
        task.name, "done", "converged", inputs="0" * 64, about={"iou": 0.9, "probability_right": 0.9, "findings": []}
    )
