"""An executor of Slurm's array jobs, by submitit: each task of an array does a bundle of jobs, one after the other.

In it they are done as on one machine, by a process of its own with limits of time and memory. Bundles that are lost, by
Slurm's time limit or with their node, are given out again. submitit keeps functions and results as pickles in a folder
that all machines see: it is the user's own, nobody else may write there.
"""

from __future__ import annotations

import math
import shlex
import shutil
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Generic, TypeVar
from uuid import uuid4

from getagrip.batch.executor import MAX_LOST_MACHINES, PROCESS_DIED, FinishedJob, Submitted, check_code, run_on_executor
from getagrip.batch.limits import Limits
from getagrip.batch.processes import Processes
from getagrip.errors import GetagripError, UsageError
from getagrip.io import extras, own_python, plugins
from getagrip.io.terminal import print_note
from getagrip.io.user_folders import state_folder

if TYPE_CHECKING:
    from submitit import Job

J = TypeVar("J")
R = TypeVar("R")

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
        submitit = extras.import_extra("submitit", "slurm", "--engine slurm")
        if shutil.which("sbatch") is None:
            raise UsageError("missing command sbatch: --engine slurm needs a machine that can submit to Slurm")
        self._workers = workers or MAX_SLURM_TASKS
        self._how = work, limits, prepare, plugins.fingerprint_with_plugins()
        self._errors = submitit.core.utils.UncompletedJobError, submitit.core.utils.FailedJobError
        self._folder = state_folder() / "slurm" / uuid4().hex[:12]
        self._folder.mkdir(parents=True, mode=0o700)
        seconds = JOBS_PER_SLURM_TASK * limits.seconds + 600.0 if limits.seconds else SLURM_TASK_HOURS * 3600.0
        self._executor = submitit.AutoExecutor(
            folder=self._folder, cluster="slurm", slurm_python=shlex.join(own_python.python_command())
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
