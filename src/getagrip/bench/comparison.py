"""Compare the scores of variants over many clips: means and paired differences with intervals, ranks, and a plot.

Intervals of means are by Student's t over groups of clips; other statistics have bootstrap resamples.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray
from scipy.special import stdtrit

from getagrip.bench.ablations import Variant
from getagrip.bench.job import ClipScores
from getagrip.io import files
from getagrip.io.terminal import format_count
from getagrip.metrics.evaluate.metric import ADD_SYM, METRICS, SCA, TRUE_SCA, Group, Metric

PAPER_METRIC_GROUPS: tuple[Group, ...] = ("paper",)
N_BOOTSTRAP_RESAMPLES = 2000
CONFIDENCE_LEVEL = 0.95
MIN_INTERVAL_CLIPS = 5
"""Minimum number of clips for an interval: the interval of two would just span both values."""
ABLATION_PLOT_METRICS = ("iou", "add_sym_success", "sca", "sca_add_sym", "sca_iou_80")
"""Names of the metrics of a plot."""
N_PANELS_PER_ROW = 3


@dataclass(frozen=True)
class GraspVariantScore:
    """The score of a variant on a clip."""

    variant: str
    """The variant's folder."""
    metrics: dict[str, float]
    """Values by metric; empty where the variant failed."""
    seconds: float
    energy: float
    ambiguous: bool
    status: str
    failed: bool = False
    again: str = ""
    """Reason why an earlier result was replaced."""
    serious: tuple[str, ...] = ()
    """Names of the checks with serious findings."""
    noted: tuple[str, ...] = ()
    """Names of the checks with other findings."""
    probability_right: float | None = None
    """Probability that the poses are right in the hand; None without a calibrated one."""
    probability_right_in_camera: float | None = None
    keep: float | None = None
    """Largest ``--keep`` that keeps the result, in the hand."""
    keep_in_camera: float | None = None


@dataclass(frozen=True)
class GraspClipScores(ClipScores):
    """The scores of all variants on a clip."""

    category: str = ""
    subject: str = ""
    """Person whose hand it is; empty where unknown."""
    has_truth: bool = False
    """True if the clip has ground truth."""
    scores: tuple[GraspVariantScore, ...] = ()
    made: int = 0
    """Number of new results."""


def mean_columns(groups: Sequence[Group] = PAPER_METRIC_GROUPS) -> tuple[Metric, ...]:
    """Return the metrics of some groups that tables show as means."""
    return tuple(m for m in METRICS.working().values() if _is_in_groups(m, groups) and m.unit == "%" and not m.folded)


def folded_columns() -> tuple[Metric, ...]:
    """Return the metrics whose means pages fold away."""
    return tuple(metric for metric in METRICS.working().values() if metric.folded)


def error_columns(groups: Sequence[Group] = PAPER_METRIC_GROUPS) -> tuple[Metric, ...]:
    """Return the metrics that tables show as medians: of some groups, and always the paper's."""
    groups = (*groups, *PAPER_METRIC_GROUPS)
    return tuple(m for m in METRICS.working().values() if _is_in_groups(m, groups) and m.unit != "%")


def _is_in_groups(metric: Metric, groups: Sequence[Group]) -> bool:
    return bool(metric.label) and metric.group in groups


@dataclass(frozen=True)
class ComparisonRow:
    """The scores of a variant over some clips."""

    variant: Variant
    values: dict[str, MeanEstimate]
    """Means by label of the metric, 0 to 1."""
    differences: dict[str, MeanEstimate]
    """Mean paired differences from the baseline variant, by label; empty for the baseline."""
    medians: dict[str, float]
    """Medians of ``error_columns``, by label, over clips on which the method did not fail."""
    ambiguous: int
    """Number of ambiguous results."""
    wrong: int
    """Number of results with a wrong pose, up to symmetries."""
    wrong_ambiguous: int
    """Number of wrong, ambiguous results."""
    serious: dict[str, int]
    """Number of clips with a serious finding, by check."""
    flagged: int
    """Number of results with a serious finding."""
    flagged_right: int
    """Number of flagged results with a right pose."""
    noted: dict[str, int]
    """Number of clips with a note, by check."""
    seconds: float
    """Median time of a clip [s]."""
    failed: int
    tried: int

    @property
    def has_failed(self) -> bool:
        """True if the method failed on every clip: the row has no values."""
        return self.failed == self.tried > 0


