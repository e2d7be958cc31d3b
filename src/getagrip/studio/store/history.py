"""Versioned states in SQLite: each change adds a version, and no version is overwritten or removed.

The newest version is the state. A change names only the fields that it sets, and is applied to the newest version: two
tabs may change different fields of one state; of two changes of the same field the later one counts, and the earlier
one stays in the history.
"""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import Field, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from threading import Lock
from types import UnionType
from typing import Any, ClassVar, Generic, Protocol, TypeVar, get_origin, get_type_hints

from getagrip.errors import GetagripError, InputError
from getagrip.io.files import Json, is_portable_name, shorten_value

TOKEN_PATTERN = re.compile(r"[A-Za-z0-9-]{8,64}")
"""Form of the page's names of marks, changes and tabs."""
Row = tuple[Any, ...]
"""Row of a database: SQLite stores values of any type in any column."""


class RefusedError(GetagripError):
    """A change that cannot be made. The message is for the annotator."""


class VersionedState(Protocol):
    """One annotator's state of a task; a frozen dataclass."""

    __dataclass_fields__: ClassVar[dict[str, Field[object]]]

    @property
    def task(self) -> str: ...
    @property
    def annotator(self) -> str: ...
    @property
    def deleted(self) -> bool: ...


Kind = TypeVar("Kind", bound=VersionedState)


@dataclass(frozen=True)
class Change:
    """A change of some fields of a state, so that two tabs can change the same one."""

    change: str
    """Unique name: the page sends a change again until it is answered."""
    tab: str
    """The browser tab that made the change."""
    sets: Json
    """New values of fields."""


class VersionDatabase:
    """An SQLite file, for any number of threads and processes."""

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        self.path, self.connection = path, connection
        self.lock = Lock()

    def rows(self, query: str, values: Sequence[object] = ()) -> list[Row]:
        """Return the rows of a query. Raises ``InputError`` where the file is damaged."""
        try:
            with self.lock:
                return self.connection.execute(query, values).fetchall()
        except (sqlite3.DatabaseError, UnicodeDecodeError) as error:  # the latter: a message of damaged text
            raise self.damaged(error) from error

    def damaged(self, error: Exception) -> InputError:
        """Return the error for contents that this program does not write."""
        got = f"{type(error).__name__}: {error}"
        return InputError(self.path, "", f"contents that are damaged ({got})", "what this program writes")

    @contextmanager
    def transaction(self) -> Iterator[sqlite3.Connection]:
        """Open a transaction: all or nothing, without other writers in between."""
        with self.lock:
            self.connection.execute("BEGIN IMMEDIATE")
            try:
                yield self.connection
            except BaseException:
                self.connection.execute("ROLLBACK")
                raise
            self.connection.execute("COMMIT")


