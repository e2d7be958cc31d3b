"""The batch engine: run tasks that several drivers share through a ledger, in this process or on an executor.

Callers define the tasks and their results: clips to reconstruct, parts of a dataset to import.
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
from itertools import count
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

from getagrip.batch.executor import FinishedJob, Start, run_in_sequence, run_on_executor
from getagrip.batch.ledger import Ledger, LedgerEntry
from getagrip.batch.scheduling import NO_LIMITS, Limits
from getagrip.io import files, plugins
from getagrip.io.terminal import NullOutput, print_note, show_stage

if TYPE_CHECKING:
    from rich.progress import Progress

PROGRESS_LINE_INTERVAL_S = 60.0
"""Interval between progress lines without a terminal."""


class NamedTask(Protocol):
    """A task: a frozen dataclass that can be pickled."""

    @property
    def name(self) -> str:
        """Key in the ledger."""
        ...


J = TypeVar("J", bound=NamedTask)
R = TypeVar("R")


@dataclass(frozen=True)
class Engine(Generic[J, R]):
    """The work of one call's tasks, and where it runs."""

    work: Callable[[J], R]
    """Does a task, in any process; raises nothing."""
    lost: Callable[[J, str], R]
    """Makes the outcome of a task whose process died or was killed, from the reason."""
    entry: Callable[[R], LedgerEntry]
    """Makes the ledger's entry from an outcome: state, why, inputs and about."""
    options: object
    """Everything besides inputs and code that the work depends on, as JSON values."""
    executor: Start[J, R] | None = None
    """Start of the executor; None: this process."""
    limits: Limits = NO_LIMITS
    """Limits for an executor's jobs."""
    prepare: Callable[[], object] | None = None
    """Called first by each process of an executor."""
    in_this: Callable[[J], R] | None = None
    """Replaces ``work`` in this process."""

    def run(self, tasks: Iterable[J], ledger: Ledger) -> Generator[R, None, None]:
        """Yield the outcome of each task as they end, including tasks of other drivers.

        Raises ``GetagripError`` where the ledger cannot be written any more, after the running tasks have ended.
        """
        digest = hashlib.sha256(files.to_json({"options": self.options}).encode()).hexdigest()
        failures_of_others = deque[R]()
        claims = self._claims(tasks, ledger, digest, failures_of_others)
        if self.executor is None:
            ends = run_in_sequence(self.in_this or self.work, claims)
        else:
            ends = run_on_executor(self.executor(self.work, self.limits, self.prepare), claims, self.limits)
        with closing(ends):
            for ended in ends:
                result = self.lost(ended.job, ended.why) if ended.why or ended.result is None else ended.result
                self._write_entry(ended, result, ledger, digest)
                yield result
                while failures_of_others:
                    yield failures_of_others.popleft()
        yield from failures_of_others

    def _claims(
        self, tasks: Iterable[J], ledger: Ledger, digest: str, failures_of_others: deque[R]
    ) -> Iterator[J | None]:
        """Claim tasks one by one, on demand; yield None while other drivers do all tasks left.

        Tasks that failed under another driver are not claimed: their outcomes go to ``failures_of_others``.
        """
        code = plugins.fingerprint_with_plugins()
        for claim_round in count():
            waiting = list[J]()
            for task in tasks:
                entry = ledger.claim(task.name, digest, code)
                if entry is None:
                    waiting.append(task)
                elif entry.state == "failed":
                    failures_of_others.append(self.lost(task, entry.why))
                else:
                    yield task
            if not waiting:
                return
            if claim_round > 0:
                yield None
            tasks = waiting

    def _write_entry(self, ended: FinishedJob[J, R], result: R, ledger: Ledger, digest: str) -> None:
        code = plugins.fingerprint_with_plugins()
        entry = replace(self.entry(result), name=ended.job.name, options=digest, code=code)
        if entry.state != "kept":
            worker = f"{ended.machine}:{ended.process}"
            entry = replace(entry, worker=worker, attempts=ended.attempts, seconds=ended.seconds)
        ledger.end(entry)


class BatchProgress:
    """Counts finished tasks, shown on a bar or as a line a minute."""

    def __init__(self, bar: Progress, tasks: str, total: int) -> None:
        """Show the progress of ``total`` tasks on a bar; ``tasks`` is their plural name."""
        self._bar, self._tasks, self._total = bar, tasks, total
        self._task = bar.add_task(f"0 of {total} {tasks}", total=total, visible=total > 1)
        self._since = self._said = time.monotonic()
        self._ended = self._worked = self._failed = 0

    def count(self, state: str) -> None:
        """Count a task that ended as ``done``, ``kept`` or ``failed``."""
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
        """Format throughput and time left; reused results are excluded from both."""
        pace = self._worked / (max(time.monotonic() - self._since, 1e-9) / 60.0)
        left = ""
        if self._worked:
            minutes = (self._total - self._ended) / pace
            left = f", {minutes:.0f} min left" if minutes < 100 else f", {minutes / 60.0:.1f} h left"
        return f"{pace:.1f} a minute{left}, {self._failed} failed"


def run_with_stage_bar(bar: Progress, work: Callable[..., R], job: NamedTask) -> R:
    """Run the work on a clip in this process, with a progress bar of its stages."""
    stage = bar.add_task("", total=1.0)
    try:
        return work(job, partial(show_stage, bar, stage, job.name))
    finally:
        bar.remove_task(stage)
