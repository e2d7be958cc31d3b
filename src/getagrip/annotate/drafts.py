"""What was computed from key frames: the polygons of the masks and the silhouette of the fitted hand, frame by frame.

A draft says from what it was made (``basis``); where the key frames have changed since, it is out of date. It is shown
until it is overwritten.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from getagrip.annotate.versions import Database

SCHEMA = """
CREATE TABLE drafts (
    seq INTEGER PRIMARY KEY AUTOINCREMENT,
    grasp TEXT NOT NULL, kind TEXT NOT NULL, frame INTEGER NOT NULL,
    basis TEXT NOT NULL, content TEXT NOT NULL,
    UNIQUE (grasp, kind, frame) ON CONFLICT REPLACE
);
CREATE INDEX drafts_of_grasp ON drafts (grasp, seq);
"""
MOST_AT_ONCE = 200
"""Drafts given in one answer."""


@dataclass(frozen=True)
class Drafts:
    """The drafts in a database."""

    database: Database

    def put(self, grasp: str, kind: str, basis: str, frames: Mapping[int, Mapping[str, Any]]) -> None:
        """Keep drafts of some frames, of the "masks" or the "hand", in the place of older ones."""
        rows = [(grasp, kind, n, basis, json.dumps(content, allow_nan=False)) for n, content in frames.items()]
        with self.database.transaction() as db:
            db.executemany("INSERT INTO drafts (grasp, kind, frame, basis, content) VALUES (?, ?, ?, ?, ?)", rows)

    def since(self, grasp: str, seq: int) -> list[dict[str, Any]]:
        """Drafts of a grasp that are newer than ``seq``, the oldest ``MOST_AT_ONCE`` of them."""
        query = "SELECT seq, kind, frame, basis, content FROM drafts WHERE grasp = ? AND seq > ? ORDER BY seq LIMIT ?"
        rows = self.database.rows(query, (grasp, seq, MOST_AT_ONCE))
        keys = ("seq", "kind", "frame", "basis")
        return [dict(zip(keys, row, strict=False)) | {"content": json.loads(row[-1])} for row in rows]

    def bases(self, grasp: str, kind: str) -> dict[int, str]:
        """By frame, what the drafts that there are were made of."""
        return dict(self.database.rows("SELECT frame, basis FROM drafts WHERE grasp = ? AND kind = ?", (grasp, kind)))

    def newest(self, grasp: str) -> int:
        """A number that grows with every draft of a grasp."""
        query = "SELECT coalesce(max(seq), 0) FROM drafts WHERE grasp = ?"
        return int(self.database.rows(query, (grasp,))[0][0])
