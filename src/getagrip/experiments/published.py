"""Numbers that others printed for the parts of a benchmark, in a table beside ours."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources

from getagrip.experiments.comparison import Table
from getagrip.io.tables import markdown_table

ALL = "all"
"""Row of the mean over all parts."""


@dataclass(frozen=True)
class Published:
    """A system's printed numbers, in per cent."""

    given: str
    """Its inputs, and the frames that count."""
    source: str
    columns: Sequence[str]
    """Labels of ours that mean the same."""
    rows: Mapping[str, Sequence[float | None]]
    """Numbers by part, in the order of the columns, and by ``ALL``."""

    def number(self, row: str, column: str) -> float:
        """Return a number; NaN where none is printed."""
        printed = dict(zip(self.columns, self.rows.get(row, ()), strict=False)).get(column)
        return math.nan if printed is None else printed


def read(name: str) -> dict[str, Published]:
    """Read the systems of a file beside the sources of clips, by name."""
    text = resources.files("getagrip.experiments.sources").joinpath(name).read_text("utf-8")
    return {system: Published(**fields) for system, fields in json.loads(text).items()}


def grid(systems: Mapping[str, Published], ours: Mapping[str, Table]) -> list[list[str]]:
    """Make a grid: the parts as columns; for each column that anybody printed, our rows and the systems' as rows.

    ``ours`` are tables by part. Their mean over all is shown only where it is of the same parts as the printed ones.
    """
    parts = sorted({*(part for system in systems.values() for part in system.rows), *ours} - {ALL})
    tables = {part: table for part, table in ours.items() if part != ALL or {*parts} <= {*ours}}
    rows = next(iter(ours.values())).rows if ours else ()
    lines = [["", *parts, ALL]]
    for column in dict.fromkeys(column for system in systems.values() for column in system.columns):
        found = {
            row.variant.label: [_mean(tables.get(p), n, column) for p in (*parts, ALL)] for n, row in enumerate(rows)
        }
        for name, system in systems.items():
            if column in system.columns:
                found[name] = [system.number(part, column) for part in (*parts, ALL)]
        lines += [[f"{column}: {name}", *map(_shown, numbers)] for name, numbers in found.items()]
    return lines


def _mean(table: Table | None, row: int, column: str) -> float:
    """Return our mean in per cent; NaN where it is not known."""
    estimate = None if table is None else table.rows[row].values.get(column)
    return math.nan if estimate is None else 100.0 * estimate.mean


def _shown(number: float) -> str:
    return "–" if math.isnan(number) else f"{number:.1f}"


def lines(systems: Mapping[str, Published], ours: Mapping[str, Table]) -> list[str]:
    """Write the grid, and what each system was given, as Markdown."""
    sources = [f"- {name}: {system.given}. Source: {system.source}" for name, system in systems.items()]
    return [*markdown_table(grid(systems, ours)), "", *sources]
