"""The page's requests on tasks, frames, marks and labels, as methods of plain data without HTTP."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from threading import Lock
from uuid import uuid4

from getagrip.geometry.lens import Lens
from getagrip.io import files
from getagrip.io.files import Json
from getagrip.readers.datasets.epic.epic_tables import EPIC_CATEGORIES
from getagrip.readers.footage import Footage, FrameNames
from getagrip.studio.jobs import parse_requested_mesh
from getagrip.studio.labelling import Labelling
from getagrip.studio.store import history, labels, marks, shapes
from getagrip.studio.store.export_clip import tasks_of_labels
from getagrip.studio.store.history import Change, RefusedError, parse_token
from getagrip.studio.store.labels import Labels
from getagrip.studio.store.mark_store import Store
from getagrip.studio.store.marks import (
    Grasp,
    Interaction,
    Mark,
    MarkedGrasp,
    interaction_of_marks,
    is_interaction,
    read_task_segments,
)
from getagrip.studio.store.tasks import Task, open_footage

PROGRESS = ("not begun", "drawn", "wrong", "uncertain", "right")
"""States of a grasp whose pose is wanted, the least far first; the last three are verdicts on its result."""
MAX_OPEN_FOOTAGE = 4
"""Maximum number of videos that are open at once."""


class Project:
    """Tasks and the store of their marks and labels."""

    def __init__(self, tasks: list[Task], store: Store, lens: Lens | None = None, wants_poses: bool = False) -> None:
        """``lens`` is the camera of all footage; without one the focal length is guessed.

        With ``wants_poses`` a task is done with a pose of each grasp, not with marks alone.
        """
        self.wants_poses = wants_poses
        self.tasks = {task.key: task for task in tasks}
        self.store = store
        self.labelling = Labelling(store, lens or Lens(), store.path.parent)
        self.name = sha256(str(store.path.resolve()).encode()).hexdigest()[:16]
        """Name by which the page distinguishes databases."""
        self._open: OrderedDict[str, Footage] = OrderedDict()
        self._lock = Lock()

    def close(self) -> None:
        """Close all files."""
        self.labelling.close()
        with self._lock:
            while self._open:
                self._open.popitem()[1].close()
        self.store.close()

    def overview(self, annotator: object) -> dict[str, object]:
        """List all tasks with an annotator's state of each: "", started, marked, discarded. Raises ``RefusedError``.

        Where poses are wanted, or the mesh of a grasp is stated, the state is that of the grasp that is least far.
        """
        own: dict[str, list[Mark]] = {}
        for mark in self.store.marks.standing(annotator=history.check_annotator(annotator)):
            own.setdefault(mark.task, []).append(mark)
        tasks = [
            asdict(task)
            | {"path": None, "found": task.path is not None, "state": self._state(task, own.get(task.key, []))}
            for task in self.tasks.values()
        ]
        last = self.store.settings.newest(history.check_annotator(annotator))
        there = last is not None and last[0] in self.tasks and self.tasks[last[0]].path is not None
        return {
            "project": self.name,
            "tasks": tasks,
            "categories": EPIC_CATEGORIES,
            "reasons": marks.DISCARD_REASONS,
            "kinds": shapes.KINDS,
            "last": last if there else None,
        }

    def task(self, key: object) -> dict[str, object]:
        """Return the frames of a task, from 0.

        Raises ``RefusedError`` for an unknown task, ``InputError`` for malformed footage.
        """
        task = self._task(key)
        footage = self.footage(task)
        first, last = task.extent(footage)
        contact = None if task.contact is None else footage.index(task.contact)
        return {"frames": footage.frames, "fps": footage.fps, "first": first, "last": last, "contact": contact}

    def frame(self, key: object, index: int, whole: bool = False) -> tuple[bytes, float, int]:
        """Return a frame as JPEG, its time [s], and its number. Raises ``RefusedError`` and ``InputError``."""
        footage = self.footage(self._task(key))
        if not 0 <= index < footage.frames:
            raise RefusedError(f"frame {index}: the footage has frames 0 to {footage.frames - 1}")
        return footage.jpeg(index, whole), footage.time(index), footage.number(index)

    def marks(self, key: object, annotator: object) -> dict[str, object]:
        """Return an annotator's marks of a task, and the number of the last change. Raises ``RefusedError``."""
        task, name = self._task(key), history.check_annotator(annotator)
        newest = self.store.marks.newest(task.key, name)  # before the marks: later changes are requested again
        own = self.store.marks.standing(task.key, name)
        state = interaction_of_marks(task, self.footage(task), own).state() if is_interaction(own) else None
        listed = [asdict(mark) for mark in own]
        return {"newest": newest, "marks": listed, "interaction": state, "state": self._state(task, own)}

    def change(self, content: Json) -> dict[str, object]:
        """Make a change of a mark; return the task's marks. Raises ``RefusedError``."""
        change = history.read_change(content, marks.MARK_SETTABLE_FIELDS)
        name = history.check_annotator(content.get("annotator"))
        blank = Mark(parse_token(content, "mark"), str(content.get("task")), name)
        footage = self.footage(self._task(blank.task))
        self.store.marks.apply(change, blank, lambda mark, sets: marks.apply_mark_change(mark, sets, footage))
        return self.marks(blank.task, blank.annotator)

    def undo(self, content: Json) -> dict[str, object]:
        """Undo a tab's last change of a task's marks; return the task's marks. Raises ``RefusedError``."""
        task, name = self._task(content.get("task")), history.check_annotator(content.get("annotator"))
        undone = self.store.marks.undo(task.key, name, parse_token(content, "tab"), parse_token(content, "change"))
        return self.marks(task.key, name) | {"undone": undone is not None}

    def labels(self, content: Json) -> dict[str, object]:
        """Return the state of a grasp's labels, and of its task. Raises ``RefusedError``."""
        return self._labels(self._grasp(content))

    def label(self, content: Json) -> dict[str, object]:
        """Make a change of a key frame of a grasp. Raises ``RefusedError``."""
        grasp = self._grasp(content)
        self.labelling.change(grasp, content)
        return self._labels(grasp)

    def set(self, content: Json) -> dict[str, object]:
        """Store some settings of a grasp, as its mesh. Raises ``RefusedError``."""
        grasp = self._grasp(content)
        self.labelling.set(grasp, content.get("set"))
        return self._labels(grasp)

    def unlabel(self, content: Json) -> dict[str, object]:
        """Undo a tab's last change of a grasp's key frames. Raises ``RefusedError``."""
        grasp = self._grasp(content)
        undone = self.labelling.undo(grasp, parse_token(content, "tab"), parse_token(content, "change"))
        return self._labels(grasp) | undone

    def check_shape(self, content: Json) -> dict[str, object]:
        """Return what is wrong with a mesh, and what is odd about its size, in words. Raises ``RefusedError``."""
        shape = parse_requested_mesh(content)
        return {"mesh": shapes.mesh_error(shape), "size_mm": shapes.unusual_size(shape)}

    def work(self, content: Json) -> dict[str, object]:
        """Start to "propagate", write "files" or "reconstruct" a grasp, take a "candidate" of its result, or "cancel".

        Raises ``RefusedError``.
        """
        grasp = self._grasp(content)
        known = {
            "propagate": lambda: self.labelling.propagate(grasp),
            "files": lambda: self.labelling.make(grasp),
            "reconstruct": lambda: self.labelling.reconstruct(grasp, content),
            "candidate": lambda: self.labelling.take_candidate(grasp, content),
            "cancel": lambda: self.labelling.background.cancel(grasp.mark.mark),
        }
        if not isinstance(what := content.get("work"), str) or what not in known:
            raise RefusedError(f"unknown work {files.shorten_value(what)}; choose from {', '.join(known)}")
        known[what]()
        return self._labels(grasp)

    def drafts(self, content: Json, since: int) -> dict[str, object]:
        """Return some drafts of a grasp's frames with numbers above ``since``. Raises ``RefusedError``."""
        return {"drafts": self.store.drafts.since(self._grasp(content).mark.mark, since)}

    def outlines(self, content: Json, candidate: int, first: int) -> dict[str, object]:
        """Return outlines of a grasp's result in frames from ``first`` on. Raises ``GetagripError``."""
        return self.labelling.outlines(self._grasp(content), candidate, first)

    def labels_file(self, content: Json) -> tuple[str, str]:
        """Return the text of a grasp's label file, and the file's name. Raises ``RefusedError``."""
        grasp = self._grasp(content)
        text = files.to_json(labels.labels_to_json(self.labelling.whole_labels(grasp))) + "\n"
        return text, f"labels-{grasp.name}.json"

    def result_file(self, content: Json, name: str) -> bytes:
        """Return the picture or the page of a grasp's report. Raises ``RefusedError``."""
        return self.labelling.result_file(self._grasp(content), name)

    def labelled(self) -> Iterator[Grasp]:
        """Yield the labelled, finished grasps and whole interactions of the tasks. Raises ``InputError``."""
        with_labels = {one.grasp for one in self.store.keyframes.standing()}
        for task, name in dict.fromkeys((self.tasks[mark.task], mark.annotator) for mark in self.known()):
            for key, grasp in self._grasps(task, name).items() if task.path is not None else ():
                if key in with_labels and grasp.mark.interval and grasp.mark.side:
                    yield grasp

    def import_labels(self, labels: Labels, annotator: str) -> Grasp:
        """Store the labels of a file as an annotator's; mark the grasp if it is not marked yet.

        Raises ``RefusedError`` for labels of other footage.
        """
        tasks, extent = tasks_of_labels(labels, list(self.tasks.values())), (labels.first, labels.last)
        footage = self.footage(tasks[0])
        extents = [(task, task.extent(footage)) for task in tasks]
        inside = [task for task, (first, last) in extents if first <= labels.first and labels.last <= last]
        task, name = (inside or tasks)[0], history.check_annotator(annotator)
        sets = {"start": labels.first, "end": labels.last, "side": labels.side}
        known = self._grasps(task, name).values()
        same = [grasp for grasp in known if grasp.mark.interval == extent and grasp.mark.side == labels.side]
        grasp = same[-1] if same else Grasp(task, self._mark(task, name, str(uuid4()), sets), footage=footage)
        self.labelling.take(grasp, labels)
        return grasp

    def import_segments(self, path: Path, annotator: str) -> int:
        """Store the segments of a file as an annotator's marks, to be corrected; return their number.

        The file's camera is ignored: the annotator states it. Raises ``InputError`` for a file that is malformed or of
        other footage, ``RefusedError`` if the annotator has marked segments of the task already.
        """
        name, count, tab = history.check_annotator(annotator), 0, str(uuid4())
        for task, listed in read_task_segments(path, self._present()):
            footage = self.footage(task)
            if any(mark.start is not None for mark in self.store.marks.standing(task.key, name)):
                raise RefusedError(f"{name} has marked segments of {task.key} already: choose another --annotator")
            for one in listed.at(FrameNames(footage), has_world=True):
                side = one.side or task.side
                sets = {"start": one.first, "end": one.last, "state": one.state}
                self._mark(task, name, tab, sets | ({} if side is None else {"side": side}))
                count += 1
        return count

    def mark_grasp(self, task: Task, annotator: str, extent: tuple[int, int], side: str) -> Grasp:
        """Mark a grasp, both frames included, unless the annotator has marked it already. Raises ``RefusedError``."""
        name = history.check_annotator(annotator)
        own = self.store.marks.standing(task.key, name)
        known = next((mark for mark in own if mark.interval == extent and mark.side == side), None)
        sets = {"start": extent[0], "end": extent[1], "side": side}
        mark = known or self._mark(task, name, str(uuid4()), sets)
        return Grasp(task, mark, footage=self.footage(task))

    def _mark(self, task: Task, name: str, tab: str, sets: Json) -> Mark:
        """Make a new mark of the task's object."""
        footage = self.footage(task)
        blank, about = Mark(str(uuid4()), task.key, name), {"category": task.category, "entity": task.entity}
        change = Change(str(uuid4()), tab, sets | {key: text for key, text in about.items() if text})
        return self.store.marks.apply(change, blank, lambda mark, sets: marks.apply_mark_change(mark, sets, footage))

    def interactions(self, annotator: str) -> list[Interaction]:
        """Return an annotator's whole interactions of the tasks. Raises ``InputError``."""
        own = ((task, self.store.marks.standing(task.key, annotator)) for task in self._present())
        return [interaction_of_marks(task, self.footage(task), marks) for task, marks in own if is_interaction(marks)]

    def known(self, annotator: str | None = None) -> list[Mark]:
        """Return the marks of the tasks, without those of other tasks in the same file."""
        return [mark for mark in self.store.marks.standing(annotator=annotator) if mark.task in self.tasks]

    def agreement(self) -> dict[str, object]:
        """Return the agreement of every two annotators."""
        return {"pairs": [asdict(one) for one in marks.pairwise_agreements(self.known())]}

    def exported(self, kind: str, annotator: object) -> str:
        """Return a file of an annotator's grasps as text: "csv", "json", or their "segments".

        Raises ``RefusedError``, ``InputError``.
        """
        name = history.check_annotator(annotator)
        if kind == "segments":
            listed = {one.task.key: one.listed().fields for one in self.interactions(name)}
            return files.to_json(listed) + "\n"
        found = self.known(name)
        if kind == "csv":
            return marks.epic_csv(found, self.tasks)
        return files.to_json(marks.grasp_intervals(found, self.tasks)) + "\n"

    def footage(self, task: Task) -> Footage:
        """Open the footage of a task, or return it if it is open.

        Raises ``InputError``, ``RefusedError`` for a task without footage.
        """
        if task.path is None:
            raise RefusedError(f"{task.video}: no such video or folder of images")
        with self._lock:
            name = str(task.path)
            if name not in self._open:
                self._open[name] = open_footage(task.path)
            self._open.move_to_end(name)
            while len(self._open) > MAX_OPEN_FOOTAGE:
                self._open.popitem(last=False)[1].close()
            return self._open[name]

    def _grasp(self, content: Json) -> Grasp:
        """Return the grasp named in a request. Raises ``RefusedError``."""
        task, name = self._task(content.get("task")), history.check_annotator(content.get("annotator"))
        own = self._grasps(task, name)
        if not isinstance(key := content.get("grasp"), str) or key not in own:
            which = f"one that {name} has marked in {task.key}"
            raise RefusedError(f"grasp must be {which} (got {files.shorten_value(key)})")
        return own[key]

    def _grasps(self, task: Task, name: str) -> dict[str, Grasp]:
        """Return what an annotator can label: segments of a task and, last, the whole interaction."""
        footage, own = self.footage(task), self.store.marks.standing(task.key, name)
        out = {mark.mark: Grasp(task, mark, footage=footage) for mark in own if mark.start is not None}
        if is_interaction(own) and (whole := interaction_of_marks(task, footage, own)).finished:
            out[whole.mark.mark] = Grasp(task, whole.mark, whole, footage=footage)
        return out

    def _task(self, key: object) -> Task:
        if not isinstance(key, str) or key not in self.tasks:
            raise RefusedError(f"task must be one of {len(self.tasks)} tasks (got {files.shorten_value(key)})")
        return self.tasks[key]

    def _labels(self, grasp: Grasp) -> dict[str, object]:
        own = self.store.marks.standing(grasp.task.key, grasp.mark.annotator)
        return self.labelling.state(grasp) | {"state": self._state(grasp.task, own)}

    def _state(self, task: Task, found: list[Mark]) -> str:
        """Return the state of a task with an annotator's marks: one of ``PROGRESS`` where a pose is wanted."""
        whole = [MarkedGrasp(task, mark) for mark in found if mark.interval and mark.side]
        wanted = [one for one in whole if self.wants_poses or self.labelling.shape(one)]
        if wanted:
            return min(map(self.labelling.progress, wanted), key=PROGRESS.index)
        state = _task_state(found)
        return PROGRESS[0] if self.wants_poses and state != "discarded" else state

    def _present(self) -> list[Task]:
        """Return the tasks with footage."""
        return [task for task in self.tasks.values() if task.path is not None]


def _task_state(found: list[Mark]) -> str:
    if any(mark.interval for mark in found):
        return "marked"
    if any(mark.reason for mark in found):
        return "discarded"
    return "started" if found else ""
