"""A mark: what one person says of a task.

Either what the object does in an interval (a segment, such as a stable grasp), or why there is nothing to mark, or that
the camera stood still.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, dataclass, fields, replace

from getagrip.annotate.footage import Footage, duration_seconds
from getagrip.annotate.versions import RefusedError, Row, VersionDatabase, Versions
from getagrip.clip.timeline import STATES
from getagrip.io.files import Json, shorten_value

DISCARD_REASONS = ("no stable grasp", "out of view", "other CAD")
"""Why a task is discarded: nothing is held stably, hand and object are not visible, the thing is unlike its mesh."""
GRASP_STATE = "grasp"
"""The state of a stable grasp (``clip.timeline``)."""
STATIC_CAMERA = "still"
"""Value for a camera that did not move."""
MARK_SETTABLE_FIELDS = frozenset({"start", "end", "side", "category", "entity", "reason", "state", "camera", "deleted"})
"""Fields that the page may change."""
MARKS_SCHEMA = """
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
SEGMENTS_MIGRATION = """
ALTER TABLE versions ADD COLUMN state TEXT;
ALTER TABLE versions ADD COLUMN camera TEXT;
"""
"""Additions of version 3 of the tables; without a state, an interval is a stable grasp."""


@dataclass(frozen=True)
class Mark:
    """The state of a mark. Frames count from 0, both included."""

    mark: str
    task: str
    annotator: str
    start: int | None = None
    end: int | None = None
    side: str | None = None
    category: str | None = None
    entity: str | None = None
    reason: str | None = None
    """One of ``DISCARD_REASONS``: then it has neither start nor end."""
    deleted: bool = False
    start_number: int | None = None
    """Start and end in the footage's own numbers."""
    end_number: int | None = None
    seconds: float | None = None
    """How long it lasts."""
    state: str = GRASP_STATE
    """State of the object in the interval: one of ``STATES``."""
    camera: str | None = None
    """``STATIC_CAMERA`` where the mark says that of the camera: then it has neither start nor end."""

    @property
    def interval(self) -> tuple[int, int] | None:
        """Start and end of a segment that has both."""
        return None if self.start is None or self.end is None or self.deleted else (self.start, self.end)

    @property
    def grasp(self) -> tuple[int, int] | None:
        """Start and end of a stable grasp that has both."""
        return self.interval if self.state == GRASP_STATE else None


MARK_COLUMNS = tuple(field.name for field in fields(Mark))


def mark_versions(database: VersionDatabase) -> Versions[Mark]:
    """Return the marks in a database."""
    order = "task, annotator, start, mark"
    return Versions(database, "versions", "marks", "mark", "task", order, MARK_COLUMNS, astuple, _mark_from_row)


def _mark_from_row(row: Row) -> Mark:
    values = dict(zip(MARK_COLUMNS, row, strict=True))
    if (values["state"] or GRASP_STATE) not in STATES:
        raise ValueError(f"state: {shorten_value(values['state'])}")
    return Mark(**values | {"deleted": bool(values["deleted"]), "state": values["state"] or GRASP_STATE})


def _check_mark_fields(sets: Mapping[str, object]) -> None:
    """Raise ``RefusedError`` for values that no mark can have."""
    for key, value in sets.items():
        if key == "deleted":
            fine, expected = isinstance(value, bool), "true or false"
        elif key in ("start", "end"):
            fine = value is None or (isinstance(value, int) and not isinstance(value, bool))
            expected = "a frame"
        elif key == "side":
            fine, expected = value in ("left", "right"), "left or right"
        elif key == "state":
            fine, expected = value in STATES, f"one of {', '.join(STATES)}"
        elif key == "camera":
            fine, expected = value == STATIC_CAMERA, STATIC_CAMERA
        elif key == "reason":
            fine, expected = value is None or value in DISCARD_REASONS, f"one of {', '.join(DISCARD_REASONS)}"
        else:
            fine = isinstance(value, str) and 0 < len(value.strip()) <= 200 and value.isprintable()
            expected = "a name of up to 200 letters"
        if not fine:
            raise RefusedError(f"{key} must be {expected} (got {shorten_value(value)})")


def apply_mark_change(mark: Mark, sets: Json, footage: Footage) -> Mark:
    """Apply a change to a mark, and add the footage's data of its frames. Raises ``RefusedError``."""
    _check_mark_fields(sets)
    new = replace(mark, **sets)
    for frame in (new.start, new.end):
        if frame is not None and not 0 <= frame < footage.frames:
            raise RefusedError(f"frame {frame}: the footage has frames 0 to {footage.frames - 1}")
    if new.end is not None and (new.start is None or new.end < new.start):
        raise RefusedError("a segment cannot end before it starts")
    if new.end is not None and new.state == GRASP_STATE and new.side is None and not new.deleted:
        raise RefusedError("say first which hand holds the object: left or right")
    entry = [value for value in (new.start, new.reason, new.camera) if value is not None]
    if len(entry) > 1:
        raise RefusedError("a mark is a segment, the reason why there is none, or about the camera: one of them")
    if not entry and not new.deleted:
        raise RefusedError("a mark needs a start, or a reason why there is none")
    return replace(
        new,
        start_number=None if new.start is None else footage.number(new.start),
        end_number=None if new.end is None else footage.number(new.end),
        seconds=None if new.start is None or new.end is None else duration_seconds(footage, new.start, new.end),
    )
