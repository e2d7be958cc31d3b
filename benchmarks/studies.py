"""Put the measurements of ``getagrip study`` into docs/arctic.md: ``python -m benchmarks.studies DIR...``.

Each folder is one that was given to ``study --out``; its ``summary.csv`` goes between the markers "<name>-study".
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

from benchmarks import page
from getagrip.grasps.study import MEASURES

PAGE = "arctic.md"
ALL = "All"
BY_OBJECT = {
    "static": ("static_rotation", "static_place"),
    "1-DoF, rotations alone": ("one_dof_rotation",),
    "1-DoF, full pose, axis anywhere": ("free_rotation", "free_place"),
    "1-DoF, full pose, axis at the hand": ("at_hand_rotation", "at_hand_place"),
}
"""Columns of the table by object: measures within grasps."""


def main(folders: list[Path]) -> None:
    """Update the page."""
    for folder in folders:
        with (folder / "summary.csv").open(encoding="utf-8", newline="") as stream:
            page.write(f"{folder.name}-study", section(list(csv.DictReader(stream))), PAGE)


def section(rows: list[dict[str, str]]) -> str:
    """Two tables: errors of the approximations by object, and all measures within grasps and outside them."""
    of = {(row["object"], row["where"], row["measure"]): row for row in rows}
    objects = list(dict.fromkeys(row["object"] for row in rows))
    total = ALL if ALL in objects else objects[0]

    def cell(obj: str, where: str, name: str, spread: bool = False) -> str:
        measure, row = MEASURES[name], of[obj, where, name]
        digits = 1 if measure.unit else 2
        shown = [f"{float(row[key]) * measure.factor:.{digits}f}" for key in ("mean", "std")[: 1 + spread]]
        return " ± ".join(shown) + (f" {measure.unit}" if measure.unit else "")

    by_object = [
        [
            obj,
            of[obj, "inside", "static_rotation"]["grasps"],
            *(", ".join(cell(obj, "inside", n) for n in names) for names in BY_OBJECT.values()),
        ]
        for obj in objects
    ]
    inside_outside = [
        [measure.label, cell(total, "inside", name, True), cell(total, "outside", name, True)]
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
    main([Path(name) for name in sys.argv[1:]])
