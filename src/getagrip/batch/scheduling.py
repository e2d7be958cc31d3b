"""Options that several commands share: executor, limits, shard and ledger of tasks, and the treatment of clips.

This module is loaded for ``--help``: executors are imported when they start.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator, Iterable, Mapping
from contextlib import closing, nullcontext
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar
from zlib import crc32

from tyro.conf import arg

from getagrip.errors import UsageError
from getagrip.io.options import Flag, OptionalFolder, parsed_argument

if TYPE_CHECKING:
    from getagrip.batch.engine import Engine, NamedTask
    from getagrip.batch.executor import Start
    from getagrip.batch.ledger import Ledger
    from getagrip.fitting.options import Options
    from getagrip.report.pages import IndexRow
    from getagrip.result import Reconstruction
    from getagrip.result.findings import Probability

    AnyStart = Start[Any, Any]

J = TypeVar("J", bound="NamedTask")
R = TypeVar("R")

MAX_JOB_LIMIT = 1e6
"""Maximum seconds and GB: clocks and the Linux kernel overflow at some thousand times this."""
MIN_KEEP_SHARE, MAX_KEEP_SHARE = 0.5, 0.98
"""Calibrated range of the share of right results (``checks.calibration``)."""
MAX_NAMED_RESULTS = 20
"""Maximum number of results named in a line; the summary lists all."""
MAX_IN_PROCESS_TASKS = 3
"""Maximum number of tasks that run in this process: other processes would take longer to start."""
NO_DEFAULT = "(default: none)"


@dataclass(frozen=True)
class Limits:
    """The limits of each job. Raises ``UsageError`` for invalid numbers, and on systems that cannot limit memory."""

    seconds: Annotated[float | None, arg(name="limit-seconds", metavar="S", help_behavior_hint=NO_DEFAULT)] = None
    """Time limit of a clip (in bench, with all its methods) or of a part of a dataset [s]."""
    gigabytes: Annotated[float | None, arg(name="limit-gb", metavar="GB", help_behavior_hint=NO_DEFAULT)] = None
    """Memory limit of each process [10^9 bytes] (Linux only)."""

    def __post_init__(self) -> None:
        for option, value in (("--limit-seconds", self.seconds), ("--limit-gb", self.gigabytes)):
            if value is not None and not (0.0 < value <= MAX_JOB_LIMIT):
                raise UsageError(f"{option} must be above 0 and at most {MAX_JOB_LIMIT:g} (got {value:g})")
        if self.gigabytes is not None and sys.platform != "linux":
            why = "only Linux limits the memory of a process"
            raise UsageError(f"--limit-gb cannot be used with {sys.platform}: {why}")

    def __bool__(self) -> bool:
        return self.seconds is not None or self.gigabytes is not None

    @property
    def too_long(self) -> str:
        """Message for a job that exceeded its time."""
        return f"it took longer than {self.seconds:g} s (--limit-seconds)"

    @property
    def suspicion(self) -> str:
        """Probable cause of a process's death."""
        return "out of memory?" if self.gigabytes is None else f"out of memory, {self.gigabytes:g} GB (--limit-gb)?"

    def enforce(self) -> None:
        """Limit the memory of this process, which must do nothing but these jobs."""
        if self.gigabytes is not None:
            import resource

            most = resource.getrlimit(resource.RLIMIT_DATA)[1]
            wanted = int(self.gigabytes * 1e9)
            resource.setrlimit(resource.RLIMIT_DATA, (wanted if most < 0 else min(wanted, most), most))


NO_LIMITS = Limits()


@dataclass(frozen=True)
class Shard:
    """One of several equal parts of all clips; a clip's name alone decides which."""

    index: int = 1
    """1 to ``count``."""
    count: int = 1

    @classmethod
    def of(cls, text: str) -> Shard:
        """Parse "i/N". Raises ``UsageError``."""
        index, slash, count = text.partition("/")
        if not (slash and index.isdecimal() and count.isdecimal() and 1 <= int(index) <= int(count)):
            raise UsageError(f"--shard must be i/N with i from 1 to N, such as 2/4 (got {text})")
        return cls(int(index), int(count))

    def __contains__(self, name: str) -> bool:
        return crc32(name.encode()) % self.count == self.index - 1


WHOLE_SHARD = Shard()


