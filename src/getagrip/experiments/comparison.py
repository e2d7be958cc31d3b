"""Scores of many clips made into rows: means with intervals, differences in pairs, best and second best."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.evaluation.metric import METRICS, Metric
from getagrip.experiments.settings import Arm
from getagrip.experiments.statistics import Estimate, estimate, resamples
from getagrip.experiments.trials import Score, Scores

COLUMNS = tuple(metric for metric in METRICS if metric.label)
"""The paper's metrics, and up to the object's symmetries."""


@dataclass(frozen=True)
class Row:
    """An arm over some clips."""

    arm: Arm
    values: dict[str, Estimate]
    """Means by label of the metric, 0 to 1."""
    differences: dict[str, Estimate]
    """Mean differences in pairs from the arm that it is compared with; empty for that arm itself."""
    seconds: float
    """Median for a clip."""
    failed: int


@dataclass(frozen=True)
class Table:
    """All arms over the same clips: all of them, or those of a category."""

    title: str
    clips: int
    columns: tuple[Metric, ...]
    """Those for which there are values."""
    rows: tuple[Row, ...]

    def ranks(self, column: Metric) -> list[int]:
        """For each row 1 if its value, as it is printed, is the best of the column, 2 the second best, else 0.

        Rows are rivals only where they count contact alike; where all are alike, none is best.
        """
        shown = [round(100.0 * row.values[column.label].mean, 1) for row in self.rows]
        ranks = []
        for row, value in zip(self.rows, shown, strict=True):
            rivals = {v for v, other in zip(shown, self.rows, strict=True) if other.arm.contact == row.arm.contact}
            best = sorted(rivals - {np.nan}, reverse=True)[:2]
            ranks.append(best.index(value) + 1 if column.ranked and len(best) > 1 and value in best else 0)
        return ranks


def compare(scores: Sequence[Scores], arms: Sequence[Arm]) -> list[Table]:
    """A table over all clips, and one for each category where there are several."""
    scores = [clip for clip in scores if clip.scores]
    if not scores:
        return []
    weights = resamples(groups(scores))
    tables = [_table("all", scores, arms, weights)]
    categories = sorted({clip.category for clip in scores})
    for category in categories if len(categories) > 1 else []:
        own = np.array([clip.category == category for clip in scores])
        tables.append(_table(category, [c for c, mine in zip(scores, own, strict=True) if mine], arms, weights[:, own]))
    return tables


def groups(scores: Sequence[Scores]) -> list[str]:
    """What the bootstrap draws: subjects where every clip has one and there are several, else clips."""
    subjects = [clip.subject for clip in scores]
    return subjects if all(subjects) and len(set(subjects)) > 1 else [clip.clip for clip in scores]


def _table(title: str, scores: Sequence[Scores], arms: Sequence[Arm], weights: Float[ndarray, "B n"]) -> Table:
    cells = {arm.label: {column.label: _values(scores, arm, column) for column in COLUMNS} for arm in arms}
    there = tuple(c for c in COLUMNS if any(not np.isnan(values[c.label]).all() for values in cells.values()))
    rows = []
    for arm in arms:
        own, other = cells[arm.label], cells.get(arm.against)
        compared = other is not None and arm.label != arm.against
        rows.append(
            Row(
                arm,
                {c.label: estimate(own[c.label], weights) for c in there},
                {c.label: estimate(own[c.label] - other[c.label], weights) for c in there}
                if other is not None and compared
                else {},
                _median([score.seconds for clip in scores if (score := _score(clip, arm)) and not score.failed]),
                sum(score.failed for clip in scores if (score := _score(clip, arm))),
            )
        )
    return Table(title, len(scores), there, tuple(rows))


def _score(clip: Scores, arm: Arm) -> Score | None:
    return next((score for score in clip.scores if score.arm == arm.folder), None)


def _values(scores: Sequence[Scores], arm: Arm, column: Metric) -> Float[ndarray, "n"]:
    """A column's value for each clip; where the method failed it is zero, the worst, so that no failure flatters."""
    key, values = column.key(arm.contact), np.full(len(scores), np.nan)
    for n, clip in enumerate(scores):
        score = _score(clip, arm)
        if score is None:
            continue
        if score.failed and column.ranked and (clip.true or not column.needs_truth):
            values[n] = 0.0
        else:
            values[n] = score.metrics.get(key, np.nan)
    return values


def _median(values: Sequence[float]) -> float:
    return float(np.median(values)) if values else float("nan")
