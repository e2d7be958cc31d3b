"""Calibrate the probability that a result is right: ``python -m benchmarks.probability OUT DEXYCB YCB [WORKERS]``.

DEXYCB and YCB are the folders of the dataset and of its models. Signs of results go into OUT/results.csv
(``signed_results``); rows that are there are kept, so that an interrupted run goes on where it stopped. After a change
of the method another OUT is to be named. The training part is fitted (``checks/calibrated.py``), the test part is held
against it: docs/checks.md, between the markers "probability", and docs/images/reliability.png.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from textwrap import wrap

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from benchmarks import page
from benchmarks.signed_results import Row, cases, collect
from getagrip.batch.pool import cores
from getagrip.checks.calibration import Calibration
from getagrip.checks.signs import SIGNS
from getagrip.experiments.reliability import auroc, bins, calibration_error, fit_weights, least_error
from getagrip.experiments.stamp import stamp
from getagrip.fitting.options import Options

METHOD = Options().method
SOURCE = Path(__file__).resolve().parents[1] / "src/getagrip/checks/calibrated.py"
SECTION, PICTURE = "probability", "reliability.png"


@dataclass(frozen=True)
class Results:
    """What is known of many results."""

    rows: Sequence[Row]

    @cached_property
    def right(self) -> Bool[ndarray, "n"]:
        """Which are right."""
        return np.array([row["right"] == "1" for row in self.rows])

    @cached_property
    def signs(self) -> Float[ndarray, "n S"]:
        """Their signs."""
        return np.array([[float(row[sign.name]) for sign in SIGNS] for row in self.rows])

    def where(self, **what: str) -> Results:
        """Those with some entries."""
        return Results([row for row in self.rows if all(row[key] == value for key, value in what.items())])

    def probability(self, calibration: Calibration) -> Float[ndarray, "n"]:
        """How probable each is right."""
        by_name = [{sign.name: float(row[sign.name]) for sign in SIGNS} for row in self.rows]
        return np.array([calibration.probability(signs).value for signs in by_name])


def calibrated(train: Results, made: str) -> Calibration:
    """Fitted to the training part."""
    weights, bias = fit_weights(train.signs, train.right, [sign.direction for sign in SIGNS])
    data = (
        f"{len(train.rows)} results of training clips of {' and '.join(of(train, 'dataset'))}, of which "
        f"{100.0 * train.right.mean():.0f} % are right: right inputs, and errors of hands, masks, size and shape"
    )
    return Calibration({sign.name: w for sign, w in zip(SIGNS, weights, strict=True)}, bias, data, made)


def of(results: Results, key: str) -> list[str]:
    """The different entries of a column."""
    return sorted({row[key] for row in results.rows})


def source(calibration: Calibration) -> str:
    """The module that holds the calibration."""
    weights = "\n".join(
        f'            "{name}": Weight({w.weight:.5g}, {w.low:.5g}, {w.high:.5g}),'
        for name, w in calibration.weights.items()
    )
    data = "\n".join(f'            "{part}"' for part in wrap(calibration.data, 90, drop_whitespace=False))
    return f'''"""What signs count; written by ``python -m benchmarks.probability``.

Made {calibration.made}.
"""

from getagrip.checks.calibration import Calibration, Weight

CALIBRATIONS: dict[str, Calibration] = {{
    "{METHOD}": Calibration(
        weights={{
{weights}
        }},
        bias={calibration.bias:.5g},
        data=(
{data}
        ),
        made="{calibration.made}",
    ),
}}
"""By method."""
'''


def section(test: Results, train: Results, calibration: Calibration) -> str:
    """The table for the page."""
    rows = [
        line(f"{dataset}, {condition}", test.where(dataset=dataset, condition=condition), calibration)
        for dataset in of(test, "dataset")
        for condition in of(test.where(dataset=dataset), "condition")
    ]
    rows += [line(f"**{name}**", test.where(dataset=name), calibration) for name in of(test, "dataset")]
    rows.append(line("**all**", test, calibration))
    header = ["test clips", "results", "right, %", "mean probability, %", "AUROC", "ECE", "ECE if it were perfect"]
    minutes = sum(float(row["seconds"]) for row in [*test.rows, *train.rows]) / 60.0
    about = (
        f"*Made {stamp()}; results of {' and '.join(of(Results([*train.rows, *test.rows]), 'made'))}. "
        f"{len(train.rows)} training and {len(test.rows)} test results; reconstructing them took {minutes:.0f} minutes "
        "of one core.*"
    )
    inside = line("in training, all", train, calibration)
    return f"{about}\n\n{page.table(header, [*rows, inside])}\n\n![reliability](images/{PICTURE})"


def line(label: str, results: Results, calibration: Calibration) -> list[str]:
    """A line of the table."""
    p, right = results.probability(calibration), results.right
    area = auroc(p, right)
    shown = "" if np.isnan(area) else f"{area:.2f}"
    errors = [f"{100.0 * x:.0f}" for x in (right.mean(), p.mean())]
    return [label, f"{len(p)}", *errors, shown, f"{calibration_error(p, right):.3f}", f"{least_error(p):.3f}"]


def draw(test: Results, calibration: Calibration, path: Path) -> None:
    """The reliability diagram: share that is right over probability, and how many results have it."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, (upper, lower) = plt.subplots(
        2, 1, figsize=(4.6, 5.4), height_ratios=(3, 1), sharex=True, layout="constrained"
    )
    upper.plot([0, 1], [0, 1], color="0.7", linewidth=1, label="perfect")
    for label, results in ((name, test.where(dataset=name)) for name in of(test, "dataset")):
        found = bins(results.probability(calibration), results.right)
        x, y, n = np.array([(b.probability, b.right, b.count) for b in found]).T
        spread = 1.96 * np.sqrt(np.maximum(x * (1.0 - x), 0.25 / n) / n)
        bars = np.array([np.minimum(spread, y), np.minimum(spread, 1.0 - y)])
        upper.errorbar(x, y, bars, fmt="o-", markersize=4, linewidth=1, capsize=2, label=f"{label}, {int(n.sum())}")
    upper.set(ylabel="share that is right", xlim=(0, 1), ylim=(0, 1.02))
    upper.legend(frameon=False, fontsize=8)
    p, edges = test.probability(calibration), np.linspace(0.0, 1.0, 11)
    lower.hist(
        [p[test.right], p[~test.right]], edges, stacked=True, color=["#2a9d8f", "#c8553d"], label=["right", "wrong"]
    )
    lower.set(xlabel="probability", ylabel="results")
    lower.legend(frameon=False, fontsize=8)
    for axes in (upper, lower):
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main(out: Path, root: Path, meshes: Path, workers: int) -> None:
    """Collect, fit, and put the measurements into the page."""
    report(Results(collect(out / "results.csv", cases(out / "clips", root, meshes), workers)))


def report(rows: Results) -> None:
    """Fit the training part, hold the test part against it, and write both down."""
    train, test = rows.where(part="train"), rows.where(part="test")
    calibration = calibrated(train, stamp())
    SOURCE.write_text(source(calibration), encoding="utf-8")
    subprocess.run(["ruff", "format", "-q", SOURCE], check=True)
    draw(test, calibration, page.DOCS / "images" / PICTURE)
    text = section(test, train, calibration)
    page.write(SECTION, text)
    print(text)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:4]), int(sys.argv[4]) if len(sys.argv) > 4 else cores())