@dataclass(frozen=True)
class ComparisonTable:
    """The rows of all variants over the same clips: all clips, or a category's."""

    title: str
    clips: int
    columns: tuple[Metric, ...]
    """Metrics with values."""
    folded: tuple[Metric, ...]
    """Metrics of ``folded_columns`` that the clips allow."""
    rows: tuple[ComparisonRow, ...]

    def ranks(self, column: Metric) -> list[int]:
        """Rank the printed values of a column: 1 for the best, 2 for the second best, else 0.

        Rows are ranked among rows of the same definition of contact; equal values have no best one.
        """
        shown = [round(100.0 * row.values[column.label].mean, 1) for row in self.rows]
        ranks = []
        for row, value in zip(self.rows, shown, strict=True):
            alike = [other.variant.contact == row.variant.contact for other in self.rows]
            rivals = {v for v, rival in zip(shown, alike, strict=True) if rival and not np.isnan(v)}
            best = sorted(rivals, reverse=True)[:2]
            ranks.append(best.index(value) + 1 if column.ranked and len(best) > 1 and value in best else 0)
        return ranks


def compare_variants(
    scores: Sequence[GraspClipScores],
    variants: Sequence[Variant],
    shown: Sequence[Group] = PAPER_METRIC_GROUPS,
    part_of: Callable[[GraspClipScores], str] = lambda clip: clip.category,
) -> list[ComparisonTable]:
    """Make a table over all clips, and one for each of several parts (default: categories).

    ``shown`` are the groups of metrics in the columns.
    """
    scores = [clip for clip in scores if clip.scores]
    if not scores:
        return []
    groups = independent_groups(scores)
    tables = [_comparison_table("all", scores, variants, groups, shown)]
    parts = sorted({part_of(clip) for clip in scores})
    for part in parts if len(parts) > 1 else []:
        own = [n for n, clip in enumerate(scores) if part_of(clip) == part]
        tables.append(_comparison_table(part, [scores[n] for n in own], variants, [groups[n] for n in own], shown))
    return tables


def independent_groups(scores: Sequence[GraspClipScores]) -> list[str]:
    """Return the independent group of each clip: its subject if all clips have one of several, else its name."""
    subjects = [clip.subject for clip in scores]
    return subjects if all(subjects) and len(set(subjects)) > 1 else [clip.name for clip in scores]


def _comparison_table(
    title: str, scores: Sequence[GraspClipScores], variants: Sequence[Variant], groups: Sequence[str],
    shown: Sequence[Group],
) -> ComparisonTable:  # fmt: skip
    means = (*mean_columns(shown), *folded_columns())
    cells = {v.label: {column.label: _column_values(scores, v, column) for column in means} for v in variants}
    known = tuple(c for c in mean_columns(shown) if not all(np.isnan(row[c.label]).all() for row in cells.values()))
    folded = tuple(c for c in folded_columns() if not c.needs_truth or any(clip.has_truth for clip in scores))
    labels = [column.label for column in (*known, *folded)]
    rows = []
    for variant in variants:
        own, other = cells[variant.label], cells.get(variant.against)
        tried = [score for clip in scores if (score := _score_of_variant(clip, variant))]
        done = [score for score in tried if not score.failed]
        wrong = [score for score in done if _is_correct_pose(score, variant) is False]
        errors = {
            e.label: [score.metrics.get(e.key(variant.contact), np.nan) for score in done] for e in error_columns(shown)
        }
        differences = dict[str, MeanEstimate]()
        if other is not None and variant.label != variant.against:
            differences = {label: estimate_mean(own[label] - other[label], groups) for label in labels}
        rows.append(
            ComparisonRow(
                variant,
                values={label: estimate_mean(own[label], groups) for label in labels},
                differences=differences,
                medians={label: _nan_median(values) for label, values in errors.items()},
                ambiguous=sum(score.ambiguous for score in done),
                wrong=len(wrong),
                wrong_ambiguous=sum(score.ambiguous for score in wrong),
                serious=_count_names([score.serious for score in done]),
                flagged=sum(bool(score.serious) for score in done),
                flagged_right=sum(bool(score.serious) for score in done if _is_correct_pose(score, variant)),
                noted=_count_names([score.noted for score in done]),
                seconds=_nan_median([score.seconds for score in done]),
                failed=len(tried) - len(done),
                tried=len(tried),
            )
        )
    return ComparisonTable(title, len(scores), known, folded, tuple(rows))


