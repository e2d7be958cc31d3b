"""Jobs over processes, one thread in each; a process that dies, hangs or grows takes no other job with it."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection, wait
from typing import Any, Generic, TypeVar

from getagrip.batch.limits import NONE, Limits

J = TypeVar("J")
R = TypeVar("R")

DIED = "its process died twice; out of memory?"
"""The message for a job for which ``in_processes`` gives None."""
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
DIES = "its process died"
ATTEMPTS = 2
"""Of a job whose process dies."""
JOBS_EACH = 500
"""A process is replaced after so many jobs: whatever libraries hold on to goes with it."""
END: Any = object()
"""Of the jobs."""
NAP = 0.5
"""Seconds after which we ask again for jobs, where there were none for the moment."""


@dataclass(frozen=True)
class Ended(Generic[J, R]):
    """A job that needs no more work."""

    job: J
    result: R | None
    """What the work returned; None where its process died or was ended."""
    why: str = ""
    """Why there is none."""
    seconds: float = 0.0
    """Wall time of the last attempt."""
    attempts: int = 1
    process: int = 0


def cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):  # Linux: what a cluster's scheduler leaves us
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def in_processes(work: Callable[[J], R], jobs: Iterable[J], workers: int) -> Iterator[tuple[J, R | None]]:
    """Each job with what ``work`` returns for it, as they finish; None where the process died twice."""
    for ended in shared_out(work, jobs, workers):
        yield ended.job, ended.result


def in_turn(work: Callable[[J], R], jobs: Iterable[J | None]) -> Generator[Ended[J, R], None, None]:
    """Each job with what ``work`` returns for it, done in this process. None among the jobs: none for the moment."""
    for job in jobs:
        if job is None:
            time.sleep(NAP)
            continue
        since = time.monotonic()
        yield Ended(job, work(job), seconds=time.monotonic() - since, process=os.getpid())


def shared_out(
    work: Callable[[J], R],
    jobs: Iterable[J | None],
    workers: int,
    limits: Limits = NONE,
    prepare: Callable[[], Any] | None = None,
) -> Generator[Ended[J, R], None, None]:
    """Each job as it ends, done by at most so many processes at once.

    A job is taken from ``jobs`` when a process is free for it, not before; None among them: none for the moment. Each
    process calls ``prepare`` first; that counts for no limit. A job whose process dies is tried once more when all
    others have ended, alone: nothing else takes its memory then. An interrupt lets the jobs at work finish. What
    ``work`` raises is raised.
    """
    crew = _Crew(workers, lambda: _Process(work, limits, prepare))
    source, again = iter(jobs), deque[J]()
    more = True
    try:
        while more or crew.busy or again:
            nap = None
            while more and not nap and len(crew.busy) < workers:
                job = next(source, END)
                if job is END:
                    more = False
                elif job is None:
                    nap = NAP
                else:
                    crew.give(job, 1)
            if again and not more and not crew.busy:
                crew.give(again.popleft(), ATTEMPTS)
            for ended in crew.wait(nap):
                if ended.why != DIES:
                    yield ended
                elif ended.attempts < ATTEMPTS:
                    again.append(ended.job)
                else:
                    yield replace(ended, why=f"its process died twice; {limits.suspicion}")
    finally:
        crew.close()


class _Crew(Generic[J, R]):
    """The processes of a call: each starts when there is a job for it."""

    def __init__(self, workers: int, start: Callable[[], _Process[J, R]]) -> None:
        self.workers, self.start = workers, start
        self.there: list[_Process[J, R]] = []

    @property
    def busy(self) -> list[_Process[J, R]]:
        """Those at work."""
        return [process for process in self.there if process.busy]

    def give(self, job: J, attempt: int) -> None:
        """Give a job to an idle process, or to a new one."""
        idle = next((process for process in self.there if not process.busy), None)
        if idle is None:
            idle = self.start()
            self.there.append(idle)
        idle.give(job, attempt)

    def wait(self, nap: float | None) -> list[Ended[J, R]]:
        """The jobs that end next; maybe none, when the ``nap`` is over [s] or nobody is at work."""
        busy = self.busy
        until = [left for process in busy if (left := process.time_left()) is not None]
        if busy or nap:
            wait([process.pipe for process in busy], min([*until, *([nap] if nap else [])], default=None))
        ends = [process.ended() for process in busy]
        self.there = [process for process in self.there if not process.gone]
        return [ended for ended in ends if ended is not None]

    def close(self) -> None:
        """Let all finish their jobs and end."""
        for process in self.there:
            process.close()


class _Process(Generic[J, R]):
    """A process that does one job after the other."""

    def __init__(self, work: Callable[[J], R], limits: Limits, prepare: Callable[[], Any] | None) -> None:
        spawn = get_context("spawn")  # forked threads and locks of numerical libraries hang
        self.pipe, theirs = spawn.Pipe()
        self.process = spawn.Process(target=_serve, args=(theirs, work, limits, prepare))
        with _one_thread_each():
            self.process.start()
        theirs.close()
        self.pid = self.process.pid or 0
        self.limits, self.done = limits, 0
        self.busy = self.ready = self.gone = False
        self.attempt, self.since = 0, 0.0

    def give(self, job: J, attempt: int) -> None:
        """Have it do a job."""
        self.job, self.attempt, self.since, self.busy = job, attempt, time.monotonic(), True
        with suppress(OSError):  # it has died; ``ended`` will notice
            self.pipe.send(job)

    def time_left(self) -> float | None:
        """Seconds until its job has taken too long; None: any."""
        if self.limits.seconds is None or not self.ready:
            return None
        return max(0.0, self.since + self.limits.seconds - time.monotonic())

    def ended(self) -> Ended[J, R] | None:
        """What has become of its job; None while it is at work. ``gone`` where the process is not there any more."""
        try:
            while self.pipe.poll():
                answer = self.pipe.recv()
                if answer is None:
                    self.ready, self.since = True, time.monotonic()
                    continue
                return self._answered(*answer)
        except (EOFError, OSError):
            self._end()
            return self._lost(DIES)
        if self.time_left() == 0.0:
            self._end()
            return self._lost(self.limits.too_long)
        return None

    def _answered(self, good: bool, value: Any) -> Ended[J, R]:
        """The job's end, as the process has said it."""
        self.busy, self.done = False, self.done + 1
        if not good:
            raise value
        if self.done == JOBS_EACH:
            self.close()
        took = time.monotonic() - self.since
        return Ended(self.job, value, "", took, self.attempt, self.pid)

    def _lost(self, why: str) -> Ended[J, R]:
        """The job's end, where the process is gone."""
        self.busy = False
        return Ended(self.job, None, why, time.monotonic() - self.since, self.attempt, self.pid)

    def _end(self) -> None:
        """End it at once."""
        self.process.kill()
        self.close()

    def close(self) -> None:
        """Let it finish its job and end."""
        self.pipe.close()
        self.process.join()
        self.process.close()
        self.gone = True


def _serve(pipe: Connection, work: Callable[[J], R], limits: Limits, prepare: Callable[[], Any] | None) -> None:
    """Runs in the process: do the jobs that come through the pipe, until it closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is left to the parent, which hands out no more jobs
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if prepare is not None:
        prepare()
    limits.enforce()
    try:
        pipe.send(None)
        while True:
            job = pipe.recv()
            try:
                answer: tuple[bool, Any] = True, work(job)
            except Exception as error:
                answer = False, error
            pipe.send(answer)
    except (EOFError, ConnectionError):  # the parent has closed it
        return


def _end_with_parent() -> None:
    """A parent that closes the pipe ends its processes, but only between jobs: one that is killed ends them at once."""
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
