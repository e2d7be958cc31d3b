"""The folded tables on the page of a result: everything that is known but not shown above."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from getagrip.checks import input_checks, result_checks
from getagrip.checks.of_timeline import JUMP
from getagrip.evaluation.metric import METRICS, Metric
from getagrip.evaluation.results import Evaluation
from getagrip.io.files import Json
from getagrip.metrics.contact import CONTACT_DEFINITIONS
from getagrip.pictures.shown import View
from getagrip.result import Reconstruction

SAID = {"iou": "iou, in the crop", "iou_soft": "iou_soft, in the crop"}
"""Metrics whose keys could be taken for the IOU at the top of the page."""


def tables(view: View, evaluation: Evaluation, record: Json) -> list[dict[str, object]]:
    """Return tables as ``parts/report.js`` reads them: a title, names of columns or none, and rows of texts."""
    result = view.result
    known = {metric.key(contact): metric for metric in METRICS.working().values() for contact in CONTACT_DEFINITIONS}
    values = [
        [f"{SAID.get(key, key)}{where}", f"{known[key].text(value)}{unit_of(known[key])}"]
        for metrics, where in ((evaluation.metrics, ""), (evaluation.metrics_of_grasps, ", in grasps"))
        for key, value in metrics.items()
        if key in known
    ]
    content = {
        "What the probabilities mean": _rows(meanings(result)),
        "Metrics (docs/metrics.md)": values,
        "Checks (docs/checks.md)": _checked(result.checks),
        "Energy [px²]": _rows(result.energy),
        "Time [s]": _rows(result.seconds),
        "Options": [*_rows(result.options), ["seed", str(result.seed)]] if result.options else [],
        "Sources of the clip": _rows(view.clip.provenance),
        "Software": _rows(record.get("software", {})),
    }
    heads = {"Checks (docs/checks.md)": ("check", "value", "usual", "verdict")}
    return [{"title": title, "head": heads.get(title, ()), "rows": rows} for title, rows in content.items() if rows]


def meanings(result: Reconstruction) -> dict[str, str]:
    """Explain its probabilities at length, by where; of a timeline, that of its grasps."""
    of_grasps = [segment.probability_right for segment in result.segments if segment.probability_right is not None]
    known = [*result.probabilities.items(), *(("in the hand", right) for right in of_grasps[:1])]
    return {f"right {where}": right.meaning for where, right in known}


def unit_of(metric: Metric) -> str:
    """Return a metric's unit as it follows a number."""
    return "°" if metric.unit == "deg" else f" {metric.unit}"


def _checked(checks: Mapping[str, float]) -> list[list[str]]:
    """Return each check's value, its limits and its verdict; for an unknown one the value alone."""
    known = {check.name: check for check in (*input_checks(), *result_checks(), JUMP)}
    out = []
    for name, value in checks.items():
        check = known.get(name)
        if check is None:
            out.append([name, f"{value:.3g}", "", ""])
        else:
            out.append([name, "" if np.isnan(value) else check.shown(value), check.usual, check.verdict(value)])
    return out


def _rows(content: Mapping[str, object]) -> list[list[str]]:
    """Names and values as texts."""
    return [[str(key), f"{value:.4g}" if isinstance(value, float) else str(value)] for key, value in content.items()]
