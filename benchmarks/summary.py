"""How often the pose is right, in tables of README and docs/results.md: ``python -m benchmarks.summary``.

It reads the tables that ``benchmarks.results`` has put into the pages.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np

from benchmarks import page

COLUMN, IN_CAMERA = "ADD sym.", "right in the camera, %"
ONE_DOF = "`one-dof`, same filters"
VALIDATION = {"soft-hinge": "default", "one-dof": ONE_DOF, "paper": "`paper`"}
"""The methods of the table of ``INPUTS``."""
TEST = {"soft-hinge": "default", "one-dof": ONE_DOF, "contact-consistency": "`contact-consistency`"}
"""The methods of the table of the test objects."""
INPUTS = {
    "exact": "as they are",
    "10 mm, 8°": "hands off by 10 mm and 8°",
    "strong": "hands off by more, also in depth and fingers (`strong`, assumed)",
    "estimated": "hands off as an estimator's were in images of ARCTIC (`estimated`)",
    "masks off by 2 px": "masks off by 2 px",
    "masks off by 4 px": "masks off by 4 px",
    "another object in 20 %": "masks of something else in one frame of five",
    "size unknown": "the object's size unknown",
    "of its kind": "a mesh that is only of the object's kind",
    "of its kind, size unknown, hands moderate": "the same, size unknown, hands off (`moderate`, assumed)",
}
"""Settings of the ablations ``inputs`` and ``final``, in words."""
CLIPS = {
    "DexYCB": "dexycb-methods",
    "ARCTIC": "arctic-methods",
    "synthetic": "synthetic-methods",
    "`moderate`": "synthetic-moderate-methods",
    "`strong`": "synthetic-strong-methods",
    "`wild`": "synthetic-wild-methods",
    "`measured`": "synthetic-measured-methods",
}
"""On what methods are compared, and the section that it is from."""
MADE = re.compile(r"made (\S+), commit (\w+)")
COUNT = re.compile(r"^All: (\d+) clips", re.MULTILINE)

Numbers = dict[str, dict[str, tuple[float, ...]]]


def main() -> None:
    """Update the pages."""
    test, validation = inputs_table("dexycb-other-final", TEST), inputs_table("dexycb-inputs", VALIDATION)
    tables = {"summary-test": test, "summary": validation, "summary-inputs": validation}
    for name, text in {**tables, "summary-methods": methods_table()}.items():
        page.write(name, text)
        print(text, end="\n\n")


def inputs_table(section: str, methods: dict[str, str]) -> str:
    """Methods, in the hand and in the camera, with a row for each kind of input."""
    found = [page.numbers(section, [column]) for column in (COLUMN, IN_CAMERA)]
    count = COUNT.findall(page.section(section))[0]
    rows = [
        [label, count, *(shown(numbers, f"{method}, {setting}") for numbers in found for method in methods)]
        for setting, label in INPUTS.items()
        if any(row.endswith(f", {setting}") for row in found[0])
    ]
    header = ["input", "clips", *methods.values(), *(f"{name}, in the camera" for name in methods.values())]
    return f"{page.table(header, rows)}\n\n{measured([section])}"


def shown(found: dict[str, tuple[float, ...]], row: str) -> str:
    """The number of a row; a dash where there is none."""
    value = found.get(row, (np.nan,))[0]
    return "–" if np.isnan(value) else f"{value:.0f}"


def methods_table() -> str:
    """All methods, with a column for each set of clips."""
    found = numbers(CLIPS.values(), COLUMN)
    rows = [
        [f"`{method}`", *(f"{found[section][method][0]:.1f}" for section in CLIPS.values())]
        for method in found[CLIPS["DexYCB"]]
    ]
    rows.append(["clips", *(COUNT.findall(page.section(section))[0] for section in CLIPS.values())])
    return f"{page.table(['', *CLIPS], rows)}\n\n{measured(found)}"


def numbers(sections: Iterable[str], column: str) -> Numbers:
    """A column of each section, by the rows' labels."""
    return {section: page.numbers(section, [column]) for section in dict.fromkeys(sections)}


def measured(sections: Iterable[str]) -> str:
    """At which commits, in a sentence."""
    made = sorted({MADE.findall(page.section(section))[0] for section in sections})
    return f"Measured at {', '.join(f'commit {commit} ({date})' for date, commit in made)}."


if __name__ == "__main__":
    main()
