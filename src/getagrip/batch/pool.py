"""Jobs over processes, one thread in each; a process that dies takes no other job with it."""

from __future__ import annotations

import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context, parent_process
from typing import TypeVar

J = TypeVar("J")
R = TypeVar("R")

DIED = "its process died twice; out of memory?"
"""The message for a job for which ``in_processes`` gives None."""
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):  # Linux: what a cluster's scheduler leaves us
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def in_processes(work: Callable[[J], R], jobs: Iterable[J], workers: int) -> Iterator[tuple[J, R | None]]:
    """Each job with what ``work`` returns for it, as they finish; None where the process died twice.

    When a process dies, Python gives up the whole pool. The jobs that were at work then are done again one at a time,
    each in a process of its own, to find the culprit. An interrupt lets the jobs at work finish.
    """
    waiting, suspects = deque(jobs), deque[J]()
    with _one_thread_each():
        while waiting:
            yield from _until_broken(work, waiting, workers, suspects)
        while suspects:
            alone, dead = deque([suspects.popleft()]), deque[J]()
            yield from _until_broken(work, alone, 1, dead)
            for job in dead:
                yield job, None


def _until_broken(work: Callable[[J], R], waiting: deque[J], workers: int, suspects: deque[J]) -> Iterator[tuple[J, R]]:
    """Work off the waiting jobs in one pool, until none is left or a process dies."""
    running: dict[Future[R], J] = {}
    spawn = get_context("spawn")  # forked threads and locks of numerical libraries hang
    with ProcessPoolExecutor(min(workers, len(waiting)), spawn, initializer=_settle_in) as pool:
        while waiting or running:
            try:
                while waiting and len(running) < workers:
                    running[pool.submit(work, waiting[0])] = waiting[0]
                    waiting.popleft()
            except BrokenProcessPool:
                suspects.extend(running.values())
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                job = running.pop(future)
                if isinstance(future.exception(), BrokenProcessPool):
                    suspects.extend([job, *running.values()])
                    return
                yield job, future.result()


def _settle_in() -> None:
    """Leave Ctrl-C to the parent, which hands out no more jobs, and end when the parent is killed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A pool that closes ends its processes, but a parent that is killed closes nothing."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Have processes that start meanwhile run numba and BLAS on one thread: they read it when they load."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
