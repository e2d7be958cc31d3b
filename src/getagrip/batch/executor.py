"""Run jobs in this process, in processes of this machine, or on any other ``Executor``.

Each process uses one thread; a process that dies, hangs or exceeds its memory limit affects only its own job.
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
from typing import Any, Generic, Protocol, TypeVar

from getagrip.batch.scheduling import MAX_IN_PROCESS_TASKS, NO_LIMITS, Limits
from getagrip.errors import GetagripError
from getagrip.io import plugins, processes

J = TypeVar("J")
R = TypeVar("R")

PROCESS_DIED = "its process died"
PROCESS_DIED_TWICE = f"its process died twice; {NO_LIMITS.suspicion}"
MAX_LOST_MACHINES = 4
"""Number of submissions of a job to lost machines after which its process counts as dead."""
MAX_JOB_ATTEMPTS = 2
"""Number of attempts of a job whose process dies."""
IDLE_POLL_S = 0.5
"""Interval between requests for jobs while every job left is claimed by another driver."""
THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
MAX_JOBS_PER_PROCESS = 500
"""Number of jobs after which a process is replaced, which frees memory that libraries retain."""


@dataclass(frozen=True)
class FinishedJob(Generic[J, R]):
    """A job that needs no more work."""

    job: J
    result: R | None
    """Return value of the work; None where the process died or was killed."""
    why: str = ""
    """Reason for a missing result."""
    seconds: float = 0.0
    """Wall time of the last attempt."""
    attempts: int = 1
    process: int = 0
    machine: str = field(default_factory=socket.gethostname)
    """Host name of the process."""


@dataclass(frozen=True)
class Submitted(Generic[J]):
    """A job that is queued or running on a cluster."""

    job: J
    attempt: int
    tries: int = 1
    """Number of submissions: after a lost worker or task, the attempt counts on unchanged."""

    @property
    def is_last_try(self) -> bool:
        """True where no further loss of a machine is tolerated."""
        return self.tries == MAX_LOST_MACHINES

    def died(self) -> FinishedJob[J, Any]:
        """Return the end of a job whose process or machines were lost."""
        return FinishedJob(self.job, None, PROCESS_DIED, attempts=self.attempt)


class Executor(Protocol[J, R]):
    """Runs jobs, several at once. ``wait`` raises the errors of the work."""

    @property
    def capacity(self) -> int:
        """Number of jobs that can start now."""
        ...

    @property
    def busy(self) -> int:
        """Number of running jobs."""
        ...

    def submit(self, job: J, attempt: int) -> None:
        """Start attempt ``attempt`` of a job; requires free capacity."""
        ...

    def wait(self, nap: float | None) -> list[FinishedJob[J, R]]:
        """Wait for the next jobs to end, for at most ``nap`` seconds (None: any time); no wait without running jobs.

        A job whose process was lost has the reason ``PROCESS_DIED``.
        """
        ...

    def close(self) -> None:
        """Let all jobs finish, and free the machines."""
        ...


Start = Callable[[Callable[[J], R], Limits, Callable[[], object] | None], Executor[J, R]]
"""Makes an executor from the work, the limits of a job, and a function that each process calls first."""


def check_code(expected: str) -> None:
    """Raise ``GetagripError`` where the fingerprint of this machine's package differs from the driver's."""
    if plugins.fingerprint_with_plugins() != expected:
        here = f"{plugins.PACKAGE} on {socket.gethostname()}"
        got = f"getagrip of other code ({plugins.fingerprint_with_plugins()})"
        raise GetagripError(f"{here} must be the same on every machine, {expected} (got {got})")


def available_cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):  # Linux: the cores that a cluster's scheduler allows
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
    """Return the value of ``work`` for each job, in their order; many jobs run in processes, by default one per core.

    ``died`` makes the value for a job whose process died twice. ``ended`` is called with each value as jobs finish.
    ``here`` replaces ``work`` in this process.
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
    """Run the jobs in this process, in turn. None among the jobs means to ask again after ``IDLE_POLL_S``."""
    for job in jobs:
        if job is None:
            time.sleep(IDLE_POLL_S)
            continue
        since = time.monotonic()
        yield FinishedJob(job, work(job), seconds=time.monotonic() - since, process=os.getpid())


