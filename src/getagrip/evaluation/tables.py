"""Evaluations of many clips, averaged and printed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from getagrip.errors import escape_unprintable
from getagrip.evaluation.metric import METRICS, SCA, TRUE_SCA, nan_mean
from getagrip.evaluation.results import Evaluation
from getagrip.io.files import Json
from getagrip.io.terminal import make_table
from getagrip.metrics.contact import CONTACT_DEFINITIONS, ContactDefinition

if TYPE_CHECKING:
    from rich.table import Table

_OBJECT_CONTACT_DEFINITION, _HAND_CONTACT_DEFINITION = (
    ContactDefinition("object", 0.010),
    ContactDefinition("hand", 0.010),
)
"""Definitions of contact in the table of results: that of reports and benchmarks, and the one that any mesh has."""


def summary(evaluations: Sequence[Evaluation]) -> Json:
    """Summarise evaluations, all together and by method.

    For each metric: its mean over the clips that have it, and their number.
    """
    return {
        "samples": [evaluation.fields() for evaluation in evaluations],
        **_mean_metrics(evaluations),
        "methods": {method: _mean_metrics(group) for method, group in group_by_method(evaluations).items()},
    }


def group_by_method(evaluations: Sequence[Evaluation]) -> dict[str, list[Evaluation]]:
    """Group the evaluations by method."""
    methods = dict.fromkeys(e.method for e in evaluations)
    return {method: [e for e in evaluations if e.method == method] for method in methods}


def _mean_metrics(evaluations: Sequence[Evaluation]) -> dict[str, Json]:
    keys = list(dict.fromkeys(key for evaluation in evaluations for key in evaluation.metrics))
    columns = {key: np.array([e.metrics.get(key, np.nan) for e in evaluations], dtype=float) for key in keys}
    return {
        "mean": {key: nan_mean(values) for key, values in columns.items()},
        "clips": {key: int(np.count_nonzero(~np.isnan(values))) for key, values in columns.items()},
    }


def results_table(evaluations: Sequence[Evaluation]) -> Table:
    """Make a table of one row per result and the mean of each method.

    Columns without any value (there is no ground truth, the scale is known) are left out.
    """
    from rich.text import Text  # no markup: names may hold brackets

    groups = group_by_method(evaluations)
    means = {method: _mean_metrics(group)["mean"] for method, group in groups.items()}
    there = _mean_metrics(evaluations)["mean"]
    columns = [
        (f"{m.heading}\n{m.unit}", m, m.key(_OBJECT_CONTACT_DEFINITION))
        for m in METRICS.working().values()
        if m.heading and not m.by_contact
    ]
    columns += [
        (f"SCA\n{_OBJECT_CONTACT_DEFINITION.distance}\n%", SCA, SCA.key(_OBJECT_CONTACT_DEFINITION)),
        ("true\nSCA\n%", TRUE_SCA, TRUE_SCA.key(_OBJECT_CONTACT_DEFINITION)),
    ]
    columns = [column for column in columns if not np.isnan(there.get(column[2], np.nan))]
    if any(
        SCA.key(_OBJECT_CONTACT_DEFINITION) not in e.metrics for e in evaluations
    ):  # a mesh that is another one in each frame
        columns.append(("hand\nSCA\n%", SCA, SCA.key(_HAND_CONTACT_DEFINITION)))

    def cells(metrics: Mapping[str, float]) -> list[str]:
        return [metric.text(metrics.get(key, np.nan)) for _, metric, key in columns]

    results = _empty_metrics_table("clip", [heading for heading, _, _ in columns])
    results.caption = "; ".join(dict.fromkeys(metric.meaning for _, metric, _ in columns if metric.meaning))
    results.caption_justify = "left"
    for e in evaluations:
        name = f"{e.clip}\n{e.method}" if len(groups) > 1 else e.clip
        results.add_row(Text(escape_unprintable(name, "\n")), *cells(e.metrics))
    if len(evaluations) > len(groups):
        results.add_section()
        for method, group in groups.items():
            of = f" ({method})" if len(groups) > 1 else ""
            results.add_row(Text(escape_unprintable(f"mean of {len(group)}{of}")), *cells(means[method]))
    return results


def contact_tables(evaluations: Sequence[Evaluation]) -> list[Table]:
    """Make a table for each method: the metrics of stable contact by each definition of contact."""
    groups = group_by_method(evaluations)
    return [
        _contact_table(method if len(groups) > 1 else "", _mean_metrics(group)["mean"])
        for method, group in groups.items()
    ]


def _contact_table(method: str, mean: Mapping[str, float]) -> Table:
    """Make a table of the metrics of stable contact by definition."""
    known = {key for key, value in mean.items() if not np.isnan(value)}
    shown = [
        metric
        for metric in METRICS.working().values()
        if metric.by_contact and metric.heading and any(metric.key(d) in known for d in CONTACT_DEFINITIONS)
    ]
    table = _empty_metrics_table(f"contact\n{method}".strip(), [metric.heading for metric in shown])
    for side, definitions in groupby(CONTACT_DEFINITIONS, lambda d: d.side):
        for d in definitions:
            table.add_row(f"{side} {d.distance}", *(m.text(mean.get(m.key(d), np.nan)) for m in shown))
        table.add_section()
    return table


def _empty_metrics_table(first: str, headings: list[str]) -> Table:
    from rich.text import Text

    table = make_table()
    table.add_column(Text(escape_unprintable(first, "\n")), overflow="fold", vertical="bottom")
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    return table
