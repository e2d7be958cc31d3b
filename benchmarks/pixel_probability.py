"""Calibrate the probability of drafts: ``python -m benchmarks.pixel_probability VIDEOS REAL``.

VIDEOS is the folder of ``getagrip bench video --split all --oracle mesh mesh+depth``, REAL that of ``getagrip bench
recording``. Training videos and real images with hands that were found fit the weights of results with lifted hands,
and choose the thresholds of each of their kinds by objects left out; both go into ``checks/calibrated.json``.
Validation videos, of other kinds, motions and looks, test them (``results/probability-pixels.json``), and so do the
real images, by fits without them; the intervals of the distance are tested besides. Nothing is reconstructed.

Masks of rendered videos are better than those of real images. Without these, few as they are, a fit promises too much.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from benchmarks import probability, store
from benchmarks.kept_rows import Row
from benchmarks.probability import stored, write
from benchmarks.reliability import auroc, calibration_error, fit_weights, least_error
from benchmarks.timing import circumstances
from getagrip.bench.pixels.videos import PLAIN, interval_holds, is_right_in_image
from getagrip.checks.calibration import (
    CALIBRATION_FILE,
    LIFTED_KINDS,
    Calibration,
    InputKind,
    KeepThresholds,
    Where,
    kind_of_input,
)
from getagrip.checks.features import LIFTED_FEATURES
from getagrip.io.plugins import date_and_commit

REAL = "real"
"""Part of the rows of real images, and their category: one object would tell the others."""
USED = (PLAIN, "mesh", "mesh+depth")
"""Drafts whose hands, masks and frames are found, with a built-in shape, the object's mesh, and a sensor's depth."""
KEPT = 0.9
"""Share of right results at which the table keeps."""
HEADER = (
    "results", "without a serious finding", "right, %", "right of those with one, %", "mean probability, %", "AUROC",
    "ECE", "ECE if it were perfect", "kept, %", "right of kept, %", "intervals that hold the distance, %",
)  # fmt: skip


@dataclass(frozen=True)
class Results(probability.Results):
    """Results with lifted hands."""

    def fitted(self, made: str) -> probability.Fit:
        """Fit the weights of the features of results without serious findings."""
        rows = [row for row in self.rows if not row["serious"]]
        used = replace(self, rows=rows)
        signs = np.array([[row["signs"][sign.name] for sign in LIFTED_FEATURES] for row in rows])
        weights, bias = fit_weights(signs, used.right, [sign.direction for sign in LIFTED_FEATURES])
        data = (
            f"{len(rows)} results of {used.clips} clips, rendered videos of {len({*used.objects.tolist()} - {REAL})} "
            f"kinds of objects and real images, of which {100.0 * used.right.mean():.0f} % are right: hands found, "
            "masks and frames mostly, built-in shapes and own meshes, without depth and with a sensor's"
        )
        by_sign = {sign.name: weight for sign, weight in zip(LIFTED_FEATURES, weights, strict=True)}
        return {"estimated": Calibration(self.where, by_sign, bias, data, made)}


def read_rows(folder: Path) -> list[Row]:
    """Read the results of a benchmark's records; drafts without a result are left out."""
    rows = []
    for file in sorted((folder / "results").glob("*.json")):
        record = json.loads(file.read_text(encoding="utf-8"))
        made = {name: record["by"][name] for name in USED if "failure" not in record["by"].get(name, {"failure": ""})}
        rows += [_row(file.stem, record["split"], name, one) for name, one in made.items()]
    return rows


def read_real_rows(folder: Path) -> list[Row]:
    """Read the results of real images with hands that were found; their poses in the hand are unknown."""
    rows = []
    for file in sorted((folder / "results").glob("*-found-*.json")):
        errors = json.loads(file.read_text(encoding="utf-8"))["errors"]
        if errors:
            rows.append(_row(file.stem, REAL, "found", errors) | {"category": REAL})
    return rows


def _row(video: str, split: str, name: str, made: Mapping[str, object]) -> Row:
    """Return the row of a draft: its kind of input, findings, features, rank of the first right candidate."""
    found: Row = dict(made)
    said = found["said"]
    signs, each = said["signs"], found["candidates"]
    right = {
        "hand": found["right_in_hand"] or [],
        "camera": [one["right"] for one in each],
        "image": [is_right_in_image(one) for one in each],
    }
    sensor = {"depth"} if signs["depth-images"] else set[str]()
    return {
        "clip": video, "category": video.rpartition("-")[0], "part": split, "condition": name,
        "kind": kind_of_input("estimated", sensor, signs["depth-images"], False, True, signs["shape-assumed"] > 0.0),
        "serious": said["serious"], "signs": signs,
        "rank": {where: each.index(True) + 1 if True in each else None for where, each in right.items()},
        "held": interval_holds(found),
    }  # fmt: skip


