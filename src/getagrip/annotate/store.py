"""Marks in an SQLite file. Every change adds a version and none is ever overwritten or removed.

The newest version of a mark is its state. A change names the fields that a person has touched and is laid over the
newest version, so two tabs that change one mark lose nothing unless they change the same field; then the later one
counts and the earlier one is in the history.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import astuple, replace
from datetime import UTC, datetime
from pathlib import Path
from threading import Lock
from typing import Any

from getagrip.annotate.marks import COLUMNS, Change, Mark, RefusedError
from getagrip.errors import InputError

VERSION = 1
"""Of the tables, kept as the file's ``user_version``."""
APPLICATION = 0x67616772
"""The file's ``application_id``: "gagr"."""
SCHEMA = """
CREATE TABLE versions (
    seq INTEGER PRIMARY KEY AUTOINCREMENT,
    change TEXT NOT NULL UNIQUE, tab TEXT NOT NULL, at TEXT NOT NULL,
    undoes INTEGER REFERENCES versions (seq),
    mark TEXT NOT NULL, task TEXT NOT NULL, annotator TEXT NOT NULL,
    start INTEGER, end INTEGER, side TEXT, category TEXT, entity TEXT, reason TEXT, deleted INTEGER NOT NULL,
    start_number INTEGER, end_number INTEGER, seconds REAL
);
CREATE INDEX versions_of_mark ON versions (mark, seq);
CREATE INDEX versions_of_task ON versions (task, annotator, tab);
CREATE VIEW marks AS SELECT * FROM versions AS v
    WHERE seq = (SELECT max(seq) FROM versions WHERE mark = v.mark) AND NOT deleted;
"""
_STATE = ", ".join(COLUMNS)

Complete = Callable[[Mark, Mapping[str, Any]], Mark]
"""A mark and what to set, to the mark that is kept. May refuse."""


class Store:
    """The marks of one file, for any number of threads and processes."""

    def __init__(self, path: Path) -> None:
        """Open the file, or make it. Raises ``InputError`` where it is something else."""
        self.path = path
        self._lock = Lock()
        try:
            self._db = sqlite3.connect(path, timeout=20.0, isolation_level=None, check_same_thread=False)
            with self._transaction():
                (version,) = self._db.execute("PRAGMA user_version").fetchone()
                (tables,) = self._db.execute("SELECT count(*) FROM sqlite_master").fetchone()
                if not tables and not version:
                    for statement in SCHEMA.split(";\n"):
                        self._db.execute(statement)
                    self._db.execute(f"PRAGMA user_version = {VERSION}")
                    self._db.execute(f"PRAGMA application_id = {APPLICATION}")
                    return
                (application,) = self._db.execute("PRAGMA application_id").fetchone()
        except sqlite3.Error as error:
            raise InputError(path, "", f"a file that is no database of marks ({error})", "one made here") from error
        if application != APPLICATION or version != VERSION:
            raise InputError(path, "", f"a database of another kind or version ({version})", f"version {VERSION}")

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            self._db.close()

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        """All or nothing, and nobody else in between."""
        with self._lock:
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield
            except BaseException:
                self._db.execute("ROLLBACK")
                raise
            self._db.execute("COMMIT")

    def marks(self, task: str | None = None, annotator: str | None = None) -> list[Mark]:
        """The marks that stand, in order of task, annotator and start; of one task or annotator where named."""
        with self._lock:
            rows = self._db.execute(
                f"SELECT {_STATE} FROM marks WHERE (?1 IS NULL OR task = ?1) AND (?2 IS NULL OR annotator = ?2) "
                "ORDER BY task, annotator, start, mark",
                (task, annotator),
            ).fetchall()
        return [_mark(row) for row in rows]

    def newest(self, task: str, annotator: str) -> int:
        """A number that grows with every change of somebody's marks of a task."""
        with self._lock:
            query = "SELECT coalesce(max(seq), 0) FROM versions WHERE task = ? AND annotator = ?"
            return int(self._db.execute(query, (task, annotator)).fetchone()[0])

    def history(self, mark: str) -> list[Mark]:
        """All states that a mark was in, the oldest first."""
        with self._lock:
            rows = self._db.execute(f"SELECT {_STATE} FROM versions WHERE mark = ? ORDER BY seq", (mark,)).fetchall()
        return [_mark(row) for row in rows]

    def apply(self, change: Change, complete: Complete) -> Mark:
        """Make a change, once, however often it is sent. Raises ``RefusedError``, and then nothing is changed."""
        with self._transaction():
            latest = self._latest(change.mark)
            if latest is not None and (latest.task, latest.annotator) != (change.task, change.annotator):
                raise RefusedError("the mark belongs to another task or annotator")
            if self._db.execute("SELECT 1 FROM versions WHERE change = ?", (change.change,)).fetchone():
                if latest is None:
                    raise RefusedError("the change was made to another mark")
                return latest
            new = complete(latest or Mark(change.mark, change.task, change.annotator), change.sets)
            self._add(new, change.change, change.tab, None)
            return new

    def undo(self, task: str, annotator: str, tab: str, change: str) -> Mark | None:
        """Take back a tab's last change of a task; the mark as it is then, or None where nothing is left to take back.

        Raises ``RefusedError`` where the mark was changed elsewhere since: that is not undone from here.
        """
        with self._transaction():
            if self._db.execute("SELECT 1 FROM versions WHERE change = ?", (change,)).fetchone():
                return None  # sent again
            last = self._db.execute(
                "SELECT seq, mark FROM versions AS v WHERE task = ? AND annotator = ? AND tab = ? AND undoes IS NULL "
                "AND NOT EXISTS (SELECT 1 FROM versions WHERE undoes = v.seq) ORDER BY seq DESC LIMIT 1",
                (task, annotator, tab),
            ).fetchone()
            if last is None:
                return None
            seq, mark = last
            later = "SELECT 1 FROM versions WHERE mark = ? AND seq > ? AND tab != ?"
            if self._db.execute(later, (mark, seq, tab)).fetchone():
                raise RefusedError("not undone: this mark was changed in another tab since")
            before = self._latest(mark, seq)
            old = replace(self._latest(mark) or Mark(mark, task, annotator), deleted=True) if before is None else before
            self._add(old, change, tab, seq)
            return old

    def _latest(self, mark: str, before: int | None = None) -> Mark | None:
        """The newest state of a mark, or the newest before a version."""
        row = self._db.execute(
            f"SELECT {_STATE} FROM versions WHERE mark = ?1 AND (?2 IS NULL OR seq < ?2) ORDER BY seq DESC LIMIT 1",
            (mark, before),
        ).fetchone()
        return None if row is None else _mark(row)

    def _add(self, mark: Mark, change: str, tab: str, undoes: int | None) -> None:
        now = datetime.now(UTC).isoformat(timespec="milliseconds")
        holes = ", ".join("?" * (4 + len(COLUMNS)))
        self._db.execute(
            f"INSERT INTO versions (change, tab, at, undoes, {_STATE}) VALUES ({holes})",
            (change, tab, now, undoes, *astuple(mark)),
        )


def _mark(row: tuple[Any, ...]) -> Mark:
    values = dict(zip(COLUMNS, row, strict=True))
    return Mark(**values | {"deleted": bool(values["deleted"])})
