"""Calibrate the probability that a result is right: ``python -m benchmarks.probability OUT DEXYCB OTHER YCB ARCTIC
[WORKERS]``.

DEXYCB, OTHER and YCB are the folders of the dataset, of its sequences of the ten other objects, and of its models,
ARCTIC a folder of clips of ARCTIC's motion (docs/datasets.md). Features of results go into OUT/rows.jsonl
(``signed_results``); existing rows are kept, so an interrupted run continues; a changed method needs another OUT. Two
fits to all results, for poses right in the hand and in the camera, go into ``checks/calibrated.json``. Its scores
(``results/probability-*.json``, docs/images/reliability.png), and the thresholds of ``checks.calibration`` for measured
hands, come from cross-validation by objects: each result's probability is from a fit without its object.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from benchmarks import store, test_runs
from benchmarks.kept_rows import ROWS, Row, collect
from benchmarks.reliability import auroc, auroc_interval, bins, calibration_error, fit_weights, least_error
from benchmarks.signed_results import ALWAYS, KEY, OTHER, cases, row
from benchmarks.store import Table
from benchmarks.timing import circumstances
from getagrip.batch.executor import available_cores
from getagrip.bench.comparison import bootstrap_resamples
from getagrip.checks.calibration import (
    CALIBRATION_FILE,
    ESTIMATED_CALIBRATIONS,
    KEEP_SHARES,
    KEEP_THRESHOLDS,
    POSE_FRAMES,
    Calibration,
    InputKind,
    KeepThresholds,
    Where,
    candidate_set_thresholds,
    keep_threshold,
)
from getagrip.checks.features import CORRECTED_FEATURES, ESTIMATED_FEATURES, FEATURES, Feature
from getagrip.fitting.options import Options
from getagrip.io.plugins import date_and_commit
from getagrip.result.findings import CANDIDATE_SET_COVERAGE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

METHOD = Options().method
COMMAND = "python -m benchmarks.probability OUT DEXYCB OTHER YCB ARCTIC"
NUMBERS = re.compile(r'\[[-\d.e,\s]*\]|\{\s*"\d[^{}]*\}')
SECTION, PICTURE, DRAWN_BINS = "probability", "reliability.png", 5
"""Name of the section and of the picture, and the number of its bins: ten hold a handful of results each below 0.8."""
KEPT = 0.95
"""Share of right results at which the table keeps."""
HEADER = (
    "results", "right, %", "mean probability, %", "AUROC", "ECE", "ECE if it were perfect", "kept, %",
    "right of kept, %",
)  # fmt: skip
RESERVE = 0.2
"""Fraction of a threshold's allowed errors kept in reserve for objects outside the calibration."""
FEWEST = 50
"""Minimum number of results for a threshold."""
RIDGE = 10.0
"""Ridge of ``fit_weights``; 3, as for estimated hands, predicts left-out objects worse."""
Hands = Literal["measured", "corrected", "estimated"]
Fit = Mapping[Hands, Calibration]
"""Calibrations by kind of hands."""
SIGNS_OF: Mapping[Hands, Sequence[Feature]] = {
    "measured": FEATURES, "corrected": CORRECTED_FEATURES, "estimated": ESTIMATED_FEATURES,
}  # fmt: skip

INPUTS_OF: Mapping[Hands, str] = {
    "measured": "right inputs, and errors of hands, masks, size and shape",
    "corrected": "hands with errors that the fit corrected",
}


def hands_of(row: Row) -> Hands:
    """Return the kind of hands of a result, which selects its calibration."""
    kind: InputKind = row["kind"]
    return kind if kind in ("measured", "corrected") else "estimated"


