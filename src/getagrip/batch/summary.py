"""What has become of all clips of a folder: ``summary.csv``, and the index page with the worst of them."""

from __future__ import annotations

import heapq
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

from getagrip.batch.job import Outcome
from getagrip.batch.ledger import Entry, Ledger
from getagrip.batch.streamed import readable
from getagrip.errors import InputError
from getagrip.io import files
from getagrip.io.csv_tables import CsvTable
from getagrip.io.storage import Place, Remote
from getagrip.result import is_result, read_result

TABLE, PAGE = "summary.csv", "index.html"
HEAD = ("clip", "status", "why", "seconds", "IOU", "probability_right", "probability_right_in_camera", "findings")
WORST = 1000
"""The index shows so many clips at most: a page of all would be too large for a browser."""


def entry_of(outcome: Outcome) -> Entry:
    """What the ledger is to say of a clip."""
    right, in_camera = outcome.probability_right, outcome.probability_right_in_camera
    return Entry(
        name=outcome.name,
        state=outcome.state,
        why=outcome.message if outcome.state == "failed" else outcome.status,
        inputs=outcome.inputs,
        seconds=outcome.seconds,
        about={
            "iou": outcome.iou,
            "probability_right": None if right is None else right.value,
            "probability_right_in_camera": None if in_camera is None else in_camera.value,
            "findings": [str(finding) for finding in outcome.findings],
        },
    )


def write_summary(ledger: Ledger, out: Place, nameless: Iterable[Outcome]) -> list[Place]:
    """Write table and index page of the ledger of a folder of results, and return where they are.

    ``nameless`` are failures of what has no entry: folders that are no clips.
    """
    if isinstance(out, Path):
        return [*_write_here(ledger, out, out, nameless)]
    with tempfile.TemporaryDirectory(prefix="getagrip.") as folder:
        for path in _write_here(ledger, out, Path(folder), nameless):
            (out / path.name).write(path.read_bytes())
    return [out / TABLE, out / PAGE]


def _write_here(ledger: Ledger, results: Place, out: Path, nameless: Iterable[Outcome]) -> list[Path]:
    """Write them into a folder on this machine."""
    with files.new_text(out / TABLE) as file:
        table = CsvTable(file)
        table.write_row(HEAD)
        for entry in _entries(ledger, results):
            about = entry.about
            numbers = [about.get(key) for key in ("iou", "probability_right", "probability_right_in_camera")]
            cells = ("" if value is None else f"{float(value):.4f}" for value in numbers)
            row = entry.name, entry.state, entry.why, f"{entry.seconds:.2f}", *cells
            table.write_row([*row, "; ".join(map(str, about.get("findings", ())))])
        for outcome in nameless:
            table.write_row([outcome.name, outcome.state, outcome.message, *[""] * (len(HEAD) - 3)])
    return [out / TABLE, _write_index(ledger, results, out)]


def _write_index(ledger: Ledger, results: Place, out: Path) -> Path:
    """The index page of the worst clips; pictures are ``getagrip report``'s, which takes as long as the clips."""
    from getagrip.pages import IndexRow, row_without_clip, write_index

    worst = heapq.nsmallest(WORST, _entries(ledger, results), key=_goodness)
    rows = []
    with readable(results, [entry.name for entry in worst if entry.state == "done"]) as there:
        for entry in worst:
            folder = there / entry.name
            try:
                if entry.state != "done":
                    rows.append(IndexRow(entry.name, problem=entry.why))
                    continue
                result, record = read_result(folder)
                page = (folder / "report.html").is_file()
                rows.append(row_without_clip(entry.name, result, record["metrics"], "", page))
            except InputError as error:
                rows.append(IndexRow(entry.name, problem=str(error)))
    title = results.name if isinstance(results, Remote) else results.resolve().name
    return write_index(rows, title, [TABLE], out / PAGE)


def _entries(ledger: Ledger, out: Place) -> Iterator[Entry]:
    """The entries, those whose results are gone marked so; in an object store that is not looked up."""
    for entry in ledger.entries():
        gone = entry.state == "done" and not files.is_plain_name(entry.name)
        gone = gone or (entry.state == "done" and isinstance(out, Path) and not is_result(out / entry.name))
        yield Entry(entry.name, "open", "its result is not there any more") if gone else entry


def _goodness(entry: Entry) -> tuple[bool, float, str]:
    """The worse a clip, the less: failed ones first."""
    iou = entry.about.get("iou")
    return entry.state == "done", float(iou) if isinstance(iou, int | float) else 0.0, entry.name
