"""Calibrate what is kept: ``python -m benchmarks.kept OUT CLIPS DEXYCB YCB [MOST]``.

CLIPS is the folder of clips of ``bench dexycb``, at most MOST of which are taken, evenly, of either part; 0: none but
those that are there. Rows go into OUT/rows.jsonl, where those that are there are kept. Training clips give
``checks/kept.py``: the probability for estimated hands, and for hands of both kinds the thresholds of
``checks.keeping``. Validation clips are held against them: ``results/kept.json``.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, get_args

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from benchmarks import store
from benchmarks.probability import entry
from benchmarks.reliability import auroc, calibration_error, fit_weights, least_error
from benchmarks.timing import circumstances
from getagrip.checks.calibrated import CALIBRATIONS
from getagrip.checks.calibration import Calibration, Where
from getagrip.checks.keeping import SHARES, Keeping, least_kept, least_times
from getagrip.checks.signs import HAND_SIGNS, SIGNS
from getagrip.clip import read_clip, read_masks
from getagrip.datasets.synthetic.noise import NOISE
from getagrip.evaluation import evaluate
from getagrip.evaluation.metric import ADD_SYM, ADD_SYM_CAM
from getagrip.experiments.changes import UNCHANGED, Change, Noisy, Several
from getagrip.experiments.simulated_evidence import SimulatedJoints
from getagrip.experiments.sources import samples
from getagrip.experiments.sources.recorded import DexYcb
from getagrip.fitting.options import Options
from getagrip.io.code import stamp
from getagrip.probability import HOLDS, Probability
from getagrip.provenance import HandsKind, kind_of_hands
from getagrip.timelines.reconstruct import reconstruct

SOURCE = Path(__file__).resolve().parents[1] / "src/getagrip/checks/kept.py"
METHOD, WHERE = Options().method, {"hand": ADD_SYM, "camera": ADD_SYM_CAM}
ESTIMATED = Noisy(NOISE["estimated"])
CONDITIONS: Mapping[str, Change] = {
    "estimated": ESTIMATED,
    "estimated, 2D joints": Several((SimulatedJoints("landmarks"), ESTIMATED)),
    "exact": UNCHANGED,
}
SIGNS_USED = [sign for sign in (*SIGNS, *HAND_SIGNS) if sign.name != "mesh-deformation"]
"""Signs for estimated hands; DexYCB's own meshes are not deformed."""
KEPT = 0.95
"""Share of right results in the table."""
Row = dict[str, Any]


def collect(file: Path, clips: Path, root: Path, meshes: Path, most: int) -> list[Row]:
    """Return the rows of both parts, and add those that are missing to the file."""
    rows = [json.loads(line) for line in file.read_text("utf-8").splitlines()] if file.exists() else []
    made = stamp()
    done = {(row["clip"], row["condition"]) for row in rows}
    for part in ("train", "validation") if most else ():
        found, _ = samples(DexYcb(split=part, root=root, meshes=meshes), clips, most, False)
        for condition, sample in product(CONDITIONS, found):
            if (sample.name, condition) not in done:
                rows.append({"part": part, "made": made} | row(sample.folder, condition))
                with file.open("a", encoding="utf-8") as stream:
                    stream.write(json.dumps(rows[-1]) + "\n")
                print(part, sample.name, condition, flush=True)
    return rows


def row(folder: Path, condition: str) -> Row:
    """Reconstruct a clip: its signs, and which of its candidates are right."""
    clip = read_clip(folder)
    clip, masks = CONDITIONS[condition](clip, read_masks(clip), 0)
    result = reconstruct(clip, masks, Options(every_frame=False))
    found, right = result.candidates, {where: list[float]() for where in WHERE}
    for T, scale in zip(found.T_hand_obj, found.scale, strict=True):
        one = replace(result, T_hand_obj=T, scale=float(scale))
        metrics = evaluate(one, clip, None, wanted=tuple(WHERE.values())).metrics
        for where, metric in WHERE.items():
            right[where].append(metrics[metric.name])
    serious = any(finding.serious for finding in result.findings)
    return {
        "clip": clip.name, "category": clip.category, "condition": condition, "kind": kind_of_hands(clip.provenance),
        "serious": serious, "signs": result.signs, "energy": found.energy.tolist(), "right": right,
    }  # fmt: skip


