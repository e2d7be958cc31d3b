"""Put the tables and plots of ``getagrip bench`` into the pages of results: ``python -m benchmarks.results DIR...``.

Each folder is one that was given to ``bench --out``, and is named like the dataset: its ``methods.md`` goes between the
markers "<name>-methods" of one of ``PAGES``, and so does each ablation that a page has markers for, with its plot.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from benchmarks import page

PAGES = ("results.md", "arctic.md", "checks.md")
CATEGORIES = "dexycb-methods"
"""The section that shows each category; the others' are in the files that ``bench`` writes."""
FINDINGS = "synthetic-train-wrong-input"
"""The section that shows only what the checks have found."""
DOUBTS = "Results that the checks doubt"


def main(folders: list[Path]) -> None:
    """Update the pages."""
    for folder in folders:
        for tables in sorted(folder.glob("*.md")):
            name = f"{folder.name}-{tables.stem}"
            for file in PAGES:
                if f"<!-- {name}: measured -->" in (page.DOCS / file).read_text(encoding="utf-8"):
                    page.write(name, section(name, tables), file)
                    print(name)


def section(name: str, tables: Path) -> str:
    """A page of ``bench`` without its title, the plot beside it moved to the pictures of the docs."""
    body = tables.read_text(encoding="utf-8").split("\n", 1)[1].strip()
    if name == FINDINGS:
        head, *_ = body.split("\n\n")
        kept = "\n".join(line for line in head.splitlines() if line.startswith(("- synthetic", "- made")))
        return f"{kept}\n\n{DOUBTS}{body.split(DOUBTS)[1].split('<details>')[0].rstrip()}"
    if name != CATEGORIES:
        body = body.split("<details>")[0].strip()
    plot = tables.with_suffix(".png")
    if not plot.exists():
        return body
    shutil.copy(plot, page.DOCS / "images" / f"results-{name}.png")
    return f"![{name}](images/results-{name}.png)\n\n{body}"


if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:]])
