"""How a batch gets on: tasks per minute, the time left, failures so far."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

from getagrip.io.terminal import Silence, report

if TYPE_CHECKING:
    from rich.progress import Progress

EVERY = 60.0
"""Seconds between lines where there is no terminal to move a bar on."""


class Pace:
    """Counts tasks, and shows it: on a bar, or as a line a minute."""

    def __init__(self, bar: Progress, tasks: str, total: int) -> None:
        """``tasks`` what they are called, in the plural."""
        self._bar, self._tasks, self._total = bar, tasks, total
        self._task = bar.add_task(f"0 of {total} {tasks}", total=total, visible=total > 1)
        self._since = self._said = time.monotonic()
        self._ended = self._worked = self._failed = 0

    def count(self, state: str) -> None:
        """Count a task that has ended as ``done``, ``kept`` or ``failed``."""
        self._ended += 1
        self._worked += state != "kept"
        self._failed += state == "failed"
        said = f"{self._ended} of {self._total} {self._tasks}, {self}"
        self._bar.update(self._task, completed=self._ended, description=said)
        now = time.monotonic()
        if self._bar.disable and now - self._said > EVERY and not isinstance(sys.stdout, Silence):
            self._said = now
            report(said)

    def __str__(self) -> str:
        """Write the pace; kept results took no time and count neither for the pace nor for what is left to do."""
        minutes = max(time.monotonic() - self._since, 1e-9) / 60.0
        pace = self._worked / minutes
        left = f", {_duration((self._total - self._ended) / pace)} left" if self._worked else ""
        return f"{pace:.1f} a minute{left}, {self._failed} failed"


def _duration(minutes: float) -> str:
    """Write a time in minutes, or in hours where it is long."""
    return f"{minutes:.0f} min" if minutes < 100 else f"{minutes / 60.0:.1f} h"
