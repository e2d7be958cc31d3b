"""How often the pose is right, in a table of the README: ``python -m benchmarks.summary``.

It reads the tables that ``benchmarks.results`` has put into docs/results.md.
"""

from __future__ import annotations

import re

from benchmarks import page

COLUMN = "ADD sym."
METHODS = {"soft-hinge": "default", "one-dof": "`one-dof`, after the paper"}
ROWS = {
    "as they are": ("hand-noise", "none"),
    "hands off by 10 mm and 8°": ("hand-noise", "10 mm, 8°"),
    "hands off by more, also in depth and fingers (`strong`, assumed)": ("hand-noise", "strong"),
    "hands off as an estimator's were in images of ARCTIC (`estimated`)": ("hand-noise", "estimated"),
    "masks off by 2 px": ("mask-noise", "2 px"),
    "masks off by 4 px": ("mask-noise", "4 px"),
    "the object's size unknown": ("scale", "free"),
}
"""What is measured, and the section and the setting that it is from."""
MADE = re.compile(r"made (\S+), commit (\w+)")


def main() -> None:
    """Update the README."""
    sections = sorted({section for section, _ in ROWS.values()})
    found = {name: page.numbers("results.md", f"dexycb-{name}", [COLUMN]) for name in sections}
    made = sorted({MADE.findall(page.section("results.md", f"dexycb-{name}"))[0] for name in sections})
    when = " and ".join(f"commit {commit} ({date})" for date, commit in made)
    rows = [
        [label, *(f"{found[section][f'{method}, {setting}'][0]:.0f}" for method in METHODS)]
        for label, (section, setting) in ROWS.items()
    ]
    text = f"{page.table(['input', *METHODS.values()], rows)}\n\nMeasured at {when}."
    page.write("summary", text, "../README.md")
    print(text)


if __name__ == "__main__":
    main()
