"""Limits of the time and memory of one job: a clip that needs more fails, and is named."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Annotated

from tyro.conf import arg

from getagrip.errors import UsageError

MAX_JOB_LIMIT = 1e6
"""Most seconds and GB: the kernel and the clock count no farther than some thousand times as many."""


@dataclass(frozen=True)
class Limits:
    """The limits of each job.

    Raises ``UsageError`` for limits that are no positive numbers, or that cannot be held here.
    """

    seconds: Annotated[float | None, arg(name="limit-seconds", metavar="S", help_behavior_hint="(default: none)")] = (
        None
    )
    """Time limit of a clip (in bench, with all its methods) or of a part of a dataset [s]."""
    gigabytes: Annotated[float | None, arg(name="limit-gb", metavar="GB", help_behavior_hint="(default: none)")] = None
    """Memory limit of each process [10^9 bytes] (Linux only)."""

    def __post_init__(self) -> None:
        for option, value in (("--limit-seconds", self.seconds), ("--limit-gb", self.gigabytes)):
            if value is not None and not (0.0 < value <= MAX_JOB_LIMIT):
                raise UsageError(f"{option} must be above 0 and at most {MAX_JOB_LIMIT:g} (got {value:g})")
        if self.gigabytes is not None and sys.platform != "linux":
            raise UsageError(
                f"--limit-gb cannot be used with {sys.platform}: only Linux limits the memory of a process"
            )

    def __bool__(self) -> bool:
        return self.seconds is not None or self.gigabytes is not None

    @property
    def too_long(self) -> str:
        """Why a job was ended, in words."""
        return f"it took longer than {self.seconds:g} s (--limit-seconds)"

    @property
    def suspicion(self) -> str:
        """Why a process may have died."""
        return "out of memory?" if self.gigabytes is None else f"out of memory, {self.gigabytes:g} GB (--limit-gb)?"

    def enforce(self) -> None:
        """Limit the memory of this process, which is to do such jobs and nothing else."""
        if self.gigabytes is not None:
            import resource

            most = resource.getrlimit(resource.RLIMIT_DATA)[1]
            wanted = int(self.gigabytes * 1e9)
            resource.setrlimit(resource.RLIMIT_DATA, (wanted if most < 0 else min(wanted, most), most))


NO_LIMITS = Limits()
"""Any time, any memory."""
