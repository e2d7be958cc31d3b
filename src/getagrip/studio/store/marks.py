"""Marks of tasks by annotators; their agreement, whole interactions, and grasps made of them.

A mark is one of: the object's state in an interval (a segment, such as a stable grasp), the reason why a task is
discarded, or the statement that the camera stood still. Agreement on stable grasps is temporal intersection over union.
An annotator's segments of a task are a whole interaction, from table to hand and back, and become a timeline; stable
grasps alone, without a mark of the camera, are independent grasps. Files of marks are EPIC-Grasps' table, and the
intervals that ``getagrip segment`` writes.
"""

from __future__ import annotations

import io
import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, field, fields, replace
from hashlib import sha256
from itertools import combinations, pairwise
from pathlib import Path
from typing import cast
from uuid import NAMESPACE_OID, uuid5

import numpy as np

from getagrip.clip import Segment, State, read
from getagrip.clip.read import SegmentList
from getagrip.clip.timeline import STATES, segment_fields
from getagrip.errors import InputError
from getagrip.hands.model import Side
from getagrip.io import files
from getagrip.io.files import Json, shorten_value
from getagrip.io.terminal import CsvTable
from getagrip.readers.footage import Footage, FrameNames, duration_seconds
from getagrip.studio.store.history import RefusedError, Row, VersionDatabase, Versions
from getagrip.studio.store.tasks import Task

DISCARD_REASONS = ("no stable grasp", "out of view", "other CAD")
"""Why a task is discarded: no stable grasp, hand or object not visible, the object differs from its mesh."""
GRASP_STATE = "grasp"
"""The state of a stable grasp (``clip.timeline``)."""
STATIC_CAMERA = "still"
"""Value of ``Mark.camera`` for a camera that did not move."""
MARK_SETTABLE_FIELDS = frozenset({"start", "end", "side", "category", "entity", "reason", "state", "camera", "deleted"})
"""Fields that a change may set."""
CONTACT_STATES = ("grasp", "contact")
"""States in which a hand touches the object."""
INTERACTION_FIELDS = ("mark", "start", "end", "start_number", "end_number", "side", "category")
"""Fields of an interaction's mark that the page shows."""
EPIC_GRASPS_COLUMNS = (
    "vid", "st_bound", "ed_bound", "st", "ed", "contact", "handside", "cat", "hos_name", "mp4_name", "set_name",
    "round", "duration", "n_unfiltered_masks", "n_filtered_masks", "good_CAD", "example", "fmt", "ablate_inithand",
)  # fmt: skip
"""Columns of EPIC-Grasps' table."""
MAX_GRASP_NAME_LENGTH = 100
"""Maximum length of a grasp's name in files [characters]."""
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
"""Columns added in version 3 of the tables; an interval without a state is a stable grasp."""


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
    """One of ``DISCARD_REASONS``, in a mark without start and end."""
    deleted: bool = False
    start_number: int | None = None
    """Start and end in the footage's own frame numbers."""
    end_number: int | None = None
    seconds: float | None = None
    """Duration [s]."""
    state: str = GRASP_STATE
    """State of the object in the interval: one of ``STATES``."""
    camera: str | None = None
    """``STATIC_CAMERA``, in a mark without start and end."""

    @property
    def interval(self) -> tuple[int, int] | None:
        """Start and end of a finished segment."""
        return None if self.start is None or self.end is None or self.deleted else (self.start, self.end)

    @property
    def grasp(self) -> tuple[int, int] | None:
        """Start and end of a finished stable grasp."""
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
    """Raise ``RefusedError`` for invalid values of fields."""
    choices = {"state": STATES, "camera": (STATIC_CAMERA,), "side": ("left", "right"), "reason": DISCARD_REASONS}
    for key, value in sets.items():
        if key == "deleted":
            fine, expected = isinstance(value, bool), "true or false"
        elif key in ("start", "end"):
            fine, expected = value is None or type(value) is int, "a frame"
        elif key in choices:
            fine = value in choices[key] or (key == "reason" and value is None)
            expected = f"one of {', '.join(choices[key])}"
        else:
            fine = isinstance(value, str) and 0 < len(value.strip()) <= 200 and value.isprintable()
            expected = "a name of up to 200 letters"
        if not fine:
            raise RefusedError(f"{key} must be {expected} (got {shorten_value(value)})")


