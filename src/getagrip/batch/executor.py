"""The executor's interface: processes on this machine or those of a cluster do the jobs that ``pool`` submits."""

from __future__ import annotations

import socket
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, Protocol, TypeVar

from getagrip.batch.limits import Limits
from getagrip.errors import GetagripError
from getagrip.io import code, plugins

J = TypeVar("J")
R = TypeVar("R")

DIES = "its process died"
TRIES = 4
"""Machines that a cluster may lose under a job before it counts as one whose process dies."""


@dataclass(frozen=True)
class Ended(Generic[J, R]):
    """A job that needs no more work."""

    job: J
    result: R | None
    """Return value of the work; None where its process died or was ended."""
    why: str = ""
    """Why there is none."""
    seconds: float = 0.0
    """Wall time of the last attempt."""
    attempts: int = 1
    process: int = 0
    machine: str = field(default_factory=socket.gethostname)
    """Host name of the process."""


class Executor(Protocol[J, R]):
    """Does jobs, several at once. What the work raises, ``wait`` raises."""

    @property
    def capacity(self) -> int:
        """How many more jobs it can begin now."""
        ...

    @property
    def busy(self) -> int:
        """How many jobs are at work."""
        ...

    def submit(self, job: J, attempt: int) -> None:
        """Begin a job, for the so-manieth time; only where there is room."""
        ...

    def wait(self, nap: float | None) -> list[Ended[J, R]]:
        """Wait for the jobs that end next; none, when the ``nap`` is over [s] or no job is running.

        ``DIES`` is why a job has ended whose process was lost, maybe by the job's own fault.
        """
        ...

    def close(self) -> None:
        """Let all finish their jobs and go."""
        ...


def check_code(expected: str) -> None:
    """Raise ``GetagripError`` where this machine has another getagrip than the one that gave out the jobs."""
    if plugins.fingerprint() != expected:
        here = f"{code.PACKAGE} on {socket.gethostname()}"
        got = f"getagrip of other code ({plugins.fingerprint()})"
        raise GetagripError(f"{here} must be the same on every machine, {expected} (got {got})")


Start = Callable[[Callable[[J], R], Limits, Callable[[], object] | None], Executor[J, R]]
"""Makes an executor from the work, the limits of a job and the function that each process calls first."""