def run_on_executor(
    executor: Executor[J, R], jobs: Iterable[J | None], limits: Limits = NO_LIMITS
) -> Generator[FinishedJob[J, R], None, None]:
    """Run the jobs on an executor, yield each as it ends, and close the executor.

    A job is taken from ``jobs`` only when the executor has capacity; None means to ask again after ``IDLE_POLL_S``. A
    job whose process died runs again after all others, alone, with all memory free. An interrupt lets running jobs
    finish. Raises the errors of the work.
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


class Processes(Generic[J, R]):
    """An executor of processes on this machine; each starts when a job needs it."""

    def __init__(
        self, workers: int, work: Callable[[J], R], limits: Limits, prepare: Callable[[], object] | None
    ) -> None:
        """Run at most ``workers`` processes. Each calls ``prepare`` first, outside the limits."""
        self.workers = workers
        self._start: Callable[[], _WorkerProcess[J, R]] = lambda: _WorkerProcess(work, limits, prepare)
        self._processes: list[_WorkerProcess[J, R]] = []

    @property
    def capacity(self) -> int:
        """Number of jobs that can start now."""
        return self.workers - self.busy

    @property
    def busy(self) -> int:
        """Number of running jobs."""
        return len(self._at_work())

    def submit(self, job: J, attempt: int) -> None:
        """Give a job to an idle process, or to a new one."""
        idle = next((process for process in self._processes if not process.busy), None)
        if idle is None:
            idle = self._start()
            self._processes.append(idle)
        idle.submit(job, attempt)

    def wait(self, nap: float | None) -> list[FinishedJob[J, R]]:
        """Wait as ``Executor.wait``, but for the whole ``nap`` where no job is running."""
        busy = self._at_work()
        until = [left for process in busy if (left := process.time_left()) is not None]
        if busy or nap:
            wait([process.pipe for process in busy], min([*until, *([nap] if nap else [])], default=None))
        ends = [process.ended() for process in busy]
        self._processes = [process for process in self._processes if not process.gone]
        return [ended for ended in ends if ended is not None]

    def close(self) -> None:
        """Let all processes finish their jobs and end."""
        for process in self._processes:
            process.close()

    def _at_work(self) -> list[_WorkerProcess[J, R]]:
        return [process for process in self._processes if process.busy]


class _WorkerProcess(Generic[J, R]):
    """A process that runs one job after the other."""

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
        """Send a job to the process."""
        self.job, self.attempt, self.since, self.busy = job, attempt, time.monotonic(), True
        with suppress(OSError):  # the process has died; ``ended`` will notice
            self.pipe.send(job)

    def time_left(self) -> float | None:
        """Return the seconds until the job's time limit; None without a limit."""
        if self.limits.seconds is None or not self.ready:
            return None
        return max(0.0, self.since + self.limits.seconds - time.monotonic())

    def ended(self) -> FinishedJob[J, R] | None:
        """Return the end of the job; None while it runs. Sets ``gone`` where the process has ended."""
        try:
            while self.pipe.poll():
                answer = self.pipe.recv()
                if answer is None:
                    self.ready, self.since = True, time.monotonic()
                    continue
                return self._answered(*answer)
        except (EOFError, OSError):
            return self._killed(PROCESS_DIED)
        return self._killed(self.limits.too_long) if self.time_left() == 0.0 else None

    def _answered(self, result: R | None, error: Exception | None) -> FinishedJob[J, R]:
        self.busy, self.done = False, self.done + 1
        if error is not None:
            raise error
        if self.done == MAX_JOBS_PER_PROCESS:
            self.close()
        return self._finished(result, "")

    def _killed(self, why: str) -> FinishedJob[J, R]:
        self.process.kill()
        self.close()
        self.busy = False
        return self._finished(None, why)

    def _finished(self, result: R | None, why: str) -> FinishedJob[J, R]:
        return FinishedJob(self.job, result, why, time.monotonic() - self.since, self.attempt, self.pid)

    def close(self) -> None:
        """Let the process finish its job and end."""
        self.pipe.close()
        self.process.join()
        self.process.close()
        self.gone = True


def _serve_jobs(pipe: Connection, work: Callable[[J], R], limits: Limits, prepare: Callable[[], object] | None) -> None:
    """Run the jobs that come through the pipe until it closes; called in the new process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # for systems that cannot block signals
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
    except (EOFError, ConnectionError):  # the parent has closed the pipe
        return


def _end_with_parent() -> None:
    """End this process at once when its parent is killed; a closed pipe would end it only between jobs."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def _single_thread_environment() -> Iterator[None]:
    """Limit processes started within to one thread of numba and BLAS, and to modules outside the current folder.

    They ignore Ctrl-C from their first instruction: the parent handles it, and starts no more jobs.
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
    """Block SIGINT in this thread: child processes inherit the mask, and this one gets the signal afterwards."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # its start would unblock the signal
    masked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, masked)