def apply_mark_change(mark: Mark, sets: Json, footage: Footage) -> Mark:
    """Apply a change to a mark, and set frame numbers and duration from the footage. Raises ``RefusedError``."""
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
        raise RefusedError("a mark must be one of: a segment, a reason to discard the task, a statement on the camera")
    if not entry and not new.deleted:
        raise RefusedError("a mark needs a start, or a reason to discard the task")
    return replace(
        new,
        start_number=None if new.start is None else footage.number(new.start),
        end_number=None if new.end is None else footage.number(new.end),
        seconds=None if new.start is None or new.end is None else duration_seconds(footage, new.start, new.end),
    )


@dataclass(frozen=True)
class Agreement:
    """The agreement of two annotators, over the tasks that both have marked or discarded."""

    first: str
    second: str
    tasks: int
    """Number of tasks."""
    both_discarded: int
    one_discarded: int
    """Number of tasks in which one annotator has marked grasps and the other none."""
    grasps: int
    """Number of grasps; matched ones are counted once."""
    iou: float | None
    """Mean temporal IOU of the grasps, 0 for unmatched ones; None without grasps."""
    above_half: float | None
    """Fraction of the grasps with an IOU above one half."""


def temporal_iou(a: tuple[int, int], b: tuple[int, int]) -> float:
    """Compute the intersection over union of two intervals of frames, ends included."""
    both = min(a[1], b[1]) - max(a[0], b[0]) + 1
    return max(0, both) / (a[1] - a[0] + 1 + b[1] - b[0] + 1 - max(0, both))


def match_grasps(ours: Sequence[Mark], theirs: Sequence[Mark]) -> list[float]:
    """Match two annotators' grasps such that the sum of IOU is largest; return the IOU of each, 0 for unmatched ones.

    Grasps of different hands or without overlap are not matched. The result is symmetric.
    """
    from scipy.optimize import linear_sum_assignment

    iou = np.zeros((len(ours), len(theirs)))
    for i, a in enumerate(ours):
        for j, b in enumerate(theirs):
            if a.grasp and b.grasp and a.side == b.side:
                iou[i, j] = temporal_iou(a.grasp, b.grasp)
    pairs = [value for value in iou[linear_sum_assignment(iou, maximize=True)].tolist() if value > 0]
    alone = len(ours) + len(theirs) - 2 * len(pairs)
    return sorted(pairs, reverse=True) + [0.0] * alone


def pairwise_agreements(marks: Sequence[Mark]) -> list[Agreement]:
    """Compute the agreement of every two annotators of the same tasks."""
    marked: dict[str, dict[str, list[Mark]]] = {}
    for mark in marks:
        if mark.interval or mark.reason:  # unfinished marks do not count
            marked.setdefault(mark.annotator, {}).setdefault(mark.task, []).append(mark)
    found = [_agreement_of_pair(a, b, marked[a], marked[b]) for a, b in combinations(sorted(marked), 2)]
    return [one for one in found if one.tasks]


def _agreement_of_pair(
    first: str, second: str, ours: dict[str, list[Mark]], theirs: dict[str, list[Mark]]
) -> Agreement:
    values, both, one = list[float](), 0, 0
    shared = sorted(ours.keys() & theirs.keys())
    for task in shared:
        a, b = ([mark for mark in marks[task] if mark.grasp] for marks in (ours, theirs))
        both += not a and not b
        one += bool(a) != bool(b)
        values += match_grasps(a, b)
    mean = float(np.mean(values)) if values else None
    half = float(np.mean(np.array(values) > 0.5)) if values else None
    return Agreement(first, second, len(shared), both, one, len(values), mean, half)


