"""``getagrip annotate``: serve the page until it is interrupted, or write what has been marked."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

from getagrip.annotate import export, labels
from getagrip.annotate.agreement import Agreement, agreements
from getagrip.annotate.background import BackgroundJob
from getagrip.annotate.labelled_footage import tasks_of
from getagrip.annotate.labelling import Grasp
from getagrip.annotate.labels import Labels
from getagrip.annotate.marks import GRASP, Mark
from getagrip.annotate.project import Project
from getagrip.annotate.server import Server, first_free, kept_token
from getagrip.annotate.store import Store
from getagrip.annotate.tasks import Task, read_tasks
from getagrip.annotate.versions import RefusedError
from getagrip.batch.ledger_place import state_folder
from getagrip.clip.intrinsics import Lens, intrinsics
from getagrip.errors import GetagripError, InputError, UsageError
from getagrip.io import files
from getagrip.io.counts import counted
from getagrip.io.csv_tables import CsvTable
from getagrip.io.terminal import progress_bar, report

if TYPE_CHECKING:
    from rich.progress import Progress

DATABASE = "marks.sqlite"
"""The marks, in the folder of the annotations."""
TOKENS = "tokens"
"""The folder, in the user's state folder, of what the addresses of pages hold."""


@dataclass(frozen=True)
class AnnotateRequest:
    """What the command is to do with its annotations, other than to serve the page."""

    labels: Path | None = None
    """Take this file of labels."""
    segments: Path | None = None
    """Take this file of segments, to be corrected."""
    annotator: str = "imported"
    """As whose."""
    export: bool = False
    """Write files."""


def annotate(
    source: Path, videos: Path | None, out: Path, port: int | None, lens: Lens, request: AnnotateRequest
) -> int:
    """Serve the page for a source; or take labels, or write what is marked and labelled as files into ``out``.

    Returns 1 where files could not be made of some grasp, else 0. Raises ``InputError`` for a source or database that
    is malformed, ``UsageError`` for a ``port`` that is taken; without one a free one is used.
    """
    tasks = read_tasks(source, videos)
    absent = [task for task in tasks if task.path is None]
    if absent:
        missing = f"no footage of {len(absent)} of them, as {files.plain(absent[0].video)}"
        report(f"{len(tasks)} candidates, {missing}")
    if request.export and request.labels is None and request.segments is None and not (out / DATABASE).is_file():
        raise UsageError(f"--export: nothing has been marked in {out}")
    given = None if request.labels is None else read_labels(request.labels, tasks)
    out.mkdir(parents=True, exist_ok=True)
    project = Project(tasks, Store(out / DATABASE), lens)
    try:
        if lens.given and (there := next((task for task in tasks if task.path is not None), None)):
            intrinsics(lens, project.footage(there).size)  # refused now rather than once joints are clicked
        if given is not None:
            grasp = take_labels(project, given, request)
            frames = f"{counted(len(given.frames), 'key frame')} of {grasp.task.key}, {grasp.mark.start_number}"
            print(f"{request.annotator}: {frames} to {grasp.mark.end_number}")
        if request.segments is not None:
            count = take_segments(project, request.segments, request.annotator)
            print(f"{request.annotator}: {counted(count, 'segment')}; give the page this name to correct them")
        if request.export:
            return max(write_files(project, out), write_labels(project))
        if given is None and request.segments is None:
            serve(project, port)
        return 0
    finally:
        project.close()


def read_labels(path: Path, tasks: list[Task]) -> Labels:
    """A file of labels. Raises ``InputError`` where it is malformed, or of none of the footage."""
    given = labels.read(path)
    try:
        tasks_of(given, tasks)
    except RefusedError as error:
        raise InputError(path, "", f"labels of other footage ({error})", "labels of the footage given") from error
    return given


def take_labels(project: Project, given: Labels, request: AnnotateRequest) -> Grasp:
    """Take labels that were read from a file. Raises ``InputError`` where they are not of the footage."""
    try:
        return project.import_labels(given, request.annotator)
    except RefusedError as error:
        assert request.labels is not None
        raise InputError(request.labels, "", f"labels that do not fit ({error})", "labels of the footage") from error


def take_segments(project: Project, path: Path, annotator: str) -> int:
    """Take segments from a file. Raises ``InputError``, and ``UsageError`` where the annotator has marked some."""
    try:
        return project.import_segments(path, annotator)
    except RefusedError as error:
        raise UsageError(str(error)) from error


def serve(project: Project, port: int | None) -> None:
    """Serve the page until it is interrupted. Raises ``UsageError`` for a port that is taken."""
    marks = sha256(os.fsencode(project.store.path.resolve())).hexdigest()[:16]
    token = kept_token(state_folder() / TOKENS / marks)  # not beside the marks: a folder may be a stranger's
    with first_free(project, token) if port is None else Server(project, port, token) as server:
        print(f"open {server.url} in a browser; marks are kept in {project.store.path}; Ctrl-C ends", flush=True)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            print()


