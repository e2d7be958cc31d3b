"""The contact IOU of every pair of a sequence's frames, with its stable grasps."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.io import files
from getagrip.report.pictures.panels import LINE_COLOUR, MUTED_COLOUR, PAPER_COLOUR, RESULT_COLOUR, figure_style
from getagrip.stable_grasps.find import PairwiseIou

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

IOU_RAMP = [PAPER_COLOUR, "#c3d3de", "#6f93b0", "#2f5573", "#16283a"]
"""Colours of contact IOU, from 0 to 1."""
MAX_MATRIX_FRAMES = 1000
"""Maximum number of rows; longer sequences are drawn at every second, third, ... frame."""


def write_matrix(
    path: str | Path,
    iou: Float[ndarray, "T T"] | PairwiseIou,
    grasps: Sequence[tuple[int, int]],
    fps: float,
    tau: float,
    title: str,
    subtitle: str = "",
) -> Path:
    """Write the picture as a PNG and return its path. ``grasps``: first and last frame of each, both included."""
    with figure_style():
        figure = _draw_matrix_figure(iou, grasps, fps, tau)
        # Names are untrusted: a dollar sign must not start a formula.
        title, subtitle = _truncate_text(title, 62), _truncate_text(subtitle, 105)
        figure.text(0.085, 0.972, title, fontsize=13, fontweight="bold", va="top", parse_math=False)
        figure.text(0.085, 0.937, subtitle, fontsize=9.5, color=MUTED_COLOUR, va="top", parse_math=False)
        with files.new_file(Path(path)) as part:
            figure.savefig(part, facecolor="white")
    return Path(path)


def _truncate_text(words: str, longest: int) -> str:
    return words if len(words) <= longest else f"{words[: longest - 3]}..."


def _draw_matrix_figure(
    iou: Float[ndarray, "T T"] | PairwiseIou, grasps: Sequence[tuple[int, int]], fps: float, tau: float
) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.colors import LinearSegmentedColormap
    from matplotlib.figure import Figure

    T = len(iou)
    step = slice(None, None, -(-T // MAX_MATRIX_FRAMES))
    figure = Figure(figsize=(7.6, 8.0), dpi=130)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.085, 0.13, 0.76, 0.722))
    colours = LinearSegmentedColormap.from_list("contact", IOU_RAMP)
    # Frame n covers n to n + 1: the axes count frames from the left border of the first.
    drawn = axes.imshow(iou[step, step], extent=(0, T, T, 0), vmin=0, vmax=1, cmap=colours, interpolation="nearest")
    axes.set(xlabel="frame", xlim=(0, T), ylim=(T, 0))
    seconds = axes.secondary_xaxis("top", functions=(partial(np.multiply, 1.0 / fps), partial(np.multiply, fps)))
    seconds.set_xlabel("seconds")
    for first, last in grasps:
        _draw_grasp_square(axes, first, last + 1, T, f"{(last + 1 - first) / fps:.1f} s")

    strip = figure.add_axes((0.085, 0.06, 0.76, 0.016))
    strip.set(xlim=(0, T), ylim=(0, 1), xticks=[], yticks=[], facecolor=PAPER_COLOUR)
    for first, last in grasps:
        strip.axvspan(first, last + 1, facecolor=RESULT_COLOUR, edgecolor="white", linewidth=0.7)
    words = f"{len(grasps)} stable grasp{'' if len(grasps) == 1 else 's'}" if grasps else "no stable grasp"
    figure.text(0.085, 0.046, words, color=RESULT_COLOUR if grasps else MUTED_COLOUR, va="top")

    bar = figure.colorbar(drawn, cax=figure.add_axes((0.89, 0.13, 0.02, 0.722)))
    bar.outline.set_edgecolor(LINE_COLOUR)
    bar.ax.axhline(tau, color=RESULT_COLOUR, linewidth=2)
    ends = [end for end in (0, 1) if abs(end - tau) > 0.03]
    bar.set_ticks([*ends, tau], labels=[*map(str, ends), f"τ {tau:g}"])
    bar.ax.set_title("contact\nIOU", fontsize=8.5, color=MUTED_COLOUR, pad=8)
    return figure


def _draw_grasp_square(axes: Axes, begin: int, end: int, frames: int, words: str) -> None:
    """Draw a square on the diagonal, with its duration inside, beside a small one, and omitted for a tiny one."""
    x, y = np.array([begin, end, end, begin, begin]), np.array([begin, begin, end, end, begin])
    axes.plot(x, y, color="white", linewidth=3.0, alpha=0.8, solid_joinstyle="miter", clip_on=False)
    axes.plot(x, y, color=RESULT_COLOUR, linewidth=1.5, solid_joinstyle="miter", clip_on=False)
    size, gap = end - begin, 0.012 * frames
    if size < 0.015 * frames:
        return
    if size >= 0.12 * frames:
        at, align = (begin + gap, end - gap), ("left", "bottom")
    elif end < 0.9 * frames:
        at, align = (end + gap, (begin + end) / 2), ("left", "center")
    else:
        at, align = (begin - gap, (begin + end) / 2), ("right", "center")
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5}
    axes.text(*at, words, color=RESULT_COLOUR, ha=align[0], va=align[1], fontweight="bold", bbox=box)
