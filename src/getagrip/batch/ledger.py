"""The ledger of a folder: the state of each task, in an SQLite file that several drivers share.

The ledger coordinates and records. Results and their validity are in the results' own files: a lost ledger is made
again from them.

Each driver has a row of its own; the claims of a dead driver are free. Wall clocks jump and differ between machines,
so a driver counts its heartbeats: it is dead to another driver that sees the same count for ``HEARTBEAT_TIMEOUT_S``
seconds of its own steady clock. On the same machine, a driver is dead as soon as its process has ended.
"""

from __future__ import annotations

import json
import os
import socket
import sqlite3
import threading
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Literal
from uuid import uuid4

from getagrip.errors import GetagripError, InputError
from getagrip.io import files
from getagrip.io.storage import Place
from getagrip.io.terminal import print_note, state_folder

DRIVERS_SCHEMA = """CREATE TABLE drivers (
    id TEXT PRIMARY KEY, machine TEXT NOT NULL, pid INTEGER NOT NULL, born TEXT NOT NULL, beats INTEGER NOT NULL
) WITHOUT ROWID"""
HEARTBEAT_S = 2.0
"""Interval between heartbeats."""
HEARTBEAT_TIMEOUT_S = 30.0
"""Time without a heartbeat after which a driver is dead."""

_LOCAL_DRIVERS: set[str] = set()
"""Working drivers of this process; a driver that rests is dead, even if a full disk keeps its row."""


class Drivers:
    """The drivers of a ledger; this process is one from ``join`` to ``rest``."""

    def __init__(self, db: sqlite3.Connection, path: Path) -> None:
        self.id = uuid4().hex
        self._db = db
        self._there = f"{path.absolute().as_uri()}?mode=rw"
        """URI of the file: absolute, and never created anew if the file is removed."""
        self._machine = _machine_id()
        self._seen: dict[str, tuple[int, float]] = {}
        self._leaving = threading.Event()

    def join(self) -> None:
        """Enter this process, start its heartbeat, and remove dead drivers."""
        self._strike_off_dead()
        row = (self.id, self._machine, os.getpid(), _process_start_time(os.getpid()))
        self._db.execute("INSERT INTO drivers VALUES (?, ?, ?, ?, 0)", row)
        _LOCAL_DRIVERS.add(self.id)
        threading.Thread(target=self._beat, daemon=True).start()

    def rest(self) -> None:
        """End the heartbeat."""
        self._leaving.set()
        _LOCAL_DRIVERS.discard(self.id)

    def leave(self) -> None:
        """Remove this process and dead drivers."""
        self._strike_off_dead()
        self._db.execute("DELETE FROM drivers WHERE id = ?", (self.id,))

    def _strike_off_dead(self) -> None:
        known = [driver for (driver,) in self._db.execute("SELECT id FROM drivers")]
        dead = [(driver,) for driver in known if not self.lives(driver)]
        self._db.executemany("DELETE FROM drivers WHERE id = ?", dead)

    def lives(self, driver: str) -> bool:
        """Return whether a driver lives, as far as this process can know."""
        row = self._db.execute("SELECT machine, pid, born, beats FROM drivers WHERE id = ?", (driver,)).fetchone()
        if row is None:
            return False
        machine, pid, born, beats = row
        if (
            machine == self._machine
            and born
            and (_process_start_time(pid) != born or (pid == os.getpid() and driver not in _LOCAL_DRIVERS))
        ):
            return False
        before, since = self._seen.get(driver, (None, 0.0))
        if before != beats:
            self._seen[driver] = beats, time.monotonic()
            return True
        return time.monotonic() - since < HEARTBEAT_TIMEOUT_S

    def _beat(self) -> None:
        """Count heartbeats in a thread until the driver rests."""
        while not self._leaving.wait(HEARTBEAT_S):
            try:
                db = sqlite3.connect(self._there, timeout=HEARTBEAT_S, isolation_level=None, uri=True)
                try:
                    db.execute("UPDATE drivers SET beats = beats + 1 WHERE id = ?", (self.id,))
                finally:
                    db.close()
            except sqlite3.Error:  # busy, or the disk is full: the next beat may succeed
                continue


def _machine_id() -> str:
    """Return an identifier of this machine since its start, and of the container's namespace of processes."""
    parts = [socket.gethostname()]
    try:
        parts.append(Path("/proc/sys/kernel/random/boot_id").read_text("utf-8").strip())
        parts.append(os.readlink("/proc/self/ns/pid"))
    except OSError:  # not Linux: only heartbeats show who lives
        parts.append(uuid4().hex)
    return " ".join(parts)


def _process_start_time(pid: int) -> str:
    """Return a process's start time, in ticks since the machine's start; empty if unknown or not running."""
    try:
        return Path(f"/proc/{pid}/stat").read_text("utf-8", "replace").rpartition(")")[2].split()[19]
    except (OSError, IndexError):
        return ""


LEDGER_FILE = "ledger.sqlite"
LEDGER_VERSION = 1
LEDGER_APPLICATION_ID = 0x6761676C
"""The file's ``application_id``: "gagl"."""
TASKS_SCHEMA = """CREATE TABLE tasks (
    name TEXT PRIMARY KEY, state TEXT NOT NULL, why TEXT NOT NULL, attempts INTEGER NOT NULL, seconds REAL NOT NULL,
    worker TEXT NOT NULL, inputs TEXT NOT NULL, options TEXT NOT NULL, code TEXT NOT NULL, about TEXT NOT NULL,
    claimed_by TEXT NOT NULL, ended_by TEXT NOT NULL
) WITHOUT ROWID"""
LEDGER_SCHEMA = (TASKS_SCHEMA, DRIVERS_SCHEMA)
MAX_LEDGER_TEXT_BYTES = 2**20
"""Maximum size of a text in the file, and of a row."""
LEDGER_TIMEOUT_S = 60.0
"""Maximum wait for another driver's transaction."""
State = Literal["open", "done", "failed", "kept"]
"""``kept``: a valid result existed already; written as ``done``."""


