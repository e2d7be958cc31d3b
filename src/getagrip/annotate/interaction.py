"""A whole interaction, from table to hand and back: the segments that one person has marked of a task, as a timeline.

Where a person has marked stable grasps only, and nothing of the camera, there is none: each grasp stands by itself.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from pathlib import Path
from typing import cast
from uuid import NAMESPACE_OID, uuid5

from getagrip.annotate.footage import Footage, FrameNames, duration_seconds
from getagrip.annotate.marks import GRASP_STATE, STATIC_CAMERA, Mark
from getagrip.annotate.tasks import Task
from getagrip.annotate.versions import RefusedError
from getagrip.clip import Segment, State, segment_files
from getagrip.clip.segment_files import SegmentList
from getagrip.clip.timeline import segment_fields
from getagrip.errors import InputError
from getagrip.hands.model import Side
from getagrip.io import files

CONTACT_STATES = ("grasp", "contact")
"""States in which a hand touches the object."""


@dataclass(frozen=True)
class Interaction:
    """Segments of a task, numbered from 1 in the order of their starts, as the page does."""

    task: Task
    footage: Footage
    numbered: tuple[tuple[int, Mark], ...]
    still: bool
    """The camera did not move, as the person states."""

    @property
    def finished(self) -> list[tuple[int, Mark]]:
        """The segments that have an end."""
        return [(n, mark) for n, mark in self.numbered if mark.interval]

    @property
    def side(self) -> Side | None:
        """The hand that touches the object longest, in stable grasps if there are any; None where none is stated."""
        frames: Counter[tuple[bool, bool, str]] = Counter()
        for _, mark in self.finished:
            if mark.side is not None:
                frames[mark.state == GRASP_STATE, mark.state in CONTACT_STATES, mark.side] += _mark_frame_count(mark)
        if not frames:
            return None
        return cast(Side, max(frames, key=lambda key: (*key[:2], frames[key]))[2])

    @property
    def mark(self) -> Mark:
        """All of it as one mark, whose frames can be labelled. Raises ``RefusedError`` where no segment is finished."""
        own = [mark for _, mark in self.finished]
        if not own:
            raise RefusedError("mark the end of a segment first")
        first, last = min(mark.start or 0 for mark in own), max(mark.end or 0 for mark in own)
        about = next((mark for mark in own if mark.category), own[0])
        return replace(
            about, mark=_interaction_id(own[0]), start=first, end=last, side=self.side,
            start_number=self.footage.number(first), end_number=self.footage.number(last),
            seconds=duration_seconds(self.footage, first, last),
        )  # fmt: skip

    def overlaps(self) -> list[str]:
        """Return texts on frames that are in two segments: these cannot be written."""
        out = []
        for (n, one), (m, other) in combinations(self.finished, 2):
            first, last = max(one.start or 0, other.start or 0), min(one.end or 0, other.end or 0)
            if first <= last:
                out.append(f"{self._frames(first, last)} in two segments, {n} and {m}: move the end of one of them.")
        return out

    def hints(self) -> list[str]:
        """Return hints: gaps, missing ends, a camera of which nothing is known."""
        return list(self._hints())

    def _hints(self) -> Iterator[str]:
        yield from (f"Segment {n} has no end yet." for n, mark in self.numbered if not mark.interval)
        order = sorted(self.finished, key=lambda one: one[1].start or 0)
        for (n, one), (m, other) in pairwise(order):
            first, last = (one.end or 0) + 1, (other.start or 0) - 1
            if first <= last:
                frames = self._frames(first, last)
                yield f"{frames} in no segment, between {n} and {m}: what the object does there counts as unknown."
        states = {mark.state for _, mark in order}
        if "static" in states and not self.still:
            yield "Where the object lies still, the camera must be known: state below that it stood still, if it did."
        if order and not states & {"static", GRASP_STATE}:
            yield "Nothing can be reconstructed yet: mark where the object lies still, or is held in a stable grasp."
        if self.side is None and states & {*CONTACT_STATES}:
            yield "Which hand touches the object? Choose left or right."
        others = [n for n, mark in order if mark.state in CONTACT_STATES and (mark.side or self.side) != self.side]
        if others:
            which = "segment" if len(others) == 1 else "segments"
            yield (
                f"The {self.side} hand is the clip's. In {which} {', '.join(map(str, others))} the other one touches "
                "the object, which is followed there by its masks only."
            )

    def listed(self) -> SegmentList:
        """Return the segments as files have them, in frames of a clip. Raises ``RefusedError`` where some overlap."""
        if overlaps := self.overlaps():
            raise RefusedError(" ".join(overlaps))
        order = sorted((mark for _, mark in self.finished), key=lambda mark: mark.start or 0)
        if self.side is None and any(mark.state in CONTACT_STATES for mark in order):
            raise RefusedError("say first which hand touches the object: left or right")
        segments = [
            Segment(
                cast(State, mark.state), mark.start or 0, mark.end or 0,
                cast(Side, mark.side or self.side) if mark.state in CONTACT_STATES else None,
            )
            for mark in order
        ]  # fmt: skip
        names = FrameNames(self.footage)
        who = next(mark.annotator for _, mark in self.numbered)
        still = f"as {who} states" if self.still else None
        path = self.task.path
        assert path is not None  # its footage is open
        return SegmentList(path, self.task.key, segment_fields(segments, names), f"marked by {who}", still)

    def state(self) -> dict[str, object]:
        """Return the fields that the page shows of it."""
        own = [mark for _, mark in self.finished]
        mark = self.mark if own else None
        about = {} if mark is None else {key: getattr(mark, key) for key in INTERACTION_FIELDS}
        return about | {"still": self.still, "overlaps": self.overlaps(), "hints": self.hints()}

    def _frames(self, first: int, last: int) -> str:
        a, b = self.footage.number(first), self.footage.number(last)
        return f"Frame {a} is" if first == last else f"Frames {a} to {b} are"


INTERACTION_FIELDS = ("mark", "start", "end", "start_number", "end_number", "side", "category")
"""Fields that the page shows of all of it."""


def is_interaction(marks: Sequence[Mark]) -> bool:
    """Return whether one person's marks of a task are of a whole interaction."""
    return any(mark.start is not None for mark in marks) and any(
        mark.camera == STATIC_CAMERA or (mark.start is not None and mark.state != GRASP_STATE) for mark in marks
    )


