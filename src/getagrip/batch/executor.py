"""The executor's interface: processes on this machine or those of a cluster; and jobs on one, or in this process."""

from __future__ import annotations

import os
import socket
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Generic, Protocol, TypeVar

from getagrip.batch.limits import NO_LIMITS, Limits
from getagrip.batch.share import MAX_IN_PROCESS_TASKS
from getagrip.errors import GetagripError
from getagrip.io import code, plugins

J = TypeVar("J")
R = TypeVar("R")

PROCESS_DIED = "its process died"
MAX_LOST_MACHINES = 4
"""Machines that a cluster may lose under a job before it counts as one whose process dies."""
PROCESS_DIED_TWICE = "its process died twice; out of memory?"
"""The message for a job whose process died, in ``for_each_job``."""
MAX_JOB_ATTEMPTS = 2
"""Number of attempts of a job whose process dies."""
IDLE_POLL_S = 0.5
"""Seconds after which we ask again for jobs, where there were none for the moment."""


@dataclass(frozen=True)
class FinishedJob(Generic[J, R]):
    """A job that needs no more work."""

    job: J
    result: R | None
    """Return value of the work; None where its process died or was ended."""
    why: str = ""
    """Why there is none."""
    seconds: float = 0.0
    """Wall time of the last attempt."""
    attempts: int = 1
    process: int = 0
    machine: str = field(default_factory=socket.gethostname)
    """Host name of the process."""


@dataclass(frozen=True)
class Submitted(Generic[J]):
    """A job that a cluster is to do, or has at work."""

    job: J
    attempt: int
    tries: int = 1
    """Number of times that it was sent: a lost worker or task is no attempt."""


class Executor(Protocol[J, R]):
    """Does jobs, several at once. What the work raises, ``wait`` raises."""

    @property
    def capacity(self) -> int:
        """Number of jobs that can start now."""
        ...

    @property
    def busy(self) -> int:
        """Number of jobs at work."""
        ...

    def submit(self, job: J, attempt: int) -> None:
        """Start attempt ``attempt`` of a job; requires free capacity."""
        ...

    def wait(self, nap: float | None) -> list[FinishedJob[J, R]]:
        """Wait for the jobs that end next; none, when the ``nap`` is over [s] or no job is running.

        ``PROCESS_DIED`` is why a job has ended whose process was lost, maybe by the job's own fault.
        """
        ...

    def close(self) -> None:
        """Let all finish their jobs and go."""
        ...


def check_code(expected: str) -> None:
    """Raise ``GetagripError`` where this machine has another getagrip than the one that gave out the jobs."""
    if plugins.fingerprint_with_plugins() != expected:
        here = f"{code.PACKAGE} on {socket.gethostname()}"
        got = f"getagrip of other code ({plugins.fingerprint_with_plugins()})"
        raise GetagripError(f"{here} must be the same on every machine, {expected} (got {got})")


Start = Callable[[Callable[[J], R], Limits, Callable[[], object] | None], Executor[J, R]]
"""Makes an executor from the work, the limits of a job and the function that each process calls first."""


def available_cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):  # Linux: what a cluster's scheduler leaves us
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def for_each_job(
    work: Callable[[J], R],
    jobs: Sequence[J],
    died: Callable[[J], R],
    ended: Callable[[R], object],
    workers: int | None = None,
    here: Callable[[J], R] | None = None,
) -> list[R]:
    """Return what ``work`` makes of each job, in their order; many are shared out over processes, one for each core.

    ``died`` says what becomes of a job whose process died twice. ``ended`` is called with what comes of each, as they
    finish. ``here`` is the work as it is done in this process, where that differs.
    """
    workers = min(len(jobs), workers or (1 if len(jobs) <= MAX_IN_PROCESS_TASKS else available_cores()))
    ends = run_in_processes(work, jobs, workers) if workers > 1 else ((job, (here or work)(job)) for job in jobs)
    done = dict[int, R]()
    for job, made in ends:
        done[id(job)] = died(job) if made is None else made
        ended(done[id(job)])
    return [done[id(job)] for job in jobs]


def run_in_processes(work: Callable[[J], R], jobs: Iterable[J], workers: int) -> Iterator[tuple[J, R | None]]:
    """Yield each job with the value of ``work``, as they finish; None where the process died twice."""
    from getagrip.batch.processes import Processes

    for ended in run_on_executor(Processes(workers, work, NO_LIMITS, None), jobs):
        yield ended.job, ended.result


def run_in_sequence(work: Callable[[J], R], jobs: Iterable[J | None]) -> Generator[FinishedJob[J, R], None, None]:
    """Yield each job with the value of ``work``, done in this process. None among the jobs: none for the moment."""
    for job in jobs:
        if job is None:
            time.sleep(IDLE_POLL_S)
            continue
        since = time.monotonic()
        yield FinishedJob(job, work(job), seconds=time.monotonic() - since, process=os.getpid())


def run_on_executor(
    executor: Executor[J, R], jobs: Iterable[J | None], limits: Limits = NO_LIMITS
) -> Generator[FinishedJob[J, R], None, None]:
    """Yield each job as it ends, done by an executor within limits; the executor is closed in the end.

    A job is taken from ``jobs`` when there is room for it, not before; None among them: none for the moment. A job
    whose process dies is tried once more when all others have ended, alone: nothing else takes its memory then. An
    interrupt lets the jobs at work finish. What the work raises is raised.
    """
    source, again = iter(jobs), deque[J]()
    more = True
    try:
        while more or executor.busy or again:
            nap = None
            while more and not nap and executor.capacity > 0:
                try:
                    job = next(source)
                except StopIteration:
                    more = False
                    break
                if job is None:
                    nap = IDLE_POLL_S
                else:
                    executor.submit(job, 1)
            if again and not more and not executor.busy:
                executor.submit(again.popleft(), MAX_JOB_ATTEMPTS)
            for ended in executor.wait(nap):
                if ended.why != PROCESS_DIED:
                    yield ended
                elif ended.attempts < MAX_JOB_ATTEMPTS:
                    again.append(ended.job)
                else:
                    yield replace(ended, why=f"its process died twice; {limits.suspicion}")
    finally:
        executor.close()
