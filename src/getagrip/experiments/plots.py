"""An ablation as a picture: a few metrics over its settings, a line for each method, with intervals."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.evaluation.metric import SCA, TRUE_SCA, Metric
from getagrip.experiments.comparison import CONFIDENCE_LEVEL, ComparisonRow, ComparisonTable
from getagrip.io import files
from getagrip.io.terminal import format_count

ABLATION_PLOT_METRICS = ("iou", "add_sym_success", "sca", "sca_add_sym", "sca_iou_80")
"""Names of the metrics drawn."""
N_PANELS_PER_ROW = 3
"""Panels side by side."""


def plot_ablation(table: ComparisonTable, title: str, path: Path) -> None:
    """Draw a table's rows into a PNG."""
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
            panel.plot(
                range(len(rows)),
                _percent_with_interval(rows, TRUE_SCA)[0],
                "k:",
                linewidth=1,
                label="SCA of the ground truth",
            )
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
    words = title.replace("`", "")
    figure.suptitle(
        f"{words} ({format_count(table.clips, 'clip')}, {100 * CONFIDENCE_LEVEL:.0f} % intervals)", fontsize=10
    )
    with files.new_file(path) as part:
        figure.savefig(part, dpi=130)
    plt.close(figure)


def _percent_with_interval(rows: Sequence[ComparisonRow], column: Metric) -> Float[ndarray, "3 n"]:
    """Means and ends of the intervals of a column."""
    values = [row.values[column.label] for row in rows]
    return 100.0 * np.array([(value.mean, value.low, value.high) for value in values]).T
