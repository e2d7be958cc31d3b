"""The paper's tables in its layout, with our numbers, and its own in brackets: terminal, Markdown and LaTeX.

``published.json`` holds the printed numbers, by table. A table has rows (categories or settings), groups (methods), and
columns (metrics) in each group; our additional groups come last.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path

from getagrip.bench.tables import LATEX_STYLE, MARKDOWN_STYLE
from getagrip.io import files
from getagrip.io.files import Json
from getagrip.io.terminal import format_count, markdown_table

Values = Mapping[str, Mapping[str, Mapping[str, float]]]
"""Measured numbers by group, row and column."""
ALL_ROW_LABEL = "All"
UNRANKED_COLUMNS = ("avg", "std", "max", "clips", "static", "1-DoF")
"""Columns without a best value."""


@cache
def published() -> Json:
    """Read the paper's printed numbers: by table its title, columns, and groups of rows."""
    content: Json = json.loads(resources.files(__package__).joinpath("published.json").read_text("utf-8"))
    return content


@dataclass(frozen=True)
class PaperTable:
    """A table of the paper with our measurements."""

    number: str
    """Number of the table, a key of ``published.json``."""
    measured: Values
    note: str = ""
    """Remark on the measurements."""

    @property
    def title(self) -> str:
        """Number and title."""
        return f"{self.number}: {published()[self.number]['title']}"

    @property
    def columns(self) -> list[str]:
        """Names of the metrics."""
        return list(published()[self.number]["columns"])

    @property
    def groups(self) -> list[str]:
        """Names of the methods, the paper's first."""
        return [*dict.fromkeys([*published()[self.number]["groups"], *self.measured])]

    @property
    def rows(self) -> list[str]:
        """Names of the rows: the paper's, additional categories, then the row of all."""
        known = [*(row for group in published()[self.number]["groups"].values() for row in group)]
        rows = [*dict.fromkeys([*known, *(row for group in self.measured.values() for row in group)])]
        return sorted(rows, key=ALL_ROW_LABEL.__eq__)

    def printed(self, group: str, row: str, column: str) -> float:
        """Return the paper's number; NaN if missing."""
        numbers = published()[self.number]["groups"].get(group, {}).get(row)
        return math.nan if numbers is None else float(numbers[self.columns.index(column)])

    def cell(self, group: str, row: str, column: str, latex: bool) -> str:
        """Write our number, marked as best or second best of its row, with the paper's in brackets."""
        ours = {g: self.measured.get(g, {}).get(row, {}).get(column, math.nan) for g in self.groups}
        known = sorted({round(v, 1) for v in ours.values() if not math.isnan(v)}, reverse=True)
        ranked = column not in UNRANKED_COLUMNS and len(known) > 1
        rank = known.index(round(ours[group], 1)) + 1 if ranked and not math.isnan(ours[group]) else 0
        text = _format_table_number(ours[group], column)
        if latex:
            shown = {1: r"\cellcolor{green!25}", 2: r"\cellcolor{yellow!25}"}.get(rank, "") + LATEX_STYLE.text(text)
        else:
            shown = MARKDOWN_STYLE.cell(text, rank, "")
        printed = self.printed(group, row, column)
        return shown if math.isnan(printed) else f"{shown} ({_format_table_number(printed, column)})"

    def grids(self) -> Iterator[tuple[str, list[list[str]]]]:
        """Yield a grid for each column, rows by groups; for a single group one grid, rows by columns."""
        if len(self.groups) == 1:
            (group,) = self.groups
            body = [[row, *(self.cell(group, row, column, False) for column in self.columns)] for row in self.rows]
            yield "", [["", *self.columns], *body]
            return
        for column in self.columns:
            body = [[row, *(self.cell(group, row, column, False) for group in self.groups)] for row in self.rows]
            yield column, [["", *self.groups], *body]

    def latex(self) -> str:
        """Make the table in the paper's layout (needs booktabs, and xcolor with its option table)."""
        width = len(self.columns)
        heads = [rf"\multicolumn{{{width}}}{{c}}{{{LATEX_STYLE.text(group)}}}" for group in self.groups]
        lines = [
            r"\begin{table*}", r"\centering", rf"\begin{{tabular}}{{l{('|' + 'c' * width) * len(self.groups)}}}",
            r"\toprule", " & ".join(["", *heads]) + r" \\",
            " & ".join(["", *map(LATEX_STYLE.text, self.columns * len(self.groups))]) + r" \\", r"\midrule",
        ]  # fmt: skip
        for row in self.rows:
            cells = [self.cell(group, row, column, True) for group in self.groups for column in self.columns]
            lines += [r"\hline"] * (row == ALL_ROW_LABEL) + [" & ".join([LATEX_STYLE.text(row), *cells]) + r" \\"]
        caption = " ".join([f"{self.title}.", *filter(None, [self.note]), "In brackets the paper's numbers."])
        return "\n".join(
            [*lines, r"\bottomrule", r"\end{tabular}", rf"\caption{{{LATEX_STYLE.text(caption)}}}", r"\end{table*}"]
        )


