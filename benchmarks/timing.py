"""Measure wall and CPU time of repeated calls, and describe the machine."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from statistics import median
from typing import TypeVar

from getagrip.io.plugins import date_and_commit

LIBRARIES = ("numpy", "numba", "scipy")

T = TypeVar("T")


@dataclass(frozen=True)
class Timing:
    """Seconds of each repetition. On a busy machine wall time is the longer, with two threads processor time."""

    wall: list[float]
    cpu: list[float]


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
    """Return the median of each part over the repetitions."""
    return {name: median(part[name] for part in parts) for name in parts[0]}


def machine() -> str:
    """Describe the processor of this machine and its number of cores."""
    about = Path("/proc/cpuinfo")  # Linux
    lines = about.read_text(encoding="utf-8").splitlines() if about.exists() else []
    names = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
    return f"{(names or [platform.machine()])[0]}, {os.cpu_count()} cores"


def circumstances(command: str) -> dict[str, str]:
    """Describe a measurement before it starts: date, code, machine and load."""
    day, _, commit = date_and_commit().partition(", commit ")
    there = {each.name: each.version for each in metadata.distributions()}
    versions = [f"{name} {there[name]}" for name in LIBRARIES if name in there]
    return {
        "date": day,
        "commit": commit,
        "command": command,
        "machine": f"{machine()}, load before the run {os.getloadavg()[0]:.1f}",
        "versions": ", ".join((f"Python {platform.python_version()}", *versions)),
    }
