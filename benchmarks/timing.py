"""How long a call takes: repeated, in wall-clock and in processor time."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from typing import TypeVar

T = TypeVar("T")


@dataclass(frozen=True)
class Timing:
    """Seconds of each repetition. On a busy machine wall time is longer than processor time; two threads would make
    processor time the longer."""

    wall: list[float]
    cpu: list[float]

    def __add__(self, other: Timing) -> Timing:
        return Timing(self.wall + other.wall, self.cpu + other.cpu)


def timed(call: Callable[[], T], repeats: int = 1) -> tuple[Timing, list[T]]:
    """Time a call, and keep what each repetition returned."""
    wall, cpu, results = [], [], []
    for _ in range(repeats):
        since, spent = time.perf_counter(), time.process_time()
        results.append(call())
        cpu.append(time.process_time() - spent)
        wall.append(time.perf_counter() - since)
    return Timing(wall, cpu), results


def typical(parts: list[dict[str, float]]) -> dict[str, float]:
    """The median of each part over the repetitions."""
    return {name: median(part[name] for part in parts) for name in parts[0]}
