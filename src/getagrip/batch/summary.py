"""The summary of a folder's clips: ``summary.csv``, an index page of the worst clips, and the marks of ``--keep``."""

from __future__ import annotations

import heapq
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from getagrip import __version__
from getagrip.batch.job import Outcome, local_results
from getagrip.batch.ledger import Entries, LedgerEntry
from getagrip.batch.scheduling import NO_KEEP_FILTER, KeepOptions
from getagrip.errors import InputError, escape_unprintable, replace_surrogates
from getagrip.io import files
from getagrip.io.storage import Place, RemotePath
from getagrip.io.terminal import CsvTable
from getagrip.result import is_result, read_result, read_result_record
from getagrip.result.findings import Probability, read_findings, read_probability

if TYPE_CHECKING:
    from getagrip.report.pages import IndexRow


SUMMARY_FILE, INDEX_FILE = "summary.csv", "index.html"
PROBABILITY_KEYS = ("probability_right", "probability_right_in_camera")
"""Probabilities that the poses are right in the hand, and in the camera."""
KEEP_KEYS = ("keep", "keep_in_camera")
"""Largest ``--keep`` that keeps the result, in the hand and in the camera."""
METHOD_KEYS = ("ambiguous", "method", "seed", "version")
_RESULT_COLUMNS = ("clip", "status", "why", "seconds", "IOU")
SUMMARY_COLUMNS = (*_RESULT_COLUMNS, *PROBABILITY_KEYS, *KEEP_KEYS, "kept", *METHOD_KEYS, "findings")
MAX_RESULT_NUMBER = 1e9
"""Limit on numbers of results: ledgers are untrusted."""
MAX_INDEX_ROWS = 1000
"""Maximum number of clips of the index: more would be too large for a browser."""
STATE_NAMES = {"failed": "failed", "done": "results", "open": "left"}
"""Names of states in the index, the worst state first."""


def outcome_entry(outcome: Outcome, method: str, seed: int) -> LedgerEntry:
    """Make the ledger's entry of a clip from the outcome of a method."""
    right = (outcome.probability_right, outcome.probability_right_in_camera)
    return LedgerEntry(
        name=outcome.name,
        state=outcome.state,
        why=outcome.message if outcome.state == "failed" else outcome.status,
        inputs=outcome.inputs,
        seconds=outcome.seconds,
        about={
            "iou": outcome.iou,
            **_probability_fields(right),
            "ambiguous": outcome.ambiguous,
            "method": method,
            "seed": seed,
            "version": __version__,
            "findings": [str(finding) for finding in outcome.findings],
        },
    )


def _probability_fields(right: Sequence[Probability | None]) -> dict[str, float | None]:
    values = {key: None if one is None else one.value for key, one in zip(PROBABILITY_KEYS, right, strict=True)}
    return values | {key: None if one is None else one.keep for key, one in zip(KEEP_KEYS, right, strict=True)}


def failed_path_entry(outcome: Outcome) -> LedgerEntry:
    """Make the ledger's entry of a path without a clip; its name is the path."""
    clip = escape_unprintable(outcome.name) or Path(outcome.path).name
    return LedgerEntry(outcome.path, "failed", outcome.message, about={"clip": clip})


def display_name(entry: LedgerEntry) -> str:
    """Return the name of an entry's clip in tables."""
    return replace_surrogates(str(entry.about.get("clip", entry.name)))


def entry_number(entry: LedgerEntry, key: str) -> float | None:
    """Return a number of a result's entry; None if unknown."""
    value = entry.about.get(key)
    return float(value) if isinstance(value, int | float) and abs(value) < MAX_RESULT_NUMBER else None


def known_entries(ledger: Entries | None, out: Place) -> Iterator[LedgerEntry]:
    """Yield an entry for each clip of the ledger or with a result; its state is that of the result.

    A done clip without a result is open; an open clip with a result is done (its driver was interrupted). States of
    clips in an object store are the ledger's.
    """
    for entry in () if ledger is None else ledger.entries():
        yield _entry_by_result(entry, out)
    for path in sorted(out.iterdir()) if isinstance(out, Path) and out.is_dir() else ():
        known = ledger is not None and path.name.isprintable() and ledger.has(path.name)
        if not known and not path.name.startswith(".") and is_result(path):
            yield _entry_from_result(LedgerEntry(path.name), path)


def ledger_severity_key(entry: LedgerEntry) -> tuple[int, float, str]:
    """Return a sort key: the worst clips first, failed ones, then by IOU."""
    return [*STATE_NAMES].index(entry.state), entry_number(entry, "iou") or 0.0, entry.name


