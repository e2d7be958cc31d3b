"""The paper's results on ARCTIC beside ours, as a table of docs/arctic.md: ``python -m benchmarks.beside_paper``.

It reads the tables that ``benchmarks.results`` has put into the pages.
"""

from __future__ import annotations

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
TO_THE_LETTER = {"one-dof": "paper", "static": "paper-static", "dynamic": "paper-dynamic"}
"""The paper's own methods, as it states them."""
ARCTIC, DEXYCB = "arctic-methods", "dexycb-methods"


def main() -> None:
    """Update the page."""
    arctic, dexycb = page.numbers(ARCTIC, COLUMNS), page.numbers(DEXYCB, COLUMNS)
    rows = []
    for method, printed in PAPER.items():
        found = {"ARCTIC, the paper": printed}
        if method in TO_THE_LETTER:
            found["ARCTIC's motion, here, to the letter"] = arctic[TO_THE_LETTER[method]]
        found |= {"ARCTIC's motion, here": arctic[method], "DexYCB": dexycb[method]}
        rows += [[f"{method}, {label}", *(f"{value:.1f}" for value in values)] for label, values in found.items()]
    page.write(
        "beside-paper",
        f"*Put here {stamp()}, from the other tables.*\n\n{page.table(['', *COLUMNS], rows)}",
    )


if __name__ == "__main__":
    main()
