"""Jobs for other processes. Nothing heavy is imported here: each process imports this file again."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from getagrip.batch.engine import Engine
from getagrip.batch.executor import Processes, Start
from getagrip.batch.ledger import Ledger, LedgerEntry
from helpers.environment import import_path


def work(job: int) -> str:
    """Runs in another process: dies for job 3, and returns the number of threads that numpy may use."""
    if job == 3:
        os._exit(1)
    time.sleep(0.01)
    return f"{job} {os.environ['OMP_NUM_THREADS']}"


def tick(file: str) -> None:
    """Runs in another process: lengthens a file as long as it lives, a minute at most."""
    for _ in range(600):
        with Path(file).open("a") as out:
            out.write(".")
        time.sleep(0.1)


def patient(job: str) -> str:
    """Runs in another process: "slow" takes a minute."""
    time.sleep(60.0 if job == "slow" else 0.0)
    return job


def slow_start() -> None:
    """Runs in another process before its first job: takes longer than the limit of a job is."""
    time.sleep(3.0)


def greedy(gigabytes: float) -> str:
    """Runs in another process: takes so much memory, and says whether it got it."""
    try:
        bytearray(int(gigabytes * 1e9))
    except MemoryError:
        return "refused"
    return "granted"


def dies_once(mark: str) -> int:
    """Runs in another process: the first time it is killed, as by a system that is out of memory."""
    if not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), 9)
    return os.getpid()


def loses_its_task(mark: str) -> str:
    """Runs in a process of an array's task: the first time the task is killed, as with its node."""
    if not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getppid(), 9)
        time.sleep(60.0)
    return "done"


@dataclass(frozen=True)
class Errand:
    """A task: takes its time, notes that it was run, and leaves a file, unless that is there."""

    name: str
    out: Path
    seconds: float

    def run(self) -> LedgerEntry:
        if (self.out / self.name).exists():
            return LedgerEntry(self.name, "kept")
        with (self.out / "runs").open("a") as runs:
            runs.write(f"{self.name}\n")
        time.sleep(self.seconds)
        (self.out / f"{self.name}.part").touch()
        (self.out / f"{self.name}.part").rename(self.out / self.name)
        return LedgerEntry(self.name, "done")


def drive(
    out: Path, count: int, seconds: float, workers: int, executor: Start[Errand, LedgerEntry] | None = None
) -> list[str]:
    """A driver of such tasks; what has become of each. ``executor`` None: processes here, or of one worker this one."""
    if executor is None and workers > 1:
        executor = partial(Processes, workers)
    engine = Engine(
        work=Errand.run, lost=lambda errand, why: LedgerEntry(errand.name, "failed", why), entry=lambda entry: entry,
        options=None, executor=executor,
    )  # fmt: skip
    errands = (Errand(f"task-{n:02d}", out, seconds) for n in range(count))
    with Ledger(out) as ledger:
        return sorted(f"{entry.name} {entry.state}" for entry in engine.run(errands, ledger))


def start_driver(out: Path, count: int, seconds: float, workers: int, executor: str = "None") -> subprocess.Popen[str]:
    """Start ``drive`` in a process that prints what has become of the tasks; ``executor`` is an expression."""
    code = (
        "from functools import partial; from pathlib import Path\n"
        "from getagrip.batch.clusters import RayExecutor; from helpers.jobs import drive\n"
        f"call = Path({str(out)!r}), {count}, {seconds}, {workers}\n"
        f"if __name__ == '__main__': print(*drive(*call, {executor}), sep='\\n')"
    )
    words = [sys.executable, "-c", code]
    return subprocess.Popen(words, env=import_path(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_for_tasks(out: Path, count: int) -> None:
    """Wait until ``count`` tasks are done."""
    end = time.monotonic() + 120.0
    while len(list(out.glob("task-??"))) < count:
        assert time.monotonic() < end
        time.sleep(0.01)
