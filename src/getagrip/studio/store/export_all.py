"""Write the files of a project: each annotator's marks, their agreement, and the inputs of clips."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from getagrip.errors import GetagripError
from getagrip.io import files
from getagrip.io.terminal import format_count, print_note, progress_bar
from getagrip.studio.jobs import CLIPS_FOLDER, BackgroundJob, CommandCall, RequestedMesh, RunCall, result_folder
from getagrip.studio.project import Project
from getagrip.studio.store import marks
from getagrip.studio.store.history import RefusedError
from getagrip.studio.store.marks import GRASP_STATE, Agreement, Grasp, Mark, pairwise_agreements

if TYPE_CHECKING:
    from rich.progress import Progress


def write_labelled_grasps(project: Project) -> int:
    """Write each labelled grasp's labels and, where they suffice, hand and masks; return 1 if any failed, else 0."""
    status = 0
    written: set[str] = set()
    for grasp in project.labelled():
        if grasp.name in written:
            print_note(f"{grasp.name}: left out: another grasp of the same frames and hand is written")
            status = 1
            continue
        written.add(grasp.name)
        value = project.labelling.labels(grasp)
        frames = format_count(value.last - value.first + 1, "frame")
        print(f"{grasp.name}: making the hand and the masks of {frames} ...", flush=True)
        command = _run_with_progress_bar(grasp.name, partial(project.labelling.write, grasp, value), "labels only: ")
        if command is None:
            status = 1
            continue
        made = project.labelling.out / grasp.name
        print(f"{made}: hand.npz and masks of {frames}; a clip is made of them, with the object's mesh, by\n{command}")
    return status


def reconstruct_labelled_grasps(project: Project, grasps: Sequence[Grasp], shape: RequestedMesh, run: RunCall) -> int:
    """Write the files of labelled grasps, and reconstruct each by ``run``; return 1 if any failed or none, else 0."""
    if not grasps:
        print_note("no mask is in the frames with a hand: nothing is reconstructed")
    status, out = int(not grasps), project.labelling.out
    for grasp in grasps:
        said = _run_with_progress_bar(grasp.name, partial(project.labelling.solve, grasp, shape), run=run)
        if said is None:
            status = 1
            continue
        result = result_folder(out, grasp.name)
        print(f"{said}\n{out / CLIPS_FOLDER / grasp.name}: the clip\n{result / 'report.html'}: the report")
    return status


def _run_with_progress_bar(
    name: str, work: Callable[[BackgroundJob], str], prefix: str = "", run: RunCall | None = None
) -> str | None:
    """Run a job of a grasp with a progress bar. Returns its outcome as text, None after an error, which is printed."""
    try:
        with progress_bar(counted=True) as bar:
            return work(JobOnBar(bar, name, run))
    except GetagripError as error:
        print_note(f"{name}: {prefix}{error}")
        return None


class JobOnBar(BackgroundJob):
    """A job with a progress bar; ``run`` runs its commands, if given."""

    def __init__(self, bar: Progress, name: str, run: RunCall | None = None) -> None:
        super().__init__("files")
        self._bar, self._name, self._task, self._run = bar, name, bar.add_task(name, total=None), run

    def run(self, call: CommandCall) -> str:
        return super().run(call) if self._run is None else self._run(call)

    def report(self, done: int, total: int) -> None:
        description = ": ".join(filter(None, (self._name, self.message)))
        self._bar.update(self._task, description=description, completed=done, total=total)


def write_mark_files(project: Project, out: Path) -> int:
    """Write ``grasps-<annotator>.csv`` and ``.json`` for each annotator, ``discards.csv`` and ``agreement.json``.

    Whole interactions are written to ``segments-<annotator>.json``. Returns 1 if segments overlap or a finished grasp
    has no side, else 0.
    """
    known, status = project.known(), 0
    others = len(project.store.marks.standing()) - len(known)
    if others:
        print_note(f"{others} marks belong to other footage: left out")
    for name in sorted({mark.annotator for mark in known}):
        own = [mark for mark in known if mark.annotator == name]
        rows = marks.grasp_intervals(own, project.tasks)
        table = out / f"grasps-{name}.csv"
        files.write_text(table, marks.epic_csv(own, project.tasks))
        files.write_json(table.with_suffix(".json"), rows)
        print(f"{name}: list of {format_count(len(rows), 'grasp')}, {table} and .json")
        listed = marks.finished_grasps(own)
        marked = [mark for mark in own if mark.start is not None and mark.state == GRASP_STATE]
        if unfinished := [mark for mark in marked if mark not in listed]:
            print_note(f"{name}: {unlisted_grasps_message(unfinished)}")
            status = max(status, int(any(mark.interval and not mark.side for mark in unfinished)))
        status = max(status, write_interaction_segments(project, out, name))
    discards = (row.values() for row in marks.discarded_tasks(known, project.tasks))
    files.write_csv(out / "discards.csv", [("task", "clip", "annotator", "reason"), *discards])
    found = pairwise_agreements(known)
    files.write_json(out / "agreement.json", [asdict(one) for one in found])
    for one in found:
        print(agreement_message(one))
    return status


def unlisted_grasps_message(unfinished: Sequence[Mark]) -> str:
    """Return the advice on unfinished grasps: what each lacks for the list."""
    lacks = {
        "mark the end": any(mark.end is None for mark in unfinished),
        "state the hand": any(not mark.side for mark in unfinished),
        "name the kind of object": any(not mark.category for mark in unfinished),
    }
    todo = " and ".join(what for what, lacking in lacks.items() if lacking)
    grasps, it = format_count(len(unfinished), "grasp is", "grasps are"), "it" if len(unfinished) == 1 else "them"
    return f"{grasps} not in this list: {todo} on the page to have {it} there, too"


def write_interaction_segments(project: Project, out: Path, annotator: str) -> int:
    """Write ``segments-<annotator>.json`` of whole interactions; return 1 if segments overlap, else 0."""
    listed, status = {}, 0
    for one in project.interactions(annotator):
        try:
            listed[one.task.key] = one.listed().fields
        except RefusedError as error:
            print_note(f"{annotator}: segments of {one.task.key} left out: {error}")
            status = 1
        for hint in one.hints():
            print_note(f"{annotator}: {one.task.key}: {hint}")
    if listed:
        files.write_json(out / f"segments-{annotator}.json", listed)
        print(f"{annotator}: segments of {format_count(len(listed), 'clip')}, {out / f'segments-{annotator}.json'}")
    return status


def agreement_message(one: Agreement) -> str:
    """Return the agreement of two annotators as one line of text."""
    reached = "no grasps to compare"
    if one.iou is not None:
        reached = f"mean temporal IOU {100 * one.iou:.1f} % of {format_count(one.grasps, 'grasp')}"
    discards = f"both discarded {one.both_discarded}, one of them {one.one_discarded}"
    return f"{one.first} and {one.second}, {one.tasks} tasks: {reached}; {discards}"
