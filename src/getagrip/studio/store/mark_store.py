"""The SQLite file of marks and key frames, with every version of them, and of drafts.

The tables ``versions`` and ``keyframe_versions`` hold all versions, the views ``marks`` and ``keyframes`` the current
states. ``drafts`` are computed from key frames: polygons of masks and the silhouette of the hand, frame by frame. A
draft has a checksum of its inputs (``basis``); if the key frames have changed since, the draft is out of date, and is
shown until it is overwritten. ``settings`` holds what the page comes back to (``grasp_settings``).
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

from getagrip.errors import InputError
from getagrip.io import files
from getagrip.studio.store import grasp_settings, labels, marks
from getagrip.studio.store.grasp_settings import SettingStore
from getagrip.studio.store.history import VersionDatabase, Versions
from getagrip.studio.store.labels import KeyFrame
from getagrip.studio.store.marks import Mark

MARKS_DATABASE_VERSION = 4
"""Version of the tables, the file's ``user_version``. Version 1 has marks of grasps only, 2 key frames, 3 segments,
4 settings: older files are migrated."""
MARKS_APPLICATION_ID = 0x67616772
"""The file's ``application_id``: "gagr"."""
MAX_MARKS_TEXT_BYTES = 2**24
"""Maximum size of a text in the file [bytes]."""
DRAFTS_SCHEMA = """
CREATE TABLE drafts (
    seq INTEGER PRIMARY KEY AUTOINCREMENT,
    grasp TEXT NOT NULL, kind TEXT NOT NULL, frame INTEGER NOT NULL,
    basis TEXT NOT NULL, content TEXT NOT NULL,
    UNIQUE (grasp, kind, frame) ON CONFLICT REPLACE
);
CREATE INDEX drafts_of_grasp ON drafts (grasp, seq);
"""
SCHEMA_MIGRATIONS = {
    1: marks.MARKS_SCHEMA,
    2: labels.KEYFRAMES_SCHEMA + DRAFTS_SCHEMA,
    3: marks.SEGMENTS_MIGRATION,
    4: grasp_settings.SETTINGS_SCHEMA,
}
"""Tables and columns that each version adds."""
MAX_DRAFTS_PER_ANSWER = 200
"""Maximum number of drafts in one answer."""


@dataclass(frozen=True)
class DraftStore:
    """The drafts in a database."""

    database: VersionDatabase

    def put(self, grasp: str, kind: str, basis: str, frames: Mapping[int, Mapping[str, object]]) -> None:
        """Store drafts of some frames, of the ``kind`` "masks" or "hand", in place of older ones."""
        rows = [(grasp, kind, n, basis, json.dumps(content, allow_nan=False)) for n, content in frames.items()]
        with self.database.transaction() as db:
            db.executemany("INSERT INTO drafts (grasp, kind, frame, basis, content) VALUES (?, ?, ?, ?, ?)", rows)

    def since(self, grasp: str, seq: int) -> list[dict[str, object]]:
        """Return the drafts of a grasp that are newer than ``seq``, the oldest ``MAX_DRAFTS_PER_ANSWER`` of them."""
        query = "SELECT seq, kind, frame, basis, content FROM drafts WHERE grasp = ? AND seq > ? ORDER BY seq LIMIT ?"
        rows = self.database.rows(query, (grasp, seq, MAX_DRAFTS_PER_ANSWER))
        keys = ("seq", "kind", "frame", "basis")
        return [dict(zip(keys, row, strict=False)) | {"content": json.loads(row[-1])} for row in rows]

    def bases(self, grasp: str, kind: str) -> dict[int, str]:
        """Return, by frame, the checksums of the inputs of existing drafts."""
        return dict(self.database.rows("SELECT frame, basis FROM drafts WHERE grasp = ? AND kind = ?", (grasp, kind)))

    def confidence(self, grasp: str, basis: Collection[str]) -> dict[int, float]:
        """Return, by frame, the confidence of masks with one of the checksums ``basis``."""
        query = "SELECT frame, basis, content FROM drafts WHERE grasp = ? AND kind = 'masks'"
        rows = self.database.rows(query, (grasp,))
        return {n: json.loads(content)["confidence"] for n, made_of, content in rows if made_of in basis}

    def newest(self, grasp: str) -> int:
        """Return a number that grows with every draft of a grasp."""
        query = "SELECT coalesce(max(seq), 0) FROM drafts WHERE grasp = ?"
        return int(self.database.rows(query, (grasp,))[0][0])


class Store:
    """The contents of one file, for any number of threads and processes."""

    def __init__(self, path: Path) -> None:
        """Open the file, or make it. Raises ``InputError`` for another kind of file."""
        self.path = path
        try:
            connection = files.connect(
                path, MARKS_APPLICATION_ID, "a file of marks made here", timeout=20.0, shared=True
            )
            connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_MARKS_TEXT_BYTES)
            self.database = VersionDatabase(path, connection)
            with self.database.transaction() as db:
                _migrate_tables(path, db)
        except (sqlite3.Error, UnicodeDecodeError) as error:  # the latter: a message that quotes damaged text
            raise InputError(path, "", f"another kind of file ({error})", "a file of marks made here") from error
        self.marks: Versions[Mark] = marks.mark_versions(self.database)
        self.keyframes: Versions[KeyFrame] = labels.keyframe_versions(self.database)
        self.drafts = DraftStore(self.database)
        self.settings = SettingStore(self.database)

    def close(self) -> None:
        """Close the file."""
        with self.database.lock:
            self.database.connection.close()


def _migrate_tables(path: Path, db: sqlite3.Connection) -> None:
    """Make missing tables. Raises ``InputError`` for another kind of database."""
    (version,) = db.execute("PRAGMA user_version").fetchone()
    (tables,) = db.execute("SELECT count(*) FROM sqlite_master").fetchone()
    (application,) = db.execute("PRAGMA application_id").fetchone()
    empty = not tables and not version
    if not empty and (application != MARKS_APPLICATION_ID or version not in SCHEMA_MIGRATIONS):
        got = f"a database of another kind or version ({version})"
        raise InputError(path, "", got, f"version 1 to {MARKS_DATABASE_VERSION}")
    # A query of a hostile file's view may never end.
    if not empty and _table_definitions(db) != _table_definitions(_empty_database(version)):
        raise InputError(path, "", "a database with other tables or views", "one made here")
    for number, schema in SCHEMA_MIGRATIONS.items():
        for statement in schema.split(";\n") if number > version else []:
            db.execute(statement)
    db.execute(f"PRAGMA user_version = {MARKS_DATABASE_VERSION}")
    db.execute(f"PRAGMA application_id = {MARKS_APPLICATION_ID}")


def _table_definitions(db: sqlite3.Connection) -> set[tuple[str, str]]:
    """Return names and definitions of tables, views and indices, without SQLite's own."""
    rows = db.execute("SELECT name, sql FROM sqlite_master WHERE name NOT GLOB 'sqlite_*'").fetchall()
    return {(str(name), " ".join(str(sql).split())) for name, sql in rows}


def _empty_database(version: int) -> sqlite3.Connection:
    db = sqlite3.connect(":memory:")
    for number, schema in SCHEMA_MIGRATIONS.items():
        db.executescript(schema if number <= version else "")
    return db
