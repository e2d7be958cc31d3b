"""Folders in which something is written before it takes its place, and what remains of them when a writer is killed.

A writer holds a lock on its folder as long as it lives. The kernel drops the lock with the process, however that ends,
so a folder whose lock can be had is nobody's.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

try:
    import fcntl
except ImportError:  # no POSIX: nothing is locked, and nothing swept
    fcntl = None  # type: ignore[assignment]

PREFIX = ".getagrip.new."
"""Of the folders' names."""


@contextmanager
def workplace(parent: Path) -> Iterator[Path]:
    """An empty hidden folder, which is removed in the end."""
    while True:
        folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=parent))
        with suppress(FileNotFoundError):  # swept before it was locked
            lock = _locked(folder, wait=True)
            if folder.exists():
                break
            _release(lock)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        _release(lock)


def restore(folder: Path) -> None:
    """Put what stands in ``old/`` of a workplace back where it was, unless something newer has taken its place."""
    for old in (folder / "old").glob("*"):
        target = folder.parent / old.name
        if not target.exists():
            os.rename(old, target)


def sweep(parent: Path) -> list[Path]:
    """Remove this user's workplaces whose writers no longer live, and return them. A replaced folder returns."""
    swept = []
    for folder in parent.glob(f"{PREFIX}*") if fcntl is not None else ():
        if folder.is_symlink() or not folder.is_dir():
            continue
        try:
            if folder.stat().st_uid != os.geteuid():
                continue
            lock = _locked(folder, wait=False)
        except OSError:  # it lives, or is another user's, or gone
            continue
        try:
            restore(folder)
            shutil.rmtree(folder, ignore_errors=True)
            swept.append(folder)
        finally:
            _release(lock)
    return swept


def _locked(folder: Path, wait: bool) -> int | None:
    """A descriptor that locks a folder until it is closed; None where folders cannot be locked.

    Raises ``OSError`` where it is locked already and we do not ``wait``.
    """
    if fcntl is None:
        return None
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError:
        os.close(descriptor)
        if wait:  # a file system without locks: it looks alive to nobody, see ``sweep``
            return None
        raise
    return descriptor


def _release(lock: int | None) -> None:
    if lock is not None:
        os.close(lock)
