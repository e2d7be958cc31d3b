"""An executor on a Ray cluster: each job is a Ray task, done by a process of ours that the worker keeps for the next.

So limits of time and memory, and what becomes of a job whose process dies, are as on one machine. Jobs of a node that
is lost are given to others.

Words for a call that a library ends from within, as Ray does where its cluster dies: another process says them.

An executor of Slurm's array jobs, by submitit: each task of an array does a bundle of jobs, one after the other.

In it they are done as on one machine, by a process of its own with limits of time and memory. Bundles that are lost, by
Slurm's time limit or with their node, are given out again. submitit keeps functions and results as pickles in a folder
that all machines see: it is the user's own, nobody else may write there.
"""

from __future__ import annotations

import math
import os
import shlex
import shutil
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import chdir, contextmanager, nullcontext, suppress
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Generic, TypeVar
from uuid import uuid4

from getagrip.batch.executor import (
    MAX_LOST_MACHINES,
    PROCESS_DIED,
    FinishedJob,
    Processes,
    Submitted,
    available_cores,
    check_code,
    run_on_executor,
)
from getagrip.batch.job import Limits
from getagrip.batch.ledger import open_existing_ledger
from getagrip.errors import GetagripError, UsageError
from getagrip.io import plugins, processes
from getagrip.io.terminal import print_note, state_folder

if TYPE_CHECKING:
    from submitit import Job


@contextmanager
def report_on_death(folder: Path, called: str) -> Iterator[None]:
    """Have what is done and left of a ledger's tasks said if this process ends within the block.

    ``folder`` is the ledger's, ``called`` what its tasks are, in the plural.
    """
    again = shlex.join(["getagrip", *sys.argv[1:]]) if processes.is_program() else "the same call"
    words = processes.python_command("-m", "getagrip.batch.clusters", str(folder.absolute()), called, again)
    watcher = subprocess.Popen(words, stdin=subprocess.PIPE, start_new_session=True)  # no Ctrl-C reaches it
    try:
        yield
    finally:
        watcher.communicate(b"ended")


def main(folder: str, called: str, again: str) -> None:
    """Wait for the end of the process that has started this one; say what it could not."""
    if sys.stdin.buffer.read():
        return
    with open_existing_ledger(Path(folder)) as ledger:
        states = Counter[str]() if ledger is None else Counter(entry.state for entry in ledger.entries())
    done = (
        f"{states['done']} of {states.total()} {called} are done, {states['failed']} failed, {states['open']} are left"
    )
    why = "Ray's cluster has died and ended this call, or it was killed"
    print_note(f"getagrip: {why}: {done}; results are whole; on a cluster that runs, this goes on: {again}")


if __name__ == "__main__":
    main(*sys.argv[1:])

J = TypeVar("J")
R = TypeVar("R")

RAY_CONNECT_TIMEOUT_S = 5.0
"""Seconds in which an address must answer."""
RAY_POLL_S = 2.0
"""Seconds after which we ask again how large the cluster is."""
OBJECT_STORE_BYTES = 100 * 2**20
"""Bytes of a local cluster's object store: clips and results do not pass through it."""


