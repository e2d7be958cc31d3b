"""How a call shares its tasks out: over how many processes, within which limits, and which part of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

from getagrip.batch.crew import Start
from getagrip.batch.limits import NONE, Limits
from getagrip.batch.plan import ALL, Shard
from getagrip.batch.pool import cores
from getagrip.batch.processes import Processes
from getagrip.errors import UsageError


@dataclass(frozen=True, kw_only=True)
class Share:
    """Of one call. Raises ``UsageError`` for fewer than one worker."""

    workers: int | None = None
    """None: one for each core, where there are more than a few tasks."""
    limits: Limits = NONE
    """Of each task."""
    fail_fast: bool = False
    """Begin no other task once one has failed."""
    shard: Shard = ALL
    """Of the tasks by name."""

    def __post_init__(self) -> None:
        if self.workers is not None and self.workers < 1:
            raise UsageError(f"--workers: got {self.workers}, expected 1 or more")

    def crew(self, count: int, few: int) -> Start[Any, Any] | None:
        """Who does so many tasks; None: this process, as by default for a ``few`` without limits."""
        workers = min(count, self.workers or (1 if count <= few else cores()))
        return None if workers <= 1 and not self.limits else partial(Processes, max(workers, 1))


ALONE = Share()
"""All tasks, any time and memory."""