def _score_of_variant(clip: GraspClipScores, variant: Variant) -> GraspVariantScore | None:
    return next((score for score in clip.scores if score.variant == variant.folder), None)


def _is_correct_pose(score: GraspVariantScore, variant: Variant) -> bool | None:
    """Return whether the pose is right up to symmetries; None where unknown."""
    success = score.metrics.get(ADD_SYM.key(variant.contact), np.nan)
    return None if np.isnan(success) else bool(success)


def _count_names(names: Sequence[tuple[str, ...]]) -> dict[str, int]:
    """Count each name, the most frequent first."""
    return dict(Counter(name for some in names for name in some).most_common())


def _column_values(scores: Sequence[GraspClipScores], variant: Variant, column: Metric) -> Float[ndarray, "n"]:
    """Return a column's value for each clip, NaN where unknown.

    A failed clip has the worst value, 0, so that failures improve no score. All values are NaN if the method failed on
    every clip (0 would look measured), or if a result was evaluated before the metric existed (a mean would mislead).
    """
    key, values = column.key(variant.contact), np.full(len(scores), np.nan)
    if not any(key in score.metrics for clip in scores for score in clip.scores):
        return values
    tried = [(n, clip, score) for n, clip in enumerate(scores) if (score := _score_of_variant(clip, variant))]
    if column.needs_truth and any(c.has_truth and not s.failed and key not in s.metrics for _, c, s in tried):
        return values
    if all(score.failed for _, _, score in tried):
        return values
    for n, clip, score in tried:
        if score.failed and column.ranked and (clip.has_truth or not column.needs_truth):
            values[n] = 0.0
        else:
            values[n] = score.metrics.get(key, np.nan)
    return values


def _nan_median(values: Sequence[float]) -> float:
    """Return the median of the values that are not NaN; NaN if none is."""
    known = [value for value in values if not np.isnan(value)]
    return float(np.median(known)) if known else float("nan")


@dataclass(frozen=True)
class MeanEstimate:
    """A mean over clips with its interval; NaN without values."""

    mean: float
    low: float
    high: float
    clips: int


def bootstrap_resamples(groups: Sequence[str]) -> Float[ndarray, "B n"]:
    """Draw the count of each clip in each bootstrap resample.

    Clips of a group (subject) are drawn together, since they are not independent. With a group for each clip this is
    the plain bootstrap.
    """
    names, member = np.unique(np.asarray(groups), return_inverse=True)
    rng = np.random.default_rng(0)
    drawn = rng.multinomial(len(names), np.full(len(names), 1.0 / len(names)), size=N_BOOTSTRAP_RESAMPLES)
    return drawn[:, member].astype(float)


def estimate_mean(values: Float[ndarray, "n"], groups: Sequence[str]) -> MeanEstimate:
    """Estimate the mean of the values that are not NaN, with an interval that holds for few groups.

    Clips of a group (subject) are not independent: the interval is Student's t with one degree of freedom less than
    the number of groups, and the standard error that of a ratio, from the groups' sums of deviations from the mean.

    The interval is NaN for fewer than ``MIN_INTERVAL_CLIPS`` values, for equal values (100 % of ten clips is no
    certainty), and for a single group.
    """
    known = ~np.isnan(values)
    n = int(known.sum())
    if not n:
        return MeanEstimate(float("nan"), float("nan"), float("nan"), 0)
    x = values[known]
    mean = float(x.mean())
    names, member = np.unique(np.asarray(groups)[known], return_inverse=True)
    G = len(names)
    if n < MIN_INTERVAL_CLIPS or not np.ptp(x) or G < 2:
        return MeanEstimate(mean, float("nan"), float("nan"), n)
    deviations = np.bincount(member, x - mean)
    error = float(np.sqrt(G / (G - 1) * np.sum(deviations**2))) / n
    wide = float(stdtrit(G - 1, (1.0 + CONFIDENCE_LEVEL) / 2.0)) * error
    return MeanEstimate(mean, mean - wide, mean + wide, n)