class RayExecutor(Generic[J, R]):
    """Workers of a running cluster, or of one on this machine that ends with the executor."""

    def __init__(
        self,
        workers: int | None,
        address: str | None,
        work: Callable[[J], R],
        limits: Limits,
        prepare: Callable[[], object] | None,
    ) -> None:
        """``workers`` None: as many as the cluster has CPUs, now and later.

        ``address`` is Ray's; None: that of ``RAY_ADDRESS``, else this machine. Raises ``UsageError`` where Ray is not
        installed or does not answer.
        """
        self._ray = plugins.import_extra("ray", "ray", "--engine ray")
        self._ours = not self._ray.is_initialized()
        if self._ours:
            with processes.leave_cwd():  # Ray puts the current folder onto the path of its workers
                _connect_ray(self._ray, workers, address or os.environ.get("RAY_ADDRESS"))
        self._workers = workers
        task = self._ray.remote(num_cpus=1, max_retries=0)(_run_ray_task)
        how = self._ray.put((work, limits, prepare, plugins.fingerprint_with_plugins(), os.getcwd()))
        self._start: Callable[[J], object] = lambda job: task.remote(how, job)
        self._at_work: dict[object, Submitted[J]] = {}
        self._cpus, self._looked = 0, -RAY_POLL_S

    @property
    def capacity(self) -> int:
        """Number of jobs that can start now; at least one, which waits for a cluster that grows."""
        if self._workers is None and time.monotonic() - self._looked >= RAY_POLL_S:
            self._cpus, self._looked = int(self._ray.cluster_resources().get("CPU", 0)), time.monotonic()
        return (self._workers or max(1, self._cpus)) - self.busy

    @property
    def busy(self) -> int:
        """Number of jobs at work."""
        return len(self._at_work)

    def submit(self, job: J, attempt: int) -> None:
        """Send a job to the cluster."""
        self._at_work[self._start(job)] = Submitted(job, attempt)

    def wait(self, nap: float | None) -> list[FinishedJob[J, R]]:
        """Wait for the jobs that end next; none, when the ``nap`` is over [s] or no job is running.

        Raises ``GetagripError`` where the cluster has died.
        """
        if not self._at_work:
            time.sleep(nap or 0.0)
            return []
        refs = [*self._at_work]
        try:
            if not self._ray.wait(refs, num_returns=1, timeout=nap)[0]:
                return []
            ready, _ = self._ray.wait(refs, num_returns=len(refs), timeout=0)  # all that have ended meanwhile, at once
        except self._ray.exceptions.RayError as error:
            why = " ".join(str(error).split())
            raise GetagripError(
                f"Ray's cluster has died ({why}); what is done is kept, and the same call goes on"
            ) from error
        ends = [self._ended(ref, self._at_work.pop(ref)) for ref in ready]
        lost = sum(ended is None for ended in ends)
        if lost:
            print_note(f"Ray has lost a node or a worker; its jobs are submitted again ({lost})")
        return [ended for ended in ends if ended is not None]

    def close(self) -> None:
        """Let all finish their jobs; a cluster that runs without us stays."""
        refs = [*self._at_work]
        if refs:
            with suppress(self._ray.exceptions.RayError):  # of a cluster that has died
                self._ray.wait(refs, num_returns=len(refs))
        if self._ours:
            self._ray.shutdown()

    def _ended(self, ref: object, submitted: Submitted[J]) -> FinishedJob[J, R] | None:
        """Return the end of a job; None where its worker was lost and the job has been sent again."""
        try:
            ended = self._ray.get(ref)
        except self._ray.exceptions.OutOfMemoryError:  # Ray has ended the worker, to save its node
            return FinishedJob(submitted.job, None, PROCESS_DIED, attempts=submitted.attempt)
        except self._ray.exceptions.RayError:
            if submitted.tries == MAX_LOST_MACHINES:
                return FinishedJob(submitted.job, None, PROCESS_DIED, attempts=submitted.attempt)
            self._at_work[self._start(submitted.job)] = replace(submitted, tries=submitted.tries + 1)
            return None
        if isinstance(ended, Exception):
            raise ended
        return replace(ended, attempts=submitted.attempt)