@dataclass(frozen=True)
class Results:
    """Results of one kind, without serious findings, and where they are to be right."""

    rows: Sequence[Row]
    where: Where

    @property
    def right(self) -> Bool[ndarray, "n"]:
        """Which are right."""
        return np.array([row["right"][self.where][0] > 0.5 for row in self.rows])

    @property
    def times(self) -> Float[ndarray, "n"]:
        """Energy of the first right candidate in multiples of the least; infinite where none is right."""
        out = []
        for row in self.rows:
            energy = np.maximum.accumulate(row["energy"]) / max(min(row["energy"]), 1e-9)
            right = np.flatnonzero(np.array(row["right"][self.where]) > 0.5)
            out.append(float(energy[right[0]]) if len(right) else np.inf)
        return np.array(out)

    def fitted(self, made: str) -> Calibration:
        """Fit the weights of the signs."""
        signs = np.array([[row["signs"][sign.name] for sign in SIGNS_USED] for row in self.rows])
        weights, bias = fit_weights(signs, self.right, [sign.direction for sign in SIGNS_USED])
        data = (
            f"{len(self.rows)} results of training clips of DexYCB with hands off as estimates are, with and without "
            f"2D joints, of which {100.0 * self.right.mean():.0f} % are right"
        )
        named = {sign.name: weight for sign, weight in zip(SIGNS_USED, weights, strict=True)}
        return Calibration(self.where, named, bias, data, made)

    def probability(self, calibration: Calibration) -> Float[ndarray, "n"]:
        """Compute the probability of each."""
        return np.array([calibration.probability(row["signs"]).value for row in self.rows])

    def without_own_object(self) -> Float[ndarray, "n"]:
        """Compute the probability of each by a fit without its own object."""
        of = np.array([row["category"] for row in self.rows])
        out = np.empty(len(self.rows))
        for category in dict.fromkeys(of.tolist()):
            rest = Results([row for row, own in zip(self.rows, of, strict=True) if own != category], self.where)
            own = Results([row for row in self.rows if row["category"] == category], self.where)
            out[of == category] = own.probability(rest.fitted(""))
        return out

    def keeping(self, probability: Float[ndarray, "n"]) -> Keeping:
        """Choose the thresholds."""
        least = {share: least_kept(probability, self.right, share) for share in SHARES}
        probable = least_kept(probability, np.isfinite(self.times), HOLDS)
        some = probability >= probable
        times = least_times(self.times[some], HOLDS) if some.any() else np.inf
        return Keeping({share: p for share, p in least.items() if np.isfinite(p)}, probable, times)


def of_kind(rows: Sequence[Row], part: str, kind: HandsKind, where: Where) -> Results:
    """Select the results of a kind that have a probability."""
    return Results([r for r in rows if (r["part"], r["kind"], r["serious"]) == (part, kind, False)], where)


def source(estimated: Mapping[Where, Calibration], keeping: Mapping[tuple[HandsKind, Where], Keeping]) -> str:
    """Return the module that holds the calibrations."""
    made = next(iter(estimated.values())).made
    fitted = "".join(map(entry, estimated.values()))
    kept = "".join(f"    {key!r}: {_literal(one)},\n" for key, one in keeping.items())
    return (
        '"""The probability for estimated hands, and the thresholds of all kinds; written by ``python -m '
        f'benchmarks.kept``.\n\nMade {made}.\n"""\n\n{"from math import inf" * ("inf" in kept)}\n\n'
        "from getagrip.checks.calibration import Calibration, Weight, Where\n"
        "from getagrip.checks.keeping import Keeping\n"
        "from getagrip.provenance import HandsKind\n\n"
        f"ESTIMATED: dict[tuple[str, Where], Calibration] = {{\n{fitted}}}\n"
        '"""By method, and by where poses are right."""\n'
        f"KEEPING: dict[tuple[HandsKind, Where], Keeping] = {{\n{kept}}}\n"
        '"""By kind of input, and by where poses are right."""\n'
    )


def _literal(one: Keeping) -> str:
    least = ", ".join(f"{share!r}: {p:.4g}" for share, p in one.least.items())
    return f"Keeping({{{least}}}, {one.probable:.4g}, {one.times:.4g})"