@dataclass(frozen=True)
class Results:
    """Rows of many results, and the frame in which they must be right."""

    rows: Sequence[Row]
    where: Where = "hand"

    @property
    def right(self) -> Bool[ndarray, "n"]:
        """True for right results."""
        return self.rank == 1.0

    @property
    def rank(self) -> Float[ndarray, "n"]:
        """Number of the first right candidate, from 1; infinite if all are wrong."""
        return np.array([row["rank"][self.where] or np.inf for row in self.rows])

    @property
    def objects(self) -> ndarray:
        """Object of each result."""
        return np.array([row["category"] for row in self.rows])

    @property
    def clips(self) -> int:
        """Number of clips."""
        return len({row["clip"] for row in self.rows})

    @property
    def weights(self) -> Float[ndarray, "B n"]:
        """Count of each result in each bootstrap resample; results of a clip are drawn together."""
        return bootstrap_resamples([row["clip"] for row in self.rows])

    def only(self, **what: object) -> Results:
        """Select the results with given entries of their rows."""
        return replace(self, rows=[row for row in self.rows if all(row[key] == value for key, value in what.items())])

    def without(self, category: str) -> Results:
        """Select the results of other objects."""
        return replace(self, rows=[row for row in self.rows if row["category"] != category])

    def fitted(self, made: str) -> Fit:
        """Fit the weights of the features, for each kind of hands."""
        hands = [hands_of(row) for row in self.rows]
        groups = {one: [row for row, of in zip(self.rows, hands, strict=True) if of == one] for one in {*hands}}
        return {one: replace(self, rows=rows).fit(one, made) for one, rows in groups.items()}

    def fit(self, hands: Hands, made: str) -> Calibration:
        """Fit the weights of the features of one kind of hands to all results."""
        counted = SIGNS_OF[hands]
        signs = np.array([[row["signs"][sign.name] for sign in counted] for row in self.rows])
        weights, bias = fit_weights(signs, self.right, [sign.direction for sign in counted], RIDGE)
        data = (
            f"{len(self.rows)} results of {self.clips} clips of {len({*self.objects.tolist()})} objects of "
            f"{' and '.join(of(self, 'dataset'))}, of which {100.0 * self.right.mean():.0f} % are right: "
            f"{INPUTS_OF[hands]}"
        )
        by_sign = {sign.name: weight for sign, weight in zip(counted, weights, strict=True)}
        return Calibration(self.where, by_sign, bias, data, made)

    def probability(self, fit: Fit) -> Float[ndarray, "n"]:
        """Compute the probability of each result."""
        return np.array([fit[hands_of(row)].probability(row["signs"]).value for row in self.rows])

    def without_own_object(self) -> Float[ndarray, "n"]:
        """Compute the probability of each result by a fit without its object."""
        of, out = self.objects, np.empty(len(self.rows))
        for category in dict.fromkeys(of.tolist()):
            out[of == category] = self.only(category=category).probability(self.without(category).fitted(""))
        return out

    def keeping(self, probability: Float[ndarray, "n"], reserve: float = 0.0) -> KeepThresholds:
        """Choose the thresholds, with a fraction of their allowed errors in reserve."""
        least = {
            share: keep_threshold(probability, self.right, share + reserve * (1.0 - share)) for share in KEEP_SHARES
        }
        sets = candidate_set_thresholds(probability, self.rank, CANDIDATE_SET_COVERAGE)
        return KeepThresholds({share: p for share, p in least.items() if np.isfinite(p)}, sets)


@dataclass(frozen=True)
class Judged:
    """Cross-validated results: probabilities, and marks of kept results, by calibrations on the other objects."""

    results: Results
    probability: Float[ndarray, "n"]
    kept: Bool[ndarray, "n"]

    def only(self, **what: object) -> Judged:
        """Select the results with given entries of their rows."""
        some = np.array([all(row[key] == value for key, value in what.items()) for row in self.results.rows])
        return Judged(self.results.only(**what), self.probability[some], self.kept[some])


def judged(results: Results) -> Judged:
    """Cross-validate by objects: fits and thresholds of an object's results come from the other objects."""
    p, kept = np.empty(len(results.rows)), np.zeros(len(results.rows), dtype=bool)
    for category in dict.fromkeys(results.objects.tolist()):
        own, others = results.objects == category, results.without(category)
        mine = results.only(category=category)
        p[own] = mine.probability(others.fitted(""))
        by_kind = thresholds(others, others.without_own_object())
        kept[own] = p[own] >= [by_kind[row["kind"]].least.get(KEPT, np.inf) for row in mine.rows]
    return Judged(results, p, kept)


