"""Executors on clusters: Ray tasks, and Slurm's array jobs (by submitit).

A Ray task does one job, a task of a Slurm array a bundle of jobs in turn; both in a ``Processes`` executor of one
process, so limits and deaths of processes are handled as on one machine. Jobs of a lost node or task are submitted
again. submitit pickles functions and results in a folder that all machines see and only the user may write.

Ray ends the driver's process where its cluster dies; ``report_on_death`` then prints the progress from another process.
Run as a program, this module is that process.
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

from getagrip.batch.executor import FinishedJob, Processes, Submitted, available_cores, check_code, run_on_executor
from getagrip.batch.ledger import open_existing_ledger
from getagrip.batch.scheduling import Limits
from getagrip.errors import GetagripError, UsageError
from getagrip.io import plugins, processes
from getagrip.io.terminal import print_note, state_folder

if TYPE_CHECKING:
    from submitit import Job


J = TypeVar("J")
R = TypeVar("R")

RAY_CONNECT_TIMEOUT_S = 5.0
"""Time limit for connecting to an address."""
RAY_POLL_S = 2.0
"""Interval between queries of the cluster's size."""
OBJECT_STORE_BYTES = 100 * 2**20
"""Object store of a local cluster; clips and results do not pass through it."""


class RayExecutor(Generic[J, R]):
    """Executor on a running Ray cluster, or on one on this machine that ends with the executor."""

    def __init__(
        self,
        workers: int | None,
        address: str | None,
        work: Callable[[J], R],
        limits: Limits,
        prepare: Callable[[], object] | None,
    ) -> None:
        """Connect to the cluster at ``address`` (None: ``RAY_ADDRESS``, else this machine).

        ``workers`` None: the cluster's number of CPUs, also when it changes. Raises ``UsageError`` where Ray is not
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
        """Number of jobs that can start now; a cluster without CPUs gets one, which waits until it has some."""
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
        """Wait as ``Executor.wait``. Raises ``GetagripError`` where the cluster has died."""
        if not self._at_work:
            time.sleep(nap or 0.0)
            return []
        refs = [*self._at_work]
        try:
            if not self._ray.wait(refs, num_returns=1, timeout=nap)[0]:
                return []
            ready, _ = self._ray.wait(refs, num_returns=len(refs), timeout=0)  # all finished tasks at once
        except self._ray.exceptions.RayError as error:
            why = f"Ray's cluster has died ({_one_line(error)})"
            raise GetagripError(f"{why}; results so far are kept, and the same call continues") from error
        ends = [self._ended(ref, self._at_work.pop(ref)) for ref in ready]
        lost = sum(ended is None for ended in ends)
        if lost:
            print_note(f"Ray has lost a node or a worker; its jobs are submitted again ({lost})")
        return [ended for ended in ends if ended is not None]

    def close(self) -> None:
        """Let all jobs finish; stop a cluster that this executor has started."""
        refs = [*self._at_work]
        if refs:
            with suppress(self._ray.exceptions.RayError):  # of a cluster that has died
                self._ray.wait(refs, num_returns=len(refs))
        if self._ours:
            self._ray.shutdown()

    def _ended(self, ref: object, submitted: Submitted[J]) -> FinishedJob[J, R] | None:
        """Return the end of a job; None where its worker was lost and the job was submitted again."""
        try:
            ended = self._ray.get(ref)
        except self._ray.exceptions.OutOfMemoryError:  # Ray has killed the worker to save its node
            return submitted.died()
        except self._ray.exceptions.RayError:
            if submitted.is_last_try:
                return submitted.died()
            self._at_work[self._start(submitted.job)] = replace(submitted, tries=submitted.tries + 1)
            return None
        if isinstance(ended, Exception):
            raise ended
        return replace(ended, attempts=submitted.attempt)


def _connect_ray(ray: ModuleType, workers: int | None, address: str | None) -> None:
    """Connect to a cluster, or start one on this machine. Raises ``UsageError``."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    quiet = {"log_to_driver": False, "logging_level": "error"}
    if address in (None, "local"):
        local = {"num_cpus": workers or available_cores(), "include_dashboard": False}
        ray.init("local", object_store_memory=OBJECT_STORE_BYTES, **local, **quiet)
        return
    try:
        check_ray_address(address)
        ray.init(address, **quiet)
    except (OSError, RuntimeError, ValueError) as error:
        expected = "the address of a running Ray cluster, HOST:PORT or auto; RAY_AUTH_MODE=token if it needs a token"
        raise UsageError(f"--address must be {expected} (got {address}: {_one_line(error)})") from error


def check_ray_address(address: str) -> None:
    """Raise ``OSError`` where an address does not answer: Ray would try for a minute, then end the process.

    Raises ``ValueError`` for an invalid address.
    """
    if "://" in address:
        raise ValueError("Ray's client is not supported; call on a machine of the cluster, as `ray job submit` does")
    host, colon, port = address.rpartition(":")
    if colon:
        if not port.isdecimal():
            raise ValueError(f"invalid port {port!r}")
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


