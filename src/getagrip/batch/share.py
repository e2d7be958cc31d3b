"""How a call shares its tasks out: over whom, within which limits, which part of them, and by which ledger."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from getagrip.batch.crew import Start
from getagrip.batch.crews import ENGINES
from getagrip.batch.engine import Engine, Named
from getagrip.batch.ledger import Ledger
from getagrip.batch.ledger_place import ledger_folder
from getagrip.batch.limits import NONE, Limits
from getagrip.batch.plan import ALL, Shard
from getagrip.batch.pool import cores
from getagrip.batch.progress import Pace
from getagrip.errors import UsageError
from getagrip.io.terminal import progress_bar

J = TypeVar("J", bound=Named)
R = TypeVar("R")

FEW = 3
"""Up to so many tasks are done in this process: others take longer to start."""


@dataclass(frozen=True, kw_only=True)
class Share:
    """Of one call. Raises ``UsageError`` for fewer than one worker."""

    workers: int | None = None
    """None: one for each core, where there are more than a few tasks; on a cluster, one for each CPU."""
    engine: str = "local"
    """Of ``ENGINES``."""
    address: str | None = None
    """Of a cluster that runs."""
    limits: Limits = NONE
    """Of each task."""
    fail_fast: bool = False
    """Begin no other task once one has failed."""
    shard: Shard = ALL
    """Of the tasks by name."""
    ledger: Path | None = None
    """Folder of the ledger; None: that of the results, or where that is in an object store, one on this machine."""

    def __post_init__(self) -> None:
        if self.workers is not None and self.workers < 1:
            raise UsageError(f"--workers: got {self.workers}, expected 1 or more")

    def crew(self, count: int, few: int = FEW) -> Start[Any, Any] | None:
        """Who does so many tasks; None: this process, by default for a ``few`` without limits."""
        workers, local = self.workers, self.engine == "local"
        if local:
            workers = max(1, min(count, workers or (1 if count <= few else cores())))
        start = ENGINES[self.engine](workers, self.address)
        return None if local and workers == 1 and not self.limits else start

    def ended(
        self, engine: Engine[J, R], tasks: Sequence[J], out: Path, called: str, few: int = FEW
    ) -> Generator[R, None, None]:
        """What an ``engine`` makes of each task, as they end, counted by a ``Pace``; the ledger is that of ``out``.

        ``called`` is what tasks are, in the plural. Raises ``UsageError`` as ``crew``, else as ``Engine.run``.
        """
        engine = replace(engine, crew=self.crew(len(tasks), few), limits=self.limits)
        ledger = Ledger(ledger_folder(out, self.ledger))
        with ledger, progress_bar() as bar, closing(engine.run(tasks, ledger)) as ends:
            pace = Pace(bar, called, len(tasks))
            for result in ends:
                yield result
                pace.count(engine.entry(result).state)


ALONE = Share()
"""All tasks, on this machine, any time and memory."""
