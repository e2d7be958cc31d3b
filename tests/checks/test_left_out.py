"""The probability fitted without a dataset: by the others' training parts, held against its own test part."""

from __future__ import annotations

import numpy as np

from benchmarks.left_out import FITS, left_out
from benchmarks.probability import Results
from getagrip.checks.signs import SIGNS


def rows(dataset: str, part: str, direction: float, count: int, condition: str) -> list[dict[str, str]]:
    """Results whose first sign tells right from wrong, in one direction or in the other."""
    rng, out = np.random.default_rng(0), []
    for n in range(count):
        right = bool(rng.random() < 0.5)
        signs = {sign.name: f"{rng.normal()}" for sign in SIGNS}
        first = next(sign for sign in SIGNS if sign.direction > 0)
        signs[first.name] = f"{direction * (4.0 if right else -4.0) + rng.normal()}"
        about = {"dataset": dataset, "part": part, "clip": f"{n}", "condition": condition, "serious": "0"}
        out.append({**about, **signs, "right": f"{int(right)}", "right-in-camera": f"{int(right)}"})
    return out


def test_a_dataset_is_judged_by_the_others_alone() -> None:
    ways = (("A", 1.0, 200, "estimated"), ("B", -1.0, 50, "moderate"))
    found = [row for part in ("train", "validation") for name, *way in ways for row in rows(name, part, *way)]
    table = left_out(Results(found))
    assert len(table.rows) == 2 * 3 * len(FITS)
    for words in ("fitted-to-all", "fitted-without-it"):  # all of A has errors that were measured on ARCTIC
        of_a, of_arctic = (table.row(f"{name}-in-the-hand-{words}") for name in ("a", "arctic"))
        assert {**of_a, "label": ""} == {**of_arctic, "label": ""}
    with_a, without = (
        table.row(f"a-in-the-hand-{words}")["auroc"][0] for words in ("fitted-to-all", "fitted-without-it")
    )
    assert with_a > 0.95
    assert without < 0.75  # B alone gives the sign no weight, since it may only count in its direction
