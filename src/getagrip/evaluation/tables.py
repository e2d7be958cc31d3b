"""Evaluations of many clips, averaged and printed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from getagrip.errors import cleaned
from getagrip.evaluation.metric import METRICS, SCA, TRUE_SCA, mean_of
from getagrip.evaluation.results import Evaluation
from getagrip.io.files import Json
from getagrip.io.terminal import plain_table
from getagrip.metrics.contact import CONTACT_DEFINITIONS, ContactDefinition

if TYPE_CHECKING:
    from rich.table import Table

_OF_OBJECT, _OF_HAND = ContactDefinition("object", 0.010), ContactDefinition("hand", 0.010)
"""Definitions of contact in the table of results: that of reports and benchmarks, and the one that any mesh has."""


def summary(evaluations: Sequence[Evaluation]) -> Json:
    """Summarise evaluations, all together and by method.

    For each metric: its mean over the clips that have it, and their number.
    """
    return {
        "samples": [evaluation.fields() for evaluation in evaluations],
        **_means(evaluations),
        "methods": {method: _means(group) for method, group in by_method(evaluations).items()},
    }


def by_method(evaluations: Sequence[Evaluation]) -> dict[str, list[Evaluation]]:
    """Group the evaluations by method."""
    methods = dict.fromkeys(e.method for e in evaluations)
    return {method: [e for e in evaluations if e.method == method] for method in methods}


def _means(evaluations: Sequence[Evaluation]) -> dict[str, Json]:
    keys = list(dict.fromkeys(key for evaluation in evaluations for key in evaluation.metrics))
    columns = {key: np.array([e.metrics.get(key, np.nan) for e in evaluations], dtype=float) for key in keys}
    return {
        "mean": {key: mean_of(values) for key, values in columns.items()},
        "clips": {key: int(np.count_nonzero(~np.isnan(values))) for key, values in columns.items()},
    }


def results_table(evaluations: Sequence[Evaluation]) -> Table:
    """Make a table of one row per result and the mean of each method.

    Columns without any value (there is no ground truth, the scale is known) are left out.
    """
    from rich.text import Text  # no markup: names may hold brackets

    groups = by_method(evaluations)
    means = {method: _means(group)["mean"] for method, group in groups.items()}
    there = _means(evaluations)["mean"]
    columns = [
        (f"{m.heading}\n{m.unit}", m, m.key(_OF_OBJECT))
        for m in METRICS.working().values()
        if m.heading and not m.by_contact
    ]
    columns += [
        (f"SCA\n{_OF_OBJECT.distance}\n%", SCA, SCA.key(_OF_OBJECT)),
        ("true\nSCA\n%", TRUE_SCA, TRUE_SCA.key(_OF_OBJECT)),
    ]
    columns = [column for column in columns if not np.isnan(there.get(column[2], np.nan))]
    if any(SCA.key(_OF_OBJECT) not in e.metrics for e in evaluations):  # a mesh that is another one in each frame
        columns.append(("hand\nSCA\n%", SCA, SCA.key(_OF_HAND)))

    def cells(metrics: Mapping[str, float]) -> list[str]:
        return [metric.text(metrics.get(key, np.nan)) for _, metric, key in columns]

    results = _table("clip", [heading for heading, _, _ in columns])
    results.caption = "; ".join(dict.fromkeys(metric.meaning for _, metric, _ in columns if metric.meaning))
    results.caption_justify = "left"
    for e in evaluations:
        name = f"{e.clip}\n{e.method}" if len(groups) > 1 else e.clip
        results.add_row(Text(cleaned(name, "\n")), *cells(e.metrics))
    if len(evaluations) > len(groups):
        results.add_section()
        for method, group in groups.items():
            of = f" ({method})" if len(groups) > 1 else ""
            results.add_row(Text(cleaned(f"mean of {len(group)}{of}")), *cells(means[method]))
    return results


def contact_tables(evaluations: Sequence[Evaluation]) -> list[Table]:
    """Make a table for each method: the metrics of stable contact by each definition of contact."""
    groups = by_method(evaluations)
    return [_contact(method if len(groups) > 1 else "", _means(group)["mean"]) for method, group in groups.items()]


def _contact(method: str, mean: Mapping[str, float]) -> Table:
    """Make a table of the metrics of stable contact by definition."""
    known = {key for key, value in mean.items() if not np.isnan(value)}
    shown = [
        metric
        for metric in METRICS.working().values()
        if metric.by_contact and metric.heading and any(metric.key(d) in known for d in CONTACT_DEFINITIONS)
    ]
    table = _table(f"contact\n{method}".strip(), [metric.heading for metric in shown])
    for side, definitions in groupby(CONTACT_DEFINITIONS, lambda d: d.side):
        for d in definitions:
            table.add_row(f"{side} {d.distance}", *(m.text(mean.get(m.key(d), np.nan)) for m in shown))
        table.add_section()
    return table


def _table(first: str, headings: list[str]) -> Table:
    from rich.text import Text

    table = plain_table()
    table.add_column(Text(cleaned(first, "\n")), overflow="fold", vertical="bottom")
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    return table
