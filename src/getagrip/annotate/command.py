"""``getagrip annotate``: serve the page until it is interrupted, or write what has been marked."""

from __future__ import annotations

import csv
import sys
from dataclasses import asdict
from pathlib import Path

from getagrip import files
from getagrip.annotate import export
from getagrip.annotate.agreement import Agreement, agreements
from getagrip.annotate.project import Project
from getagrip.annotate.server import Server
from getagrip.annotate.store import Store
from getagrip.annotate.tasks import read_tasks
from getagrip.errors import UsageError

DATABASE = "marks.sqlite"
"""The marks, in the folder of the annotations."""


def annotate(source: Path, videos: Path | None, out: Path, port: int, write: bool) -> int:
    """Serve the page for a source, or write its marks as files into ``out``; 0.

    Raises ``InputError`` for a source or database that is malformed, ``UsageError`` for a port that is taken.
    """
    tasks = read_tasks(source, videos)
    absent = [task for task in tasks if task.path is None]
    if absent:
        missing = f"no footage of {len(absent)} of them, as {files.plain(absent[0].video)}"
        print(f"{len(tasks)} candidates, {missing}", file=sys.stderr)
    if write and not (out / DATABASE).is_file():
        raise UsageError(f"--export: nothing has been marked in {out}")
    out.mkdir(parents=True, exist_ok=True)
    project = Project(tasks, Store(out / DATABASE))
    try:
        if write:
            return write_files(project, out)
        with Server(project, port) as server:
            print(f"open {server.url} in a browser; marks are kept in {out / DATABASE}; Ctrl-C ends", flush=True)
            try:
                server.serve_forever()
            except KeyboardInterrupt:
                print()
        return 0
    finally:
        project.close()


def write_files(project: Project, out: Path) -> int:
    """Write ``grasps-<annotator>.csv`` and ``.json`` for each person, ``discards.csv`` and ``agreement.json``; 0."""
    known = project.known()
    others = len(project.store.marks.standing()) - len(known)
    if others:
        print(f"{others} marks belong to other footage: left out", file=sys.stderr)
    for name in sorted({mark.annotator for mark in known}):
        own = [mark for mark in known if mark.annotator == name]
        rows = export.intervals(own, project.tasks)
        table = out / f"grasps-{name}.csv"
        table.write_text(export.epic_csv(own, project.tasks), "utf-8", newline="")
        files.write_json(table.with_suffix(".json"), rows)
        print(f"{name}: {len(rows)} grasps, {table} and .json")
        if unfinished := sum(not mark.reason for mark in own) - len(export.grasps(own)):
            print(f"{name}: {unfinished} grasps left out: they lack an end or the kind of object", file=sys.stderr)
    with (out / "discards.csv").open("w", encoding="utf-8", newline="") as stream:
        lines = csv.DictWriter(stream, ("task", "clip", "annotator", "reason"))
        lines.writeheader()
        lines.writerows(export.discards(known, project.tasks))
    found = agreements(known)
    files.write_json(out / "agreement.json", [asdict(one) for one in found])
    for one in found:
        print(in_words(one))
    return 0


def in_words(one: Agreement) -> str:
    """The agreement of two people in a line."""
    reached = "no grasps to compare"
    if one.iou is not None:
        reached = f"mean temporal IOU {100 * one.iou:.1f} % of {one.grasps} grasps"
    discards = f"both discarded {one.both_discarded}, one of them {one.one_discarded}"
    return f"{one.first} and {one.second}, {one.tasks} tasks: {reached}; {discards}"
