"""What has become of all clips of a folder: ``summary.csv``, and the index page with the worst of them."""

from __future__ import annotations

import csv
import heapq
from collections.abc import Iterable, Iterator
from pathlib import Path

from getagrip.batch.job import Outcome
from getagrip.batch.ledger import Entry, Ledger
from getagrip.errors import InputError
from getagrip.io import files
from getagrip.result import is_result, read_result

TABLE, PAGE = "summary.csv", "index.html"
HEAD = ("clip", "status", "why", "seconds", "IOU", "probability_right", "findings")
WORST = 1000
"""The index shows so many clips at most: a page of all would be too large for a browser."""


def entry_of(outcome: Outcome) -> Entry:
    """What the ledger is to say of a clip."""
    right = outcome.probability_right
    return Entry(
        name=outcome.name,
        state=outcome.state,
        why=outcome.message if outcome.state == "failed" else outcome.status,
        inputs=outcome.inputs,
        seconds=outcome.seconds,
        about={
            "iou": outcome.iou,
            "probability_right": None if right is None else right.value,
            "findings": [str(finding) for finding in outcome.findings],
        },
    )


def write_summary(ledger: Ledger, out: Path, nameless: Iterable[Outcome]) -> list[Path]:
    """Write table and index page of the ledger of a folder, and return their paths.

    ``nameless`` are failures of what has no entry: folders that are no clips.
    """
    with files.new_file(out / TABLE) as part, part.open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file)
        table.writerow(HEAD)
        for entry in _entries(ledger, out):
            about = entry.about
            numbers = (about.get("iou"), about.get("probability_right"))
            cells = ("" if value is None else f"{float(value):.4f}" for value in numbers)
            row = entry.name, entry.state, entry.why, f"{entry.seconds:.2f}", *cells
            table.writerow([*row, "; ".join(map(str, about.get("findings", ())))])
        for outcome in nameless:
            table.writerow([outcome.name, outcome.state, outcome.message, "", "", "", ""])
    return [out / TABLE, _write_index(ledger, out)]


def _write_index(ledger: Ledger, out: Path) -> Path:
    """The index page of the worst clips; pictures are ``getagrip report``'s, which takes as long as the clips."""
    from getagrip.pages import IndexRow, row_without_clip, write_index

    worst = heapq.nsmallest(WORST, _entries(ledger, out), key=_goodness)
    rows = []
    for entry in worst:
        folder = out / entry.name
        try:
            if entry.state != "done":
                rows.append(IndexRow(entry.name, problem=entry.why))
                continue
            result, record = read_result(folder)
            page = (folder / "report.html").is_file()
            rows.append(row_without_clip(entry.name, result, record["metrics"], "", page))
        except InputError as error:
            rows.append(IndexRow(entry.name, problem=str(error)))
    return write_index(rows, out.resolve().name, [TABLE], out / PAGE)


def _entries(ledger: Ledger, out: Path) -> Iterator[Entry]:
    """The entries, those whose results are gone marked so."""
    for entry in ledger.entries():
        gone = entry.state == "done" and not (files.is_plain_name(entry.name) and is_result(out / entry.name))
        yield Entry(entry.name, "open", "its result is not there any more") if gone else entry


def _goodness(entry: Entry) -> tuple[bool, float, str]:
    """The worse a clip, the less: failed ones first."""
    iou = entry.about.get("iou")
    return entry.state == "done", float(iou) if isinstance(iou, int | float) else 0.0, entry.name