@lru_cache(maxsize=1)  # the process of an earlier call ends when its executor leaves the cache
def _worker_executor(
    work: Callable[[J], R], limits: Limits, prepare: Callable[[], object] | None, folder: str
) -> Processes[J, R]:
    """Return the executor of this Ray worker, one process in the driver's ``folder``; it is kept for the next job."""
    return Processes(1, work, limits, prepare)


@contextmanager
def _in_driver_folder(folder: str) -> Iterator[None]:
    """Start processes in the driver's folder, if this machine has it: paths may be relative.

    The processes do not load the Ray worker's main file, which would load Ray.
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
"""Default maximum number of simultaneous tasks of all arrays."""
JOBS_PER_SLURM_TASK = 100
"""Maximum number of jobs of a task: it should take minutes, since Slurm needs seconds to start one."""
SLURM_TASK_HOURS = 4.0
"""Time limit of a task if jobs have none."""
SLURM_JOB_GB = 3.0
"""Memory for a job without a limit; a task gets 1 GB more."""
SLURM_POLL_S = 1.0
"""Interval between queries for finished tasks."""


class SlurmExecutor(Generic[J, R]):
    """Executor of Slurm array tasks, ``workers`` at once; a new array is submitted when half of them have ended."""

    def __init__(
        self, workers: int | None, work: Callable[[J], R], limits: Limits, prepare: Callable[[], object] | None
    ) -> None:
        """Run up to ``workers`` tasks at once. Raises ``UsageError`` where submitit or Slurm is not installed."""
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
        """Number of jobs that can start now; 0 while more than half of the tasks run, so that arrays are large."""
        if len(self._at_work) > self._workers // 2:
            return 0
        return (self._workers - len(self._at_work)) * JOBS_PER_SLURM_TASK - len(self._collected)

    @property
    def busy(self) -> int:
        """Number of jobs at work."""
        return len(self._collected) + sum(map(len, self._at_work.values()))

    def submit(self, job: J, attempt: int) -> None:
        """Add a job to the next array."""
        self._collected.append(Submitted(job, attempt))

    def wait(self, nap: float | None) -> list[FinishedJob[J, R]]:
        """Wait as ``Executor.wait``, after submitting the collected jobs."""
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
        """Cancel pending tasks, and let running tasks finish."""
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
        """Submit the collected jobs as one array of equal bundles."""
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
            raise GetagripError(f"--engine slurm: sbatch has refused the jobs ({_one_line(error)})") from error
        self._at_work |= dict(zip(tasks, bundles, strict=True))

    def _ended(self, task: Job, bundle: list[Submitted[J]]) -> list[FinishedJob[J, R]]:
        try:
            ends = task.result()
        except self._errors:
            self._lost += 1
            print_note(f"Slurm has lost a task ({task.job_id}); its jobs are submitted again ({len(bundle)})")
            self._collected += [replace(sent, tries=sent.tries + 1) for sent in bundle if not sent.is_last_try]
            return [sent.died() for sent in bundle if sent.is_last_try]
        if isinstance(ends, Exception):
            raise ends
        return [replace(ended, attempts=max(ended.attempts, bundle[0].attempt)) for ended in ends]


def _run_slurm_bundle(
    how: tuple[Callable[[J], R], Limits, Callable[[], object] | None, str], jobs: list[J]
) -> list[FinishedJob[J, R]] | Exception:
    """Do the jobs of a Slurm task; an exception is returned, for the driver to raise."""
    work, limits, prepare, expected = how
    try:
        check_code(expected)
        return list(run_on_executor(Processes(1, work, limits, prepare), jobs, limits))
    except Exception as error:
        return error


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


@contextmanager
def report_on_death(folder: Path, called: str) -> Iterator[None]:
    """Start a process that prints the progress of the ledger in ``folder`` if this process dies within the block.

    ``called`` is the plural name of its tasks.
    """
    again = shlex.join(["getagrip", *sys.argv[1:]]) if processes.is_program() else "the same call"
    words = processes.python_command("-m", "getagrip.batch.clusters", str(folder.absolute()), called, again)
    watcher = subprocess.Popen(words, stdin=subprocess.PIPE, start_new_session=True)  # receives no Ctrl-C
    try:
        yield
    finally:
        watcher.communicate(b"ended")


def main(folder: str, called: str, again: str) -> None:
    """Wait for the parent's end; print the progress of the ledger in ``folder`` if the parent died."""
    if sys.stdin.buffer.read():
        return
    with open_existing_ledger(Path(folder)) as ledger:
        states = Counter[str]() if ledger is None else Counter(entry.state for entry in ledger.entries())
    done = f"{states['done']} of {states.total()} {called} are done, {states['failed']} failed"
    why = f"Ray's cluster has died and ended this call, or it was killed: {done}, {states['open']} are left"
    print_note(f"getagrip: {why}; results are whole; on a running cluster, this continues: {again}")


if __name__ == "__main__":
    main(*sys.argv[1:])
