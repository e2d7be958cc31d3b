"""Calibrate the thresholds of ``--keep`` and the probability for estimated hands: ``python -m benchmarks.kept ROWS``.

ROWS is a file of ``benchmarks.kept_rows``, or several joined. The training parts, with simulated and with real errors
of hands, are fitted together with the synthetic part: the probability for estimated hands, and the thresholds for each
kind of input, go into ``checks/calibrated.json`` (``benchmarks.probability`` calibrates measured hands). The other
parts test them (``results/kept.json``); ``results/evidence-validation.json`` counts right validation results. Nothing
is reconstructed.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import get_args

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from benchmarks import probability, store
from benchmarks.kept_rows import REAL, REAL_APART, SYNTHETIC, Row, read
from benchmarks.probability import stored, write
from benchmarks.reliability import auroc, auroc_interval, calibration_error, fit_weights, least_error
from benchmarks.timing import circumstances
from getagrip.bench.comparison import CONFIDENCE_LEVEL
from getagrip.checks.calibration import (
    CALIBRATION_FILE,
    CALIBRATIONS,
    CORRECTED_CALIBRATIONS,
    KEEP_THRESHOLDS,
    LIFTED_KINDS,
    POSE_FRAMES,
    Calibration,
    InputKind,
    KeepThresholds,
    Where,
)
from getagrip.checks.features import ESTIMATED_FEATURES
from getagrip.fitting.options import Options
from getagrip.io.plugins import date_and_commit
from getagrip.result.findings import Probability

METHOD = Options().method
Kept = Mapping[tuple[InputKind, Where], KeepThresholds]
KEPT = 0.95
"""Share of right results at which the table keeps."""
MEASURED = ("measured", "corrected")
PARTS = ("train", REAL, "validation", REAL_APART)


@dataclass(frozen=True)
class Results(probability.Results):
    """Results without serious findings, which have a probability, and the frame in which they must be right."""

    synthetic: Sequence[Row] = ()
    """Synthetic results of the fit. They have a bias of their own, since their share of right results differs."""

    def without(self, category: str) -> Results:
        """Select the results with objects of other categories."""
        rows, synthetic = ([row for row in of if row["category"] != category] for of in (self.rows, self.synthetic))
        return replace(self, rows=rows, synthetic=synthetic)

    @property
    def estimated(self) -> Results:
        """Results with estimated hands."""
        return replace(self, rows=[row for row in self.rows if row["kind"] not in MEASURED])

    def fitted(self, made: str) -> probability.Fit:
        """Fit the weights of the features."""
        every = Results([*self.rows, *self.synthetic], self.where)
        own = [[row["signs"][sign.name] for sign in ESTIMATED_FEATURES] for row in every.rows]
        signs = np.column_stack([own, np.arange(len(own)) >= len(self.rows)])
        weights, bias = fit_weights(signs, every.right, [*(sign.direction for sign in ESTIMATED_FEATURES), 0])
        named = {"train": "training clips of DexYCB", REAL: "clips of ARCTIC with an estimator's hands"}
        counts = [f"{len(of.rows)} of {of.clips} {named[part]}" for part in named if (of := self.only(part=part)).rows]
        right, more = f"{100.0 * self.right.mean():.0f} % of {len(self.rows)} results are right", len(self.synthetic)
        data = f"{' and '.join(counts)} ({right}), and {more} synthetic ones, with and without 2D joints and depth"
        by_sign = {sign.name: weight for sign, weight in zip(ESTIMATED_FEATURES, weights[:-1], strict=True)}
        return {"estimated": Calibration(self.where, by_sign, bias, data, made)}


def of_part(rows: Sequence[Row], part: str, where: Where) -> Results:
    """Select the results of a part without serious findings, with the synthetic ones for fits.

    Training in the hand includes real hands; their camera is assumed, so they have no probability in the camera.
    """
    parts = (part, REAL) if (part, where) == ("train", "hand") else (part,)
    rows, synthetic = ([row for row in rows if row["part"] in of and not row["serious"]] for of in (parts, [SYNTHETIC]))
    return Results(rows, where, synthetic)


HEADER = (
    "results", "right, %", "AUROC", "ECE", "ECE if it were perfect", "kept at 95 %, %", "right of kept, %",
    "with a set, %", "sets that hold it, %", "candidates",
)  # fmt: skip


def lines(rows: Sequence[Row], fitted: Mapping[Where, Calibration], keeping: Kept) -> Iterator[list[str]]:
    """Test the calibrations on all parts; training results with estimated hands by fits without their own object."""
    for where, part in product(POSE_FRAMES, PARTS):
        if where == "camera" and part in (REAL, REAL_APART):
            continue
        of = of_part(rows, "train" if part == REAL else part, where)
        measured, estimated = of.only(kind="measured", part=part), of.estimated
        p = (
            estimated.without_own_object()
            if part in ("train", REAL)
            else estimated.probability({"estimated": fitted[where]})
        )
        p, estimated = p[[row["part"] == part for row in estimated.rows]], estimated.only(part=part)
        label = f"{part}, in the {where}"
        if measured.rows:
            fit: probability.Fit = {
                "measured": CALIBRATIONS[METHOD, where],
                "corrected": CORRECTED_CALIBRATIONS[METHOD, where],
            }
            exact = measured.probability(fit)
            yield line(f"{label}, measured hands", measured, exact, keeping)
        if not estimated.rows:
            continue
        yield line(f"{label}, estimated hands", estimated, p, keeping)
        for condition in dict.fromkeys(row["condition"] for row in estimated.rows):
            some = np.array([row["condition"] == condition for row in estimated.rows])
            yield line(f"{label}, {condition}", estimated.only(condition=condition), p[some], keeping)


def line(label: str, results: Results, p: Float[ndarray, "n"], keeping: Kept) -> list[str]:
    """Summarise results with their probabilities in a row of the table."""
    right, where, rows, weights = results.right, results.where, results.rows, results.weights
    verdicts = [
        keeping[row["kind"], where].applied(Probability(x, "")) for x, row in zip(p.tolist(), rows, strict=True)
    ]
    kept, count = np.array([one.keep >= KEPT for one in verdicts]), np.array([one.candidates for one in verdicts])
    sets, holds, area = count > 0, results.rank <= count, ""
    if 0 < right.sum() < len(right):
        low, high = auroc_interval(p, right, weights)
        area = f"{auroc(p, right):.2f} [{low:.2f}, {high:.2f}]"
    return [
        label, f"{len(p)}", f"{100.0 * right.mean():.0f}", area, f"{calibration_error(p, right):.3f}",
        f"{least_error(p):.3f}", _share(kept, np.ones_like(kept), weights), _share(right, kept, weights),
        _share(sets, np.ones_like(sets), weights), _share(holds, sets, weights),
        f"{count[sets].mean():.1f}" if sets.any() else "",
    ]  # fmt: skip


def _share(what: Bool[ndarray, "n"], among: Bool[ndarray, "n"], weights: Float[ndarray, "B n"]) -> str:
    """Format a share of results in per cent, with its interval over clips unless it is 0 or 1."""
    if not among.any():
        return ""
    share = 100.0 * what[among].mean()
    if share in (0.0, 100.0):
        return f"{share:.0f}"
    of = weights[:, among].sum(axis=1)
    drawn = 100.0 * (weights[:, among] @ what[among])[of > 0] / of[of > 0]
    low, high = np.quantile(drawn, [(1.0 - CONFIDENCE_LEVEL) / 2.0, (1.0 + CONFIDENCE_LEVEL) / 2.0])
    return f"{share:.0f} [{low:.0f}, {high:.0f}]"


def calibrated(rows: Sequence[Row], made: str) -> tuple[Mapping[Where, Calibration], Kept]:
    """Fit the probabilities and choose the thresholds by the training parts."""
    estimated, keeping = dict[Where, Calibration](), dict[tuple[InputKind, Where], KeepThresholds]()
    for where in POSE_FRAMES:
        train = of_part(rows, "train", where)
        every = train.estimated
        estimated[where] = every.fitted(made)["estimated"]
        fair, kinds = every.without_own_object(), np.array([row["kind"] for row in every.rows])
        for kind in get_args(InputKind):
            if kind in (*MEASURED, *LIFTED_KINDS):
                continue
            keeping[kind, where] = every.only(kind=kind).keeping(fair[kinds == kind])
    return estimated, keeping


def by_evidence(rows: Sequence[Row]) -> Iterator[list[str]]:
    """Count right validation results in each frame, including results with serious findings."""
    of = [row for row in rows if row["part"] == "validation"]
    for condition in dict.fromkeys(row["condition"] for row in of):
        some = [Results([row for row in of if row["condition"] == condition], where) for where in POSE_FRAMES]
        shares = (_share(one.right, np.ones_like(one.right), one.weights) for one in some)
        yield [condition, f"{len(some[0].rows)}", *shares]


def main(file: Path) -> None:
    """Calibrate, and write calibration and tables."""
    rows = read(file)
    estimated, keeping = calibrated(rows, date_and_commit())
    write(CALIBRATION_FILE, keeping, estimated=stored(estimated.values()))
    makers = ", ".join(sorted({row["made"] for row in rows if row["part"] != SYNTHETIC}))
    counts = [sum(row["part"] == part and not row["serious"] for row in rows) for part in (*PARTS, SYNTHETIC)]
    notes = (
        f"by {makers}: " + ", ".join(f"{n} {part}" for n, part in zip(counts, (*PARTS, SYNTHETIC), strict=True)),
        "none with a serious finding; real: ARCTIC's hands as estimated; synthetic: in the fit only",
        "training results with estimated hands: by fits without their object; intervals: 95 %, clips drawn together",
    )
    header = ("input", "results", *(f"right in the {where}, %" for where in POSE_FRAMES))
    settings = (
        "hands: exact, or at the level estimated, their masks not ragged; 2D joints: landmarks, wild, lab, one a draw; "
        "depth: mono, realsense",
        f"all 70 validation clips, by {makers}; intervals: 95 %, clips drawn together",
    )
    tables = {
        "kept": store.of_cells(
            "What is kept", ("input", *HEADER), [*lines(rows, estimated, KEEP_THRESHOLDS | keeping)], notes
        ),
        "evidence-validation": store.of_cells("Evidence on hands", header, [*by_evidence(rows)], settings),
    }
    made = circumstances("python -m benchmarks.kept ROWS")
    for name, table in tables.items():
        print(store.write(name, replace(table, made=made)).read_text(encoding="utf-8"))


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    main(Path(sys.argv[1]))