@dataclass(frozen=True)
class Versions(Generic[Kind]):
    """The versions of one kind of states, in a table, and a view of the current states."""

    database: VersionDatabase
    table: str
    view: str
    """Newest versions of the states that are not deleted."""
    key: str
    """Key column: rows with the same value are versions of one state."""
    scope: str
    """Column of the scope within which changes are undone, and states are queried."""
    order: str
    """Columns by which states are sorted."""
    columns: tuple[str, ...]
    row: Callable[[Kind], Row]
    """Convert a state to its columns."""
    state: Callable[[Row], Kind]
    """Convert a row to a state."""

    def standing(self, scope: str | None = None, annotator: str | None = None) -> list[Kind]:
        """Return the current states, in order, of one scope or annotator where named. Raises ``InputError``."""
        rows = self.database.rows(
            f"SELECT {', '.join(self.columns)} FROM {self.view} WHERE (?1 IS NULL OR {self.scope} = ?1) "
            f"AND (?2 IS NULL OR annotator = ?2) ORDER BY {self.order}",
            (scope, annotator),
        )
        return [self._state(row) for row in rows]

    def newest(self, scope: str, annotator: str) -> int:
        """Return a number that grows with every change of an annotator's states of a scope."""
        query = f"SELECT coalesce(max(seq), 0) FROM {self.table} WHERE {self.scope} = ? AND annotator = ?"
        return int(self.database.rows(query, (scope, annotator))[0][0])

    def times(self, scope: str, annotator: str) -> list[datetime]:
        """Return the times of an annotator's changes within a scope, the oldest first. Raises ``InputError``."""
        query = f"SELECT at FROM {self.table} WHERE {self.scope} = ? AND annotator = ? ORDER BY seq"
        try:
            return [datetime.fromisoformat(at) for (at,) in self.database.rows(query, (scope, annotator))]
        except (TypeError, ValueError) as error:
            raise self.database.damaged(error) from error

    def history(self, key: str) -> list[Kind]:
        """Return all versions of a state, the oldest first."""
        query = f"SELECT {', '.join(self.columns)} FROM {self.table} WHERE {self.key} = ? ORDER BY seq"
        return [self._state(row) for row in self.database.rows(query, (key,))]

    def apply(self, change: Change, blank: Kind, complete: Callable[[Kind, Json], Kind]) -> Kind:
        """Make a change of the newest version, or of ``blank`` without versions; a repeated change has no effect.

        ``complete`` returns the new state from the old one and the new values. Raises ``RefusedError``, as ``complete``
        may, without a change.
        """
        with self.database.transaction() as db:
            key = getattr(blank, self.key)
            latest = self._latest(db, key)
            if latest is not None and (latest.task, latest.annotator) != (blank.task, blank.annotator):
                raise RefusedError(f"the {self.key} belongs to another task or annotator")
            if db.execute(f"SELECT 1 FROM {self.table} WHERE change = ?", (change.change,)).fetchone():
                if latest is None:
                    raise RefusedError(f"the change was made to another {self.key}")
                return latest
            new = complete(latest or blank, change.sets)
            self._add(db, new, change.change, change.tab, None)
            return new

    def undo(self, scope: str, annotator: str, tab: str, change: str) -> Kind | None:
        """Undo a tab's last change within a scope; return the state after it, or None without a change to undo.

        Raises ``RefusedError`` where another tab has changed the state since.
        """
        with self.database.transaction() as db:
            if db.execute(f"SELECT 1 FROM {self.table} WHERE change = ?", (change,)).fetchone():
                return None  # a repeated request
            last = db.execute(
                f"SELECT seq, {self.key} FROM {self.table} AS v WHERE {self.scope} = ? AND annotator = ? AND tab = ? "
                f"AND undoes IS NULL AND NOT EXISTS (SELECT 1 FROM {self.table} WHERE undoes = v.seq) "
                "ORDER BY seq DESC LIMIT 1",
                (scope, annotator, tab),
            ).fetchone()
            if last is None:
                return None
            seq, key = last
            later = f"SELECT 1 FROM {self.table} WHERE {self.key} = ? AND seq > ? AND tab != ?"
            if db.execute(later, (key, seq, tab)).fetchone():
                raise RefusedError(f"not undone: this {self.key} was changed in another tab since")
            old = self._latest(db, key, seq)
            if old is None:  # that change made the state
                now = self._latest(db, key)
                assert now is not None
                old = replace(now, deleted=True)
            self._add(db, old, change, tab, seq)
            return old

    def _latest(self, db: sqlite3.Connection, key: str, before: int | None = None) -> Kind | None:
        """Return the newest version of a state, or the newest before a version."""
        row = db.execute(
            f"SELECT {', '.join(self.columns)} FROM {self.table} WHERE {self.key} = ?1 AND (?2 IS NULL OR seq < ?2) "
            "ORDER BY seq DESC LIMIT 1",
            (key, before),
        ).fetchone()
        return None if row is None else self._state(row)

    def _state(self, row: Row) -> Kind:
        """Convert a row to a state. Raises ``InputError`` for values of a wrong type or form."""
        try:
            state = self.state(row)
            check_annotator(state.annotator)
            for name, hint in get_type_hints(type(state)).items():
                kind = hint if isinstance(hint, UnionType) else get_origin(hint) or hint
                if not isinstance(value := getattr(state, name), kind):
                    raise ValueError(f"{name}: {shorten_value(value)}")
        except (RefusedError, ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
            raise self.database.damaged(error) from error
        return state

    def _add(self, db: sqlite3.Connection, state: Kind, change: str, tab: str, undoes: int | None) -> None:
        now = datetime.now(UTC).isoformat(timespec="milliseconds")
        holes = ", ".join("?" * (4 + len(self.columns)))
        db.execute(
            f"INSERT INTO {self.table} (change, tab, at, undoes, {', '.join(self.columns)}) VALUES ({holes})",
            (change, tab, now, undoes, *self.row(state)),
        )


def read_change(content: Mapping[str, object], settable: frozenset[str]) -> Change:
    """Parse a change in a request; its values are not checked. Raises ``RefusedError``."""
    sets = content.get("set")
    if not isinstance(sets, dict) or not sets or not sets.keys() <= settable:
        raise RefusedError(f"set must be some of {', '.join(sorted(settable))} (got {shorten_value(sets)})")
    return Change(parse_token(content, "change"), parse_token(content, "tab"), sets)


def parse_token(content: Mapping[str, object], key: str) -> str:
    """Parse a name made by the page, such as a change's. Raises ``RefusedError``."""
    value = content.get(key)
    if not isinstance(value, str) or not TOKEN_PATTERN.fullmatch(value):
        raise RefusedError(f"{key} must be 8 to 64 letters, digits or hyphens (got {shorten_value(value)})")
    return value


def check_annotator(name: object) -> str:
    """Check an annotator's name, which also names files. Raises ``RefusedError``."""
    if not isinstance(name, str) or not is_portable_name(name) or len(name) > 60:
        needs = "annotator must be a name of up to 60 letters, without / and \\"
        raise RefusedError(f"{needs} (got {shorten_value(name)})")
    return name
