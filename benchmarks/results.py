"""Put the tables and plots of ``getagrip bench`` into the pages of results: ``python -m benchmarks.results DIR...``.

Each folder is one that was given to ``bench --out``, and is named like the dataset: its ``methods.md`` goes between the
markers "<name>-methods", and so does each ablation that a page has markers for, with its plot.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from benchmarks import page
from getagrip.experiments.tables import CATEGORIES, DOUBTS

BY_CATEGORY = "dexycb-methods"
"""The section that shows each category; the others' are in the files that ``bench`` writes."""
FINDINGS = "synthetic-train-wrong-input"
"""The section that shows only what the checks have found."""


def main(folders: list[Path]) -> None:
    """Update the pages."""
    for folder in folders:
        for tables in sorted(folder.glob("*.md")):
            name = f"{folder.name}-{tables.stem}"
            if page.has(name):
                page.write(name, section(name, tables))
                print(name)


def section(name: str, tables: Path) -> str:
    """A page of ``bench`` without its title, the plot beside it moved to the pictures of the docs."""
    body = tables.read_text(encoding="utf-8").split("\n", 1)[1].strip()
    if name == FINDINGS:
        about, *_ = body.split("\n\n")
        found = body.split(_opening(DOUBTS))[1].split("</details>")[0].strip()
        return f"{about}\n\n{DOUBTS}:\n\n{found}"
    if name != BY_CATEGORY:
        body = body.split(_opening(CATEGORIES))[0].strip()
    plot = tables.with_suffix(".png")
    if not plot.exists():
        return body
    shutil.copy(plot, page.DOCS / "images" / f"results-{name}.png")
    return f"![{name}](images/results-{name}.png)\n\n{body}"


def _opening(title: str) -> str:
    """How ``bench`` begins what it folds away."""
    return f"<details><summary>{title}</summary>"


if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:]])
