"""Calibrate the probability that a result is right: ``python -m benchmarks.probability OUT DEXYCB OTHER YCB ARCTIC
[WORKERS]``.

DEXYCB, OTHER and YCB are the folders of the dataset, of its sequences of the ten other objects, and of its models,
ARCTIC a folder of clips of ARCTIC's motion (docs/datasets.md). Signs of results go into OUT/rows.jsonl
(``signed_results``); rows that are there are kept, so that an interrupted run goes on where it stopped. After a change
of the method another OUT is to be named. All results are fitted (``checks/calibrated.json``), once to what is right in
the hand and once to what is right in the camera. How good that is, and the thresholds of ``checks.keeping`` for
measured hands, come from probabilities by objects left out: each result's is of a fit without any result of its object.
``results/probability-*.json`` and docs/images/reliability.png have it.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, get_args

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from benchmarks import store, test_runs
from benchmarks.kept_rows import ROWS, Row, collect
from benchmarks.reliability import auroc, auroc_interval, bins, calibration_error, fit_weights, least_error
from benchmarks.signed_results import ALWAYS, KEY, OTHER, cases, row
from benchmarks.store import Table
from benchmarks.timing import circumstances
from getagrip.batch.executor import cores
from getagrip.checks.calibrated import ESTIMATED, FILE, KEEPING
from getagrip.checks.calibration import Calibration, Where
from getagrip.checks.keeping import SHARES, InputKind, Keeping, least_kept, least_of_sets
from getagrip.checks.signs import SIGNS
from getagrip.experiments.comparison import resamples
from getagrip.fitting.options import Options
from getagrip.io.code import stamp
from getagrip.probability import HOLDS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

METHOD = Options().method
COMMAND = "python -m benchmarks.probability OUT DEXYCB OTHER YCB ARCTIC"
NUMBERS = re.compile(r'\[[-\d.e,\s]*\]|\{\s*"\d[^{}]*\}')
SECTION, PICTURE = "probability", "reliability.png"
KEPT = 0.95
"""Share of right results that the table keeps for."""
HEADER = (
    "results", "right, %", "mean probability, %", "AUROC", "ECE", "ECE if it were perfect", "kept, %",
    "right of kept, %",
)  # fmt: skip


@dataclass(frozen=True)
class Results:
    """What is known of many results, and where they are to be right."""

    rows: Sequence[Row]
    where: Where = "hand"

    @property
    def right(self) -> Bool[ndarray, "n"]:
        """Which are right."""
        return self.rank == 1.0

    @property
    def rank(self) -> Float[ndarray, "n"]:
        """Which candidate is the first that is right; infinite where none is."""
        return np.array([row["rank"][self.where] or np.inf for row in self.rows])

    @property
    def objects(self) -> ndarray:
        """The object of each."""
        return np.array([row["category"] for row in self.rows])

    @property
    def clips(self) -> int:
        """How many clips they are of."""
        return len({row["clip"] for row in self.rows})

    @property
    def weights(self) -> Float[ndarray, "B n"]:
        """How often each is in each bootstrap resample; results of a clip are drawn together."""
        return resamples([row["clip"] for row in self.rows])

    def only(self, **what: object) -> Results:
        """Those with some entries."""
        return replace(self, rows=[row for row in self.rows if all(row[key] == value for key, value in what.items())])

    def without(self, category: str) -> Results:
        """Those of other objects."""
        return replace(self, rows=[row for row in self.rows if row["category"] != category])

    def fitted(self, made: str) -> Calibration:
        """Fit the weights of the signs."""
        signs = np.array([[row["signs"][sign.name] for sign in SIGNS] for row in self.rows])
        weights, bias = fit_weights(signs, self.right, [sign.direction for sign in SIGNS])
        data = (
            f"{len(self.rows)} results of {self.clips} clips of {len({*self.objects.tolist()})} objects of "
            f"{' and '.join(of(self, 'dataset'))}, of which {100.0 * self.right.mean():.0f} % are right: right inputs, "
            "and errors of hands, masks, size and shape"
        )
        by_sign = {sign.name: weight for sign, weight in zip(SIGNS, weights, strict=True)}
        return Calibration(self.where, by_sign, bias, data, made)

    def probability(self, calibration: Calibration) -> Float[ndarray, "n"]:
        """Compute the probability of each."""
        return np.array([calibration.probability(row["signs"]).value for row in self.rows])

    def without_own_object(self) -> Float[ndarray, "n"]:
        """Compute the probability of each by a fit without its own object."""
        of, out = self.objects, np.empty(len(self.rows))
        for category in dict.fromkeys(of.tolist()):
            out[of == category] = self.only(category=category).probability(self.without(category).fitted(""))
        return out

    def keeping(self, probability: Float[ndarray, "n"]) -> Keeping:
        """Choose the thresholds."""
        least = {share: least_kept(probability, self.right, share) for share in SHARES}
        sets = least_of_sets(probability, self.rank, HOLDS)
        return Keeping({share: p for share, p in least.items() if np.isfinite(p)}, sets)


@dataclass(frozen=True)
class Judged:
    """Results with probabilities by objects left out, and which of them are kept by thresholds of the other objects."""

    results: Results
    probability: Float[ndarray, "n"]
    kept: Bool[ndarray, "n"]

    def only(self, **what: object) -> Judged:
        """Those with some entries."""
        some = np.array([all(row[key] == value for key, value in what.items()) for row in self.results.rows])
        return Judged(self.results.only(**what), self.probability[some], self.kept[some])


def judged(results: Results) -> Judged:
    """Hold every result against other objects: fits and thresholds of the others, whose fits have no part of it."""
    p, kept = np.empty(len(results.rows)), np.zeros(len(results.rows), dtype=bool)
    for category in dict.fromkeys(results.objects.tolist()):
        own, others = results.objects == category, results.without(category)
        p[own] = results.only(category=category).probability(others.fitted(""))
        least = thresholds(others, others.without_own_object()).least.get(KEPT, np.inf)
        kept[own] = p[own] >= least
    return Judged(results, p, kept)


def thresholds(results: Results, probability: Float[ndarray, "n"]) -> Keeping:
    """The least probabilities that hold with exact hands and at each level of errors of hands (``ALWAYS``)."""
    kinds = np.array([row["condition"] for row in results.rows])
    each = [results.only(condition=kind).keeping(probability[kinds == kind]) for kind in ALWAYS]
    shares = [share for share in SHARES if all(share in one.least for one in each)]
    return Keeping(
        {share: max(one.least[share] for one in each) for share in shares}, results.keeping(probability).sets
    )


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


def write(file: Path, keeping: Mapping[tuple[InputKind, Where], Keeping] | None = None, **parts: object) -> None:
    """Replace parts of ``calibrated.json``, of the thresholds those of some inputs; lists of numbers take a line."""
    record = json.loads(file.read_text(encoding="utf-8"))
    new = {
        key: {part: {f"{n}": float(f"{p:.4g}") for n, p in least.items()} for part, least in vars(one).items()}
        for key, one in (keeping or {}).items()
    }
    before = {(one["input"], one["where"]): {"least": one["least"], "sets": one["sets"]} for one in record["keeping"]}
    listed = [{"input": kind, "where": where} | least for (kind, where), least in (before | new).items()]
    text = json.dumps(record | parts | {"keeping": listed}, indent=1)
    file.write_text(NUMBERS.sub(lambda one: " ".join(one[0].split()), text) + "\n", encoding="utf-8")


def tables(
    rows: Sequence[Row], held: Mapping[Where, Judged], calibrations: Mapping[Where, Calibration]
) -> dict[str, Table]:
    """One for right in the hand, one for right in the camera."""
    every = Results(rows)
    about = (
        f"results of {' and '.join(of(every, 'made'))}: {len(rows)} of {every.clips} clips of "
        f"{len({*every.objects.tolist()})} objects; reconstructing them took "
        f"{sum(row['seconds'] for row in rows) / 60.0:.0f} minutes of one core",
        "each probability by a fit without its object, kept by thresholds of the others; intervals: 95 %, clips drawn "
        "together",
        left_out(every),
    )
    out = {}
    for where, one in held.items():
        estimated = replace(
            one.results, rows=[row for row in rows if row["kind"] == "estimated" and not row["serious"]]
        )
        lines = [*_lines(one, calibrations[where]), *_of_estimated(estimated)]
        title = f"Probability that a result is right in the {where}, by objects left out"
        out[f"{SECTION}-{where}"] = store.of_cells(title, ("", *HEADER), lines, about)
    return out


def _lines(held: Judged, calibration: Calibration) -> Iterator[list[str]]:
    """By condition, the most important first; by dataset; all, and all with their own object in the fit."""
    conditions = of(held.results, "condition")
    for condition in (*ALWAYS, *(each for each in conditions if each not in ALWAYS)):
        yield line(condition, held.only(condition=condition))
    for dataset in of(held.results, "dataset"):
        yield total(dataset, held.only(dataset=dataset))
    yield total("all", held)
    yield total("all, own object in the fit", replace(held, probability=held.results.probability(calibration)))


def _of_estimated(results: Results) -> Iterator[list[str]]:
    """Estimated hands, which have a probability of their own, of the objects that have no part in it."""
    others = results.only(dataset=OTHER)
    if others.rows:
        p = others.probability(ESTIMATED[METHOD, results.where])
        least = KEEPING["estimated", results.where].least.get(KEPT, np.inf)
        yield line("estimated hands, by their own calibration", Judged(others, p, p >= least))


def total(label: str, held: Judged) -> list[str]:
    """A line that sums up others, with the interval of the AUROC."""
    low, high = auroc_interval(held.probability, held.results.right, held.results.weights)
    cells = line(label, held)
    cells[1 + HEADER.index("AUROC")] += f" [{low:.2f}, {high:.2f}]"
    return cells


def line(label: str, held: Judged) -> list[str]:
    """A line of the table."""
    p, right, kept = held.probability, held.results.right, held.kept
    area = auroc(p, right)
    return [
        label, f"{len(p)}", *(f"{100.0 * x:.0f}" for x in (right.mean(), p.mean())),
        "" if np.isnan(area) else f"{area:.2f}", f"{calibration_error(p, right):.3f}", f"{least_error(p):.3f}",
        f"{100.0 * kept.mean():.0f}", f"{100.0 * right[kept].mean():.1f}" if kept.any() else "",
    ]  # fmt: skip


def draw(held: Mapping[Where, Judged], path: Path) -> None:
    """The reliability diagrams: share that is right over probability, and how many results have it."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(
        2, len(held), figsize=(4.2 * len(held), 5.4), height_ratios=(3, 1), sharex=True, sharey="row",
        layout="constrained", squeeze=False,
    )  # fmt: skip
    for column, (where, one) in zip(panels.T, held.items(), strict=True):
        _diagram(*column, one)
        column[0].set_title(f"right in the {where}", loc="left", fontsize=10)
    panels[0, 0].set_ylabel("share that is right")
    panels[1, 0].set_ylabel("results")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _diagram(upper: Axes, lower: Axes, held: Judged) -> None:
    """One frame's."""
    upper.plot([0, 1], [0, 1], color="0.7", linewidth=1, label="perfect")
    for label, some in ((name, held.only(condition=name)) for name in ALWAYS):
        found = bins(some.probability, some.results.right)
        x, y, n = np.array([(b.probability, b.right, b.count) for b in found]).T
        spread = 1.96 * np.sqrt(np.maximum(x * (1.0 - x), 0.25 / n) / n)
        bars = np.array([np.minimum(spread, y), np.minimum(spread, 1.0 - y)])
        upper.errorbar(x, y, bars, fmt="o-", markersize=4, linewidth=1, capsize=2, label=f"{label}, {int(n.sum())}")
    upper.set(xlim=(0, 1), ylim=(0, 1.02))
    p, right = held.probability, held.results.right
    lower.hist(
        [p[right], p[~right]], list(np.linspace(0.0, 1.0, 11)), stacked=True, color=["#2a9d8f", "#c8553d"],
        label=["right", "wrong"],
    )  # fmt: skip
    lower.set(xlabel="probability")
    for axes in (upper, lower):
        axes.legend(frameon=False, fontsize=8)
        axes.spines[["top", "right"]].set_visible(False)


