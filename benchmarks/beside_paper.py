"""The paper's results on ARCTIC beside ours, as a table of docs/arctic.md: ``python -m benchmarks.beside_paper``.

It reads the tables that ``benchmarks.results`` has put into the pages.
"""

from __future__ import annotations

import re

from benchmarks import page
from getagrip.experiments.stamp import stamp

COLUMNS = ("IOU", "ADD", "SCA-IOU 0.8", "SCA-ADD")
PAPER = {
    "single-frame": (83.3, 15.0, 19.5, 6.0),
    "homan": (81.4, 37.1, 33.1, 22.0),
    "static": (81.4, 46.9, 46.6, 34.2),
    "dynamic": (90.8, 59.6, 45.5, 31.5),
    "one-dof": (88.1, 57.3, 55.7, 38.5),
}
"""The row "All" of the paper's table of results on ARCTIC-Grasps, by our names, in the order of ``COLUMNS``."""
SOURCES = {
    "ARCTIC, the paper": None,
    "ARCTIC's motion, here": ("arctic.md", "arctic-methods"),
    "DexYCB": ("results.md", "dexycb-methods"),
}
NUMBER = re.compile(r"[0-9]+\.[0-9]")


def main() -> None:
    """Update the page."""
    found = {label: None if place is None else measured(*place) for label, place in SOURCES.items()}
    rows = [
        [f"{method}, {label}", *(f"{value:.1f}" for value in (of or PAPER)[method])]
        for method in PAPER
        for label, of in found.items()
    ]
    page.write(
        "beside-paper",
        f"*Put here {stamp()}, from the other tables.*\n\n{page.table(['', *COLUMNS], rows)}",
        "arctic.md",
    )


def measured(file: str, name: str) -> dict[str, tuple[float, ...]]:
    """The first table of a section, of all clips, by method. Raises ``ValueError`` where there is none."""
    text = (page.DOCS / file).read_text(encoding="utf-8")
    section = text.split(f"<!-- {name}: measured -->")[1].split(f"<!-- {name}: end -->")[0]
    table = section[section.index("\n|") + 1 :].split("\n\n")[0]
    lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in table.splitlines()]
    places = [lines[0].index(column) for column in COLUMNS]
    return {
        row[0]: tuple(float(match[0]) for at in places if (match := NUMBER.search(row[at])))
        for row in lines[2:]
        if row[0] in PAPER
    }


if __name__ == "__main__":
    main()