def _connect_ray(ray: ModuleType, workers: int | None, address: str | None) -> None:
    """Connect to a cluster, or start one on this machine. Raises ``UsageError``."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # no report to Ray's makers
    quiet = {"log_to_driver": False, "logging_level": "error"}
    if address in (None, "local"):
        ray.init(
            "local",
            num_cpus=workers or available_cores(),
            include_dashboard=False,
            object_store_memory=OBJECT_STORE_BYTES,
            **quiet,
        )
        return
    try:
        check_ray_address(address)
        ray.init(address, **quiet)
    except (OSError, RuntimeError, ValueError) as error:
        reason = " ".join(str(error).split())
        expected = "the address of a Ray cluster that runs, HOST:PORT or auto; RAY_AUTH_MODE=token if it wants a token"
        raise UsageError(f"--address must be {expected} (got {address}: {reason})") from error


def check_ray_address(address: str) -> None:
    """Raise ``OSError`` where nobody listens at an address: Ray itself would try for a minute, then end the process.

    ``ValueError`` where it is none.
    """
    if "://" in address:
        raise ValueError("Ray's client is not supported; call on a machine of the cluster, as `ray job submit` does")
    host, colon, port = address.rpartition(":")
    if colon:
        if not port.isdecimal():
            raise ValueError(f"{port!r} is no port")
        socket.create_connection((host, int(port)), RAY_CONNECT_TIMEOUT_S).close()


def _run_ray_task(
    how: tuple[Callable[[J], R], Limits, Callable[[], object] | None, str, str], job: J
) -> FinishedJob[J, R] | Exception:
    """Do a job in a Ray worker; an exception is returned, for the driver to raise."""
    work, limits, prepare, expected, folder = how
    try:
        check_code(expected)
        executor = _worker_executor(work, limits, prepare, folder)
        with _in_driver_folder(folder):
            executor.submit(job, 1)
        while True:
            for ended in executor.wait(None):
                return ended
    except Exception as error:
        return error


@lru_cache(maxsize=1)  # what comes later is of another call: the process of the one before ends when it is forgotten
def _worker_executor(
    work: Callable[[J], R], limits: Limits, prepare: Callable[[], object] | None, folder: str
) -> Processes[J, R]:
    """Return this Ray worker's one process, which works in the driver's ``folder``; it is kept for the next job."""
    return Processes(1, work, limits, prepare)


@contextmanager
def _in_driver_folder(folder: str) -> Iterator[None]:
    """Start processes in the driver's folder, if there is one here: paths may be relative.

    Nor do they load the main file of a Ray worker, and with it Ray.
    """
    main = sys.modules["__main__"]
    file = main.__dict__.pop("__file__", None)
    try:
        with chdir(folder) if os.path.isdir(folder) else nullcontext():
            yield
    finally:
        if file is not None:
            main.__file__ = file


MAX_SLURM_TASKS = 64
"""Most tasks of all arrays at once, if the user does not say."""
JOBS_PER_SLURM_TASK = 100
"""Jobs of a task, at most: a task takes minutes, and Slurm some seconds for it."""
SLURM_TASK_HOURS = 4.0
"""Time limit of a task where jobs have none."""
SLURM_JOB_GB = 3.0
"""GB for a job where it has no limit; a task gets one more."""
SLURM_POLL_S = 1.0
"""Seconds between looks at what has ended."""


class SlurmExecutor(Generic[J, R]):
    """Tasks of array jobs, ``workers`` at once; new ones are submitted when half of them have ended."""

    def __init__(
        self, workers: int | None, work: Callable[[J], R], limits: Limits, prepare: Callable[[], object] | None
    ) -> None:
        """``workers``: tasks at once. Raises ``UsageError`` where submitit or Slurm is not there."""
        submitit = plugins.import_extra("submitit", "slurm", "--engine slurm")
        if shutil.which("sbatch") is None:
            raise UsageError("missing command sbatch: --engine slurm needs a machine that can submit to Slurm")
        self._workers = workers or MAX_SLURM_TASKS
        self._how = work, limits, prepare, plugins.fingerprint_with_plugins()
        self._errors = submitit.core.utils.UncompletedJobError, submitit.core.utils.FailedJobError
        self._folder = state_folder() / "slurm" / uuid4().hex[:12]
        self._folder.mkdir(parents=True, mode=0o700)
        seconds = JOBS_PER_SLURM_TASK * limits.seconds + 600.0 if limits.seconds else SLURM_TASK_HOURS * 3600.0
        self._executor = submitit.AutoExecutor(
            folder=self._folder, cluster="slurm", slurm_python=shlex.join(processes.python_command())
        )
        self._executor.update_parameters(
            name="getagrip", cpus_per_task=1, timeout_min=math.ceil(seconds / 60.0),
            mem_gb=math.ceil((limits.gigabytes or SLURM_JOB_GB) + 1.0),
        )  # fmt: skip
        self._collected: list[Submitted[J]] = []
        self._at_work: dict[Job, list[Submitted[J]]] = {}
        self._lost = 0

    @property
    def capacity(self) -> int:
        """Number of jobs that can start now; 0 while more than half of the tasks work, so that arrays are large."""
        if len(self._at_work) > self._workers // 2:
            return 0
        return (self._workers - len(self._at_work)) * JOBS_PER_SLURM_TASK - len(self._collected)

    @property
    def busy(self) -> int:
        """Number of jobs at work."""
        return len(self._collected) + sum(map(len, self._at_work.values()))

    def submit(self, job: J, attempt: int) -> None:
        """Put a job into the next array."""
        self._collected.append(Submitted(job, attempt))

    def wait(self, nap: float | None) -> list[FinishedJob[J, R]]:
        """Wait for the jobs that end next; none, when the ``nap`` is over [s] or no job is running."""
        self._submit()
        if not self._at_work:
            time.sleep(nap or 0.0)
        until = time.monotonic() + (math.inf if nap is None else nap)
        while not (done := [task for task in self._at_work if task.done()]):
            left = until - time.monotonic()
            if left <= 0.0 or not self._at_work:
                return []
            time.sleep(min(SLURM_POLL_S, left))
        return [ended for task in done for ended in self._ended(task, self._at_work.pop(task))]

    def close(self) -> None:
        """Cancel what waits in Slurm's queue, and let the rest finish."""
        for task in self._at_work:
            if task.state == "PENDING":
                task.cancel()
        for task in self._at_work:
            task.wait()
        if self._lost:
            print_note(f"{self._folder}: logs of the tasks that were lost ({self._lost})")
        else:
            shutil.rmtree(self._folder, ignore_errors=True)

    def _submit(self) -> None:
        """Submit what is collected as one array, in equal bundles."""
        jobs, self._collected = self._collected, []
        if not jobs:
            return
        free = max(1, self._workers - len(self._at_work))
        size = min(JOBS_PER_SLURM_TASK, math.ceil(len(jobs) / free))
        bundles = [jobs[first : first + size] for first in range(0, len(jobs), size)]
        self._executor.update_parameters(slurm_array_parallelism=free)
        handed_out = [[submitted.job for submitted in bundle] for bundle in bundles]
        try:
            tasks = self._executor.map_array(_run_slurm_bundle, [self._how] * len(bundles), handed_out)
        except (*self._errors, OSError, RuntimeError) as error:
            raise GetagripError(
                f"--engine slurm: sbatch has refused the jobs ({' '.join(str(error).split())})"
            ) from error
        self._at_work |= dict(zip(tasks, bundles, strict=True))

    def _ended(self, task: Job, bundle: list[Submitted[J]]) -> list[FinishedJob[J, R]]:
        try:
            ends = task.result()
        except self._errors:
            self._lost += 1
            print_note(f"Slurm has lost a task ({task.job_id}); its jobs are submitted again ({len(bundle)})")
            self._collected += [
                replace(submitted, tries=submitted.tries + 1)
                for submitted in bundle
                if submitted.tries < MAX_LOST_MACHINES
            ]
            return [
                FinishedJob(submitted.job, None, PROCESS_DIED, attempts=submitted.attempt)
                for submitted in bundle
                if submitted.tries == MAX_LOST_MACHINES
            ]
        if isinstance(ends, Exception):
            raise ends
        return [replace(ended, attempts=max(ended.attempts, bundle[0].attempt)) for ended in ends]


def _run_slurm_bundle(
    how: tuple[Callable[[J], R], Limits, Callable[[], object] | None, str], jobs: list[J]
) -> list[FinishedJob[J, R]] | Exception:
    """Do the jobs of an array's task; an exception is returned, for the driver to raise."""
    work, limits, prepare, expected = how
    try:
        check_code(expected)
        return list(run_on_executor(Processes(1, work, limits, prepare), jobs, limits))
    except Exception as error:
        return error
