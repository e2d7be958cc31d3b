"""What the page can ask for: the tasks, their frames, and changes of marks. Plain functions of plain data, no HTTP."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from hashlib import sha256
from threading import Lock
from typing import Any
from uuid import uuid4

from getagrip.annotate import agreement, export, labels, marks, versions
from getagrip.annotate.footage import Footage
from getagrip.annotate.labelled_footage import tasks_of
from getagrip.annotate.labelling import Grasp, Labelling
from getagrip.annotate.labels import Labels
from getagrip.annotate.marks import Mark
from getagrip.annotate.store import Store
from getagrip.annotate.tasks import Task, open_footage
from getagrip.annotate.versions import Change, RefusedError, token
from getagrip.clip.intrinsics import Lens
from getagrip.datasets.epic.tables import CATEGORIES
from getagrip.io import files

MOST_OPEN = 4
"""Footage that is kept open at once."""


class Project:
    """Tasks and the store of their marks and labels."""

    def __init__(self, tasks: list[Task], store: Store, lens: Lens | None = None) -> None:
        """``lens`` is the camera of all footage; without one the focal length is guessed."""
        self.tasks = {task.key: task for task in tasks}
        self.store = store
        self.labelling = Labelling(store, lens or Lens(), store.path.parent)
        self.name = sha256(str(store.path.resolve()).encode()).hexdigest()[:16]
        """What the page calls the database, so that it takes no other for it."""
        self._open: OrderedDict[str, Footage] = OrderedDict()
        self._lock = Lock()

    def close(self) -> None:
        """Close all files."""
        self.labelling.close()
        with self._lock:
            while self._open:
                self._open.popitem()[1].close()
        self.store.close()

    def overview(self, annotator: object) -> dict[str, Any]:
        """All tasks, and how far an annotator is with each: "", started, marked, discarded."""
        own: dict[str, list[Mark]] = {}
        for mark in self.store.marks.standing(annotator=versions.annotator(annotator)):
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

    def frame(self, key: object, index: int, whole: bool = False) -> tuple[bytes, float, int]:
        """A frame as JPEG, when it is shown [s], and its number. Raises ``RefusedError`` and ``InputError``."""
        footage = self.footage(self._task(key))
        if not 0 <= index < footage.frames:
            raise RefusedError(f"frame {index}: the footage has frames 0 to {footage.frames - 1}")
        return footage.jpeg(index, whole), footage.time(index), footage.number(index)

    def marks(self, key: object, annotator: object) -> dict[str, Any]:
        """Somebody's marks of a task, and the number of the change that made them what they are."""
        task, name = self._task(key), versions.annotator(annotator)
        newest = self.store.marks.newest(task.key, name)  # before the marks: what changes in between is asked for again
        return {"newest": newest, "marks": [asdict(mark) for mark in self.store.marks.standing(task.key, name)]}

    def change(self, content: Mapping[str, Any]) -> dict[str, Any]:
        """Make a change. Raises ``RefusedError``."""
        change = versions.read_change(content, marks.SETTABLE)
        blank = Mark(token(content, "mark"), str(content.get("task")), versions.annotator(content.get("annotator")))
        footage = self.footage(self._task(blank.task))
        self.store.marks.apply(change, blank, lambda mark, sets: marks.changed(mark, sets, footage))
        return self.marks(blank.task, blank.annotator)

    def undo(self, content: Mapping[str, Any]) -> dict[str, Any]:
        """Take back a tab's last change of a task's marks. Raises ``RefusedError``."""
        task, name = self._task(content.get("task")), versions.annotator(content.get("annotator"))
        undone = self.store.marks.undo(task.key, name, token(content, "tab"), token(content, "change"))
        return self.marks(task.key, name) | {"undone": undone is not None}

    def labels(self, content: Mapping[str, Any]) -> dict[str, Any]:
        """The labels of a grasp. Raises ``RefusedError``."""
        return self.labelling.state(self._grasp(content))

    def label(self, content: Mapping[str, Any]) -> dict[str, Any]:
        """Make a change of one of its frames. Raises ``RefusedError``."""
        grasp = self._grasp(content)
        self.labelling.change(grasp, content)
        return self.labelling.state(grasp)

    def unlabel(self, content: Mapping[str, Any]) -> dict[str, Any]:
        """Take back a tab's last change of its frames. Raises ``RefusedError``."""
        grasp = self._grasp(content)
        undone = self.labelling.undo(grasp, token(content, "tab"), token(content, "change"))
        return self.labelling.state(grasp) | undone

    def work(self, content: Mapping[str, Any]) -> dict[str, Any]:
        """Begin to "propagate", write "files" or "reconstruct" a grasp, or "cancel" that. Raises ``RefusedError``."""
        grasp = self._grasp(content)
        known = {
            "propagate": lambda: self.labelling.propagate(grasp),
            "files": lambda: self.labelling.make(grasp),
            "reconstruct": lambda: self.labelling.reconstruct(grasp, content),
            "cancel": lambda: self.labelling.background.cancel(grasp.mark.mark),
        }
        if not isinstance(what := content.get("work"), str) or what not in known:
            raise RefusedError(f"work: got {files.shown(what)}, expected one of {', '.join(known)}")
        known[what]()
        return self.labelling.state(grasp)

    def drafts(self, content: Mapping[str, Any], since: int) -> dict[str, Any]:
        """Some drafts of a grasp's frames that are newer than what was given before. Raises ``RefusedError``."""
        return {"drafts": self.store.drafts.since(self._grasp(content).mark.mark, since)}

    def labels_file(self, content: Mapping[str, Any]) -> tuple[str, str]:
        """The labels of a grasp as JSON, and what to call the file. Raises ``RefusedError``."""
        grasp = self._grasp(content)
        text = files.to_json(labels.to_json(self.labelling.whole_labels(grasp))) + "\n"
        return text, f"labels-{grasp.name}.json"

    def result_file(self, content: Mapping[str, Any], name: str) -> bytes:
        """The picture or the page of a grasp's result. Raises ``RefusedError``."""
        return self.labelling.result_file(self._grasp(content), name)

    def labelled(self) -> Iterator[Grasp]:
        """The finished grasps of these tasks that have labels. Raises ``InputError``."""
        with_labels = {one.grasp for one in self.store.keyframes.standing()}
        for mark in self.known():
            task = self.tasks[mark.task]
            if mark.mark in with_labels and mark.interval and mark.side and task.path is not None:
                yield Grasp(task, self.footage(task), mark)

    def import_labels(self, given: Labels, annotator: str) -> Grasp:
        """Take a file of labels as an annotator's own, of a grasp that is marked if it is not yet.

        Raises ``RefusedError`` where it is of other footage.
        """
        tasks = tasks_of(given, list(self.tasks.values()))
        footage = self.footage(tasks[0])
        inside = [task for task in tasks if _holds(task.extent(footage), (given.first, given.last))]
        task, name = (inside or tasks)[0], versions.annotator(annotator)
        sets = {"start": given.first, "end": given.last, "side": given.side}
        same = [
            mark
            for mark in self.store.marks.standing(task.key, name)
            if mark.interval == (given.first, given.last) and mark.side == given.side
        ]
        if not same:
            blank, about = Mark(str(uuid4()), task.key, name), {"category": task.category, "entity": task.entity}
            change = Change(str(uuid4()), str(uuid4()), sets | {key: text for key, text in about.items() if text})
            same = [self.store.marks.apply(change, blank, lambda mark, sets: marks.changed(mark, sets, footage))]
        grasp = Grasp(task, footage, same[0])
        self.labelling.take(grasp, given)
        return grasp

    def known(self, annotator: str | None = None) -> list[Mark]:
        """The marks of these tasks; those of other tasks in the same file are left out."""
        return [mark for mark in self.store.marks.standing(annotator=annotator) if mark.task in self.tasks]

    def agreement(self) -> dict[str, Any]:
        """How far people agree."""
        return {"pairs": [asdict(one) for one in agreement.agreements(self.known())]}

    def exported(self, kind: str, annotator: object) -> str:
        """Somebody's grasps as text: "csv" or "json"."""
        found = self.known(versions.annotator(annotator))
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
                self._open.popitem(last=False)[1].close()
            return self._open[name]

    def _grasp(self, content: Mapping[str, Any]) -> Grasp:
        """The grasp that a request is about, and who asks. Raises ``RefusedError``."""
        task, name = self._task(content.get("task")), versions.annotator(content.get("annotator"))
        own = {mark.mark: mark for mark in self.store.marks.standing(task.key, name) if mark.start is not None}
        if not isinstance(key := content.get("grasp"), str) or key not in own:
            raise RefusedError(f"grasp: got {files.shown(key)}, expected one that {name} has marked in {task.key}")
        return Grasp(task, self.footage(task), own[key])

    def _task(self, key: object) -> Task:
        if not isinstance(key, str) or key not in self.tasks:
            raise RefusedError(f"task: got {files.shown(key)}, expected one of the {len(self.tasks)} there are")
        return self.tasks[key]


def _holds(outer: tuple[int, int], inner: tuple[int, int]) -> bool:
    return outer[0] <= inner[0] and inner[1] <= outer[1]


def _state(found: list[Mark]) -> str:
    if any(mark.interval for mark in found):
        return "marked"
    if any(mark.reason for mark in found):
        return "discarded"
    return "started" if found else ""
