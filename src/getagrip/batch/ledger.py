"""The ledger of a folder: what has become of each task, in an SQLite file that several drivers share.

It coordinates and records. What a result is, and whether it is still good, its own files say: a ledger that is lost is
made again from them.
"""

from __future__ import annotations

import json
import sqlite3
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from getagrip.batch import drivers
from getagrip.batch.drivers import Drivers
from getagrip.errors import GetagripError, InputError
from getagrip.io import databases

FILE = "ledger.sqlite"
VERSION = 1
APPLICATION = 0x6761676C
"""The file's ``application_id``: "gagl"."""
TASKS = """CREATE TABLE tasks (
    name TEXT PRIMARY KEY, state TEXT NOT NULL, why TEXT NOT NULL, attempts INTEGER NOT NULL, seconds REAL NOT NULL,
    worker TEXT NOT NULL, inputs TEXT NOT NULL, options TEXT NOT NULL, code TEXT NOT NULL, about TEXT NOT NULL,
    claimed_by TEXT NOT NULL, ended_by TEXT NOT NULL
) WITHOUT ROWID"""
SCHEMA = (TASKS, drivers.SCHEMA)
LONGEST = 2**20
"""Bytes of a text in the file, and of a row."""
PATIENCE = 60.0
"""Seconds to wait for another driver's transaction."""
State = Literal["open", "done", "failed", "kept"]
"""``kept`` is what has become of a task whose result was there already; it is written as ``done``."""


@dataclass(frozen=True)
class Entry:
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
    about: Mapping[str, Any] = field(default_factory=dict)
    """What else a summary says of it."""


COLUMNS = tuple(Entry.__dataclass_fields__)


LEDGER = f"a ledger of version {VERSION}, or none: results do without"


