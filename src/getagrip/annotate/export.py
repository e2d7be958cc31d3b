"""Marks of grasps as files: EPIC-Grasps' table, and the intervals as ``getagrip segment`` writes them."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence

from getagrip.annotate.marks import Mark
from getagrip.annotate.tasks import Task
from getagrip.io.tables import CsvTable

EPIC_GRASPS_COLUMNS = ("vid", "st_bound", "ed_bound", "st", "ed", "contact", "handside", "cat", "hos_name", "mp4_name", "set_name",
           "round", "duration", "n_unfiltered_masks", "n_filtered_masks", "good_CAD", "example", "fmt",
           "ablate_inithand")  # fmt: skip
"""Columns of EPIC-Grasps' table."""


def finished_grasps(marks: Sequence[Mark]) -> list[Mark]:
    """Return the finished grasps, each once: of those with the same video, hand, category and frames the first."""
    return [mark for mark in marks if mark.grasp and mark.side and mark.category]


def epic_rows(marks: Sequence[Mark], tasks: Mapping[str, Task]) -> list[Mapping[str, object]]:
    """Return the rows of EPIC-Grasps' table.

    What annotation cannot know stays empty: the counts of masks, sets and rounds.

    A task without rough bounds has the grasp's own.
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
    rows = epic_rows(marks, tasks)
    CsvTable(stream).write_rows(
        [EPIC_GRASPS_COLUMNS, *([row[column] for column in EPIC_GRASPS_COLUMNS] for row in rows)]
    )
    return stream.getvalue()


def grasp_intervals(marks: Sequence[Mark], tasks: Mapping[str, Task]) -> list[Mapping[str, object]]:
    """Return the grasps under the names that ``segment`` gives them; frames count from 0, both included, seconds."""
    rows = [
        {
            "clip": tasks[mark.task].video,
            "side": mark.side,
            "object": mark.category,
            "start": mark.start,
            "end": mark.end,
            "duration": mark.seconds,
        }
        for mark in finished_grasps(marks)
    ]
    return [row for n, row in enumerate(rows) if row not in rows[:n]]


def discarded_tasks(marks: Sequence[Mark], tasks: Mapping[str, Task]) -> list[Mapping[str, object]]:
    """Return the tasks that were discarded, and why."""
    return [
        {"task": mark.task, "clip": tasks[mark.task].video, "annotator": mark.annotator, "reason": mark.reason}
        for mark in marks
        if mark.reason
    ]
