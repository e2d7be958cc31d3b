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

TEMPORARY_FOLDER_PREFIX = ".getagrip.new."
"""Prefix of the folders' names."""


@contextmanager
def temporary_folder(parent: Path) -> Iterator[Path]:
    """Make an empty hidden folder, which is removed in the end."""
    while True:
        folder = Path(tempfile.mkdtemp(prefix=TEMPORARY_FOLDER_PREFIX, dir=parent))
        with suppress(FileNotFoundError):  # swept before it was locked
            lock = locks.acquire_lock(folder, wait=True)
            if folder.exists():
                break
            locks.release_lock(lock)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        locks.release_lock(lock)


def restore(folder: Path) -> None:
    """Put what stands in ``old/`` of a workplace back where it was, unless something newer has taken its place."""
    if (folder / "old").is_symlink():  # a stranger's: what it leads to stays where it is
        return
    for old in (folder / "old").glob("*"):
        target = folder.parent / old.name
        if not os.path.lexists(target):
            os.rename(old, target)


def remove_stale_folders(parent: Path) -> list[Path]:
    """Remove this user's workplaces whose writers are dead, and return them; restore folders being replaced."""
    swept = []
    for folder in parent.glob(f"{TEMPORARY_FOLDER_PREFIX}*") if locks.HAS_FILE_LOCKS else ():
        if folder.is_symlink() or not folder.is_dir():
            continue
        try:
            if folder.stat().st_uid != os.geteuid():
                continue
            lock = locks.acquire_lock(folder, wait=False)
        except OSError:  # it lives, or is another user's, or gone
            continue
        try:
            restore(folder)
            shutil.rmtree(folder, ignore_errors=True)
            swept.append(folder)
        finally:
            locks.release_lock(lock)
    return swept
