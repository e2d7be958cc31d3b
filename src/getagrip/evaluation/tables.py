"""Evaluations of many clips, averaged and printed."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from getagrip.evaluation.results import IOU_THRESHOLDS, Metrics, mean_of
from getagrip.io.terminal import plain_table
from getagrip.metrics.contact import SIDES, THRESHOLDS

if TYPE_CHECKING:
    from rich.table import Table


def summary(evaluations: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The evaluations; for each metric, its mean over the clips that have it and their number; the same by method."""
    return {
        "samples": list(evaluations),
        **_means(evaluations),
        "methods": {method: _means(group) for method, group in by_method(evaluations).items()},
    }


def by_method(evaluations: Sequence[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """The evaluations of each method."""
    methods = dict.fromkeys(e["method"] for e in evaluations)
    return {method: [e for e in evaluations if e["method"] == method] for method in methods}


def _means(evaluations: Sequence[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    keys = list(dict.fromkeys(key for evaluation in evaluations for key in evaluation["metrics"]))
    columns = {key: np.array([e["metrics"].get(key, np.nan) for e in evaluations], dtype=float) for key in keys}
    return {
        "mean": {key: mean_of(values) for key, values in columns.items()},
        "clips": {key: int(np.count_nonzero(~np.isnan(values))) for key, values in columns.items()},
    }


class _Column(NamedTuple):
    heading: str
    metric: str
    factor: float
    decimals: int

    def cell(self, metrics: Metrics) -> str:
        value = metrics.get(self.metric, float("nan"))
        return "-" if np.isnan(value) else f"{self.factor * value:.{self.decimals}f}"


_COLUMNS = (
    _Column("IOU\n%", "iou", 100, 1),
    _Column("full\n%", "iou_full", 100, 1),
    _Column("ADD\nmm", "add_mm", 1, 1),
    _Column("ADD\n%", "add_success", 100, 0),
    _Column("sym\nmm", "add_sym_mm", 1, 1),
    _Column("sym\n%", "add_sym_success", 100, 0),
    _Column("rot\ndeg", "rotation_sym_deg", 1, 1),
    _Column("trans\nmm", "translation_sym_mm", 1, 1),
    _Column("scale\n%", "scale_error", 100, 1),
    _Column("depth\nmm", "penetration_object_mm", 1, 1),
    _Column("SCA\n%", "sca_object_0mm", 100, 1),
    _Column("true\nSCA %", "truth_sca_object_0mm", 100, 1),
)
_OF_MESHES = _Column("hand\nSCA %", "sca_hand_0mm", 100, 1)
"""Shown where a result has no SCA on the object: a mesh that is another one in each frame."""
_KINDS = {"SCA": "sca", "truth's": "truth_sca", "SCA-ADD": "sca_add", "SCA-ADD\nsymmetric": "sca_add_sym"} | {
    f"SCA-IOU\n> {threshold:g}": f"sca_iou_{threshold * 100:.0f}" for threshold in IOU_THRESHOLDS
}


def tables(evaluations: Sequence[dict[str, Any]]) -> list[Table]:
    """One row per result and the mean of each method; then, method by method, stable contact area by definition.

    Columns of which no result has a value (there is no truth, the scale is known) are left out.
    """
    from rich.text import Text  # no markup: names may hold brackets

    groups = by_method(evaluations)
    means = {method: _means(group)["mean"] for method, group in groups.items()}
    there = _means(evaluations)["mean"]
    columns = [column for column in _COLUMNS if not np.isnan(there.get(column.metric, np.nan))]
    if any("sca_object_0mm" not in e["metrics"] for e in evaluations):
        columns.append(_OF_MESHES)
    results = _table("clip", [column.heading for column in columns])
    for e in evaluations:
        name = f"{e['clip']}\n{e['method']}" if len(groups) > 1 else e["clip"]
        results.add_row(Text(name), *(column.cell(e["metrics"]) for column in columns))
    if len(evaluations) > len(groups):
        results.add_section()
        for method, group in groups.items():
            of = f" ({method})" if len(groups) > 1 else ""
            results.add_row(Text(f"mean of {len(group)}{of}"), *(column.cell(means[method]) for column in columns))
    return [results, *(_contact(method if len(groups) > 1 else "", mean) for method, mean in means.items())]


def _contact(method: str, mean: Metrics) -> Table:
    """Stable contact area by definition."""
    definitions = [f"{side}_{threshold * 1e3:.0f}mm" for side in SIDES for threshold in THRESHOLDS]
    known = {key for key, value in mean.items() if not np.isnan(value)}
    kinds = {h: kind for h, kind in _KINDS.items() if any(f"{kind}_{d}" in known for d in definitions)}
    table = _table(f"contact\n{method}".strip(), list(kinds))
    for side in SIDES:
        for threshold in THRESHOLDS:
            keys = [f"{kind}_{side}_{threshold * 1e3:.0f}mm" for kind in kinds.values()]
            table.add_row(f"{side} {threshold * 1e3:.0f} mm", *(_Column("", key, 100, 1).cell(mean) for key in keys))
        table.add_section()
    return table


def _table(first: str, headings: list[str]) -> Table:
    from rich.text import Text

    table = plain_table()
    table.add_column(Text(first), overflow="fold", vertical="bottom")
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    return table
