"""Numbers that others printed for the parts of a benchmark, in a table beside ours."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources

from getagrip.experiments.comparison import ComparisonTable
from getagrip.io.tables import markdown_table

ALL_PARTS_LABEL = "all"
"""Row of the mean over all parts."""


@dataclass(frozen=True)
class PublishedResults:
    """A system's printed numbers, in per cent."""

    given: str
    """Its inputs, and the frames that count."""
    source: str
    columns: Sequence[str]
    """Labels of ours that mean the same."""
    rows: Mapping[str, Sequence[float | None]]
    """Numbers by part, in the order of the columns, and by ``ALL_PARTS_LABEL``."""

    def number(self, row: str, column: str) -> float:
        """Return a number; NaN where none is printed."""
        printed = dict(zip(self.columns, self.rows.get(row, ()), strict=False)).get(column)
        return math.nan if printed is None else printed


def read_published_results(name: str) -> dict[str, PublishedResults]:
    """Read the systems of a file beside the sources of clips, by name."""
    text = resources.files("getagrip.experiments.sources").joinpath(name).read_text("utf-8")
    return {system: PublishedResults(**fields) for system, fields in json.loads(text).items()}


def published_grid(systems: Mapping[str, PublishedResults], ours: Mapping[str, ComparisonTable]) -> list[list[str]]:
    """Make a grid: the parts as columns; for each column that anybody printed, our rows and the systems' as rows.

    ``ours`` are tables by part. Their mean over all is shown only where it is of the same parts as the printed ones.
    """
    parts = sorted({*(part for system in systems.values() for part in system.rows), *ours} - {ALL_PARTS_LABEL})
    tables = {part: table for part, table in ours.items() if part != ALL_PARTS_LABEL or {*parts} <= {*ours}}
    rows = next(iter(ours.values())).rows if ours else ()
    lines = [["", *parts, ALL_PARTS_LABEL]]
    for column in dict.fromkeys(column for system in systems.values() for column in system.columns):
        found = {
            row.variant.label: [_mean_percent(tables.get(p), n, column) for p in (*parts, ALL_PARTS_LABEL)]
            for n, row in enumerate(rows)
        }
        for name, system in systems.items():
            if column in system.columns:
                found[name] = [system.number(part, column) for part in (*parts, ALL_PARTS_LABEL)]
        lines += [[f"{column}: {name}", *map(_format_number, numbers)] for name, numbers in found.items()]
    return lines


def _mean_percent(table: ComparisonTable | None, row: int, column: str) -> float:
    """Return our mean in per cent; NaN where it is not known."""
    estimate = None if table is None else table.rows[row].values.get(column)
    return math.nan if estimate is None else 100.0 * estimate.mean


def _format_number(number: float) -> str:
    return "–" if math.isnan(number) else f"{number:.1f}"


def published_markdown(systems: Mapping[str, PublishedResults], ours: Mapping[str, ComparisonTable]) -> list[str]:
    """Write the grid, and what each system was given, as Markdown."""
    sources = [f"- {name}: {system.given}. Source: {system.source}" for name, system in systems.items()]
    return [*markdown_table(published_grid(systems, ours)), "", *sources]
