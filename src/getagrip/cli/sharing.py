"""The options of commands that share their tasks out through a ledger."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import arg

from getagrip.io.arguments import Flag, OptionalFolder

if TYPE_CHECKING:
    from getagrip.batch.share import Share


@dataclass(frozen=True, kw_only=True)
class Sharing:
    """Who does the tasks: clips, or what one process reads of a dataset."""

    workers: Annotated[int | None, arg(metavar="N", help_behavior_hint="(default: one per core)")] = None
    """Processes to share the tasks between; up to three clips to reconstruct, or parts of a dataset, need no other. On
    a Ray cluster, as many as it has CPUs; tasks of a Slurm array, 64."""
    engine: Literal["local", "ray", "slurm"] = "local"
    """Where they run: on this machine, on a Ray cluster, or in Slurm's array jobs. All machines must see what is read
    and written under the same paths."""
    address: Annotated[str | None, arg(metavar="ADDR", help_behavior_hint="(default: RAY_ADDRESS, else one here)")] = (
        None
    )
    """Ray cluster that runs: HOST:PORT, or auto."""
    limit_seconds: Annotated[float | None, arg(metavar="S", help_behavior_hint="(default: none)")] = None
    """What takes longer is left behind: a clip, in bench with all its methods, or a part of a dataset."""
    limit_gb: Annotated[float | None, arg(metavar="GB", help_behavior_hint="(default: none)")] = None
    """What wants more memory in its process is left behind (Linux)."""
    fail_fast: Flag = False
    """Begin nothing else once something has failed."""
    shard: Annotated[str | None, arg(metavar="I/N", help_behavior_hint="(default: all)")] = None
    """Of N equal parts of the work only the I-th, for N machines."""
    ledger: OptionalFolder = None
    """Local folder for the ledger, where --out is on a network file system."""

    def share(self) -> Share:
        """Them, checked. Raises ``UsageError``."""
        from getagrip.batch.limits import Limits
        from getagrip.batch.plan import ALL, Shard
        from getagrip.batch.share import Share

        return Share(
            workers=self.workers, engine=self.engine, address=self.address,
            limits=Limits(self.limit_seconds, self.limit_gb), fail_fast=self.fail_fast,
            shard=ALL if self.shard is None else Shard.of(self.shard), ledger=self.ledger,
        )  # fmt: skip
