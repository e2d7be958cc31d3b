"""How often the pose is right, in a table of the README and two of docs/results.md: ``python -m benchmarks.summary``.

It reads the tables that ``benchmarks.results`` has put into the pages.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np

from benchmarks import page

COLUMN, IN_CAMERA = "ADD sym.", "right in the camera, %"
METHODS = {"soft-hinge": "default", "one-dof": "`one-dof`, after the paper"}
INPUTS = {
    "as they are": ("dexycb-hand-noise", "none"),
    "hands off by 10 mm and 8°": ("dexycb-hand-noise", "10 mm, 8°"),
    "hands off by more, also in depth and fingers (`strong`, assumed)": ("dexycb-hand-noise", "strong"),
    "hands off as an estimator's were in images of ARCTIC (`estimated`)": ("dexycb-hand-noise", "estimated"),
    "masks off by 2 px": ("dexycb-mask-noise", "2 px"),
    "masks off by 4 px": ("dexycb-mask-noise", "4 px"),
    "masks of something else in one frame of five": ("dexycb-wrong-masks", "another object in 20 %, checked"),
    "the object's size unknown": ("dexycb-scale", "free"),
    "a mesh that is only of the object's kind": ("dexycb-other-mesh", "of its kind, fitted"),
    "the same, size unknown, hands off (`moderate`, assumed)": (
        "dexycb-other-mesh",
        "of its kind, size unknown, hands moderate, fitted",
    ),
}
"""What is measured, and the section and the setting that it is from."""
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
    inputs = inputs_table()
    for name, text in {"summary": inputs, "summary-inputs": inputs, "summary-methods": methods_table()}.items():
        page.write(name, text)
        print(text, end="\n\n")


def inputs_table() -> str:
    """Two methods, in the hand and in the camera, with a row for each kind of input."""
    sections = dict.fromkeys(section for section, _ in INPUTS.values())
    in_hand, in_camera = numbers(sections, COLUMN), numbers(sections, IN_CAMERA)
    rows = [
        [
            label,
            *(shown(found[section], f"{method}, {setting}") for found in (in_hand, in_camera) for method in METHODS),
        ]
        for label, (section, setting) in INPUTS.items()
    ]
    header = ["input", *METHODS.values(), "default, in the camera", "`one-dof`, in the camera"]
    return f"{page.table(header, rows)}\n\n{measured(sections)}"


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
