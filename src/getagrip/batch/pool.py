"""Jobs on an executor, or without one: in turn, in this process."""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import replace
from typing import TypeVar

from getagrip.batch.executor import DIES, Ended, Executor
from getagrip.batch.limits import NONE, Limits
from getagrip.batch.processes import Processes

J = TypeVar("J")
R = TypeVar("R")

DIED = "its process died twice; out of memory?"
"""The message for a job for which ``in_processes`` gives None."""
ATTEMPTS = 2
"""Number of attempts of a job whose process dies."""
NAP = 0.5
"""Seconds after which we ask again for jobs, where there were none for the moment."""


def cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):  # Linux: what a cluster's scheduler leaves us
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def in_processes(work: Callable[[J], R], jobs: Iterable[J], workers: int) -> Iterator[tuple[J, R | None]]:
    """Yield each job with the value of ``work``, as they finish; None where the process died twice."""
    for ended in shared_out(Processes(workers, work, NONE, None), jobs):
        yield ended.job, ended.result


def in_turn(work: Callable[[J], R], jobs: Iterable[J | None]) -> Generator[Ended[J, R], None, None]:
    """Yield each job with the value of ``work``, done in this process. None among the jobs: none for the moment."""
    for job in jobs:
        if job is None:
            time.sleep(NAP)
            continue
        since = time.monotonic()
        yield Ended(job, work(job), seconds=time.monotonic() - since, process=os.getpid())


def shared_out(
    executor: Executor[J, R], jobs: Iterable[J | None], limits: Limits = NONE
) -> Generator[Ended[J, R], None, None]:
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
                    nap = NAP
                else:
                    executor.submit(job, 1)
            if again and not more and not executor.busy:
                executor.submit(again.popleft(), ATTEMPTS)
            for ended in executor.wait(nap):
                if ended.why != DIES:
                    yield ended
                elif ended.attempts < ATTEMPTS:
                    again.append(ended.job)
                else:
                    yield replace(ended, why=f"its process died twice; {limits.suspicion}")
    finally:
        executor.close()
