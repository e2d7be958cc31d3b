"""The entries of a ledger, one for each task. They are read here, by whoever does not change it, too."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from getagrip.batch import drivers
from getagrip.errors import GetagripError, InputError
from getagrip.io import databases
from getagrip.io.terminal import print_note

LEDGER_FILE = "ledger.sqlite"
LEDGER_VERSION = 1
LEDGER_APPLICATION_ID = 0x6761676C
"""The file's ``application_id``: "gagl"."""
TASKS_SCHEMA = """CREATE TABLE tasks (
    name TEXT PRIMARY KEY, state TEXT NOT NULL, why TEXT NOT NULL, attempts INTEGER NOT NULL, seconds REAL NOT NULL,
    worker TEXT NOT NULL, inputs TEXT NOT NULL, options TEXT NOT NULL, code TEXT NOT NULL, about TEXT NOT NULL,
    claimed_by TEXT NOT NULL, ended_by TEXT NOT NULL
) WITHOUT ROWID"""
LEDGER_SCHEMA = (TASKS_SCHEMA, drivers.DRIVERS_SCHEMA)
MAX_LEDGER_TEXT_BYTES = 2**20
"""Bytes of a text in the file, and of a row."""
LEDGER_TIMEOUT_S = 60.0
"""Seconds to wait for another driver's transaction."""
State = Literal["open", "done", "failed", "kept"]
"""``kept`` is what has become of a task whose result was there already; it is written as ``done``."""


@dataclass(frozen=True)
class LedgerEntry:
    """A task in the ledger."""

    name: str
    state: State = "open"
    why: str = ""
    """Why it failed; of one that is done, how it ended."""
    attempts: int = 0
    """In the run that has ended it."""
    seconds: float = 0.0
    """Wall time of the last attempt."""
    worker: str = ""
    """Machine and number of the process that made it."""
    inputs: str = ""
    """Checksum of what it was made from."""
    options: str = ""
    """Checksum of the options."""
    code: str = ""
    """Version and fingerprint of the code."""
    about: Mapping[str, object] = field(default_factory=dict)
    """Other fields of a summary."""


LEDGER_COLUMNS = tuple(LedgerEntry.__dataclass_fields__)


EXPECTED_LEDGER = f"a ledger of version {LEDGER_VERSION}, or none: results do without"


class Entries:
    """The entries of a ledger that is open."""

    path: Path
    _db: sqlite3.Connection

    def entries(self) -> Iterator[LedgerEntry]:
        """Yield all entries, by name."""
        with self._named():
            for row in self._db.execute(f"SELECT {', '.join(LEDGER_COLUMNS)} FROM tasks ORDER BY name"):
                yield self._entry(row)

    def has(self, name: str) -> bool:
        """Return whether a task has an entry."""
        with self._named():
            return self._db.execute("SELECT 1 FROM tasks WHERE name = ?", (name,)).fetchone() is not None

    def _entry(self, row: sqlite3.Row) -> LedgerEntry:
        """Convert a row to an entry. Raises ``InputError`` where it is none."""
        values = dict(zip(LEDGER_COLUMNS, row, strict=True))
        texts = [value for column, value in values.items() if column not in ("attempts", "seconds")]
        try:
            values["about"] = json.loads(values["about"])
            good = all(isinstance(text, str) for text in texts) and isinstance(values["about"], dict)
            good = good and isinstance(values["attempts"], int) and isinstance(values["seconds"], float)
        except (TypeError, ValueError, RecursionError):
            good = False
        if not good or values["state"] not in ("open", "done", "failed"):
            raise InputError(self.path, "tasks", "a damaged row", "a ledger, or none: results do without")
        return LedgerEntry(**values)

    def _tables(self) -> list[str]:
        """How the tables were made."""
        made = self._db.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL ORDER BY rowid")
        return [sql for (sql,) in made]

    def _check(self) -> None:
        """Raise ``InputError`` where the file is of something else."""
        is_ours = self._db.execute("PRAGMA application_id").fetchone() == (LEDGER_APPLICATION_ID,)
        version = self._db.execute("PRAGMA user_version").fetchone()[0]
        if not is_ours or version != LEDGER_VERSION or self._tables() != list(LEDGER_SCHEMA):
            raise InputError(self.path, "", f"a database of another kind or version ({version})", EXPECTED_LEDGER)

    @contextmanager
    def _named(self) -> Iterator[None]:
        """Say which file SQLite's errors are about."""
        try:
            yield
        except sqlite3.OperationalError as error:  # a full disk, no permission, no answer
            raise GetagripError(f"{self.path}: the ledger cannot be used ({error})") from error
        except (sqlite3.Error, UnicodeDecodeError) as error:  # the latter: a message that quotes damaged text
            got = f"a file that is no ledger ({error})"
            raise InputError(self.path, "", got, "a ledger, or none: results do without") from error


class ReadOnlyLedger(Entries):
    """A ledger as it is at the moment; nothing in it is changed, and whoever writes it is not disturbed."""

    def __init__(self, folder: Path) -> None:
        """Open it. Raises ``InputError`` where it is something else, ``GetagripError`` where it cannot be read."""
        self.path = folder / LEDGER_FILE
        with self._named():
            self._db = databases.connect(
                self.path, LEDGER_APPLICATION_ID, EXPECTED_LEDGER, timeout=LEDGER_TIMEOUT_S, read_only=True
            )
        self._db.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_LEDGER_TEXT_BYTES)
        try:
            with self._named():
                self._check()
        except BaseException:
            self._db.close()
            raise

    def __enter__(self) -> ReadOnlyLedger:
        return self

    def __exit__(self, *_: object) -> None:
        self._db.close()


@contextmanager
def open_existing_ledger(folder: Path) -> Iterator[Entries | None]:
    """Open the ledger in a folder; None, with a message, where there is none that can be read: results do without."""
    if not (folder / LEDGER_FILE).exists():
        yield None
        return
    try:
        ledger = ReadOnlyLedger(folder)
    except GetagripError as error:
        print_note(f"{error}; only results are listed")
        yield None
        return
    with ledger:
        yield ledger
