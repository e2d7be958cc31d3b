"""Fit the probability again without a dataset: ``python -m benchmarks.left_out OUT DEXYCB YCB [WORKERS]``.

OUT, DEXYCB and YCB are those of ``benchmarks.probability``, whose results are used, or made. Each dataset's test part
is held against the fit to all training parts, and to those of the others: ``results/probability-left-out.json``. ARCTIC
is in them by errors of hands and motion of objects that were measured there. Other constants that a command fits do not
change with a dataset: docs/leaderboard.md lists them.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

from benchmarks import store
from benchmarks.probability import HEADER, RIGHT, Results, calibrated, of, total
from benchmarks.signed_results import Row, cases, collect
from benchmarks.store import Table
from benchmarks.timing import circumstances
from getagrip.batch.executor import cores

FITS = "fitted to all", "fitted without it"
ARCTIC = "ARCTIC"
OF_ARCTIC = "estimated", "measured"
"""Conditions with what was measured on ARCTIC: errors of hands, motion of objects (``datasets.synthetic.noise``)."""


def left_out(rows: Results) -> Table:
    """Each dataset's test part by both fits, for right in the hand and in the camera."""
    lines = []
    for where in RIGHT:
        train, test = (rows.only(part=part).rows for part in ("train", "validation"))
        for dataset in (*of(rows, "dataset"), ARCTIC):
            its, others = [row for row in test if _is_of(row, dataset)], [r for r in train if not _is_of(r, dataset)]
            for words, data in zip(FITS, (train, others), strict=True):
                label = f"{dataset}, in the {where}, {words}"
                lines.append(total(label, Results(its, where), calibrated(Results(data, where), "")))
    return store.of_cells("The probability, fitted with a dataset and without it", HEADER, lines)


def _is_of(row: Row, dataset: str) -> bool:
    return row["condition"] in OF_ARCTIC if dataset == ARCTIC else row["dataset"] == dataset


def main(out: Path, root: Path, meshes: Path, workers: int) -> None:
    """Collect, fit again, and write the table."""
    rows = Results(collect(out / "results.csv", cases(out / "clips", root, meshes), workers)).only(serious="0")
    made = circumstances("python -m benchmarks.left_out OUT DEXYCB YCB")
    print(store.write("probability-left-out", replace(left_out(rows), made=made)))


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:4]), int(sys.argv[4]) if len(sys.argv) > 4 else cores())
