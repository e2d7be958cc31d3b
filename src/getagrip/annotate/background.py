"""Work that takes longer than a request: in one thread, one piece after the other, with its progress."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from threading import Event, Lock

from getagrip.errors import GetagripError


class CancelledError(Exception):
    """Raised within work that was cancelled."""


@dataclass
class BackgroundJob:
    """A piece of work and its progress."""

    what: str
    """In a word: "propagate", "files"."""
    state: str = "waiting"
    """Then "running", and at last "done", "failed" or "cancelled"."""
    done: int = 0
    total: int = 0
    message: str = ""
    """Error, or a description of the output."""
    stop: Event = field(default_factory=Event)

    def report(self, done: int, total: int) -> None:
        """Note the progress. Raises ``CancelledError`` once the work was cancelled."""
        self.done, self.total = done, total
        if self.stop.is_set():
            raise CancelledError

    def status(self) -> dict[str, object]:
        """Return the fields that the page shows."""
        return {key: getattr(self, key) for key in ("what", "state", "done", "total", "message")}


Work = Callable[[BackgroundJob], str]
"""Does it, and says in words what was made."""


class BackgroundQueue:
    """The last job of each thing that was worked on."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1)
        self._jobs: dict[str, BackgroundJob] = {}
        self._lock = Lock()

    def start(self, key: str, what: str, work: Work) -> None:
        """Start work on something, and cancel what is in progress on it."""
        job = BackgroundJob(what)
        with self._lock:
            if (old := self._jobs.get(key)) is not None:
                old.stop.set()
            self._jobs[key] = job
        self._pool.submit(_run_background_job, job, work)

    def cancel(self, key: str) -> None:
        """Cancel the work on something."""
        if (job := self._jobs.get(key)) is not None:
            job.stop.set()

    def job(self, key: str) -> BackgroundJob | None:
        """Return the last job."""
        return self._jobs.get(key)

    def close(self) -> None:
        """End everything, and wait until it has ended."""
        for job in list(self._jobs.values()):
            job.stop.set()
        self._pool.shutdown()


def _run_background_job(job: BackgroundJob, work: Work) -> None:
    try:
        job.report(0, 0)
        job.state = "running"
        job.message = work(job)
        job.state = "done"
    except CancelledError:
        job.state = "cancelled"
    except (GetagripError, OSError, MemoryError) as error:
        job.state, job.message = "failed", str(error)
    except Exception as error:  # nobody sees a thread's errors: the page shows them
        job.state, job.message = "failed", f"an error of the program: {type(error).__name__}: {error}"
