"""What the page can ask for: the tasks, their frames, and changes of marks. Plain functions of plain data, no HTTP."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import asdict
from hashlib import sha256
from threading import Lock
from typing import Any

from getagrip import files
from getagrip.annotate import agreement, export, marks
from getagrip.annotate.footage import Footage
from getagrip.annotate.marks import Mark, RefusedError
from getagrip.annotate.store import Store
from getagrip.annotate.tasks import Task, open_footage
from getagrip.annotate.video import Video
from getagrip.datasets.epic_files import CATEGORIES

MOST_OPEN = 4
"""Footage that is kept open at once."""


class Project:
    """Tasks and the store of their marks."""

    def __init__(self, tasks: list[Task], store: Store) -> None:
        self.tasks = {task.key: task for task in tasks}
        self.store = store
        self.name = sha256(str(store.path.resolve()).encode()).hexdigest()[:16]
        """What the page calls the database, so that it takes no other for it."""
        self._open: OrderedDict[str, Footage] = OrderedDict()
        self._lock = Lock()

    def close(self) -> None:
        """Close all files."""
        with self._lock:
            while self._open:
                _close(self._open.popitem()[1])
        self.store.close()

    def overview(self, annotator: object) -> dict[str, Any]:
        """All tasks, and how far somebody is with each: "", started, marked, discarded."""
        own: dict[str, list[Mark]] = {}
        for mark in self.store.marks(annotator=marks.annotator(annotator)):
            own.setdefault(mark.task, []).append(mark)
        tasks = [
            asdict(task) | {"path": None, "found": task.path is not None, "state": _state(own.get(task.key, []))}
            for task in self.tasks.values()
        ]
        return {"project": self.name, "tasks": tasks, "categories": CATEGORIES, "reasons": marks.REASONS}

    def task(self, key: object) -> dict[str, Any]:
        """The frames of a task. Raises ``RefusedError`` for an unknown one, ``InputError`` where it does not open."""
        task = self._task(key)
        footage = self.footage(task)
        first, last = task.extent(footage)
        contact = None if task.contact is None else footage.index(task.contact)
        return {"frames": footage.frames, "fps": footage.fps, "first": first, "last": last, "contact": contact}

    def frame(self, key: object, index: int) -> tuple[bytes, float, int]:
        """A frame as JPEG, when it is shown [s], and its number. Raises ``RefusedError`` and ``InputError``."""
        footage = self.footage(self._task(key))
        if not 0 <= index < footage.frames:
            raise RefusedError(f"frame {index}: the footage has frames 0 to {footage.frames - 1}")
        return footage.jpeg(index), footage.time(index), footage.number(index)

    def marks(self, key: object, annotator: object) -> dict[str, Any]:
        """Somebody's marks of a task, and the number of the change that made them what they are."""
        task, name = self._task(key), marks.annotator(annotator)
        newest = self.store.newest(task.key, name)  # before the marks: what changes in between is asked for again
        return {"newest": newest, "marks": [asdict(mark) for mark in self.store.marks(task.key, name)]}

    def change(self, content: Mapping[str, Any]) -> dict[str, Any]:
        """Make a change. Raises ``RefusedError``."""
        change = marks.read_change(content)
        footage = self.footage(self._task(change.task))
        self.store.apply(change, lambda mark, sets: marks.changed(mark, sets, footage))
        return self.marks(change.task, change.annotator)

    def undo(self, content: Mapping[str, Any]) -> dict[str, Any]:
        """Take back a tab's last change of a task. Raises ``RefusedError``."""
        task, name = self._task(content.get("task")), marks.annotator(content.get("annotator"))
        for key in ("tab", "change"):
            if not isinstance(value := content.get(key), str) or not marks.TOKEN.fullmatch(value):
                raise RefusedError(f"{key}: got {files.shown(value)}, expected 8 to 64 letters, digits or hyphens")
        undone = self.store.undo(task.key, name, content["tab"], content["change"])
        return self.marks(task.key, name) | {"undone": undone is not None}

    def known(self, annotator: str | None = None) -> list[Mark]:
        """The marks of these tasks; those of other tasks in the same file are left out."""
        return [mark for mark in self.store.marks(annotator=annotator) if mark.task in self.tasks]

    def agreement(self) -> dict[str, Any]:
        """How far people agree."""
        return {"pairs": [asdict(one) for one in agreement.agreements(self.known())]}

    def exported(self, kind: str, annotator: object) -> str:
        """Somebody's grasps as text: "csv" or "json"."""
        found = self.known(marks.annotator(annotator))
        if kind == "csv":
            return export.epic_csv(found, self.tasks)
        return files.to_json(export.intervals(found, self.tasks)) + "\n"

    def footage(self, task: Task) -> Footage:
        """The footage of a task, opened where it is not. Raises ``InputError``, ``RefusedError`` if none was found."""
        if task.path is None:
            raise RefusedError(f"{task.video}: no such video or folder of images")
        with self._lock:
            name = str(task.path)
            if name not in self._open:
                self._open[name] = open_footage(task.path)
            self._open.move_to_end(name)
            while len(self._open) > MOST_OPEN:
                _close(self._open.popitem(last=False)[1])
            return self._open[name]

    def _task(self, key: object) -> Task:
        if not isinstance(key, str) or key not in self.tasks:
            raise RefusedError(f"task: got {files.shown(key)}, expected one of the {len(self.tasks)} there are")
        return self.tasks[key]


def _close(footage: Footage) -> None:
    if isinstance(footage, Video):
        footage.close()


def _state(found: list[Mark]) -> str:
    if any(mark.interval for mark in found):
        return "marked"
    if any(mark.reason for mark in found):
        return "discarded"
    return "started" if found else ""
