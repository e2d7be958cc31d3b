"""How a call shares its tasks out: over whom, within which limits, which part of them, and by which ledger.

These are options of several commands; what runs is loaded when it does.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

from tyro.conf import arg

from getagrip.batch.limits import Limits
from getagrip.batch.shard import ALL, Shard
from getagrip.errors import UsageError
from getagrip.io.arguments import Flag, OptionalFolder, parsed

if TYPE_CHECKING:
    from pathlib import Path

    from getagrip.batch.engine import Engine, Named
    from getagrip.batch.executor import Start

J = TypeVar("J", bound="Named")
R = TypeVar("R")

FEW = 3
"""Up to this number of tasks are done in this process: others take longer to start."""


@dataclass(frozen=True, kw_only=True)
class Share:
    """Who does the tasks of a call: clips, or what one process reads of a dataset.

    Raises ``UsageError`` for fewer than one worker.
    """

    workers: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: one per core)")] = None
    """Number of processes; up to three clips, or parts of a dataset, are done in this one. Default on a Ray cluster:
    its CPUs; on Slurm: 64 tasks of an array."""
    engine: Literal["local", "ray", "slurm"] = "local"
    """Executor of the jobs: this machine, a Ray cluster, or Slurm's array jobs. All machines must see inputs and
    outputs under the same paths."""
    address: Annotated[str | None, arg(metavar="ADDR", help_behavior_hint="(default: RAY_ADDRESS, else one here)")] = (
        None
    )
    """Address of a running Ray cluster: HOST:PORT, or auto."""
    limits: Annotated[Limits, arg(name="")] = field(default_factory=Limits)
    fail_fast: Flag = False
    """Stop after the first failure; work in progress is finished."""
    shard: Annotated[Shard, parsed("I/N", Shard.of, Shard), arg(metavar="I/N", help_behavior_hint="(default: all)")] = (
        ALL
    )
    """Do part I of N equal parts of the work, for N machines."""
    ledger: OptionalFolder = None
    """Local folder for the ledger, where --out is on a network file system."""

    def __post_init__(self) -> None:
        if self.workers is not None and self.workers < 1:
            raise UsageError(f"--workers must be 1 or more (got {self.workers})")

    def executor(self, count: int, few: int = FEW) -> Start[Any, Any] | None:
        """Choose the executor of ``count`` tasks; None: this process, by default for a ``few`` without limits."""
        from getagrip.batch.executors import ENGINES
        from getagrip.batch.pool import cores

        workers, local = self.workers, self.engine == "local"
        if local:
            workers = max(1, min(count, workers or (1 if count <= few else cores())))
        start = ENGINES[self.engine](workers, self.address)
        return None if local and workers == 1 and not self.limits else start

    def ended(
        self, engine: Engine[J, R], tasks: Sequence[J], out: Path, called: str, few: int = FEW
    ) -> Generator[R, None, None]:
        """Yield the outcome of each task, as they end, counted by a ``Pace``; the ledger is that of ``out``.

        ``called`` is what tasks are, in the plural. Raises ``UsageError`` as ``executor`` does, else as ``Engine.run``.
        """
        from getagrip.batch.ledger import Ledger
        from getagrip.batch.ledger_place import ledger_folder
        from getagrip.batch.progress import Pace
        from getagrip.io.terminal import progress_bar

        engine = replace(engine, executor=self.executor(len(tasks), few), limits=self.limits)
        ledger = Ledger(ledger_folder(out, self.ledger))
        with ledger, progress_bar() as bar, closing(engine.run(tasks, ledger)) as ends:
            pace = Pace(bar, called, len(tasks))
            for result in ends:
                yield result
                pace.count(engine.entry(result).state)


ALONE = Share()
"""All tasks, on this machine, any time and memory."""
