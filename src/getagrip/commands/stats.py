"""``getagrip stats``: the dataset tables, on the screen and as files."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from getagrip.errors import UsageError
from getagrip.experiments.durations import ALL, CategoryDurations, Fps, durations, read_epic, read_list
from getagrip.io import files
from getagrip.io.terminal import console, plain_table, report

EPIC = "epic-grasps"
HEADINGS = ("category", "avg [s]", "std [s]", "max [s]", "clips", "left", "right")


def print_stats(
    source: str, table: Path | None, errata: Path | None, fps: Fps | None, out: Path | None, json: Path | None
) -> int:
    """Print how long the grasps of a list last, and write it as ``out/stats.md`` and ``stats.csv``; returns 0.

    ``source`` is ``epic-grasps``, and ``table`` its CSV, or ``source`` is a list of grasps. ``errata`` of
    the CSV are applied where they are given. Raises ``UsageError`` for calls that are neither, and ``InputError``.
    """
    if source == EPIC:
        if table is None:
            raise UsageError(f"stats {EPIC}: got no file, expected its CSV")
        grasps = read_epic(table, fps or "paper", errata)
    else:
        if table is not None:
            raise UsageError(f"stats: got {source!r} and {table}, expected {EPIC} and its CSV, or one list of grasps")
        if errata is not None:
            raise UsageError(f"--errata: got {errata}, expected none: they are of {EPIC}")
        if fps is not None:
            raise UsageError(f"--fps: got {fps}, expected none: a list of grasps is in seconds")
        grasps = read_list(Path(source), report)
    rows = durations(grasps)
    if not rows:
        print("no grasps")
    else:
        _print(rows)
    if out is not None:
        _write(rows, out)
    if json is not None:
        files.write_json(json, [asdict(row) for row in rows])
    return 0


def _cells(row: CategoryDurations) -> list[str]:
    """A row as people read it."""
    seconds = [f"{value:.2f}" for value in (row.mean, row.std, row.longest)]
    return [row.category, *seconds, str(row.clips), str(row.left), str(row.right)]


def _print(rows: Sequence[CategoryDurations]) -> None:
    from rich.text import Text

    shown = plain_table()
    for n, heading in enumerate(HEADINGS):
        shown.add_column(Text(heading), justify="right" if n else "left", no_wrap=n > 0, overflow="fold")
    for row in rows:
        if row.category == ALL:
            shown.add_section()
        shown.add_row(*map(Text, _cells(row)))  # no markup: names may hold brackets
    console().print(shown)


def _write(rows: Sequence[CategoryDurations], out: Path) -> None:
    """The same as Markdown, and unrounded as CSV."""
    out.mkdir(parents=True, exist_ok=True)
    lines: list[Sequence[Any]] = [HEADINGS, ["---", *["---:"] * (len(HEADINGS) - 1)], *map(_cells, rows)]
    page = "".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |\n" for line in lines)
    (out / "stats.md").write_text(page, "utf-8")
    with (out / "stats.csv").open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(asdict(rows[0]) if rows else ())
        writer.writerows(asdict(row).values() for row in rows)
    print(out / "stats.md")
