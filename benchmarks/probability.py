"""Calibrate the probabilities that a result is right: ``python -m benchmarks.probability OUT DEXYCB YCB [WORKERS]``.

DEXYCB and YCB are the folders of the dataset and of its models. Signs of results go into OUT/rows.jsonl
(``signed_results``); rows that are there are kept, so that an interrupted run goes on where it stopped. After a change
of the method another OUT is to be named. The training part is fitted (``checks/calibrated.json``), once to what is
right in the hand and once to what is right in the camera; the test part is held against it:
``results/probability-*.json`` and docs/images/reliability.png.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, get_args

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from benchmarks import store
from benchmarks.kept_rows import ROWS, Row, collect
from benchmarks.reliability import auroc, auroc_interval, bins, calibration_error, fit_weights, least_error
from benchmarks.signed_results import KEY, cases, row
from benchmarks.store import Table
from benchmarks.timing import circumstances
from getagrip.batch.executor import cores
from getagrip.checks.calibrated import FILE
from getagrip.checks.calibration import Calibration, Where
from getagrip.checks.signs import SIGNS
from getagrip.experiments.comparison import resamples
from getagrip.fitting.options import Options
from getagrip.io.code import stamp

if TYPE_CHECKING:
    from matplotlib.axes import Axes

METHOD = Options().method
NUMBERS = re.compile(r'\[[-\d.e,\s]*\]|\{\s*"\d[^{}]*\}')
SECTION, PICTURE = "probability", "reliability.png"
HEADER = ("test clips", "results", "right, %", "mean probability, %", "AUROC", "ECE", "ECE if it were perfect")


@dataclass(frozen=True)
class Results:
    """What is known of many results."""

    rows: Sequence[Row]
    where: Where = "hand"
    """The frame in which they are right or not."""

    @cached_property
    def right(self) -> Bool[ndarray, "n"]:
        """Which are right."""
        return np.array([row["right"][self.where] for row in self.rows])

    @cached_property
    def signs(self) -> Float[ndarray, "n S"]:
        """Their signs."""
        return np.array([[row["signs"][sign.name] for sign in SIGNS] for row in self.rows])

    def only(self, **what: object) -> Results:
        """Those with some entries."""
        rows = [row for row in self.rows if all(row[key] == value for key, value in what.items())]
        return Results(rows, self.where)

    def probability(self, calibration: Calibration) -> Float[ndarray, "n"]:
        """How probable each is right."""
        return np.array([calibration.probability(row["signs"]).value for row in self.rows])


def calibrated(train: Results, made: str) -> Calibration:
    """Fitted to the training part."""
    weights, bias = fit_weights(train.signs, train.right, [sign.direction for sign in SIGNS])
    data = (
        f"{len(train.rows)} results of training clips of {' and '.join(of(train, 'dataset'))}, of which "
        f"{100.0 * train.right.mean():.0f} % are right: right inputs, and errors of hands, masks, size and shape"
    )
    return Calibration(train.where, {sign.name: w for sign, w in zip(SIGNS, weights, strict=True)}, bias, data, made)


def of(results: Results, key: str) -> list[str]:
    """The different entries of a column."""
    return sorted({row[key] for row in results.rows})


def stored(calibrations: Iterable[Calibration]) -> dict[str, object]:
    """The calibrations as ``calibrated.json`` holds them."""

    def short(*numbers: float) -> list[float]:
        return [float(f"{number:.5g}") for number in numbers]

    return {
        METHOD: [
            asdict(one)
            | {"bias": short(one.bias)[0], "weights": {name: short(*astuple(w)) for name, w in one.weights.items()}}
            for one in calibrations
        ]
    }


def write(file: Path, **parts: object) -> None:
    """Replace parts of ``calibrated.json``; lists of numbers take a line."""
    text = json.dumps(json.loads(file.read_text(encoding="utf-8")) | parts, indent=1)
    file.write_text(NUMBERS.sub(lambda one: " ".join(one[0].split()), text) + "\n", encoding="utf-8")


def tables(rows: Results, calibrations: Mapping[Where, Calibration], flagged: Results) -> dict[str, Table]:
    """One for right in the hand, one for right in the camera."""
    train, test = rows.only(part="train"), rows.only(part="validation")
    minutes = sum(row["seconds"] for row in rows.rows) / 60.0
    about = (
        f"results of {' and '.join(of(rows, 'made'))}: {len(train.rows)} training and {len(test.rows)} test results; "
        f"reconstructing them took {minutes:.0f} minutes of one core"
    )
    return {
        f"{SECTION}-{where}": replace(
            table(Results(test.rows, where), Results(train.rows, where), calibration),
            notes=(about, left_out(flagged)),
        )
        for where, calibration in calibrations.items()
    }


def table(test: Results, train: Results, calibration: Calibration) -> Table:
    """One calibration's."""
    rows = [
        line(f"{dataset}, {condition}", test.only(dataset=dataset, condition=condition), calibration)
        for dataset in of(test, "dataset")
        for condition in of(test.only(dataset=dataset), "condition")
    ]
    rows += [total(name, test.only(dataset=name), calibration) for name in of(test, "dataset")]
    rows += [total("all", test, calibration), total("in training, all", train, calibration)]
    return store.of_cells(f"Probability that a result is right in the {test.where}", HEADER, rows)