@dataclass(frozen=True)
class LedgerEntry:
    """A task in the ledger."""

    name: str
    state: State = "open"
    why: str = ""
    """Reason of a failure; status of a result."""
    attempts: int = 0
    """Number of attempts in the last run."""
    seconds: float = 0.0
    """Wall time of the last attempt."""
    worker: str = ""
    """Machine and process number of the last attempt."""
    inputs: str = ""
    """Checksum of the inputs."""
    options: str = ""
    """Checksum of the options."""
    code: str = ""
    """Version and fingerprint of the code."""
    about: Mapping[str, object] = field(default_factory=dict)
    """Other fields of a summary."""


LEDGER_COLUMNS = tuple(LedgerEntry.__dataclass_fields__)
EXPECTED_LEDGER = f"a ledger of version {LEDGER_VERSION}, or none: results do without"


class Entries:
    """The entries of an open ledger."""

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
        """Convert a row to an entry. Raises ``InputError`` for a damaged row."""
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
        """Return the statements that created the tables."""
        rows = self._db.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL ORDER BY rowid")
        return [sql for (sql,) in rows]

    def _check(self) -> None:
        """Raise ``InputError`` where the file is not a ledger of this version."""
        is_ours = self._db.execute("PRAGMA application_id").fetchone() == (LEDGER_APPLICATION_ID,)
        version = self._db.execute("PRAGMA user_version").fetchone()[0]
        if not is_ours or version != LEDGER_VERSION or self._tables() != list(LEDGER_SCHEMA):
            raise InputError(self.path, "", f"a database of another kind or version ({version})", EXPECTED_LEDGER)

    @contextmanager
    def _named(self) -> Iterator[None]:
        """Convert SQLite's errors to errors that name the file."""
        try:
            yield
        except sqlite3.OperationalError as error:  # a full disk, no permission, no answer
            raise GetagripError(f"{self.path}: the ledger cannot be used ({error})") from error
        except (sqlite3.Error, UnicodeDecodeError) as error:  # the latter: a message that quotes damaged text
            got = f"not a ledger ({error})"
            raise InputError(self.path, "", got, "a ledger, or none: results do without") from error


class ReadOnlyLedger(Entries):
    """A ledger opened for reading, which does not disturb its drivers."""

    def __init__(self, folder: Path) -> None:
        """Open a folder's ledger. Raises ``InputError`` for another file, ``GetagripError`` where it is unreadable."""
        self.path = folder / LEDGER_FILE
        with self._named():
            self._db = files.connect(
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
    """Open the ledger in a folder; None if it does not exist, or, with a message, if it is unreadable."""
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


class Ledger(Entries):
    """The ledger of a folder, opened by one driver."""

    def __init__(self, folder: Path) -> None:
        """Open or create a folder's ledger. Raises ``InputError`` for another file, ``GetagripError`` on failure."""
        folder.mkdir(parents=True, exist_ok=True)
        self.path = folder / LEDGER_FILE
        with self._named():
            self._db = files.connect(self.path, LEDGER_APPLICATION_ID, EXPECTED_LEDGER, timeout=LEDGER_TIMEOUT_S)
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
        """Give back unfinished claims, and leave."""
        self._drivers.rest()
        try:
            with self._transaction() as db:
                db.execute("UPDATE tasks SET claimed_by = '' WHERE claimed_by = ?", (self._drivers.id,))
                self._drivers.leave()
        except GetagripError:  # a full disk: other drivers will find this one dead
            pass
        finally:
            self._db.close()

    def expect(self, names: Iterable[str], failed: Iterable[LedgerEntry]) -> None:
        """Enter new tasks, and replace the paths without a clip (names with a slash) of earlier calls."""
        with self._transaction() as db:
            values = ((name, "open", "", 0, 0.0, "", "", "", "", "{}", "", "") for name in names)
            db.executemany(f"INSERT OR IGNORE INTO tasks VALUES ({', '.join('?' * 12)})", values)
            db.execute("DELETE FROM tasks WHERE instr(name, '/') > 0")
            rows = ((e.name, e.state, e.why, 0, 0.0, "", "", "", "", json.dumps(e.about), "", "") for e in failed)
            db.executemany(f"INSERT OR IGNORE INTO tasks VALUES ({', '.join('?' * 12)})", rows)

    def claim(self, name: str, options: str, code: str) -> LedgerEntry | None:
        """Claim a task for this driver, and return its entry; None while another living driver works on it.

        A returned entry in state ``failed`` is not claimed: a living driver has just failed at the same work.
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
        """Write the outcome of this driver's task, unless another driver has taken over the task.

        A ``kept`` result keeps its earlier entry.
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
        """Return whether a driver lives and is not this one."""
        return bool(driver) and driver != self._drivers.id and self._drivers.lives(driver)

    def _prepare(self) -> None:
        """Create the tables, or check existing ones."""
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
        """Set WAL mode; SQLite's timeout does not cover this statement, so wait for other drivers here."""
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
        """Open a transaction that is committed as a whole or rolled back, without other writers in between."""
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
    """Return the ledger's folder, on a local disk: ``value``, else the results' folder, else one in the state folder.

    Calls on the same results on one machine share the ledger.
    """
    if value is not None:
        return value
    if isinstance(out, Path):
        return out
    return state_folder() / f"{out.name[:40]}-{sha256(out.url.encode()).hexdigest()[:12]}"
