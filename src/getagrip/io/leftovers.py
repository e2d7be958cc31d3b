"""Folders in which something is written before it takes its place, and what remains of them when a writer is killed.

A writer holds a lock on its folder as long as it lives, so a folder whose lock can be had is nobody's. Where there are
no locks, nothing is swept; where a file system has none, a folder looks alive to nobody.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from getagrip.io import locks

PREFIX = ".getagrip.new."
"""Prefix of the folders' names."""


@contextmanager
def workplace(parent: Path) -> Iterator[Path]:
    """Make an empty hidden folder, which is removed in the end."""
    while True:
        folder = Path(tempfile.mkdtemp(prefix=PREFIX, dir=parent))
        with suppress(FileNotFoundError):  # swept before it was locked
            lock = locks.locked(folder, wait=True)
            if folder.exists():
                break
            locks.release(lock)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        locks.release(lock)


def restore(folder: Path) -> None:
    """Put what stands in ``old/`` of a workplace back where it was, unless something newer has taken its place."""
    if (folder / "old").is_symlink():  # a stranger's: what it leads to stays where it is
        return
    for old in (folder / "old").glob("*"):
        target = folder.parent / old.name
        if not os.path.lexists(target):
            os.rename(old, target)


def sweep(parent: Path) -> list[Path]:
    """Remove this user's workplaces whose writers are dead, and return them; restore folders being replaced."""
    swept = []
    for folder in parent.glob(f"{PREFIX}*") if locks.KNOWN else ():
        if folder.is_symlink() or not folder.is_dir():
            continue
        try:
            if folder.stat().st_uid != os.geteuid():
                continue
            lock = locks.locked(folder, wait=False)
        except OSError:  # it lives, or is another user's, or gone
            continue
        try:
            restore(folder)
            shutil.rmtree(folder, ignore_errors=True)
            swept.append(folder)
        finally:
            locks.release(lock)
    return swept
