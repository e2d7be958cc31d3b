"""Tables in CSV, which a spreadsheet opens without running anything, and in Markdown.

Spreadsheets take a text that begins with ``=``, ``+``, ``-``, ``@`` or a control character for a formula. Names come
from untrusted files, so that such a text gets an apostrophe before it, which spreadsheets do not show and
``files.csv_rows`` takes away again. Numbers stay as they are.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Sequence
from typing import TextIO

_FORMULA_PATTERN = re.compile(r"'*[=+\-@\t\r\n]")
"""Beginning of a text that gets an apostrophe; one that has some already gets one more, so that reading undoes it."""


class CsvTable:
    """A table that is being written into a text stream, opened with ``newline=""``."""

    def __init__(self, stream: TextIO) -> None:
        self._rows = csv.writer(stream)

    def write_row(self, cells: Iterable[object]) -> None:
        """Add a row: texts so that none is a formula, numbers as they are."""
        self._rows.writerow([escape_cell(cell) if isinstance(cell, str) else cell for cell in cells])

    def write_rows(self, rows: Iterable[Iterable[object]]) -> None:
        """Add rows."""
        for cells in rows:
            self.write_row(cells)


def escape_cell(text: str) -> str:
    """Write a text as a cell holds it."""
    return f"'{text}" if _FORMULA_PATTERN.match(text) else text


def unescape_cell(cell: str) -> str:
    """Return the text of a cell that ``escape_cell`` wrote; other cells stay as they are."""
    return cell[1:] if cell.startswith("'") and _FORMULA_PATTERN.match(cell) else cell


def markdown_page(title: str, grid: Sequence[Sequence[str]], about: Sequence[str], words: int = 1) -> str:
    """Write one table under a title, and how it was made; the first columns are ``words``, the others numbers."""
    lines = [f"# {title}", "", *markdown_table(grid, words), "", *(f"- {line}" for line in about)]
    return "\n".join(lines) + "\n"


def markdown_table(grid: Sequence[Sequence[str]], words: int = 1) -> list[str]:
    """Return the lines of a table, headings first; the first columns are ``words``, the others numbers."""
    headings, *body = grid
    rule = [*["---"] * words, *["---:"] * (len(headings) - words)]
    escaped = ([cell.replace("|", "\\|") for cell in cells] for cells in (headings, rule, *body))
    return [f"| {' | '.join(cells)} |" for cells in escaped]