@dataclass(frozen=True)
class Interaction:
    """An annotator's segments of a task."""

    task: Task
    footage: Footage
    numbered: tuple[tuple[int, Mark], ...]
    """Segments with their numbers on the page, from 1 in the order of starts."""
    still: bool
    """True if the annotator states that the camera did not move."""

    @property
    def finished(self) -> list[tuple[int, Mark]]:
        """Segments with an end, and their numbers."""
        return [(n, mark) for n, mark in self.numbered if mark.interval]

    @property
    def side(self) -> Side | None:
        """The hand that touches the object longest, in stable grasps if any; None where no side is stated."""
        frames: Counter[tuple[bool, bool, str]] = Counter()
        for _, mark in self.finished:
            if mark.side is not None:
                frames[mark.state == GRASP_STATE, mark.state in CONTACT_STATES, mark.side] += _n_frames(mark)
        if not frames:
            return None
        return cast(Side, max(frames, key=lambda key: (*key[:2], frames[key]))[2])

    @property
    def mark(self) -> Mark:
        """One mark from the first to the last frame, for labels. Raises ``RefusedError`` without a finished segment.

        Its name does not depend on the segments, so labels remain when these change.
        """
        own = [mark for _, mark in self.finished]
        if not own:
            raise RefusedError("mark the end of a segment first")
        first, last = min(mark.start or 0 for mark in own), max(mark.end or 0 for mark in own)
        about = next((mark for mark in own if mark.category), own[0])
        name = str(uuid5(NAMESPACE_OID, f"{about.annotator}/{about.task}"))
        return replace(
            about, mark=name, start=first, end=last, side=self.side,
            start_number=self.footage.number(first), end_number=self.footage.number(last),
            seconds=duration_seconds(self.footage, first, last),
        )  # fmt: skip

    def overlaps(self) -> list[str]:
        """Return texts on frames in two segments, which prevent writing."""
        out = []
        for (n, one), (m, other) in combinations(self.finished, 2):
            first, last = max(one.start or 0, other.start or 0), min(one.end or 0, other.end or 0)
            if first <= last:
                out.append(f"{self._frames(first, last)} in two segments, {n} and {m}: move the end of one of them.")
        return out

    def hints(self) -> list[str]:
        """Return hints on gaps, missing ends, an unknown camera and unknown hands."""
        out = [f"Segment {n} has no end yet." for n, mark in self.numbered if not mark.interval]
        order = sorted(self.finished, key=lambda one: one[1].start or 0)
        for (n, one), (m, other) in pairwise(order):
            first, last = (one.end or 0) + 1, (other.start or 0) - 1
            if first <= last:
                frames = self._frames(first, last)
                out.append(f"{frames} in no segment, between {n} and {m}: the object's state there counts as unknown.")
        states = {mark.state for _, mark in order}
        if "static" in states and not self.still:
            out.append("Where the object lies still, the camera must be known: state below if it stood still.")
        if order and not states & {"static", GRASP_STATE}:
            out.append("Nothing can be reconstructed yet: mark where the object lies still, or a stable grasp.")
        if self.side is None and states & {*CONTACT_STATES}:
            out.append("Which hand touches the object? Choose left or right.")
        others = [n for n, mark in order if mark.state in CONTACT_STATES and (mark.side or self.side) != self.side]
        if others:
            where = f"{'segment' if len(others) == 1 else 'segments'} {', '.join(map(str, others))}"
            only = "the other hand touches the object, whose poses come from its masks only."
            out.append(f"The {self.side} hand is the clip's. In {where} {only}")
        return out

    def listed(self) -> SegmentList:
        """Return the entry of a segment file, in frames of a clip. Raises ``RefusedError`` where segments overlap."""
        if overlaps := self.overlaps():
            raise RefusedError(" ".join(overlaps))
        order = sorted((mark for _, mark in self.finished), key=lambda mark: mark.start or 0)
        if self.side is None and any(mark.state in CONTACT_STATES for mark in order):
            raise RefusedError("say first which hand touches the object: left or right")
        sides = [cast(Side, mark.side or self.side) if mark.state in CONTACT_STATES else None for mark in order]
        segments = [
            Segment(cast(State, mark.state), mark.start or 0, mark.end or 0, side)
            for mark, side in zip(order, sides, strict=True)
        ]
        names = FrameNames(self.footage)
        who = next(mark.annotator for _, mark in self.numbered)
        still = f"as {who} states" if self.still else None
        path = self.task.path
        assert path is not None  # its footage is open
        return SegmentList(path, self.task.key, segment_fields(segments, names), f"marked by {who}", still)

    def state(self) -> dict[str, object]:
        """Return the fields that the page shows."""
        mark = self.mark if self.finished else None
        about = {} if mark is None else {key: getattr(mark, key) for key in INTERACTION_FIELDS}
        return about | {"still": self.still, "overlaps": self.overlaps(), "hints": self.hints()}

    def _frames(self, first: int, last: int) -> str:
        a, b = self.footage.number(first), self.footage.number(last)
        return f"Frame {a} is" if first == last else f"Frames {a} to {b} are"