def thresholds(results: Results, probability: Float[ndarray, "n"]) -> dict[InputKind, KeepThresholds]:
    """Choose the thresholds for measured and for corrected hands.

    A threshold holds, with ``RESERVE``, under each condition of ``ALWAYS`` with at least ``FEWEST`` results of these
    hands. For measured hands, whose errors may be undetected, it is at least the share itself.
    """
    kinds, conditions = (np.array([row[key] for row in results.rows]) for key in ("kind", "condition"))
    out = dict[InputKind, KeepThresholds]()
    for kind in dict.fromkeys(kinds.tolist()):
        of_kind = [(kinds == kind) & (conditions == condition) for condition in ALWAYS]
        each = [
            results.only(kind=kind, condition=condition).keeping(probability[some], RESERVE)
            for condition, some in zip(ALWAYS, of_kind, strict=True)
            if some.sum() >= FEWEST
        ]
        shares = [share for share in KEEP_SHARES if each and all(share in one.least for one in each)]
        sets = results.only(kind=kind).keeping(probability[kinds == kind]).sets
        least = {share: max(one.least[share] for one in each) for share in shares}
        if kind == "measured":
            least = {share: max(p, share) for share, p in least.items()}
            sets = {size: max(p, CANDIDATE_SET_COVERAGE) for size, p in sets.items()}
        out[kind] = KeepThresholds(least, sets)
    return out


def of(results: Results, key: str) -> list[str]:
    """Return the distinct entries of a column."""
    return sorted({row[key] for row in results.rows})


def stored(calibrations: Iterable[Calibration]) -> dict[str, object]:
    """Return the calibrations as entries of ``calibrated.json``."""

    def short(*numbers: float) -> list[float]:
        return [float(f"{number:.5g}") for number in numbers]

    return {
        METHOD: [
            asdict(one)
            | {"bias": short(one.bias)[0], "weights": {name: short(*astuple(w)) for name, w in one.weights.items()}}
            for one in calibrations
        ]
    }


def write(file: Path, keeping: Mapping[tuple[InputKind, Where], KeepThresholds] | None = None, **parts: object) -> None:
    """Replace parts of ``calibrated.json`` and the thresholds of some inputs; a list of numbers takes one line."""
    record = json.loads(file.read_text(encoding="utf-8"))
    new = {
        key: {part: {f"{n}": float(f"{p:.4g}") for n, p in least.items()} for part, least in vars(one).items()}
        for key, one in (keeping or {}).items()
    }
    before = {(one["input"], one["where"]): {"least": one["least"], "sets": one["sets"]} for one in record["keeping"]}
    listed = [{"input": kind, "where": where} | least for (kind, where), least in (before | new).items()]
    text = json.dumps(record | parts | {"keeping": listed}, indent=1)
    file.write_text(NUMBERS.sub(lambda one: " ".join(one[0].split()), text) + "\n", encoding="utf-8")