def left_out(every: Results) -> str:
    """How many results have no probability, since a finding is serious, and how many of these are right."""
    flagged = replace(every, rows=[row for row in every.rows if row["serious"]])
    right = f"{flagged.right.sum()} of them right in the hand"
    return f"a finding was serious for {len(flagged.rows)} of them, {right}: these have no probability"


def main(out: Path, root: Path, other: Path, meshes: Path, arctic: Path, workers: int) -> None:
    """Collect, fit, and put the measurements into the page."""
    every = cases(out, root, other, meshes, arctic)
    if {OTHER} & {case.dataset for case in every} and not test_runs.noted(SECTION, test_runs.commit()):
        test_runs.note(SECTION, COMMAND)
    wanted = {case.key for case in every}
    rows = collect(out / ROWS, every, KEY, row, workers)
    report([row for row in rows if tuple(row[key] for key in KEY) in wanted])


def report(rows: Sequence[Row]) -> None:
    """Fit all results of measured hands, hold them against fits without their objects, and write both down.

    Results with a serious finding have no probability, and are no part of it.
    """
    used, made = [row for row in rows if row["kind"] == "measured" and not row["serious"]], stamp()
    calibrations = {where: Results(used, where).fitted(made) for where in get_args(Where)}
    held = {where: judged(Results(used, where)) for where in get_args(Where)}
    keeping = {("measured", where): thresholds(one.results, one.probability) for where, one in held.items()}
    write(FILE, keeping, measured=stored(calibrations.values()))
    draw(held, store.ROOT / "docs/images" / PICTURE)
    how = circumstances(COMMAND)
    for name, table in tables(rows, held, calibrations).items():
        print(store.write(name, replace(table, made=how)))


if __name__ == "__main__":
    if len(sys.argv) < 6:
        sys.exit(__doc__)
    main(*map(Path, sys.argv[1:6]), int(sys.argv[6]) if len(sys.argv) > 6 else cores())
