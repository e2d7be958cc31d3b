"""SQLite files of ours, opened only once it is known that they are ours: folders of strangers may hold other files."""

from __future__ import annotations

import os
import sqlite3
from pathlib import Path
from urllib.parse import quote

from getagrip.errors import InputError

SQLITE_MAGIC = b"SQLite format 3\0"
APPLICATION_ID = slice(68, 72)
"""Bytes at a file's start that say which application made it, as a big-endian number (SQLite's file format, 1.3)."""
SQLITE_LOG_SUFFIXES = ("-journal", "-wal", "-shm")
"""Suffixes of the files that SQLite writes beside a database."""


def connect(
    path: Path, application: int, what: str, *, timeout: float, shared: bool = False, read_only: bool = False
) -> sqlite3.Connection:
    """Open a database of an application, or a new file; nothing of another's is changed.

    ``shared``: threads may share the connection. ``read_only``: nothing is changed or made. Raises ``InputError`` for
    links and for files of something else, and ``sqlite3.Error``.
    """
    for file in (path, *(path.with_name(path.name + end) for end in SQLITE_LOG_SUFFIXES)):
        if file.is_symlink() or (file.exists() and not file.is_file()):
            raise InputError(file, "", "a link or a folder", f"{what}; move it away")
    if path.exists() and path.stat().st_size:
        with path.open("rb") as stream:
            head = stream.read(100)
        # 0 is that of a file of ours whose first transaction is still beside it.
        if not head.startswith(SQLITE_MAGIC) or int.from_bytes(head[APPLICATION_ID], "big") not in (application, 0):
            raise InputError(path, "", "a file of another program", what)
    name = _read_only_uri(path) if read_only else path
    connection = sqlite3.connect(
        name, timeout=timeout, isolation_level=None, check_same_thread=not shared, uri=read_only
    )
    try:
        connection.execute("PRAGMA trusted_schema = OFF")
        (tables,) = connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
        (found,) = connection.execute("PRAGMA application_id").fetchone()
        if tables and found != application:
            raise InputError(path, "", f"a database of another program ({found})", what)
    except BaseException:
        connection.close()
        raise
    return connection


def _read_only_uri(path: Path) -> str:
    """Return an address that opens a file for reading only: SQLite would leave new files beside one without a log."""
    log = path.with_name(f"{path.name}-wal")
    mode = "mode=ro" if log.exists() and log.stat().st_size else "immutable=1"
    return f"file:{quote(os.fsencode(path.absolute()))}?{mode}"
