"""States with all their versions: a change adds one, and none is ever overwritten or removed.

The newest version is the state. A change names what a person has touched and is laid over the newest version, so two
tabs that change one thing lose nothing unless they touch the same part of it; then the later one counts and the earlier
one is in the history.
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
"""Row of a database: SQLite keeps any kind of value in any column."""


class RefusedError(GetagripError):
    """A change that cannot be made. The message is for the person who made it."""


class VersionedState(Protocol):
    """One annotator's state of a task; a frozen dataclass."""

    __dataclass_fields__: ClassVar[dict[str, Field[object]]]

    @property
    def task(self) -> str:
        """The task it belongs to."""

    @property
    def annotator(self) -> str:
        """Whose it is."""

    @property
    def deleted(self) -> bool:
        """True if it is deleted."""


Kind = TypeVar("Kind", bound=VersionedState)


@dataclass(frozen=True)
class Change:
    """A change of a state: only what a person has touched, so that two tabs can change the same one."""

    change: str
    """Unlike any other: the page sends a change again where it saw no answer."""
    tab: str
    sets: Json


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
        """Make the error for contents that this program does not write."""
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
    """The versions of one kind of states, in a table and in a view of those that stand."""

    database: VersionDatabase
    table: str
    view: str
    key: str
    """Column of the key: states with the same value are versions of one thing."""
    scope: str
    """Column of what is undone together, and asked for together."""
    order: str
    """Columns that states are sorted by."""
    columns: tuple[str, ...]
    row: Callable[[Kind], Row]
    """The columns of a state."""
    state: Callable[[Row], Kind]
    """Convert a row to a state."""

    def standing(self, scope: str | None = None, annotator: str | None = None) -> list[Kind]:
        """Return the states that stand, in order; of one scope or annotator where named."""
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
        """Return when an annotator changed states of a scope, the first change first."""
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
        """Make a change, once, however often it is sent: of the newest version, or of ``blank`` where there is none.

        Raises ``RefusedError``, as ``complete`` may, and then nothing is changed.
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
        """Take back a tab's last change within a scope; the state as it is then, or None where nothing is left.

        Raises ``RefusedError`` where it was changed elsewhere since: that is not undone from here.
        """
        with self.database.transaction() as db:
            if db.execute(f"SELECT 1 FROM {self.table} WHERE change = ?", (change,)).fetchone():
                return None  # sent again
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
            if old is None:  # it was made by that change
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
        """Convert a row to a state.

        Raises ``InputError`` for values that no state has: SQLite keeps any in any column.
        """
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
    """Parse a change as the page sends it; its values are yet to be checked. Raises ``RefusedError``."""
    sets = content.get("set")
    if not isinstance(sets, dict) or not sets or not sets.keys() <= settable:
        raise RefusedError(f"set must be some of {', '.join(sorted(settable))} (got {shorten_value(sets)})")
    return Change(parse_token(content, "change"), parse_token(content, "tab"), sets)


def parse_token(content: Mapping[str, object], key: str) -> str:
    """Parse the page's name of something. Raises ``RefusedError``."""
    value = content.get(key)
    if not isinstance(value, str) or not TOKEN_PATTERN.fullmatch(value):
        raise RefusedError(f"{key} must be 8 to 64 letters, digits or hyphens (got {shorten_value(value)})")
    return value


def check_annotator(name: object) -> str:
    """Check the name of a person, which also names files. Raises ``RefusedError``."""
    if not isinstance(name, str) or not is_portable_name(name) or len(name) > 60:
        raise RefusedError(
            f"annotator must be a name of up to 60 letters, without / and \\ (got {shorten_value(name)})"
        )
    return name
