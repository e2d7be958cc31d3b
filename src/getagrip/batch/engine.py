"""The batch engine: tasks that several drivers share through a ledger, done in this process or by an executor.

What a task is and what its work returns is the caller's: clips to reconstruct, parts of a dataset to import.
"""

from __future__ import annotations

import hashlib
import sys
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

from getagrip.batch.executor import FinishedJob, Start, run_in_sequence, run_on_executor
from getagrip.batch.job import NO_LIMITS, Limits
from getagrip.batch.ledger import Ledger, LedgerEntry
from getagrip.io import files, plugins
from getagrip.io.terminal import NullOutput, print_note, show_stage

if TYPE_CHECKING:
    from rich.progress import Progress


PROGRESS_LINE_INTERVAL_S = 60.0
"""Seconds between lines where there is no terminal to move a bar on."""


class NamedTask(Protocol):
    """A task: a frozen dataclass that can be sent to another process."""

    @property
    def name(self) -> str:
        """Its key in the ledger."""
        ...


J = TypeVar("J", bound=NamedTask)
R = TypeVar("R")


@dataclass(frozen=True)
class Engine(Generic[J, R]):
    """How to do the tasks of one call."""

    work: Callable[[J], R]
    """In whatever process; raises nothing."""
    lost: Callable[[J, str], R]
    """Makes the outcome of a task that no process could do, from the reason."""
    entry: Callable[[R], LedgerEntry]
    """Makes the ledger's entry: state, why, inputs and about."""
    options: object
    """Everything besides inputs and code that the work depends on: anything that JSON can hold."""
    executor: Start[J, R] | None = None
    """Who does it; None: this process."""
    limits: Limits = NO_LIMITS
    """Limits for an executor."""
    prepare: Callable[[], object] | None = None
    """Called by each process of an executor before it does anything."""
    in_this: Callable[[J], R] | None = None
    """The work as it is done in this process, where that differs."""

    def run(self, tasks: Iterable[J], ledger: Ledger) -> Generator[R, None, None]:
        """Yield the outcome of each task, as they end; one that another driver does is waited for.

        Raises ``GetagripError`` where the ledger cannot be written any more. Tasks at work are finished first.
        """
        digest = hashlib.sha256(files.to_json({"options": self.options}).encode()).hexdigest()
        failed_elsewhere = deque[R]()
        claims = self._claims(tasks, ledger, digest, failed_elsewhere)
        if self.executor is None:
            ends = run_in_sequence(self.in_this or self.work, claims)
        else:
            ends = run_on_executor(self.executor(self.work, self.limits, self.prepare), claims, self.limits)
        with closing(ends):
            for ended in ends:
                result = self._result(ended)
                self._note(ended, result, ledger, digest)
                yield result
                while failed_elsewhere:
                    yield failed_elsewhere.popleft()
        yield from failed_elsewhere

    def _claims(
        self, tasks: Iterable[J], ledger: Ledger, digest: str, failed_elsewhere: deque[R]
    ) -> Iterator[J | None]:
        """Claim tasks one by one, as they are asked for; yield None while another driver does all that is left."""
        waiting = deque[J]()
        for task in tasks:
            yield from self._claimed(task, ledger, digest, failed_elsewhere, waiting)
        while waiting:
            for _ in range(len(waiting)):
                yield from self._claimed(waiting.popleft(), ledger, digest, failed_elsewhere, waiting)
            if waiting:
                yield None

    def _claimed(
        self, task: J, ledger: Ledger, digest: str, failed_elsewhere: deque[R], waiting: deque[J]
    ) -> Iterator[J]:
        """Claim a task; else wait for it, or pass it over where it has failed elsewhere."""
        entry = ledger.claim(task.name, digest, plugins.fingerprint_with_plugins())
        if entry is None:
            waiting.append(task)
        elif entry.state == "failed":
            failed_elsewhere.append(self.lost(task, entry.why))
        else:
            yield task

    def _result(self, ended: FinishedJob[J, R]) -> R:
        return self.lost(ended.job, ended.why) if ended.why or ended.result is None else ended.result

    def _note(self, ended: FinishedJob[J, R], result: R, ledger: Ledger, digest: str) -> None:
        """Write into the ledger what has become of a task."""
        entry = replace(
            self.entry(result), name=ended.job.name, options=digest, code=plugins.fingerprint_with_plugins()
        )
        if entry.state != "kept":
            worker = f"{ended.machine}:{ended.process}"
            entry = replace(entry, worker=worker, attempts=ended.attempts, seconds=ended.seconds)
        ledger.end(entry)


class BatchProgress:
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
        if self._bar.disable and now - self._said > PROGRESS_LINE_INTERVAL_S and not isinstance(sys.stdout, NullOutput):
            self._said = now
            print_note(said)

    def __str__(self) -> str:
        """Write the pace; kept results took no time and count neither for the pace nor for what is left to do."""
        minutes = max(time.monotonic() - self._since, 1e-9) / 60.0
        pace = self._worked / minutes
        left = f", {_duration((self._total - self._ended) / pace)} left" if self._worked else ""
        return f"{pace:.1f} a minute{left}, {self._failed} failed"


def _duration(minutes: float) -> str:
    """Write a time in minutes, or in hours where it is long."""
    return f"{minutes:.0f} min" if minutes < 100 else f"{minutes / 60.0:.1f} h"


def run_with_stage_bar(bar: Progress, work: Callable[..., R], job: NamedTask) -> R:
    """Do the work on a clip in this process, with a progress bar."""
    stage = bar.add_task("", total=1.0)
    try:
        return work(job, partial(show_stage, bar, stage, job.name))
    finally:
        bar.remove_task(stage)