def write_labels(project: Project) -> int:
    """Write each labelled grasp's labels and, where they suffice, hand and masks; 1 where one could not be made."""
    status = 0
    written: set[str] = set()
    for grasp in project.labelled():
        if grasp.name in written:
            report(f"{grasp.name}: left out: another grasp of the same frames and hand is written")
            status = 1
            continue
        written.add(grasp.name)
        given = project.labelling.labels(grasp)
        frames = counted(given.last - given.first + 1, "frame")
        print(f"{grasp.name}: making the hand and the masks of {frames} ...", flush=True)
        try:
            with progress_bar(counted=True) as bar:
                command = project.labelling.write(grasp, given, JobOnBar(bar, grasp.name))
        except GetagripError as error:
            report(f"{grasp.name}: labels only: {error}")
            status = 1
            continue
        made = project.labelling.out / grasp.name
        print(f"{made}: hand.npz and masks of {frames}; a clip is made of them, with the object's mesh, by\n{command}")
    return status


class JobOnBar(BackgroundJob):
    """Work that a bar shows."""

    def __init__(self, bar: Progress, name: str) -> None:
        super().__init__("files")
        self._bar, self._task = bar, bar.add_task(name, total=None)

    def report(self, done: int, total: int) -> None:
        self._bar.update(self._task, completed=done, total=total)


def write_files(project: Project, out: Path) -> int:
    """Write ``grasps-<annotator>.csv`` and ``.json`` for each person, ``discards.csv`` and ``agreement.json``.

    Of whole interactions also ``segments-<annotator>.json``. Returns 1 where segments overlap or a finished grasp is of
    neither hand, else 0.
    """
    known, status = project.known(), 0
    others = len(project.store.marks.standing()) - len(known)
    if others:
        report(f"{others} marks belong to other footage: left out")
    for name in sorted({mark.annotator for mark in known}):
        own = [mark for mark in known if mark.annotator == name]
        rows = export.intervals(own, project.tasks)
        table = out / f"grasps-{name}.csv"
        files.write_text(table, export.epic_csv(own, project.tasks))
        files.write_json(table.with_suffix(".json"), rows)
        print(f"{name}: list of {counted(len(rows), 'grasp')}, {table} and .json")
        listed = export.grasps(own)
        marked = [mark for mark in own if mark.start is not None and mark.state == GRASP]
        if unfinished := [mark for mark in marked if mark not in listed]:
            report(f"{name}: {not_listed(unfinished)}")
            status = max(status, int(any(mark.interval and not mark.side for mark in unfinished)))
        status = max(status, write_segments(project, out, name))
    with files.new_text(out / "discards.csv") as stream:
        discards = (row.values() for row in export.discards(known, project.tasks))
        CsvTable(stream).write_rows([("task", "clip", "annotator", "reason"), *discards])
    found = agreements(known)
    files.write_json(out / "agreement.json", [asdict(one) for one in found])
    for one in found:
        print(in_words(one))
    return status


def not_listed(unfinished: Sequence[Mark]) -> str:
    """What grasps lack to be in the list."""
    lacks = {
        "mark the end": any(mark.end is None for mark in unfinished),
        "state the hand": any(not mark.side for mark in unfinished),
        "name the kind of object": any(not mark.category for mark in unfinished),
    }
    todo = " and ".join(what for what, lacking in lacks.items() if lacking)
    grasps, it = counted(len(unfinished), "grasp is", "grasps are"), "it" if len(unfinished) == 1 else "them"
    return f"{grasps} not in this list: {todo} on the page to have {it} there, too"


def write_segments(project: Project, out: Path, annotator: str) -> int:
    """Write ``segments-<annotator>.json`` of whole interactions; 1 where segments of one overlap, else 0."""
    listed, status = {}, 0
    for one in project.interactions(annotator):
        try:
            listed[one.task.key] = one.listed().fields
        except RefusedError as error:
            report(f"{annotator}: segments of {one.task.key} left out: {error}")
            status = 1
        for hint in one.hints():
            report(f"{annotator}: {one.task.key}: {hint}")
    if listed:
        files.write_json(out / f"segments-{annotator}.json", listed)
        print(f"{annotator}: segments of {counted(len(listed), 'clip')}, {out / f'segments-{annotator}.json'}")
    return status


def in_words(one: Agreement) -> str:
    """The agreement of two people in a line."""
    reached = "no grasps to compare"
    if one.iou is not None:
        reached = f"mean temporal IOU {100 * one.iou:.1f} % of {counted(one.grasps, 'grasp')}"
    discards = f"both discarded {one.both_discarded}, one of them {one.one_discarded}"
    return f"{one.first} and {one.second}, {one.tasks} tasks: {reached}; {discards}"