@dataclass(frozen=True, kw_only=True)
class SchedulingOptions:
    """Executor, limits, shard and ledger of a call's tasks: clips or parts of a dataset.

    Raises ``UsageError`` for fewer than one worker.
    """

    workers: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: one per core)")] = None
    """Number of processes. Up to three clips, or parts of a dataset, run in the command's own process. Default on a Ray
    cluster: its CPUs; on Slurm: 64 array tasks."""
    engine: Literal["local", "ray", "slurm"] = "local"
    """Executor of the jobs: this machine, a Ray cluster, or Slurm's array jobs. All machines must see inputs and
    outputs under the same paths."""
    address: Annotated[str | None, arg(metavar="ADDR", help_behavior_hint="(default: RAY_ADDRESS, or local)")] = None
    """Address of a running Ray cluster: HOST:PORT, or auto."""
    limits: Annotated[Limits, arg(name="")] = field(default_factory=Limits)
    fail_fast: Flag = False
    """Start no further work after the first failure; work in progress is finished."""
    shard: Annotated[
        Shard, parsed_argument("I/N", Shard.of, Shard), arg(metavar="I/N", help_behavior_hint="(default: all)")
    ] = WHOLE_SHARD
    """Do part I of N equal parts of the work, for N machines."""
    ledger: OptionalFolder = None
    """Local folder for the ledger, needed if --out is on a network file system."""

    def __post_init__(self) -> None:
        if self.workers is not None and self.workers < 1:
            raise UsageError(f"--workers must be 1 or more (got {self.workers})")

    def executor(self, count: int, few: int = MAX_IN_PROCESS_TASKS) -> AnyStart | None:
        """Choose the executor of ``count`` tasks; None: this process, the default for up to ``few`` without limits."""
        from getagrip.batch.executor import available_cores

        workers, local = self.workers, self.engine == "local"
        if local:
            workers = max(1, min(count, workers or (1 if count <= few else available_cores())))
        start = ENGINES[self.engine](workers, self.address)
        return None if local and workers == 1 and not self.limits else start

    def ended(
        self,
        engine: Engine[J, R],
        tasks: Iterable[J],
        count: int,
        ledger: Ledger,
        called: str,
        *,
        few: int = MAX_IN_PROCESS_TASKS,
        stages: bool = False,
    ) -> Generator[R, None, None]:
        """Yield the outcome of each of ``count`` tasks as they end, counted by a ``BatchProgress``.

        ``called`` is the tasks' plural name. With ``stages``, ``engine.work`` takes a second argument, a ``Progress``,
        which a bar shows in this process. Raises the errors of ``executor`` and ``Engine.run``.
        """
        from getagrip.batch.clusters import report_on_death
        from getagrip.batch.engine import BatchProgress, run_with_stage_bar
        from getagrip.io.terminal import progress_bar

        engine = replace(engine, executor=self.executor(count, few), limits=self.limits)
        watched = report_on_death(ledger.path.parent, called) if self.engine == "ray" else nullcontext()
        with watched, progress_bar() as bar:
            if stages:
                engine = replace(engine, in_this=partial(run_with_stage_bar, bar, engine.work))
            pace = BatchProgress(bar, called, count)
            with closing(engine.run(tasks, ledger)) as ends:
                for result in ends:
                    yield result
                    pace.count(engine.entry(result).state)


Executors = Annotated[SchedulingOptions, arg(name="executor", help="Where the work is done, and within which limits.")]
"""Scheduling options under a heading of their own in ``--help``."""
DEFAULT_SCHEDULING = SchedulingOptions()
"""All tasks on this machine, without limits."""


