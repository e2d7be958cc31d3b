"""How often the pose is right, in a table of the README and two of docs/results.md: ``python -m benchmarks.summary``.

It reads the tables that ``benchmarks.results`` has put into the pages.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from benchmarks import page

COLUMN = "ADD sym."
METHODS = {"soft-hinge": "default", "one-dof": "`one-dof`, after the paper"}
INPUTS = {
    "as they are": ("dexycb-hand-noise", "none"),
    "hands off by 10 mm and 8°": ("dexycb-hand-noise", "10 mm, 8°"),
    "hands off by more, also in depth and fingers (`strong`, assumed)": ("dexycb-hand-noise", "strong"),
    "hands off as an estimator's were in images of ARCTIC (`estimated`)": ("dexycb-hand-noise", "estimated"),
    "masks off by 2 px": ("dexycb-mask-noise", "2 px"),
    "masks off by 4 px": ("dexycb-mask-noise", "4 px"),
    "the object's size unknown": ("dexycb-scale", "free"),
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
    """Two methods, with a row for each kind of input."""
    found = numbers(section for section, _ in INPUTS.values())
    rows = [
        [label, *(f"{found[section][f'{method}, {setting}'][0]:.0f}" for method in METHODS)]
        for label, (section, setting) in INPUTS.items()
    ]
    return f"{page.table(['input', *METHODS.values()], rows)}\n\n{measured(found)}"


def methods_table() -> str:
    """All methods, with a column for each set of clips."""
    found = numbers(CLIPS.values())
    rows = [
        [f"`{method}`", *(f"{found[section][method][0]:.1f}" for section in CLIPS.values())]
        for method in found[CLIPS["DexYCB"]]
    ]
    rows.append(["clips", *(COUNT.findall(page.section(section))[0] for section in CLIPS.values())])
    return f"{page.table(['', *CLIPS], rows)}\n\n{measured(found)}"


def numbers(sections: Iterable[str]) -> Numbers:
    """The column of each section, by the rows' labels."""
    return {section: page.numbers(section, [COLUMN]) for section in dict.fromkeys(sections)}


def measured(sections: Iterable[str]) -> str:
    """At which commits, in a sentence."""
    made = sorted({MADE.findall(page.section(section))[0] for section in sections})
    return f"Measured at {', '.join(f'commit {commit} ({date})' for date, commit in made)}."


if __name__ == "__main__":
    main()
