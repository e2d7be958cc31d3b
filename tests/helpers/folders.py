"""What a folder holds, and a disk that is full.

A disk that is full from some write on, or for one write: for the writes of Python and of SQLite in this process.

What a command writes, and copies of a folder in which such names are links to a user's other files.
"""

from __future__ import annotations

import errno
import io
import os
import shutil
import sqlite3
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

FullDisk = Callable[[int], AbstractContextManager[None]]


def contents(folder: Path) -> dict[str, bytes]:
    """All files below a folder, hidden ones too: their bytes by their paths."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def results_in(folder: Path) -> list[Path]:
    """The result folders in a folder, sorted."""
    return sorted(path.parent for path in folder.glob("*/result.json"))


CHANGES = ("INSERT", "UPDATE", "DELETE", "CREATE", "COMMIT", "PRAGMA journal_mode")
"""SQL that takes place on a disk."""


class FailingDisk:
    """Counts the writes of this process from 1, and lets those from the ``first`` to the ``last`` fail."""

    def __init__(self, patch: pytest.MonkeyPatch, first: int, last: int) -> None:
        self.writes, self.first, self.last = 0, first, last
        disk, real_open, real_mkdir, connect = self, io.open, os.mkdir, sqlite3.connect

        def opened(file: Any, mode: str = "r", *args: Any, **more: Any) -> Any:
            writes = bool({*mode} & {*"wax+"}) and not isinstance(file, int)
            if writes:
                disk.count(file)
            stream = real_open(file, mode, *args, **more)
            if not writes:
                return stream
            write = stream.write
            return _Writer(stream, lambda content: (disk.count(file), write(content))[1])

        def mkdir(path: Any, *args: Any, **more: Any) -> None:
            disk.count(path)
            real_mkdir(path, *args, **more)

        class Connection(sqlite3.Connection):
            def execute(self, sql: str, *args: Any) -> sqlite3.Cursor:
                if sql.startswith(CHANGES):
                    disk.count(None)
                return super().execute(sql, *args)

        def connected(path: Any, *args: Any, **more: Any) -> sqlite3.Connection:
            return connect(path, *args, **more, **({"factory": Connection} if path else {}))

        patch.setattr(io, "open", opened)
        patch.setattr("builtins.open", opened)
        patch.setattr(os, "mkdir", mkdir)
        patch.setattr(sqlite3, "connect", connected)

    def count(self, path: Any) -> None:
        """Count a write; raise what a full disk raises."""
        self.writes += 1
        if self.first <= self.writes <= self.last:
            if path is None:
                raise sqlite3.OperationalError("database or disk is full")
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))


class _Writer:
    """A file whose writes are counted."""

    def __init__(self, stream: Any, write: Any) -> None:
        self._stream, self.write = stream, write

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def __enter__(self) -> _Writer:
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.close()


SQLITE = ("-journal", "-wal", "-shm")

State = dict[str, tuple[int, bytes | None]]
"""By path: when it was changed [ns], and a file's bytes; None of a folder."""


def state(folder: Path) -> State:
    """All that is in a folder, links not followed."""
    found: State = {}
    for place, folders, names in os.walk(folder):
        for name in (*folders, *names):
            path = Path(place, name)
            content = None if name in folders or path.is_symlink() else path.read_bytes()
            found[path.relative_to(folder).as_posix()] = path.lstat().st_mtime_ns * (name not in folders), content
    return found


@dataclass(frozen=True)
class Written:
    """The names that a command has written in a folder."""

    before: Path
    """The folder as it was."""
    files: tuple[str, ...]
    folders: tuple[str, ...]
    """Those in which the files are, but for folders that the user has named."""

    @staticmethod
    def of(before: Path, after: Path, words: Iterable[object]) -> Written:
        """``words`` are those of the command, in which folders may be named."""
        old, new = state(before), state(after)
        files = sorted(name for name, it in new.items() if it[1] is not None and old.get(name) != it)
        named = {path.as_posix() for word in map(Path, map(str, words)) for path in (word, *word.parents)}
        made = {name for name, it in new.items() if it[1] is None and name not in old}
        around = {path.as_posix() for name in files for path in Path(name).parents}
        return Written(before, tuple(files), tuple(sorted((made | around) - named)))

    @property
    def databases(self) -> list[str]:
        """SQLite's files, and those that it writes beside them."""
        return [name + end for name in self.files if name.endswith(".sqlite") for end in ("", *SQLITE)]

    @property
    def others(self) -> list[str]:
        """The other files, and the names that were once those of their unfinished parts."""
        others = [name for name in self.files if not name.endswith(".sqlite")]
        parts = [Path(name).parent / f".{Path(name).name}.{os.getpid()}" for name in others]
        return others + [part.as_posix() for part in parts]


class Linked:
    """A copy of a folder, in which names are links to canaries, or to where nothing is."""

    def __init__(self, written: Written, place: Path) -> None:
        self.folder, self._written = place / "work", written
        self._canaries, self._nowhere = place / "canaries", place / "nowhere"
        shutil.copytree(written.before, self.folder, symlinks=True)
        for folder in (self._canaries, self._nowhere):
            folder.mkdir()

    def link(self, names: Iterable[str], dangling: bool) -> None:
        """Replace names by links. What was there already is the canary, also where a new name would dangle."""
        for n, name in enumerate(names):
            path, old = self.folder / name, self._written.before / name
            canary = self._canaries / f"{n}-{path.name}"
            if old.is_dir():
                shutil.copytree(old, canary)
                shutil.rmtree(path)
            elif old.exists():
                shutil.copy2(old, canary)
                path.unlink()
            elif dangling:
                canary = self._nowhere / f"{n}"
            elif name in self._written.folders:
                canary.mkdir()
                (canary / "own").write_bytes(b"another file of the user's")
            else:
                canary.write_bytes(b"another file of the user's")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.symlink_to(canary)
        self._before = self._outside()

    def leaks(self) -> list[str]:
        """The names outside of the folder that were written or removed since they were linked."""
        after = self._outside()
        return sorted(name for name in self._before.keys() | after.keys() if self._before.get(name) != after.get(name))

    def _outside(self) -> State:
        places = {"canaries": self._canaries, "nowhere": self._nowhere}
        return {f"{place}/{name}": it for place, folder in places.items() for name, it in state(folder).items()}
