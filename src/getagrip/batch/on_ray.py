"""An executor on a Ray cluster: each job is a Ray task, done by a process of ours that the worker keeps for the next.

So limits of time and memory, and what becomes of a job whose process dies, are as on one machine. Jobs of a node that
is lost are given to others.
"""

from __future__ import annotations

import os
import socket
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import chdir, contextmanager, nullcontext, suppress
from dataclasses import replace
from functools import lru_cache
from types import ModuleType
from typing import Generic, TypeVar

from getagrip.batch.executor import MAX_LOST_MACHINES, PROCESS_DIED, FinishedJob, Submitted, available_cores, check_code
from getagrip.batch.limits import Limits
from getagrip.batch.processes import Processes
from getagrip.errors import GetagripError, UsageError
from getagrip.io import extras, own_python, plugins
from getagrip.io.terminal import print_note

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
        self._ray = extras.import_extra("ray", "ray", "--engine ray")
        self._ours = not self._ray.is_initialized()
        if self._ours:
            with own_python.leave_cwd():  # Ray puts the current folder onto the path of its workers
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