class Ledger:
    """The ledger of a folder, opened by one driver."""

    def __init__(self, folder: Path) -> None:
        """Open or make it. Raises ``InputError`` where it is something else, ``GetagripError`` where it cannot be."""
        folder.mkdir(parents=True, exist_ok=True)
        self.path = folder / FILE
        with self._named():
            self._db = databases.connect(self.path, APPLICATION, LEDGER, timeout=PATIENCE)
        self._db.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LONGEST)
        try:
            self._prepare()
            self._drivers = Drivers(self._db, self.path)
            with self._transaction():
                self._drivers.join()
        except BaseException:
            self._db.close()
            raise

    def __enter__(self) -> Ledger:
        return self

    def __exit__(self, *_: object) -> None:
        """Give back what is claimed and not ended, and leave."""
        self._drivers.rest()
        try:
            with self._transaction() as db:
                db.execute("UPDATE tasks SET claimed_by = '' WHERE claimed_by = ?", (self._drivers.id,))
                self._drivers.leave()
        except GetagripError:  # a full disk: others will see that we are gone
            pass
        finally:
            self._db.close()

    def claim(self, name: str, options: str, code: str) -> Entry | None:
        """Claim a task for this driver, and return its entry; None where a living driver is at work on it.

        An entry that has ``failed`` is not claimed: a living driver has just tried the same, in vain.
        """
        with self._transaction() as db:
            row = db.execute(f"SELECT {', '.join(COLUMNS)}, claimed_by, ended_by FROM tasks WHERE name = ?", (name,))
            found = row.fetchone()
            if found is None:
                values = (name, "open", "", 0, 0.0, "", "", options, code, "{}", self._drivers.id, "")
                db.execute(f"INSERT INTO tasks VALUES ({', '.join('?' * len(values))})", values)
                return Entry(name, options=options, code=code)
            entry, (claimed_by, ended_by) = self._entry(found[:-2]), found[-2:]
            if self._of_another(claimed_by):
                return None
            if (
                entry.state == "failed"
                and (entry.options, entry.code) == (options, code)
                and self._of_another(ended_by)
            ):
                return entry
            db.execute("UPDATE tasks SET claimed_by = ? WHERE name = ?", (self._drivers.id, name))
            return Entry(**{**vars(entry), "state": "open" if entry.state == "failed" else entry.state})

    def end(self, entry: Entry) -> None:
        """Write what has become of a task of ours, unless another driver has taken us for dead and it over.

        Of one whose result was ``kept``, what is known of its making stays.
        """
        me = {"claimed_by": "", "ended_by": self._drivers.id}
        values = vars(entry) | {"why": entry.why[: LONGEST // 8], "about": json.dumps(entry.about)} | me
        ours = "name = :name AND claimed_by = :me"
        with self._transaction() as db:
            if entry.state == "kept":
                known = "state = 'done' AND inputs = :inputs AND options = :options AND code = :code"
                kept = db.execute(
                    f"UPDATE tasks SET claimed_by = '' WHERE {ours} AND {known}", values | {"me": self._drivers.id}
                )
                if kept.rowcount:
                    return
                values["state"] = "done"
            changes = ", ".join(f"{column} = :{column}" for column in values)
            db.execute(f"UPDATE tasks SET {changes} WHERE {ours}", values | {"me": self._drivers.id})

    def entries(self) -> Iterator[Entry]:
        """All of them, by name."""
        with self._named():
            for row in self._db.execute(f"SELECT {', '.join(COLUMNS)} FROM tasks ORDER BY name"):
                yield self._entry(row)

    def _of_another(self, driver: str) -> bool:
        """Whether this is a driver that lives, and not ourselves."""
        return bool(driver) and driver != self._drivers.id and self._drivers.lives(driver)

    def _entry(self, row: tuple[Any, ...]) -> Entry:
        """A row as an entry. Raises ``InputError`` where it is none."""
        values = dict(zip(COLUMNS, row, strict=True))
        texts = [value for column, value in values.items() if column not in ("attempts", "seconds")]
        try:
            values["about"] = json.loads(values["about"])
            good = all(isinstance(text, str) for text in texts) and isinstance(values["about"], dict)
            good = good and isinstance(values["attempts"], int) and isinstance(values["seconds"], float)
        except (TypeError, ValueError, RecursionError):
            good = False
        if not good or values["state"] not in ("open", "done", "failed"):
            raise InputError(self.path, "tasks", "a damaged row", "a ledger, or none: results do without")
        return Entry(**values)

    def _prepare(self) -> None:
        """Make the tables, or see that they are ours."""
        with self._named():
            self._to_wal()
            self._db.execute("PRAGMA synchronous = NORMAL")
        with self._transaction() as db:
            tables = [
                sql for (sql,) in db.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL ORDER BY rowid")
            ]
            if not tables:
                for statement in SCHEMA:
                    db.execute(statement)
                db.execute(f"PRAGMA user_version = {VERSION}")
                db.execute(f"PRAGMA application_id = {APPLICATION}")
                return
            is_ours = db.execute("PRAGMA application_id").fetchone() == (APPLICATION,)
            version = db.execute("PRAGMA user_version").fetchone()[0]
            if not is_ours or version != VERSION or tables != list(SCHEMA):
                given = f"a database of another kind or version ({version})"
                raise InputError(self.path, "", given, LEDGER)

    def _to_wal(self) -> None:
        """Have the file in WAL mode. Here SQLite does not wait for another driver that begins, as it does elsewhere."""
        until = time.monotonic() + PATIENCE
        while True:
            try:
                self._db.execute("PRAGMA journal_mode = WAL")
                return
            except sqlite3.OperationalError as error:
                if "locked" not in str(error) or time.monotonic() > until:
                    raise
            time.sleep(0.01)

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        """A transaction that nobody else writes into; it holds whole or not at all."""
        with self._named():
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield self._db
                self._db.execute("COMMIT")
            except BaseException:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")
                raise

    @contextmanager
    def _named(self) -> Iterator[None]:
        """Say which file SQLite's errors are about."""
        try:
            yield
        except sqlite3.OperationalError as error:  # a full disk, no permission, no answer
            raise GetagripError(f"{self.path}: the ledger cannot be written ({error})") from error
        except (sqlite3.Error, UnicodeDecodeError) as error:  # the latter: a message that quotes damaged text
            given = f"a file that is no ledger ({error})"
            raise InputError(self.path, "", given, "a ledger, or none: results do without") from error
