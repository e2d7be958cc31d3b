"""What the probabilities of a bench's results are worth: ``python -m benchmarks.bench_probability DIR``.

DIR is a folder that was given to ``bench --out`` and is named like the dataset: the table goes into docs/arctic.md,
between the markers "<name>-probability". It is made from ``methods-clips.csv``, whatever the results were made of.
"""

from __future__ import annotations

import csv
import sys
from itertools import product
from pathlib import Path

import numpy as np

from benchmarks import page
from benchmarks.reliability import auroc, calibration_error, least_error
from getagrip.experiments.stamp import stamp

RIGHT = (
    ("in the hand", "add_sym_success", "probability_right"),
    ("in the camera", "add_sym_cam_success", "probability_right_in_camera"),
    ("in the camera, by the probability in the hand", "add_sym_cam_success", "probability_right"),
)
"""What may be right, the column that says so, and that of the probability, which older tables lack."""
HEADS = ("", "results", "right, %", "mean probability, %", "AUROC", "ECE", "ECE if it were perfect")


def main(folder: Path) -> None:
    """Update the page."""
    with (folder / "methods-clips.csv").open(encoding="utf-8", newline="") as lines:
        every = list(csv.DictReader(lines))
    rows = []
    for method, (where, column, estimate) in product(sorted({row["method"] for row in every}), RIGHT):
        of_method = [row for row in every if row["method"] == method and row[column] and row.get(estimate)]
        if not of_method:
            continue
        probability = np.array([float(row[estimate]) for row in of_method])
        right = np.array([float(row[column]) == 1.0 for row in of_method])
        shares = (f"{100.0 * right.mean():.0f}", f"{100.0 * probability.mean():.0f}")
        errors = (f"{error:.3f}" for error in (calibration_error(probability, right), least_error(probability)))
        count, area = str(len(of_method)), f"{auroc(probability, right):.2f}"
        rows.append((f"{method}, {where}", count, *shares, area, *errors))
    page.write(f"{folder.name}-probability", f"*Made {stamp()}.*\n\n{page.table(HEADS, rows)}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
