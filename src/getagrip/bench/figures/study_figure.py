"""The study's figure: mean and spread of each measure over normalised time, inside and outside the grasps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from getagrip.io import files
from getagrip.report.pictures.panels import (
    AXIS_COLOUR,
    INK_COLOUR,
    LINE_COLOUR,
    MUTED_COLOUR,
    RESULT_COLOUR,
    figure_style,
)
from getagrip.stable_grasps.study import NORMALISED_TIMES, STUDY_MEASURES, Spread

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

GRASP_BAND_COLOUR, MEASURE_COLOUR, HAND_MEASURE_COLOUR = "#e3ecf4", "#41698c", "#7b5ea7"
STUDY_PANELS: tuple[tuple[str, dict[str, tuple[str, str]]], ...] = (
    ("contact kept\nIOU with the grasp's frames", {"contact_iou": ("", MEASURE_COLOUR)}),
    ("finger pose\nfingertip rotation [deg]", {"fingers_turned": ("", MEASURE_COLOUR)}),
    (
        "object in hand\nrotation error [deg]",
        {"static_rotation": ("static", RESULT_COLOUR), "one_dof_rotation": ("1-DoF", AXIS_COLOUR)},
    ),
    ("fingertip translation [mm]", {"fingers_moved": ("", MEASURE_COLOUR)}),
    (
        "1-DoF of the full pose\nrotation error [deg]",
        {
            "free_rotation": ("axis anywhere", AXIS_COLOUR),
            "at_hand_rotation": ("axis at the hand", HAND_MEASURE_COLOUR),
        },
    ),
    (
        "object in hand\ncentre error [mm]",
        {
            "static_place": ("static", RESULT_COLOUR),
            "free_place": ("axis anywhere", AXIS_COLOUR),
            "at_hand_place": ("axis at the hand", HAND_MEASURE_COLOUR),
        },
    ),
)
"""Panels: a title, and its measures with their labels and colours. The first row is the paper's."""


def write_study(path: str | Path, curves: Mapping[str, Sequence[Spread]], title: str, subtitle: str) -> Path:
    """Write the picture as a PNG and return its path.

    ``curves`` are the spreads at ``NORMALISED_TIMES``, by measure.
    """
    with figure_style():
        figure = _draw_study(curves)
        figure.text(0.055, 0.975, title, fontsize=13, fontweight="bold", va="top", parse_math=False)
        figure.text(0.055, 0.938, subtitle, fontsize=9.5, color=MUTED_COLOUR, va="top", parse_math=False)
        with files.new_file(Path(path)) as part:
            figure.savefig(part, facecolor="white")
    return Path(path)


def _draw_study(curves: Mapping[str, Sequence[Spread]]) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 7.2), dpi=130)
    FigureCanvasAgg(figure)
    for n, (title, lines) in enumerate(STUDY_PANELS):
        axes = figure.add_axes((0.055 + 0.32 * (n % 3), 0.525 if n < 3 else 0.095, 0.27, 0.30))
        axes.set_title(title, loc="left", fontsize=9.5, color=INK_COLOUR)
        _draw_study_panel(axes, curves, lines)
        if n >= 3:
            axes.set_xlabel("time, the grasp from 0 to 1")
    legend = "lines: mean over grasps · bands: middle half of them · blue: the stable grasp"
    figure.text(0.055, 0.012, f"{legend}; outside it, its axis is kept{_describe_coverage(curves)}", color=MUTED_COLOUR)
    return figure


def _describe_coverage(curves: Mapping[str, Sequence[Spread]]) -> str:
    """Describe the number of grasps with frames before and after."""
    spreads = curves["static_rotation"]
    before, after = (spreads[int(np.argmin(np.abs(NORMALISED_TIMES - time)))].grasps for time in (-0.25, 1.25))
    return f" · at -0.25: {before} grasps, at 1.25: {after}"


def _draw_study_panel(axes: Axes, curves: Mapping[str, Sequence[Spread]], lines: Mapping[str, tuple[str, str]]) -> None:
    axes.axvspan(0.0, 1.0, color=GRASP_BAND_COLOUR, linewidth=0)
    for name, (label, colour) in lines.items():
        factor = STUDY_MEASURES[name].factor
        bounds = [(spread.low * factor, spread.mean * factor, spread.high * factor) for spread in curves[name]]
        low, mean, high = np.array(bounds).T
        axes.fill_between(NORMALISED_TIMES, low, high, color=colour, alpha=0.18, linewidth=0)
        axes.plot(NORMALISED_TIMES, mean, color=colour, linewidth=1.8, label=label or None)
    axes.set(xlim=(NORMALISED_TIMES[0], NORMALISED_TIMES[-1]), xticks=[-0.5, 0.0, 0.5, 1.0, 1.5])
    highest = 1.0 if STUDY_MEASURES[next(iter(lines))].unit == "" else axes.get_ylim()[1]
    axes.set_ylim(0.0, highest * (1.0 + 0.11 * len(lines) * (len(lines) > 1)))  # room for the legend
    axes.grid(axis="y", color=LINE_COLOUR, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    if len(lines) > 1:
        axes.legend(frameon=False, loc="upper left", handlelength=1.4)
