"""The ledger of a folder: what has become of each task, in an SQLite file that several drivers share.

It coordinates and records. What a result is, and whether it is still good, its own files say: a ledger that is lost is
made again from them.
"""

from __future__ import annotations

import json
import sqlite3
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from hashlib import sha256
from pathlib import Path

from getagrip.batch.drivers import Drivers
from getagrip.batch.entries import (
    EXPECTED_LEDGER,
    LEDGER_APPLICATION_ID,
    LEDGER_COLUMNS,
    LEDGER_FILE,
    LEDGER_SCHEMA,
    LEDGER_TIMEOUT_S,
    LEDGER_VERSION,
    MAX_LEDGER_TEXT_BYTES,
    Entries,
    LedgerEntry,
)
from getagrip.errors import GetagripError
from getagrip.io import databases
from getagrip.io.storage import Place
from getagrip.io.user_folders import state_folder


class Ledger(Entries):
    """The ledger of a folder, opened by one driver."""

    def __init__(self, folder: Path) -> None:
        """Open or make it. Raises ``InputError`` where it is something else, ``GetagripError`` where it cannot be."""
        folder.mkdir(parents=True, exist_ok=True)
        self.path = folder / LEDGER_FILE
        with self._named():
            self._db = databases.connect(self.path, LEDGER_APPLICATION_ID, EXPECTED_LEDGER, timeout=LEDGER_TIMEOUT_S)
        self._db.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_LEDGER_TEXT_BYTES)
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

    def expect(self, names: Iterable[str], failed: Iterable[LedgerEntry]) -> None:
        """Enter tasks that have no entry, and paths that give no clip.

        Their names have a slash, as no clip's has. They take the place of those of earlier calls.
        """
        with self._transaction() as db:
            values = ((name, "open", "", 0, 0.0, "", "", "", "", "{}", "", "") for name in names)
            db.executemany(f"INSERT OR IGNORE INTO tasks VALUES ({', '.join('?' * 12)})", values)
            db.execute("DELETE FROM tasks WHERE instr(name, '/') > 0")
            rows = ((e.name, e.state, e.why, 0, 0.0, "", "", "", "", json.dumps(e.about), "", "") for e in failed)
            db.executemany(f"INSERT OR IGNORE INTO tasks VALUES ({', '.join('?' * 12)})", rows)

    def claim(self, name: str, options: str, code: str) -> LedgerEntry | None:
        """Claim a task for this driver, and return its entry; None where a living driver is at work on it.

        An entry that has ``failed`` is not claimed: a living driver has just tried the same, in vain.
        """
        with self._transaction() as db:
            row = db.execute(
                f"SELECT {', '.join(LEDGER_COLUMNS)}, claimed_by, ended_by FROM tasks WHERE name = ?", (name,)
            )
            found = row.fetchone()
            if found is None:
                values = (name, "open", "", 0, 0.0, "", "", options, code, "{}", self._drivers.id, "")
                db.execute(f"INSERT INTO tasks VALUES ({', '.join('?' * len(values))})", values)
                return LedgerEntry(name, options=options, code=code)
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
            return LedgerEntry(**{**vars(entry), "state": "open" if entry.state == "failed" else entry.state})

    def end(self, entry: LedgerEntry) -> None:
        """Write the outcome of this driver's task, unless another one took this for dead and the task over.

        Of one whose result was ``kept``, what is known of its making stays.
        """
        me = {"claimed_by": "", "ended_by": self._drivers.id}
        values = vars(entry) | {"why": entry.why[: MAX_LEDGER_TEXT_BYTES // 8], "about": json.dumps(entry.about)} | me
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

    def _of_another(self, driver: str) -> bool:
        """Return whether this is a living driver other than this process."""
        return bool(driver) and driver != self._drivers.id and self._drivers.lives(driver)

    def _prepare(self) -> None:
        """Make the tables, or see that they are ours."""
        with self._named():
            self._to_wal()
            self._db.execute("PRAGMA synchronous = NORMAL")
        with self._transaction() as db:
            if not self._tables():
                for statement in LEDGER_SCHEMA:
                    db.execute(statement)
                db.execute(f"PRAGMA user_version = {LEDGER_VERSION}")
                db.execute(f"PRAGMA application_id = {LEDGER_APPLICATION_ID}")
                return
            self._check()

    def _to_wal(self) -> None:
        """Have the file in WAL mode. Here SQLite does not wait for another driver that begins, as it does elsewhere."""
        until = time.monotonic() + LEDGER_TIMEOUT_S
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
        """Open a transaction that holds whole or not at all, without other writers in between."""
        with self._named():
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield self._db
                self._db.execute("COMMIT")
            except BaseException:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")
                raise


def ledger_folder(out: Place, value: Path | None) -> Path:
    """Return the ledger's folder: the one ``given``, else that of the results, else one in the user's state folder.

    SQLite needs a local disk. Calls on the same results on one machine share the ledger.
    """
    if value is not None:
        return value
    if isinstance(out, Path):
        return out
    return state_folder() / f"{out.name[:40]}-{sha256(out.url.encode()).hexdigest()[:12]}"
