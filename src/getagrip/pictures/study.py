"""The study's figure: each measure over normalised time, inside the grasps and outside, mean and spread."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from getagrip.grasps.study import MEASURES, TIMES, Spread
from getagrip.io import files
from getagrip.pictures.style import AXIS, FAINT, FOUND, INK, LINE, letters

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INSIDE, PLAIN, AT_HAND = "#e3ecf4", "#41698c", "#7b5ea7"
PANELS: tuple[tuple[str, dict[str, tuple[str, str]]], ...] = (
    ("contact kept\nIOU with the grasp's frames", {"contact_iou": ("", PLAIN)}),
    ("finger pose\nfingertip rotation [deg]", {"fingers_turned": ("", PLAIN)}),
    (
        "object in hand\nrotation error [deg]",
        {"static_rotation": ("static", FOUND), "one_dof_rotation": ("1-DoF", AXIS)},
    ),
    ("fingertip translation [mm]", {"fingers_moved": ("", PLAIN)}),
    (
        "1-DoF of the full pose\nrotation error [deg]",
        {"free_rotation": ("axis anywhere", AXIS), "at_hand_rotation": ("axis at the hand", AT_HAND)},
    ),
    (
        "object in hand\ncentre error [mm]",
        {
            "static_place": ("static", FOUND),
            "free_place": ("axis anywhere", AXIS),
            "at_hand_place": ("axis at the hand", AT_HAND),
        },
    ),
)
"""Title, and the measures drawn under it with their names there and colours. The first row is the paper's."""


def write_study(path: str | Path, curves: Mapping[str, Sequence[Spread]], title: str, subtitle: str) -> Path:
    """Write the picture as a PNG and return its path. ``curves``: of each measure, its spread at each of ``TIMES``."""
    with letters():
        figure = _draw(curves)
        figure.text(0.055, 0.975, title, fontsize=13, fontweight="bold", va="top", parse_math=False)
        figure.text(0.055, 0.938, subtitle, fontsize=9.5, color=FAINT, va="top", parse_math=False)
        with files.new_file(Path(path)) as part:
            figure.savefig(part, facecolor="white")
    return Path(path)


def _draw(curves: Mapping[str, Sequence[Spread]]) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 7.2), dpi=130)
    FigureCanvasAgg(figure)
    for n, (title, lines) in enumerate(PANELS):
        axes = figure.add_axes((0.055 + 0.32 * (n % 3), 0.525 if n < 3 else 0.095, 0.27, 0.30))
        axes.set_title(title, loc="left", fontsize=9.5, color=INK)
        _panel(axes, curves, lines)
        if n >= 3:
            axes.set_xlabel("time, the grasp from 0 to 1")
    legend = "lines: mean over grasps · bands: middle half of them · blue: the stable grasp"
    figure.text(0.055, 0.012, f"{legend}; outside it, its axis is kept{_outside(curves)}", color=FAINT)
    return figure


def _outside(curves: Mapping[str, Sequence[Spread]]) -> str:
    """How many of the grasps have frames before and after."""
    spreads = curves["static_rotation"]
    before, after = (spreads[int(np.argmin(np.abs(TIMES - time)))].grasps for time in (-0.25, 1.25))
    return f" · at -0.25: {before} grasps, at 1.25: {after}"


def _panel(axes: Axes, curves: Mapping[str, Sequence[Spread]], lines: Mapping[str, tuple[str, str]]) -> None:
    axes.axvspan(0.0, 1.0, color=INSIDE, linewidth=0)
    for name, (label, colour) in lines.items():
        factor = MEASURES[name].factor
        low, mean, high = (
            np.array([getattr(spread, part) * factor for spread in curves[name]]) for part in ("low", "mean", "high")
        )
        axes.fill_between(TIMES, low, high, color=colour, alpha=0.18, linewidth=0)
        axes.plot(TIMES, mean, color=colour, linewidth=1.8, label=label or None)
    axes.set(xlim=(TIMES[0], TIMES[-1]), xticks=[-0.5, 0.0, 0.5, 1.0, 1.5])
    highest = 1.0 if MEASURES[next(iter(lines))].unit == "" else axes.get_ylim()[1]
    axes.set_ylim(0.0, highest * (1.0 + 0.11 * len(lines) * (len(lines) > 1)))  # room for the names
    axes.grid(axis="y", color=LINE, linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)
    if len(lines) > 1:
        axes.legend(frameon=False, loc="upper left", handlelength=1.4)