HEADER = (
    "clips", "results", "right, %", "AUROC", "ECE", "ECE if it were perfect", "kept at 95 %, %", "right of kept, %",
    "with a set, %", "sets that hold it, %", "candidates",
)  # fmt: skip


def lines(rows: Sequence[Row], estimated: Mapping[Where, Calibration], keeping: Any) -> Iterator[list[str]]:
    """Hold both parts against the calibrations; estimated hands of training by fits without their own object."""
    for where, part in product(WHERE, ("train", "validation")):
        for kind in get_args(HandsKind):
            results = of_kind(rows, part, kind, where)
            if not results.rows:
                continue
            fitted = estimated[where] if kind == "estimated" else CALIBRATIONS[METHOD, where]
            fair = results.without_own_object if (part, kind) == ("train", "estimated") else None
            p = results.probability(fitted) if fair is None else fair()
            yield line(f"{part}, in the {where}, {kind}", results, p, keeping[kind, where])
            for condition in CONDITIONS:
                of = np.array([row["condition"] == condition for row in results.rows])
                if 0 < of.sum() < len(of):
                    some = [row for row, own in zip(results.rows, of, strict=True) if own]
                    label = f"{part}, in the {where}, {condition} alone"
                    yield line(label, Results(some, where), p[of], keeping[kind, where])


def line(label: str, results: Results, p: Float[ndarray, "n"], keeping: Keeping) -> list[str]:
    """Sum up results of these probabilities."""
    right, where = results.right, results.where
    verdicts = [
        keeping.applied(Probability(float(x), ""), np.array(row["energy"]))
        for x, row in zip(p, results.rows, strict=True)
    ]
    kept, count = np.array([one.keep >= KEPT for one in verdicts]), np.array([one.candidates for one in verdicts])
    first = [row["right"][where][:n] for row, n in zip(results.rows, count, strict=True)]
    holds = np.array([max(one, default=0.0) > 0.5 for one in first])
    sets, area = count > 0, auroc(p, right)
    shares = [kept.mean(), _mean(right[kept]), sets.mean(), _mean(holds[sets])]
    return [
        label, f"{len(p)}", f"{100.0 * right.mean():.0f}", "" if np.isnan(area) else f"{area:.2f}",
        f"{calibration_error(p, right):.3f}", f"{least_error(p):.3f}",
        *("" if np.isnan(x) else f"{100.0 * x:.0f}" for x in shares),
        "" if not sets.any() else f"{count[sets].mean():.1f}",
    ]  # fmt: skip


def _mean(x: ndarray) -> float:
    return float(x.mean()) if len(x) else float("nan")


def main(out: Path, clips: Path, root: Path, meshes: Path, most: int = 1000) -> None:
    """Collect, fit, and write both down."""
    out.mkdir(parents=True, exist_ok=True)
    rows = collect(out / "rows.jsonl", clips, root, meshes, most)
    estimated, keeping = dict[Where, Calibration](), dict[tuple[HandsKind, Where], Keeping]()
    for where in WHERE:
        train = of_kind(rows, "train", "estimated", where)
        estimated[where] = train.fitted(stamp())
        keeping["estimated", where] = train.keeping(train.without_own_object())
        exact = of_kind(rows, "train", "measured", where)
        keeping["measured", where] = exact.keeping(exact.probability(CALIBRATIONS[METHOD, where]))
    SOURCE.write_text(source(estimated, keeping), encoding="utf-8")
    subprocess.run([sys.executable, "-m", "ruff", "format", "-q", SOURCE], check=True)
    makers = ", ".join(sorted({row["made"] for row in rows}))
    notes = (
        f"{len(of_kind(rows, 'train', 'estimated', 'hand').rows)} training results with estimated hands and "
        f"{len(of_kind(rows, 'train', 'measured', 'hand').rows)} with measured ones, by {makers}; "
        "results with serious findings are left out",
    )
    made = circumstances("python -m benchmarks.kept OUT CLIPS DEXYCB YCB MOST")
    table = store.of_cells("What is kept", HEADER, [*lines(rows, estimated, keeping)], notes)
    print(store.write("kept", replace(table, made=made)).read_text(encoding="utf-8"))


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:5]), *map(int, sys.argv[5:]))
