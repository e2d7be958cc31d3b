"""A disk that is full from some write on, or for one write: for the writes of Python and of SQLite in this process."""

from __future__ import annotations

import errno
import io
import os
import sqlite3
from typing import Any

import pytest

CHANGES = ("INSERT", "UPDATE", "DELETE", "CREATE", "COMMIT", "PRAGMA journal_mode")
"""SQL that takes place on a disk."""


class FullDisk:
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