def plot_ablation(table: ComparisonTable, title: str, path: Path) -> None:
    """Draw a few metrics over an ablation's settings into a PNG: a line for each method, with intervals."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    columns = [column for column in table.columns if column.name in ABLATION_PLOT_METRICS]
    methods = list(dict.fromkeys(row.variant.group for row in table.rows))
    steps = list(dict.fromkeys(row.variant.step for row in table.rows))
    down = -(-(len(columns) + 1) // N_PANELS_PER_ROW)  # one panel is the legend's
    width = max(3.0, 0.35 * len(steps) + 1.2)
    slanted = max(map(len, steps)) * len(steps) > 25
    height = 2.9 + slanted * 0.04 * max(0, max(map(len, steps)) - 12)  # slanted labels hang down
    figure, grid = plt.subplots(
        down, N_PANELS_PER_ROW, figsize=(width * N_PANELS_PER_ROW, height * down), layout="constrained"
    )
    panels = grid.ravel()
    turn = {"rotation": 40, "ha": "right", "rotation_mode": "anchor"} if slanted else {}
    for panel, column in zip(panels, columns, strict=False):
        for n, method in enumerate(methods):
            rows = [row for row in table.rows if row.variant.group == method]
            mean, low, high = _percent_with_interval(rows, column)
            x = np.array([steps.index(row.variant.step) for row in rows]) + 0.12 * (n - (len(methods) - 1) / 2)
            bars = np.nan_to_num([mean - low, high - mean])  # no interval, no bar
            dots = panel.errorbar(x, mean, bars, fmt="o", markersize=4, elinewidth=1.2, capsize=2, label=method)
            panel.plot(x, mean, linewidth=1, alpha=0.5, color=dots[0].get_color())
        if column is SCA and TRUE_SCA in table.columns:
            rows = [row for row in table.rows if row.variant.group == methods[0]]
            true = _percent_with_interval(rows, TRUE_SCA)[0]
            panel.plot(range(len(rows)), true, "k:", linewidth=1, label="SCA of the ground truth")
            panel.legend(handles=panel.lines[-1:], fontsize=8, frameon=False)
        bottom, top = panel.get_ylim()
        panel.set_ylim(max(bottom, -2.0), min(top, 102.0))
        panel.set_title(f"{column.label}, %", fontsize=10)
        panel.set_xticks(range(len(steps)), steps, fontsize=8, **turn)
        panel.tick_params(axis="y", labelsize=8)
        panel.grid(axis="y", alpha=0.3)
        panel.spines[["top", "right"]].set_visible(False)
    for panel in panels[len(columns) :]:
        panel.axis("off")
    panels[len(columns)].legend(*panels[0].get_legend_handles_labels(), fontsize=9, frameon=False, loc="center left")
    about = f"{format_count(table.clips, 'clip')}, {100 * CONFIDENCE_LEVEL:.0f} % intervals"
    figure.suptitle(f"{title.replace('`', '')} ({about})", fontsize=10)
    with files.new_file(path) as part:
        figure.savefig(part, dpi=130)
    plt.close(figure)


def _percent_with_interval(rows: Sequence[ComparisonRow], column: Metric) -> Float[ndarray, "3 n"]:
    """Return means and ends of the intervals of a column, in per cent."""
    values = [row.values[column.label] for row in rows]
    return 100.0 * np.array([(value.mean, value.low, value.high) for value in values]).T