def is_interaction(marks: Sequence[Mark]) -> bool:
    """Return whether an annotator's marks of a task are a whole interaction, rather than independent grasps."""
    return any(mark.start is not None for mark in marks) and any(
        mark.camera == STATIC_CAMERA or (mark.start is not None and mark.state != GRASP_STATE) for mark in marks
    )


def interaction_of_marks(task: Task, footage: Footage, marks: Sequence[Mark]) -> Interaction:
    """Return the interaction of an annotator's marks of a task, without marks beyond the end of the footage."""
    inside = [mark for mark in marks if mark.start is not None and max(mark.start, mark.end or 0) < footage.frames]
    segments = sorted(inside, key=lambda mark: mark.start or 0)
    still = any(mark.camera == STATIC_CAMERA for mark in marks)
    return Interaction(task, footage, tuple(enumerate(segments, start=1)), still)


def read_task_segments(path: Path, tasks: Sequence[Task]) -> list[tuple[Task, SegmentList]]:
    """Return a segment file's entries for tasks, by their names; for a single task also the only entry.

    Raises ``InputError``.
    """
    if len(tasks) == 1:
        return [(tasks[0], read.read_segment_list(path, [tasks[0].key, tasks[0].video]))]
    known = files.read_json(path)
    found = [task for task in tasks if task.key in known]
    if not found:
        raise InputError(path, "", "no segments of the input footage", f"{files.printable(tasks[0].key)}, ...")
    return [(task, read.read_segment_list(path, [task.key])) for task in found]


def _n_frames(mark: Mark) -> int:
    return (mark.end or 0) - (mark.start or 0) + 1


def finished_grasps(marks: Sequence[Mark]) -> list[Mark]:
    """Return the stable grasps with start, end, side and category."""
    return [mark for mark in marks if mark.grasp and mark.side and mark.category]


