"""Which clips another run is at work on: a lock for each result, which ends with the process that holds it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ModuleNotFoundError:  # not on Windows, where two runs may do the same clip
    fcntl = None  # type: ignore[assignment]


@contextmanager
def claim(result: Path, wait: bool) -> Iterator[bool]:
    """Hold the place of a result. Gives False, at once, where another process holds it and is not to be waited for.

    Where the file system has no locks, it is as if nobody held it. Raises ``OSError`` where no file can be made.
    """
    lock = result.with_name(f".{result.name}.lock")
    lock.parent.mkdir(parents=True, exist_ok=True)
    with lock.open("w") as file:
        if fcntl is not None:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            except BlockingIOError:
                yield False
                return
            except OSError:  # no locks here
                pass
        yield True
        with suppress(OSError):
            lock.unlink()