def interaction_of_marks(task: Task, footage: Footage, marks: Sequence[Mark]) -> Interaction:
    """Return the interaction of one person's marks of a task.

    Marks beyond the footage, which was longer once, are left out.
    """
    inside = [mark for mark in marks if mark.start is not None and max(mark.start, mark.end or 0) < footage.frames]
    segments = sorted(inside, key=lambda mark: mark.start or 0)
    still = any(mark.camera == STATIC_CAMERA for mark in marks)
    return Interaction(task, footage, tuple(enumerate(segments, start=1)), still)


def read_task_segments(path: Path, tasks: Sequence[Task]) -> list[tuple[Task, SegmentList]]:
    """Return a file's segments of some tasks, by their names; of a single task also the only entry.

    Raises ``InputError``.
    """
    if len(tasks) == 1:
        return [(tasks[0], segment_files.read_segment_list(path, [tasks[0].key, tasks[0].video]))]
    known = files.read_json(path)
    found = [task for task in tasks if task.key in known]
    if not found:
        raise InputError(path, "", "no segments of the footage given", f"those of {files.printable(tasks[0].key)}, ...")
    return [(task, segment_files.read_segment_list(path, [task.key])) for task in found]


def _interaction_id(mark: Mark) -> str:
    """Return the name that labels of the whole are kept under, whatever its segments are."""
    return str(uuid5(NAMESPACE_OID, f"{mark.annotator}/{mark.task}"))


def _mark_frame_count(mark: Mark) -> int:
    return (mark.end or 0) - (mark.start or 0) + 1
