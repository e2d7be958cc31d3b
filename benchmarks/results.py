"""Copy the tables of benchmarks into ``results/``, and numbers into pages: ``python -m benchmarks.results DIR...``.

Each folder is one that was given to ``getagrip bench --out``. A table is named like the folder and its file:
``out/dexycb/inputs.csv`` becomes ``results/dexycb-inputs.json`` (``out/recording/recording.md``: ``recording.json``),
and ``inputs-clips.csv``, its numbers by clip, ``results/clips/dexycb-inputs.csv.gz``. A table of the test objects must
be of a run that ``test_runs`` notes. Without folders only README and pages are brought up to date.
``python -m benchmarks.release`` measures all tables of a release before.
"""

from __future__ import annotations

import csv
import math
import re
import shutil
import sys
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from benchmarks import cite, store, test_runs
from benchmarks.release import BENCHES
from benchmarks.store import Cell, Column, Table
from benchmarks.timing import machine
from getagrip.checks import INPUT_CHECKS, RESULT_CHECKS
from getagrip.io.plugins import date_and_commit
from getagrip.metrics.evaluate.metric import METRICS

README = store.ROOT / "README.md"
PICTURES = store.ROOT / "docs/images"
"""Plots of pages; other plots stay in the folder of ``bench``."""
MADE = re.compile(r"(?:; )?made (\d{4}-\d\d-\d\d)(?:, commit (\w+))?.*")
SERIOUS = {check.name for check in (*INPUT_CHECKS.values(), *RESULT_CHECKS.values()) if check.serious}
LABELLED = {metric.label: metric for metric in METRICS.values() if metric.label}
ALL, CATEGORIES, CLIPS = "all", "-categories", "-clips"


def main(folders: Sequence[Path]) -> None:
    """Update tables, README and pages."""
    for folder in folders:
        tables = found(folder)
        for name, table in tables.items():
            if name in test_runs.tables() and not test_runs.noted(name, table.made.get("commit", "unknown")):
                raise SystemExit(f"{name}: the test objects are run by make results only, which notes each run")
            print(store.write(name, table))
            by_clip = folder / f"{name.removeprefix(f'{folder.resolve().name}-')}{CLIPS}.csv"
            if by_clip.exists():
                print(store.write_clips(name, by_clip.read_text(encoding="utf-8")))
        for picture in folder.glob("*.png"):
            if (shown := PICTURES / f"results-{folder.resolve().name}-{picture.name}").exists():
                shutil.copy(picture, shown)
    for page in (README, *sorted((store.ROOT / "docs").glob("*.md"))):
        page.write_text(cite.fill_written(page.read_text(encoding="utf-8")), encoding="utf-8")


def found(folder: Path) -> dict[str, Table]:
    """Read the tables of a folder, by name. Raises ``FileNotFoundError`` without any."""
    tables: dict[str, Table] = {}
    for page in sorted(folder.glob("*.md")):
        own = folder.resolve().name
        name = own if page.stem == own else f"{own}-{page.stem}"
        numbers = page.with_suffix(".csv")
        if not numbers.exists():
            tables[name] = printed(name, page)
            continue
        tables[name] = bench(name, numbers)
        each = f"{name}{CATEGORIES}"
        if each in store.names() and (table := bench(each, numbers)).rows:
            tables[each] = table
    if not tables:
        raise FileNotFoundError(f"{folder}: no table of a bench")
    return tables


def bench(name: str, numbers: Path) -> Table:
    """Make a table of clips: over all of them, or of each category.

    Made of ``NAME.csv``, which has the means, ``NAME-clips.csv``, which has what was found of each clip, and the title
    and the settings in ``NAME.md``.
    """
    title, about, settings = _page(numbers.with_suffix(".md"))
    by_category = name.endswith(CATEGORIES)
    columns = {"clips": Column("clips", "clips")}
    rows, differences = dict[str, dict[str, Cell]](), dict[str, dict[str, Cell]]()
    for line in csv.DictReader(numbers.read_text(encoding="utf-8").splitlines()):
        if (line["table"] != ALL) != by_category:
            continue
        column = _column(line["column"])
        label = f"{line['row']}, {line['table']}" if by_category else line["row"]
        row = rows.setdefault(label, {"label": label})
        if "clips" not in row and line["clips"]:
            row["clips"] = int(line["clips"])
        value = _estimate(line, "", column)
        if value is not None:
            columns[column.key], row[column.key] = column, value
        if line["against"] and column.best and not by_category:
            difference = differences.setdefault(label, {"label": label, "against": line["against"]})
            difference[column.key] = _estimate(line, "difference_", column)
    if not by_category:
        columns |= _of_clips(rows, numbers.with_name(f"{numbers.stem}{CLIPS}.csv"))
    versions = next((line for line in settings if line.startswith("python ")), "")
    notes = [MADE.sub("", line) for line in (*about, *settings) if line != versions]
    made = _made(name, "\n".join(about)) | {"versions": versions}
    return Table(_title(name, title), made, [*columns.values()], [*rows.values()], [*differences.values()], notes)