def _format_table_number(value: float, column: str) -> str:
    """Format a number: counts without decimals, seconds with two, shares with one."""
    digits = {"clips": 0, "avg": 2, "std": 2, "max": 2}.get(column, 1)
    return "–" if math.isnan(value) else f"{value:.{digits}f}"


def write_paper_tables(tables: Sequence[PaperTable], out: Path, about: Sequence[str]) -> None:
    """Print the tables, and write ``tables.md``, ``tables.tex`` and ``tables.json`` into a folder."""
    lines = ["# The paper's tables", "", *(f"- {line}" for line in about)]
    for table in tables:
        lines += ["", f"## {table.title}", *(["", table.note] if table.note else [])]
        for column, grid in table.grids():
            lines += ["", *([f"{column}:", ""] if column else []), *markdown_table(grid)]
    text = "\n".join(lines) + "\n"
    print(text, end="")
    files.write_text(out / "tables.md", text)
    files.write_text(out / "tables.tex", "\n\n".join(table.latex() for table in tables) + "\n")
    content = {t.number: {"note": t.note, "measured": t.measured, "published": published()[t.number]} for t in tables}
    files.write_json(out / "tables.json", {"tables": content})
    print(*(out / f"tables.{end}" for end in ("md", "tex", "json")), sep="\n")


def bench_values(page: Path, label: str, columns: Mapping[str, str]) -> dict[str, dict[str, float]]:
    """Return a variant's means in per cent, by category, from a file of ``bench --json``; empty without results.

    ``columns`` maps the paper's columns to ours.
    """
    found: dict[str, dict[str, float]] = {}
    tables = _read_bench_tables(page)
    for table in tables:
        for row in table["rows"]:
            if row["row"] == label and row["failed"] < table["clips"]:
                means = {name: row["values"].get(ours, {}).get("mean") for name, ours in columns.items()}
                values = {name: math.nan if mean is None else 100.0 * mean for name, mean in means.items()}
                found[ALL_ROW_LABEL if table["table"] == "all" else table["table"]] = values
    if len(tables) == 1 and ALL_ROW_LABEL in found:  # the clips are of one category, which has no table of its own
        found[next(clip["category"] for clip in files.read_json(page)["clips"])] = found[ALL_ROW_LABEL]
    return found


def describe_clip_count(page: Path) -> str:
    """Describe the number of clips of a file of ``bench --json``."""
    return "".join(f"On {format_count(table['clips'], 'clip')}." for table in _read_bench_tables(page)[:1])


def _read_bench_tables(page: Path) -> Sequence[Json]:
    """Return the tables of a file of ``bench --json``; empty where the file is missing, since no clip succeeded."""
    return files.read_json(page)["tables"] if page.is_file() else ()


def read_durations(page: Path) -> Values:
    """Read the statistics of ``stats --json`` [s]."""
    keys = {"avg": "mean", "std": "std", "max": "longest", "clips": "clips"}
    rows = files.read_json(page)["durations"]
    return {"grasps": {row["category"]: {name: row[key] for name, key in keys.items()} for row in rows}}
