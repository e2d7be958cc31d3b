"""The options of commands that share their tasks out through a ledger."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from getagrip.io.arguments import Flag

if TYPE_CHECKING:
    from getagrip.batch.share import Share


@dataclass(frozen=True, kw_only=True)
class Sharing:
    """As for reconstruct; a task is a clip, or what one process reads of a dataset."""

    workers: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: one per core)")] = None
    """Processes to share the work between."""
    limit_seconds: Annotated[float | None, arg(metavar="S", help_behavior_hint="(default: none)")] = None
    """What takes longer is left behind: a clip with all its methods, or a part of a dataset."""
    limit_gb: Annotated[float | None, arg(metavar="GB", help_behavior_hint="(default: none)")] = None
    """What wants more memory in its process is left behind (Linux)."""
    fail_fast: Flag = False
    """Begin nothing else once something has failed."""
    shard: Annotated[str | None, arg(metavar="I/N", help_behavior_hint="(default: all)")] = None
    """Of N equal parts of the work only the I-th, for N machines."""

    def share(self) -> Share:
        """Them, checked. Raises ``UsageError``."""
        from getagrip.batch.limits import Limits
        from getagrip.batch.plan import ALL, Shard
        from getagrip.batch.share import Share

        limits = Limits(self.limit_seconds, self.limit_gb)
        shard = ALL if self.shard is None else Shard.of(self.shard)
        return Share(workers=self.workers, limits=limits, fail_fast=self.fail_fast, shard=shard)
