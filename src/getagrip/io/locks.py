"""Locks on files and folders. The kernel drops a lock with the process that holds it, however that ends."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

try:
    import fcntl
except ImportError:  # no POSIX: nothing is locked
    fcntl = None  # type: ignore[assignment]

HAS_FILE_LOCKS = fcntl is not None
"""True if this system has locks."""


@contextmanager
def hold_lock(path: Path) -> Iterator[None]:
    """Hold the lock of a file or folder, after waiting for it; go on without where it cannot be locked."""
    lock = acquire_lock(path, wait=True)
    try:
        yield
    finally:
        release_lock(lock)


def acquire_lock(path: Path, wait: bool) -> int | None:
    """Lock a file or folder until the descriptor is closed; None where it cannot be locked.

    Raises ``OSError`` where it is not there, and where it is locked already and we do not ``wait``.
    """
    if fcntl is None:
        return None
    descriptor = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError:
        os.close(descriptor)
        if wait:  # a file system without locks
            return None
        raise
    return descriptor


def release_lock(lock: int | None) -> None:
    """Give back what ``acquire_lock`` has returned."""
    if lock is not None:
        os.close(lock)