def total(label: str, results: Results, calibration: Calibration) -> list[str]:
    """A line of the table that sums up others, with the interval of the AUROC; results of a clip are drawn together."""
    weights = resamples([f"{row['dataset']}, {row['clip']}" for row in results.rows])
    low, high = auroc_interval(results.probability(calibration), results.right, weights)
    cells = line(label, results, calibration)
    cells[HEADER.index("AUROC")] += f" [{low:.2f}, {high:.2f}]"
    return cells


def line(label: str, results: Results, calibration: Calibration) -> list[str]:
    """A line of the table."""
    p, right = results.probability(calibration), results.right
    area = auroc(p, right)
    shown = "" if np.isnan(area) else f"{area:.2f}"
    errors = [f"{100.0 * x:.0f}" for x in (right.mean(), p.mean())]
    return [label, f"{len(p)}", *errors, shown, f"{calibration_error(p, right):.3f}", f"{least_error(p):.3f}"]


def draw(test: Results, calibrations: Mapping[Where, Calibration], path: Path) -> None:
    """The reliability diagrams: share that is right over probability, and how many results have it."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(
        2, len(calibrations), figsize=(4.2 * len(calibrations), 5.4), height_ratios=(3, 1), sharex=True, sharey="row",
        layout="constrained", squeeze=False,
    )  # fmt: skip
    for column, (where, calibration) in zip(panels.T, calibrations.items(), strict=True):
        _diagram(*column, Results(test.rows, where), calibration)
        column[0].set_title(f"right in the {where}", loc="left", fontsize=10)
    panels[0, 0].set_ylabel("share that is right")
    panels[1, 0].set_ylabel("results")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _diagram(upper: Axes, lower: Axes, test: Results, calibration: Calibration) -> None:
    """One calibration's."""
    upper.plot([0, 1], [0, 1], color="0.7", linewidth=1, label="perfect")
    for label, results in ((name, test.only(dataset=name)) for name in of(test, "dataset")):
        found = bins(results.probability(calibration), results.right)
        x, y, n = np.array([(b.probability, b.right, b.count) for b in found]).T
        spread = 1.96 * np.sqrt(np.maximum(x * (1.0 - x), 0.25 / n) / n)
        bars = np.array([np.minimum(spread, y), np.minimum(spread, 1.0 - y)])
        upper.errorbar(x, y, bars, fmt="o-", markersize=4, linewidth=1, capsize=2, label=f"{label}, {int(n.sum())}")
    upper.set(xlim=(0, 1), ylim=(0, 1.02))
    p, edges = test.probability(calibration), np.linspace(0.0, 1.0, 11)
    lower.hist(
        [p[test.right], p[~test.right]], edges, stacked=True, color=["#2a9d8f", "#c8553d"], label=["right", "wrong"]
    )
    lower.set(xlabel="probability")
    for axes in (upper, lower):
        axes.legend(frameon=False, fontsize=8)
        axes.spines[["top", "right"]].set_visible(False)


def left_out(flagged: Results) -> str:
    """How many results have no probability, since a finding is serious, and how many of these are right."""
    counts = [
        f"{len(some.rows)} of the {part} results, {some.right.sum()} of them right in the hand"
        for part in ("training", "validation")
        for some in [flagged.only(part=part.removesuffix("ing"))]
    ]
    return f"A finding was serious for {', and for '.join(counts)}: these have no probability."


def main(out: Path, root: Path, meshes: Path, workers: int) -> None:
    """Collect, fit, and put the measurements into the page."""
    report(Results(collect(out / ROWS, cases(out / "clips", root, meshes), KEY, row, workers)))


def report(rows: Results) -> None:
    """Fit the training part, hold the test part against it, and write both down.

    Results with a serious finding have no probability, and are no part of either.
    """
    flagged, rows = rows.only(serious=True), rows.only(serious=False)
    train, made = rows.only(part="train"), stamp()
    calibrations = {where: calibrated(Results(train.rows, where), made) for where in get_args(Where)}
    write(FILE, measured=stored(calibrations.values()))
    draw(rows.only(part="validation"), calibrations, store.ROOT / "docs/images" / PICTURE)
    how = circumstances("python -m benchmarks.probability OUT DEXYCB YCB")
    for name, made_table in tables(rows, calibrations, flagged).items():
        print(store.write(name, replace(made_table, made=how)))


if __name__ == "__main__":
    if len(sys.argv) < 4:
        sys.exit(__doc__)
    main(*map(Path, sys.argv[1:4]), int(sys.argv[4]) if len(sys.argv) > 4 else cores())