def epic_rows(marks: Sequence[Mark], tasks: Mapping[str, Task]) -> list[Mapping[str, object]]:
    """Return the rows of EPIC-Grasps' table, one for each video, hand, category and interval.

    Counts of masks, sets and rounds stay empty. A task without rough bounds gets the grasp's own.
    """
    rows: dict[str, Mapping[str, object]] = {}
    for mark in finished_grasps(marks):
        task = tasks[mark.task]
        st, ed = mark.start_number, mark.end_number
        bounds = (st, ed) if task.start is None else (task.start, task.end)
        contact = -1 if task.contact is None else task.contact
        touched = [task.contact] if task.contact is not None else []
        name = "_".join(map(str, [task.video, bounds[0], *touched, bounds[1], mark.side, mark.category]))
        fmt = f"{mark.category}/{task.video}_{mark.side}_hand_{st}_{ed}"
        row = dict.fromkeys(EPIC_GRASPS_COLUMNS, "") | {
            "vid": task.video, "st_bound": bounds[0], "ed_bound": bounds[1], "st": st, "ed": ed, "contact": contact,
            "handside": f"{mark.side} hand", "cat": mark.category, "hos_name": mark.entity or mark.category,
            "mp4_name": task.mp4_name or f"{name}.mp4", "duration": (ed or 0) - (st or 0) + 1, "good_CAD": 1,
            "example": len(rows), "fmt": fmt, "ablate_inithand": 0,
        }  # fmt: skip
        rows.setdefault(fmt, row)
    return list(rows.values())


def epic_csv(marks: Sequence[Mark], tasks: Mapping[str, Task]) -> str:
    """Write EPIC-Grasps' table as text."""
    stream = io.StringIO(newline="")
    rows = ([row[column] for column in EPIC_GRASPS_COLUMNS] for row in epic_rows(marks, tasks))
    CsvTable(stream).write_rows([EPIC_GRASPS_COLUMNS, *rows])
    return stream.getvalue()


def grasp_intervals(marks: Sequence[Mark], tasks: Mapping[str, Task]) -> list[Mapping[str, object]]:
    """Return the grasps with the keys of ``getagrip segment``: frames from 0, both included, duration [s]."""
    fields = {"side": "side", "object": "category", "start": "start", "end": "end", "duration": "seconds"}
    rows = [
        {"clip": tasks[mark.task].video} | {key: getattr(mark, field) for key, field in fields.items()}
        for mark in finished_grasps(marks)
    ]
    return [row for n, row in enumerate(rows) if row not in rows[:n]]


def discarded_tasks(marks: Sequence[Mark], tasks: Mapping[str, Task]) -> list[Mapping[str, object]]:
    """Return the discarded tasks, with annotator and reason."""
    return [
        {"task": mark.task, "clip": tasks[mark.task].video, "annotator": mark.annotator, "reason": mark.reason}
        for mark in marks
        if mark.reason
    ]


def name_grasp(task: Task, mark: Mark) -> str:
    """Return the name of the files of a grasp with a side; truncated or changed names end with a checksum."""
    whole = "-".join(map(str, [mark.annotator, task.video, mark.start_number, mark.end_number, mark.side]))
    plain = re.sub(r"[^\w.-]", "_", whole).lstrip(".")[:MAX_GRASP_NAME_LENGTH]
    return plain if plain == whole else f"{plain}-{sha256(json.dumps([whole]).encode()).hexdigest()[:8]}"


@dataclass(frozen=True)
class MarkedGrasp:
    """A grasp, or a whole interaction, that is marked; its footage need not be open."""

    task: Task
    mark: Mark
    whole: Interaction | None = None
    """The interaction; None for a single grasp."""

    @property
    def extent(self) -> tuple[int, int]:
        """First and last frame. Raises ``RefusedError`` without these marks."""
        if self.mark.interval is None:
            raise RefusedError("mark the start and the end of the grasp first")
        return self.mark.interval

    @property
    def side(self) -> Side:
        """Side of the hand. Raises ``RefusedError`` for a mark without it."""
        if self.mark.side not in ("left", "right"):
            raise RefusedError("say first which hand holds the object")
        return cast(Side, self.mark.side)

    @property
    def name(self) -> str:
        """Name of the grasp's files."""
        return name_grasp(self.task, self.mark)

    @property
    def path(self) -> Path:
        """Path of the footage."""
        assert self.task.path is not None
        return self.task.path


@dataclass(frozen=True)
class Grasp(MarkedGrasp):
    """A grasp, or a whole interaction, and its footage."""

    footage: Footage = field(kw_only=True)