def _column(label: str) -> Column:
    """Return the column of a line of the CSV file."""
    if label == "seconds (median)":
        return Column("seconds", "s", "s", 2)
    label = label.removesuffix(" (median)")
    metric = LABELLED[label]
    if metric.unit != "%":
        heading, unit = label.rsplit(", ", 1)
        return Column(metric.name, heading, unit, 1, "lowest")
    key = "right_in_camera" if metric.folded else store.COLUMN_KEYS.get(label) or store.slug(label, "_")
    return Column(key, label, "%", 1, "highest" if metric.ranked else "")


def _estimate(line: Mapping[str, str], prefix: str, column: Column) -> Cell:
    """Parse a mean with its interval, or a median; shares in per cent."""
    factor = 100.0 if column.unit == "%" else 1.0
    value, low, high = (factor * float(line[f"{prefix}{key}"] or "nan") for key in ("mean", "low", "high"))
    if math.isnan(value):
        return None
    return round(value, 3) if math.isnan(low) else [round(value, 2), round(low, 2), round(high, 2)]


def _of_clips(rows: Mapping[str, dict[str, Cell]], path: Path) -> dict[str, Column]:
    """Add counts of failed, ambiguous, wrong and flagged results to the rows; return their columns."""
    by_setting = defaultdict(list)
    for line in csv.DictReader(path.read_text(encoding="utf-8").splitlines()):
        by_setting[line["method"], line["setting"].removeprefix("'")].append(
            line
        )  # the apostrophe that keeps spreadsheets from reading a formula
    for label, row in rows.items():
        lines = _lines_of(label, by_setting)
        if not lines:
            continue
        done = [line for line in lines if line["iou"]]
        right = [float(line.get("add_sym_success") or "nan") for line in done]
        ambiguous = [line["ambiguous"] == "True" for line in done]
        named = [line["findings"].split() for line in done]
        flagged = [any(name in SERIOUS for name in each) for each in named]
        counts = Counter(name for each in named for name in each).most_common()
        row |= {
            "failed": len(lines) - len(done),
            "ambiguous": sum(ambiguous),
            "wrong": right.count(0.0),
            "wrong_ambiguous": sum(a for a, r in zip(ambiguous, right, strict=True) if r == 0.0),
            "flagged": sum(flagged),
            "flagged_right": sum(d for d, r in zip(flagged, right, strict=True) if r == 1.0),
        }
        for key, wanted in (("serious", True), ("notes", False)):
            if of := {name: count for name, count in counts if (name in SERIOUS) == wanted}:
                row[key] = of
    labels = {
        "failed": "failed", "ambiguous": "ambiguous", "wrong": "wrong", "wrong_ambiguous": "of these ambiguous",
        "flagged": "flagged", "flagged_right": "of these right", "serious": "serious findings", "notes": "notes",
    }  # fmt: skip
    return {key: Column(key, label) for key, label in labels.items()}


def _lines_of(label: str, by_setting: Mapping[tuple[str, str], list[dict[str, str]]]) -> list[dict[str, str]]:
    """Select the lines of a row, by method and setting; by setting alone if methods differ between rows.

    None where several rows share their results, as by several definitions of contact.
    """
    whole = [lines for (method, setting), lines in by_setting.items() if label in {f"{method}, {setting}", setting}]
    likely = [lines for (_, setting), lines in by_setting.items() if label.endswith(f", {setting}")]
    return next((found[0] for found in (whole, likely) if len(found) == 1), [])


def _page(path: Path) -> tuple[str, list[str], list[str]]:
    """Split a page of ``bench`` into title, description of the run, and settings."""
    title, *lines = path.read_text(encoding="utf-8").splitlines()
    listed = [line.removeprefix("- ") for line in lines if line.startswith("- ")]
    count = next((n for n, line in enumerate(lines) if line.startswith("|")), 0)
    before = sum(line.startswith("- ") for line in lines[:count])
    return title.removeprefix("# "), listed[:before], listed[before:]


def printed(name: str, page: Path) -> Table:
    """Read the only table of a page of segments or timelines."""
    title, before, after = _page(page)
    lines = [line for line in page.read_text(encoding="utf-8").splitlines() if line.startswith("|")]
    header, _, *body = ([cell.strip() for cell in line[1:-1].split("|")] for line in lines)
    notes = [note for line in (*before, *after) if (note := MADE.sub("", line))]
    table = store.of_cells(_title(name, title), header, body, notes)
    units = {one.key: one.unit for one in store.read(name).columns} if name in store.names() else {}
    columns = [replace(one, unit=one.unit or units.get(one.key, "")) for one in table.columns]
    return replace(table, columns=columns, made=_made(name, "\n".join((*before, *after))))


def _title(name: str, title: str) -> str:
    """Return a table's earlier title, else its name and its page's title (most pages are called "Methods")."""
    return store.read(name).title if name in store.names() else f"{name}: {title}"


def _made(name: str, text: str) -> dict[str, str]:
    """Describe date, commit, command and machine as far as known; only output of today was made on this machine."""
    how = MADE.search(text) or MADE.search(f"made {date_and_commit()}")
    day, commit = how.groups() if how else (None, None)
    before = dict(store.read(name).made) if name in store.names() else {}
    command = BENCHES.get(name, before.get("command", ""))
    made = {key: value for key, value in (("date", day), ("commit", commit), ("command", command)) if value}
    where = before.get("machine") if made.items() <= before.items() else None
    where = where or (machine() if day == date_and_commit().partition(",")[0] else None)
    return made | ({"machine": where} if where else {})


if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:]])
