"""Put the measurements of ``getagrip study`` into docs/arctic.md: ``python -m benchmarks.studies DIR OTHER...``.

Folders are those that were given to ``study --out``. The first one's ``summary.csv`` goes between the markers
"<name>-study"; a line for each of the others, which are of other definitions of contact, between "<name>-definitions".
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Sequence
from datetime import date
from pathlib import Path

from benchmarks import page
from getagrip.experiments.stamp import stamp
from getagrip.grasps.definition import Definition
from getagrip.grasps.study import MEASURES
from getagrip.io import files

ALL = "All"
BY_OBJECT = {
    "static": ("static_rotation", "static_place"),
    "1-DoF, rotations alone": ("one_dof_rotation",),
    "1-DoF, full pose, axis anywhere": ("free_rotation", "free_place"),
    "1-DoF, full pose, axis at the hand": ("at_hand_rotation", "at_hand_place"),
}
"""Columns of the table by object: measures within grasps."""


def main(first: Path, *others: Path) -> None:
    """Update the page."""
    page.write(f"{first.name}-study", f"{made(first)}\n\n{section(summary(first))}")
    if others:
        page.write(f"{first.name}-definitions", f"{made(*others)}\n\n{definitions(others)}")


def made(*folders: Path) -> str:
    """When the studies were made, and by which code their tables were."""
    days = {date.fromtimestamp((folder / "summary.csv").stat().st_mtime).isoformat() for folder in folders}
    return f"*Measured {' and '.join(sorted(days))}; put here {stamp()}.*"


def summary(folder: Path) -> list[dict[str, str]]:
    """The lines of a study's table."""
    with (folder / "summary.csv").open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def definitions(folders: Sequence[Path]) -> str:
    """A table of all grasps under each definition."""
    rows = []
    for folder in folders:
        inside = {r["measure"]: r for r in summary(folder) if r["object"] == ALL and r["where"] == "inside"}
        definition = Definition(**files.read_json(folder / "grasps.json")["cut"])
        columns = (", ".join(shown(inside[name]) for name in names) for names in BY_OBJECT.values())
        rows.append([definition.description, inside["static_rotation"]["grasps"], *columns])
    return page.table(["grasps of", "", *BY_OBJECT], rows)


def shown(row: dict[str, str], spread: bool = False) -> str:
    """A measure's mean, and its standard deviation, as people read them."""
    measure = MEASURES[row["measure"]]
    digits = 1 if measure.unit else 2
    numbers = [f"{float(row[key]) * measure.factor:.{digits}f}" for key in ("mean", "std")[: 1 + spread]]
    return " ± ".join(numbers) + (f" {measure.unit}" if measure.unit else "")


def section(rows: list[dict[str, str]]) -> str:
    """Two tables: errors of the approximations by object, and all measures within grasps and outside them."""
    of = {(row["object"], row["where"], row["measure"]): row for row in rows}
    objects = list(dict.fromkeys(row["object"] for row in rows))
    total = ALL if ALL in objects else objects[0]

    by_object = [
        [
            obj,
            of[obj, "inside", "static_rotation"]["grasps"],
            *(", ".join(shown(of[obj, "inside", n]) for n in names) for names in BY_OBJECT.values()),
        ]
        for obj in objects
    ]
    inside_outside = [
        [measure.label, *(shown(of[total, where, name], spread=True) for where in ("inside", "outside"))]
        for name, measure in MEASURES.items()
    ]
    outside = of[total, "outside", "static_rotation"]["grasps"]
    return "\n\n".join(
        [
            "Error of the approximation within grasps, means:",
            page.table(["object", "grasps", *BY_OBJECT], by_object),
            f"Mean ± standard deviation over grasps, {outside} of which have frames outside:",
            page.table(["measure", "within", "outside"], inside_outside),
        ]
    )


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
