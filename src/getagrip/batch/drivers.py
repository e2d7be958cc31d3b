"""The living drivers: the processes that work on a folder together, each with a row in its ledger.

A driver that dies gives back its claims. Clocks decide nothing, since they jump and differ between machines: a driver
counts its heartbeats, and is dead to another one that has seen the same count for ``HEARTBEAT_TIMEOUT_S`` seconds of its own
steady clock. On the same machine a process that is gone, or whose number another one has, is dead at once.
"""

from __future__ import annotations

import os
import socket
import sqlite3
import threading
import time
from pathlib import Path
from uuid import uuid4

DRIVERS_SCHEMA = """CREATE TABLE drivers (
    id TEXT PRIMARY KEY, machine TEXT NOT NULL, pid INTEGER NOT NULL, born TEXT NOT NULL, beats INTEGER NOT NULL
) WITHOUT ROWID"""
HEARTBEAT_S = 2.0
"""Seconds between heartbeats."""
HEARTBEAT_TIMEOUT_S = 30.0
"""Seconds without one after which a driver is dead."""


_LOCAL_DRIVERS: set[str] = set()
"""Drivers of this process that are at work: one that rests is dead, also where a full disk keeps its row."""


class Drivers:
    """The drivers of a ledger, of which this process is one from ``join`` to ``rest``."""

    def __init__(self, db: sqlite3.Connection, path: Path) -> None:
        self.id = uuid4().hex
        self._db = db
        self._there = f"{path.absolute().as_uri()}?mode=rw"
        """The file's address: it is made by nobody else, should it be gone or this process in another folder."""
        self._machine = _machine_id()
        self._seen: dict[str, tuple[int, float]] = {}
        self._leaving = threading.Event()

    def join(self) -> None:
        """Enter this process, start its heartbeat, and remove the drivers that were killed."""
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
        """Remove this process, and the drivers that have died meanwhile."""
        self._strike_off_dead()
        self._db.execute("DELETE FROM drivers WHERE id = ?", (self.id,))

    def _strike_off_dead(self) -> None:
        """Remove the rows of drivers that do not live: nobody else would."""
        known = [driver for (driver,) in self._db.execute("SELECT id FROM drivers")]
        dead = [(driver,) for driver in known if not self.lives(driver)]
        self._db.executemany("DELETE FROM drivers WHERE id = ?", dead)

    def lives(self, driver: str) -> bool:
        """Return whether a driver is at work, as far as can be known."""
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
        """Count in a thread until the driver leaves."""
        while not self._leaving.wait(HEARTBEAT_S):
            try:
                db = sqlite3.connect(self._there, timeout=HEARTBEAT_S, isolation_level=None, uri=True)
                try:
                    db.execute("UPDATE drivers SET beats = beats + 1 WHERE id = ?", (self.id,))
                finally:
                    db.close()
            except sqlite3.Error:  # busy, or the disk is full: the next beat may come through
                continue


def _machine_id() -> str:
    """Return an identifier of this machine since its start; containers with processes of their own have another one."""
    parts = [socket.gethostname()]
    try:
        parts.append(Path("/proc/sys/kernel/random/boot_id").read_text("utf-8").strip())
        parts.append(os.readlink("/proc/self/ns/pid"))
    except OSError:  # no Linux: then heartbeats alone say who lives
        parts.append(uuid4().hex)
    return " ".join(parts)


def _process_start_time(pid: int) -> str:
    """When a process has started, in ticks since the machine has; empty for none, and where that is unknown."""
    try:
        return Path(f"/proc/{pid}/stat").read_text("utf-8", "replace").rpartition(")")[2].split()[19]
    except (OSError, IndexError):
        return ""