@dataclass(frozen=True)
class KeepOptions:
    """Selection of results that are probably right. Raises ``UsageError`` for a share out of range."""

    keep: Annotated[float | None, arg(metavar="SHARE", help_behavior_hint="(default: no result is marked)")] = None
    """Mark each result as kept or dropped, such that at least this share of the kept ones (0.5 to 0.98) is right.
    Nothing is deleted. Calibrated with simulated and with real errors of hands."""
    keep_in: Literal["hand", "camera"] = "hand"
    """Frame in which kept results must be right."""

    def __post_init__(self) -> None:
        if self.keep is not None and not MIN_KEEP_SHARE <= self.keep <= MAX_KEEP_SHARE:
            raise UsageError(f"--keep must be {MIN_KEEP_SHARE:g} to {MAX_KEEP_SHARE:g} (got {self.keep:g})")

    def check(self, options: Options) -> None:
        """Raise ``UsageError`` where results of these options have no probability: all would be dropped."""
        if self.keep is not None:
            from getagrip.fitting.stages.confidence import uncalibrated_reason

            if why := uncalibrated_reason(options, ()):
                raise UsageError(f"--keep needs the probability that results are right, and {why}")

    def verdict(self, in_hand: Probability | None, in_camera: Probability | None) -> str:
        """Return "kept" or "dropped"; empty without ``keep``. Results without a probability are dropped."""
        return self.mark(*(None if right is None else right.keep for right in (in_hand, in_camera)))

    def mark(self, in_hand: float | None, in_camera: float | None) -> str:
        """Return the verdict from ``Probability.keep`` in the hand and in the camera."""
        if self.keep is None:
            return ""
        share = in_hand if self.keep_in == "hand" else in_camera
        return "kept" if share is not None and share >= self.keep else "dropped"

    def marked(self, row: IndexRow, result: Reconstruction) -> IndexRow:
        """Return a row of the index, flagged where its result is dropped."""
        dropped = self.verdict(result.probability_right, result.probability_right_in_camera) == "dropped"
        return replace(row, flags=(*row.flags, "dropped")) if dropped else row

    def summary(self, verdicts: Mapping[str, str]) -> str:
        """Summarise the verdicts of results by name, in a line."""
        dropped = sorted(name for name, verdict in verdicts.items() if verdict == "dropped")
        kept = len(verdicts) - len(dropped)
        more = f" and {len(dropped) - MAX_NAMED_RESULTS} more" if len(dropped) > MAX_NAMED_RESULTS else ""
        named = f"; dropped: {', '.join(dropped[:MAX_NAMED_RESULTS])}{more}" if dropped else ""
        share = f"{kept} of {len(verdicts)} ({100.0 * kept / max(len(verdicts), 1):.0f} %) are kept"
        return f"{share}: at least {100.0 * (self.keep or 0.0):.3g} % of such are right in the {self.keep_in}{named}"


NO_KEEP_FILTER = KeepOptions()


@dataclass(frozen=True)
class BatchOptions:
    """How a call treats its clips. Raises ``UsageError``."""

    threads: Annotated[int, arg(metavar="N")] = 1
    """Threads for each clip, to get a single clip sooner; many clips are faster with --workers. Results are
    bit-equal."""
    overwrite: Flag = False
    """Recompute valid results, too."""
    strict: Flag = False
    """Exit with 1 also if a check has a serious finding (the result is probably worthless), or a result is less
    probable than --min-probability."""
    min_probability: Annotated[float, arg(metavar="P")] = 0.5
    """With --strict, the least probability that poses are right in the hand, 0 to 1. Results without a probability
    pass, if no finding is serious."""
    keep: Annotated[KeepOptions, arg(name="")] = field(default_factory=KeepOptions)
    share: Executors = field(default_factory=SchedulingOptions)

    def __post_init__(self) -> None:
        if not 0.0 <= self.min_probability <= 1.0:
            raise UsageError(f"--min-probability must be 0 to 1 (got {self.min_probability:g})")
        if self.threads < 1:
            raise UsageError(f"--threads must be 1 or more (got {self.threads})")


def _local_executor(workers: int | None, address: str | None) -> AnyStart:
    from getagrip.batch.executor import Processes, available_cores

    _refuse_address(address)
    return partial(Processes, workers or available_cores())


def _ray_executor(workers: int | None, address: str | None) -> AnyStart:
    from getagrip.batch.clusters import RayExecutor

    return partial(RayExecutor, workers, address)


def _slurm_executor(workers: int | None, address: str | None) -> AnyStart:
    from getagrip.batch.clusters import SlurmExecutor

    _refuse_address(address)
    return partial(SlurmExecutor, workers)


def _refuse_address(address: str | None) -> None:
    if address is not None:
        raise UsageError("--address cannot be used without --engine ray")


ENGINES: dict[str, Callable[[int | None, str | None], AnyStart]] = {
    "local": _local_executor, "ray": _ray_executor, "slurm": _slurm_executor,
}  # fmt: skip
"""Executors by name: each makes a ``Start`` from the number of workers and the cluster's address (None: default)."""