def tables(rows: Sequence[Row], held: Mapping[Where, Judged], fits: Mapping[Where, Fit]) -> dict[str, Table]:
    """Make a table for results right in the hand, and one for the camera."""
    every = Results(rows)
    commits = sorted({made.partition(", commit ")[2].split()[0] for made in of(every, "made")})
    about = (
        f"results of the code at {', '.join(commits)}: {len(rows)} of {every.clips} clips of "
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
        lines = [*_lines(one, fits[where]), *_of_estimated(estimated)]
        title = f"Probability that a result is right in the {where}, by objects left out"
        out[f"{SECTION}-{where}"] = store.of_cells(title, ("", *HEADER), lines, about)
    return out


def _lines(held: Judged, fit: Fit) -> Iterator[list[str]]:
    """Yield rows by condition, by dataset, of all results, and of all with their own object in the fit."""
    conditions = of(held.results, "condition")
    for condition in (*ALWAYS, *(each for each in conditions if each not in ALWAYS)):
        yield line(condition, held.only(condition=condition))
    for dataset in of(held.results, "dataset"):
        yield total(dataset, held.only(dataset=dataset))
    yield total("all", held)
    yield total("all, own object in the fit", replace(held, probability=held.results.probability(fit)))


def _of_estimated(results: Results) -> Iterator[list[str]]:
    """Yield a row of estimated hands, by their own calibration, of objects outside it."""
    others = results.only(dataset=OTHER)
    if others.rows:
        p = others.probability({"estimated": ESTIMATED_CALIBRATIONS[METHOD, results.where]})
        least = KEEP_THRESHOLDS["estimated", results.where].least.get(KEPT, np.inf)
        yield line("estimated hands, by their own calibration", Judged(others, p, p >= least))


def total(label: str, held: Judged) -> list[str]:
    """Make a row of a total, with the interval of the AUROC."""
    low, high = auroc_interval(held.probability, held.results.right, held.results.weights)
    cells = line(label, held)
    cells[1 + HEADER.index("AUROC")] += f" [{low:.2f}, {high:.2f}]"
    return cells


def line(label: str, held: Judged) -> list[str]:
    """Make a row of the table."""
    p, right, kept = held.probability, held.results.right, held.kept
    area = auroc(p, right)
    return [
        label, f"{len(p)}", *(f"{100.0 * x:.0f}" for x in (right.mean(), p.mean())),
        "" if np.isnan(area) else f"{area:.2f}", f"{calibration_error(p, right):.3f}", f"{least_error(p):.3f}",
        f"{100.0 * kept.mean():.0f}", f"{100.0 * right[kept].mean():.1f}" if kept.any() else "",
    ]  # fmt: skip


def draw(held: Mapping[Where, Judged], path: Path) -> None:
    """Draw the reliability diagrams: share of right results, and number of results, over probability."""
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
    """Draw the diagram of one frame."""
    upper.plot([0, 1], [0, 1], color="0.7", linewidth=1, label="perfect")
    for label, below in zip(ALWAYS, (-3, -11, -19), strict=True):
        some = held.only(condition=label)
        found = bins(some.probability, some.results.right, DRAWN_BINS)
        x, y, n = np.array([(b.probability, b.right, b.count) for b in found]).T
        spread = 1.96 * np.sqrt(np.maximum(x * (1.0 - x), 0.25 / n) / n)
        bars = np.array([np.minimum(spread, y), np.minimum(spread, 1.0 - y)])
        line = upper.errorbar(x, y, bars, fmt="o-", markersize=4, linewidth=1, capsize=2, label=label).lines[0]
        for one in found:
            upper.annotate(
                f"{one.count}", (one.probability, one.right), (6, below), textcoords="offset points",
                fontsize=7, color=line.get_color(),
            )  # fmt: skip
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
    """Describe the results without a probability, which have serious findings, and the right ones among them."""
    flagged = replace(every, rows=[row for row in every.rows if row["serious"]])
    right = f"{flagged.right.sum()} of them right in the hand"
    return f"a finding was serious for {len(flagged.rows)} of them, {right}: these have no probability"


def main(out: Path, root: Path, other: Path, meshes: Path, arctic: Path, workers: int) -> None:
    """Collect rows, calibrate, and write calibration and tables."""
    every = cases(out, root, other, meshes, arctic)
    if {OTHER} & {case.dataset for case in every} and not test_runs.noted(SECTION, test_runs.commit()):
        test_runs.note(SECTION, COMMAND)
    wanted = {case.key for case in every}
    rows = collect(out / ROWS, every, KEY, row, workers)
    report([row for row in rows if tuple(row[key] for key in KEY) in wanted])


def report(rows: Sequence[Row]) -> None:
    """Fit all results of measured hands, cross-validate by objects, and write calibration and tables.

    Results with a serious finding have no probability and are excluded.
    """
    made, how = date_and_commit(), circumstances(COMMAND)  # before anything is written
    used = [row for row in rows if hands_of(row) != "estimated" and not row["serious"]]
    fits = {where: Results(used, where).fitted(made) for where in POSE_FRAMES}
    held = {where: judged(Results(used, where)) for where in POSE_FRAMES}
    keeping: dict[tuple[InputKind, Where], KeepThresholds] = {
        (kind, where): least
        for where, one in held.items()
        for kind, least in thresholds(one.results, one.probability).items()
    }
    parts = {hands: stored(fit[hands] for fit in fits.values()) for hands in ("measured", "corrected")}
    write(CALIBRATION_FILE, keeping, **parts)
    draw(held, store.ROOT / "docs/images" / PICTURE)
    for name, table in tables(rows, held, fits).items():
        print(store.write(name, replace(table, made=how)))


if __name__ == "__main__":
    if len(sys.argv) < 6:
        sys.exit(__doc__)
    main(*map(Path, sys.argv[1:6]), int(sys.argv[6]) if len(sys.argv) > 6 else available_cores())
