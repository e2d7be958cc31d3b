"""The executor's interface: processes on this machine or those of a cluster; and jobs on one, or in this process.

Processes on this machine that do jobs, one thread in each; one that dies, hangs or grows takes no other along.
"""

from __future__ import annotations

import os
import signal
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection, wait
from typing import Generic, Protocol, TypeVar

from getagrip.batch.job import NO_LIMITS, Limits
from getagrip.batch.scheduling import MAX_IN_PROCESS_TASKS
from getagrip.errors import GetagripError
from getagrip.io import plugins, processes

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
        here = f"{plugins.PACKAGE} on {socket.gethostname()}"
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


THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
MAX_JOBS_PER_PROCESS = 500
"""Number of jobs after which a process is replaced, which frees whatever libraries hold on to."""


class Processes(Generic[J, R]):
    """An executor of processes on this machine: each starts when there is a job for it."""

    def __init__(
        self, workers: int, work: Callable[[J], R], limits: Limits, prepare: Callable[[], object] | None
    ) -> None:
        """Run at most ``workers`` processes. Each calls ``prepare`` first; that counts for no limit."""
        self.workers = workers
        self._start: Callable[[], _WorkerProcess[J, R]] = lambda: _WorkerProcess(work, limits, prepare)
        self._there: list[_WorkerProcess[J, R]] = []

    @property
    def capacity(self) -> int:
        """Number of jobs that can start now."""
        return self.workers - self.busy

    @property
    def busy(self) -> int:
        """Number of jobs at work."""
        return len(self._at_work())

    def submit(self, job: J, attempt: int) -> None:
        """Give a job to an idle process, or to a new one."""
        idle = next((process for process in self._there if not process.busy), None)
        if idle is None:
            idle = self._start()
            self._there.append(idle)
        idle.submit(job, attempt)

    def wait(self, nap: float | None) -> list[FinishedJob[J, R]]:
        """Wait for the jobs that end next; none, when the ``nap`` is over [s] or no job is running."""
        busy = self._at_work()
        until = [left for process in busy if (left := process.time_left()) is not None]
        if busy or nap:
            wait([process.pipe for process in busy], min([*until, *([nap] if nap else [])], default=None))
        ends = [process.ended() for process in busy]
        self._there = [process for process in self._there if not process.gone]
        return [ended for ended in ends if ended is not None]

    def close(self) -> None:
        """Let all finish their jobs and end."""
        for process in self._there:
            process.close()

    def _at_work(self) -> list[_WorkerProcess[J, R]]:
        return [process for process in self._there if process.busy]


class _WorkerProcess(Generic[J, R]):
    """A process that does one job after the other."""

    def __init__(self, work: Callable[[J], R], limits: Limits, prepare: Callable[[], object] | None) -> None:
        spawn = get_context("spawn")  # forked threads and locks of numerical libraries hang
        self.pipe, theirs = spawn.Pipe()
        self.process = spawn.Process(target=_serve_jobs, args=(theirs, work, limits, prepare))
        with _single_thread_environment():
            self.process.start()
        theirs.close()
        self.pid = self.process.pid or 0
        self.limits, self.done = limits, 0
        self.busy = self.ready = self.gone = False
        self.attempt, self.since = 0, 0.0

    def submit(self, job: J, attempt: int) -> None:
        """Have it do a job."""
        self.job, self.attempt, self.since, self.busy = job, attempt, time.monotonic(), True
        with suppress(OSError):  # it has died; ``ended`` will notice
            self.pipe.send(job)

    def time_left(self) -> float | None:
        """Return the seconds until its job has taken too long; None: any."""
        if self.limits.seconds is None or not self.ready:
            return None
        return max(0.0, self.since + self.limits.seconds - time.monotonic())

    def ended(self) -> FinishedJob[J, R] | None:
        """Return the end of its job; None while it is at work. ``gone`` where the process is not there any more."""
        try:
            while self.pipe.poll():
                answer = self.pipe.recv()
                if answer is None:
                    self.ready, self.since = True, time.monotonic()
                    continue
                return self._answered(*answer)
        except (EOFError, OSError):
            self._end()
            return self._lost(PROCESS_DIED)
        if self.time_left() == 0.0:
            self._end()
            return self._lost(self.limits.too_long)
        return None

    def _answered(self, result: R | None, error: Exception | None) -> FinishedJob[J, R]:
        """Return the job's end, as the process has reported it."""
        self.busy, self.done = False, self.done + 1
        if error is not None:
            raise error
        if self.done == MAX_JOBS_PER_PROCESS:
            self.close()
        took = time.monotonic() - self.since
        return FinishedJob(self.job, result, "", took, self.attempt, self.pid)

    def _lost(self, why: str) -> FinishedJob[J, R]:
        self.busy = False
        return FinishedJob(self.job, None, why, time.monotonic() - self.since, self.attempt, self.pid)

    def _end(self) -> None:
        self.process.kill()
        self.close()

    def close(self) -> None:
        """Let it finish its job and end."""
        self.pipe.close()
        self.process.join()
        self.process.close()
        self.gone = True


def _serve_jobs(pipe: Connection, work: Callable[[J], R], limits: Limits, prepare: Callable[[], object] | None) -> None:
    """Do the jobs that come through the pipe, in the process, until it closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # also where signals cannot be blocked
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if prepare is not None:
        prepare()
    limits.enforce()
    try:
        pipe.send(None)
        while True:
            job = pipe.recv()
            try:
                answer: tuple[R | None, Exception | None] = work(job), None
            except Exception as error:
                answer = None, error
            pipe.send(answer)
    except (EOFError, ConnectionError):  # the parent has closed it
        return


def _end_with_parent() -> None:
    """End this process at once when its parent is killed; a parent that closes the pipe ends it between jobs only."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def _single_thread_environment() -> Iterator[None]:
    """Have processes that start meanwhile run numba and BLAS on one thread, and load nothing of the current folder.

    They never hear a Ctrl-C, from their first instruction on: it is left to the parent, which hands out no more jobs.
    """
    changed = dict.fromkeys(THREAD_VARIABLES, "1") | processes.SAFE_PATH_ENVIRONMENT
    before = {name: os.environ.get(name) for name in changed}
    os.environ.update(changed)
    try:
        with _without_interrupts():
            yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def _without_interrupts() -> Iterator[None]:
    """Block the signal of a Ctrl-C in this thread: processes inherit that, and this one hears of it afterwards."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # a process of Python's own, whose start would unblock it
    masked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, masked)