def calibrated(
    rows: Sequence[Row], where: Where, made: str
) -> tuple[Calibration, dict[InputKind, KeepThresholds], Float[ndarray, "n"]]:
    """Fit training rows; return the thresholds of each kind, and the probabilities by fits without their objects."""
    every = Results(rows, where)
    p, least = every.without_own_object(), dict[InputKind, KeepThresholds]()
    used = np.array([not row["serious"] for row in rows])
    for kind in LIFTED_KINDS:
        of_kind = used & np.array([row["kind"] == kind for row in rows])
        least[kind] = replace(every, rows=[rows[n] for n in np.flatnonzero(of_kind)]).keeping(p[of_kind])
    return every.fitted(made)["estimated"], least, p


def lines(
    label: str, results: Results, p: Float[ndarray, "n"], least: Mapping[InputKind, KeepThresholds]
) -> Iterator[list[str]]:
    """Yield a row for each kind of input, and one for all."""
    kinds = np.array([row["kind"] for row in results.rows])
    usable = np.array([not row["serious"] for row in results.rows])
    kept = p >= [least[row["kind"]].least.get(KEPT, np.inf) for row in results.rows]
    held = np.array([row["held"] for row in results.rows], dtype=object)
    for kind in (*LIFTED_KINDS, "all"):
        of_kind = (kinds == kind) | (kind == "all")
        some = of_kind & usable
        if not some.any():
            continue
        right, refused, known = results.right[some], of_kind & ~usable, held[of_kind]
        stated = known[known != None].astype(bool)  # noqa: E711
        area = auroc(p[some], right)
        yield [
            f"{label}, {kind}", f"{of_kind.sum()}", f"{some.sum()}", f"{100.0 * right.mean():.0f}",
            f"{100.0 * results.right[refused].mean():.0f}" if refused.any() else "",
            f"{100.0 * p[some].mean():.0f}", "" if np.isnan(area) else f"{area:.2f}",
            f"{calibration_error(p[some], right):.3f}", f"{least_error(p[some]):.3f}",
            f"{100.0 * kept[some].mean():.0f}", f"{100.0 * right[kept[some]].mean():.0f}" if kept[some].any() else "",
            f"{100.0 * stated.mean():.0f}" if len(stated) else "",
        ]  # fmt: skip


def main(videos: Path, real: Path) -> None:
    """Calibrate, and write calibration and table."""
    rows, how = read_rows(videos), circumstances("python -m benchmarks.pixel_probability VIDEOS REAL")
    rows += read_real_rows(real)
    rendered, test = ([row for row in rows if row["part"] == part] for part in ("train", "validation"))
    recorded = [row for row in rows if row["part"] == REAL]
    keeping, fits, table = dict[tuple[InputKind, Where], KeepThresholds](), list[Calibration](), list[list[str]]()
    for where in get_args(Where):
        train = rendered if where == "hand" else rendered + recorded
        fit, least, p = calibrated(train, where, date_and_commit())
        fits.append(fit)
        keeping |= {(kind, where): one for kind, one in least.items()}
        for part in dict.fromkeys(row["part"] for row in train):
            some = np.array([row["part"] == part for row in train])
            of_part = Results([row for row in train if row["part"] == part], where)
            table += lines(f"{part}, in the {where}", of_part, p[some], least)
        if test:
            other = Results(test, where)
            table += lines(f"validation, in the {where}", other, other.probability({"estimated": fit}), least)
    write(CALIBRATION_FILE, keeping, lifted=stored(fits))
    camera = Results(rendered + test, "camera")
    refused = replace(camera, rows=[row for row in camera.rows if row["serious"]])
    notes = (
        f"of rendered videos, {refused.right.sum()} of {camera.right.sum()} results that are right in the camera have "
        f"a serious finding, and {(~refused.right).sum()} of {(~camera.right).sum()} wrong ones",
        f"{Results(rendered).clips} training and {Results(test).clips} validation videos; a serious finding leaves a "
        "result without a probability",
        "training and real images: by fits without the object; validation: by the fit of all training, which lacks "
        "its kinds of objects",
        f"kept: at {100.0 * KEPT:.0f} %, by thresholds of training; lifted: own mesh; lifted-shape: a built-in shape",
    )
    made = store.of_cells("Probability that a draft of a rendered video is right", ("", *HEADER), table, notes)
    print(store.write("probability-pixels", replace(made, made=how)).read_text(encoding="utf-8"))


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    main(*map(Path, sys.argv[1:]))