def write_summary(ledger: Entries | None, out: Place, keep: KeepOptions = NO_KEEP_FILTER) -> list[Place]:
    """Write table and index page of a folder of results and its ledger, and return their paths."""
    if isinstance(out, Path):
        return [*_write_summary_files(ledger, out, out, keep)]
    with tempfile.TemporaryDirectory(prefix="getagrip.") as folder:
        for path in _write_summary_files(ledger, out, Path(folder), keep):
            (out / path.name).write(path.read_bytes())
    return [out / SUMMARY_FILE, out / INDEX_FILE]


def write_summary_table(
    ledger: Entries | None, results: Place, path: Path, keep: KeepOptions = NO_KEEP_FILTER
) -> Counter[str]:
    """Write the table of all clips; return the number of clips in each state."""
    states = Counter[str]()
    with files.new_text(path) as file:
        table = CsvTable(file)
        table.write_row(SUMMARY_COLUMNS)
        for entry in known_entries(ledger, results):
            states[entry.state] += 1
            about, known = entry.about, [entry_number(entry, key) for key in ("iou", *PROBABILITY_KEYS, *KEEP_KEYS)]
            cells = ["" if value is None else f"{value:.4f}" for value in known]
            cells.append(keep.mark(*known[-2:]) if entry.state == "done" else "")
            method = ["" if (value := about.get(key)) is None else str(value) for key in METHOD_KEYS]
            row = [display_name(entry), entry.state, entry.why, f"{entry.seconds:.2f}", *cells, *method]
            findings = about.get("findings")
            table.write_row([*row, "; ".join(map(str, findings)) if isinstance(findings, list) else ""])
    return states


def row_without_result(entry: LedgerEntry) -> IndexRow:
    """Make the index's row of a failed or open clip."""
    from getagrip.report.pages import IndexRow

    return IndexRow(display_name(entry), entry.why, flags=(STATE_NAMES[entry.state],))


def _write_summary_files(ledger: Entries | None, results: Place, out: Path, keep: KeepOptions) -> list[Path]:
    states = write_summary_table(ledger, results, out / SUMMARY_FILE, keep)
    return [out / SUMMARY_FILE, _write_index(ledger, results, out, states, keep)]


def _write_index(ledger: Entries | None, results: Place, out: Path, states: Counter[str], keep: KeepOptions) -> Path:
    """Write the index page of the worst clips, without pictures, which only ``getagrip report`` renders."""
    from getagrip.report.pages import IndexRow, index_row_without_clip, write_index

    worst = heapq.nsmallest(MAX_INDEX_ROWS, known_entries(ledger, results), key=ledger_severity_key)
    rows = []
    with local_results(results, [entry.name for entry in worst if entry.state == "done"]) as local:
        for entry in worst:
            folder = local / entry.name
            try:
                if entry.state != "done":
                    rows.append(row_without_result(entry))
                    continue
                result, record = read_result(folder)
                page = (folder / "report.html").is_file()
                row = index_row_without_clip(entry.name, result, record["metrics"], "", page)
                rows.append(keep.marked(row, result))
            except InputError as error:
                rows.append(IndexRow(entry.name, problem=str(error), flags=("failed",)))
    title = results.name if isinstance(results, RemotePath) else results.resolve().name
    counts = Counter({kind: states[state] for state, kind in STATE_NAMES.items()})
    return write_index(rows, title, [SUMMARY_FILE], out / INDEX_FILE, None if states.total() == len(rows) else counts)


def _entry_by_result(entry: LedgerEntry, out: Place) -> LedgerEntry:
    if entry.state == "failed":
        return entry
    has_result = isinstance(out, RemotePath) or (files.is_portable_name(entry.name) and is_result(out / entry.name))
    if entry.state == "done":
        return entry if has_result else LedgerEntry(entry.name, "open", "its result has been removed")
    if has_result and isinstance(out, Path):
        return _entry_from_result(entry, out / entry.name)
    return replace(entry, why=entry.why or "not done yet")


def _entry_from_result(entry: LedgerEntry, folder: Path) -> LedgerEntry:
    path = folder / "result.json"
    try:
        record = read_result_record(folder)
        right = {key: read_probability(path, record[key], key) for key in PROBABILITY_KEYS}
        findings = [str(finding) for finding in read_findings(path, record["findings"])]
    except InputError as error:
        return replace(entry, why=f"its result cannot be read ({error})")
    about = {
        "iou": record["metrics"].get("iou_full"),
        **_probability_fields([*right.values()]),
        **{key: record[key] for key in METHOD_KEYS[:-1]},
        "version": record["software"].get("getagrip"),
        "findings": findings,
    }
    seconds = record["seconds"].get("total") or 0.0
    return replace(entry, state="done", why=record["message"], seconds=seconds, about=about)
