"""Tables in Markdown."""

from __future__ import annotations

from collections.abc import Sequence


def page(title: str, grid: Sequence[Sequence[str]], about: Sequence[str], words: int = 1) -> str:
    """Write one table under a title, and how it was made; the first columns are ``words``, the others numbers."""
    lines = [f"# {title}", "", *table(grid, words), "", *(f"- {line}" for line in about)]
    return "\n".join(lines) + "\n"


def table(grid: Sequence[Sequence[str]], words: int = 1) -> list[str]:
    """Return the lines of a table, headings first; the first columns are ``words``, the others numbers."""
    headings, *body = grid
    rule = [*["---"] * words, *["---:"] * (len(headings) - words)]
    escaped = ([cell.replace("|", "\\|") for cell in cells] for cells in (headings, rule, *body))
    return [f"| {' | '.join(cells)} |" for cells in escaped]
