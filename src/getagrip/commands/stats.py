"""``getagrip stats``: the dataset tables, on the screen and as files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from getagrip.datasets.epic.tables import chosen_errata, read_grasps
from getagrip.errors import UsageError
from getagrip.experiments import counts, durations
from getagrip.experiments.counts import Counts
from getagrip.experiments.durations import ALL, CategoryDurations, Fps
from getagrip.grasps import lists
from getagrip.io import files
from getagrip.io.csv_tables import CsvTable
from getagrip.io.terminal import console, plain_table, report

EPIC = "epic-grasps"
HEADINGS = ("category", "avg [s]", "std [s]", "max [s]", "clips", "left", "right")


def print_stats(
    source: str,
    table: Path | None,
    errata: bool,
    errata_file: Path | None,
    fps: Fps | None,
    out: Path | None,
    json: Path | None,
) -> int:
    """Print how long the grasps of a dataset last and what it has, and write it to files; returns 0.

    ``source`` is ``epic-grasps``, and ``table`` its CSV, or ``source`` is a list of grasps, or a folder of clips with
    one. ``out`` gets ``stats.md``, ``stats.csv`` and ``counts.csv``. Raises ``UsageError`` for calls that are neither,
    and ``InputError``.
    """
    if source == EPIC:
        if table is None:
            raise UsageError(f"stats {EPIC}: got no file, expected its CSV")
        chosen = chosen_errata(table, errata or errata_file is not None, errata_file)
        if errata and chosen is None:
            raise UsageError(f"--errata: got no {table.stem}_errata.csv beside {table}, expected it or --errata-file")
        grasps = read_grasps(table, chosen)
        lasting, counted = durations.of_epic(grasps, fps or "paper"), counts.of_epic(grasps)
    else:
        if table is not None:
            raise UsageError(f"stats: got {source!r} and {table}, expected {EPIC} and its CSV, or one list of grasps")
        if errata or errata_file is not None:
            raise UsageError(f"--errata: got it for {source}, expected none: they are of {EPIC}")
        if fps is not None:
            raise UsageError(f"--fps: got {fps}, expected none: a list of grasps is in seconds")
        folder = Path(source) if Path(source).is_dir() else None
        path = Path(source) if folder is None else folder / lists.FILE
        listed = lists.read(path, report).grasps
        lasting, counted = durations.of_list(path, listed), counts.of_list(listed, folder)
    rows = durations.durations(lasting)
    if not rows:
        print("no grasps")
    else:
        _print(rows)
        print(", ".join(f"{number} {name}" for name, number in asdict(counted).items() if number is not None))
    if out is not None:
        _write(rows, counted, out)
    if json is not None:
        files.write_json(json, {"durations": [asdict(row) for row in rows], "counts": asdict(counted)})
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


def _write(rows: Sequence[CategoryDurations], counted: Counts, out: Path) -> None:
    """The same as Markdown, and unrounded as CSV."""
    out.mkdir(parents=True, exist_ok=True)
    figures = {name: "-" if number is None else f"{number}" for name, number in asdict(counted).items()}
    pages = [_grid(HEADINGS, [_cells(row) for row in rows]), _grid(list(figures), [list(figures.values())])]
    files.write_text(out / "stats.md", "\n".join(pages))
    with files.new_text(out / "counts.csv") as stream:
        CsvTable(stream).write_rows([asdict(counted), asdict(counted).values()])
    with files.new_text(out / "stats.csv") as stream:
        table = CsvTable(stream)
        table.write_row(asdict(rows[0]) if rows else ())
        table.write_rows(asdict(row).values() for row in rows)
    print(out / "stats.md")


def _grid(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = [headings, ["---", *["---:"] * (len(headings) - 1)], *rows]
    return "".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |\n" for line in lines)
