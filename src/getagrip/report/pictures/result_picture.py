"""The report of a result in one picture: tiles of the images and renderings, above plots of angle and IOU over time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np

from getagrip.clip import Clip, Masks, check_masks
from getagrip.errors import check_arguments
from getagrip.fitting.methods import label_of
from getagrip.io import files
from getagrip.metrics.evaluate.metric import ADD_MM, ADD_SYM_MM, IOU_OF_VIEW, ROTATION_SYM, nan_mean
from getagrip.report.pictures.panels import (
    AXIS_COLOUR,
    INK_COLOUR,
    LINE_COLOUR,
    MUTED_COLOUR,
    PAPER_COLOUR,
    RESULT_COLOUR,
    TRUTH_COLOUR,
    Sheet,
    content_windows,
    draw_over_image,
    draw_rendered,
    figure_style,
)
from getagrip.report.pictures.result_view import View, angle_curve, result_times
from getagrip.result import Reconstruction
from getagrip.result.findings import format_probability

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

N_REPORT_TILES, REPORT_TILE_PX, FINDING_LINE_CHARACTERS, VIEW_NAME_CHARACTERS = 5, 320, 150, 18
RENDERED_ROWS = ("result, from the camera", "result, from the side")
TITLE_METRICS = {"ADD": ADD_MM, "ADD sym.": ADD_SYM_MM, "rotation": ROTATION_SYM}
"""Metrics in the title, each under a short name."""


@check_arguments
def write_report(
    result: Reconstruction,
    clip: Clip,
    masks: Masks | None,
    path: str | Path,
    metrics: Mapping[str, float] | None = None,
) -> Path:
    """Write a picture of a result as a PNG file: silhouettes, the axis in two views, angle and IOU over time.

    Args:
        result: the reconstruction.
        clip: the clip that was reconstructed. Its images are drawn if its folder has them.
        masks: masks of all frames of the clip; None to leave them out.
        path: the file to write.
        metrics: metrics to print in the picture (``Evaluation.metrics``).

    Returns:
        The path of the file.

    Raises the errors of ``report_figure``.
    """
    figure = report_figure(result, clip, masks, metrics)
    with files.new_file(Path(path)) as part:
        figure.savefig(part, format="png", facecolor="white")
    return Path(path)


def report_figure(
    result: Reconstruction, clip: Clip, masks: Masks | None, metrics: Mapping[str, float] | None = None
) -> Figure:
    """Draw the report as a matplotlib figure: rows of tiles, one column a frame, above two plots over time.

    The rows show the image, that of each further view, and renderings from the camera and from the side.

    ``clip`` and ``masks`` may have more frames than the result. ``metrics`` are those of ``evaluate``, of which the
    title shows ``TITLE_METRICS``. Without images in the clip's folder the masks are drawn. Raises ``InputError`` for a
    frame of the result that the clip lacks, ``UsageError`` for masks of another clip or an unknown method.
    """
    if masks is not None:
        check_masks(clip, masks)
    index = clip.index_of(result.frames)
    view = View.of(result, clip.take(index), None if masks is None else masks.take(index))
    return _draw_report(view, metrics or {})


def _draw_report(view: View, metrics: Mapping[str, float]) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with figure_style():
        left, right, gap, tile = 0.62, 0.25, 0.08, 2.3  # inches
        width = left + right + N_REPORT_TILES * tile + (N_REPORT_TILES - 1) * gap
        found = [str(finding) for finding in view.result.findings]
        lines = [line for text in found for line in wrap(text, FINDING_LINE_CHARACTERS)]
        rows = [("input and fitted contour", view), *_rows_of_views(view, metrics)]
        head, foot, plots, between = 1.22 + 0.2 * len(lines), 0.48, 1.75, 0.62
        tiles = (len(rows) + len(RENDERED_ROWS)) * (tile + gap) - gap
        height = head + tiles + between + plots + foot
        figure = Figure(figsize=(width, height), dpi=130)
        FigureCanvasAgg(figure)
        sheet = Sheet(figure, width, height, 130)
        _draw_report_title(figure, view, metrics, left / width, 1.0 - 0.2 / height, 0.27 / height)
        figure.text(left / width, 1.0 - 1.02 / height, "\n".join(lines), color=RESULT_COLOUR, fontsize=9.5, va="top")
        frames = np.unique(np.linspace(0, len(view.result.frames) - 1, N_REPORT_TILES).round().astype(int))
        for row, (label, seen) in enumerate([*rows, *((label, view) for label in RENDERED_ROWS)]):
            top, crops = head + row * (tile + gap), content_windows([seen], frames, REPORT_TILE_PX)
            beside: dict[str, Any] = {"rotation": 90, "ha": "center", "va": "center", "parse_math": False}
            figure.text(0.35 / width, 1.0 - (top + tile / 2) / height, label, **beside)
            for k, n in enumerate(frames):
                axes = sheet.axes(left + k * (tile + gap), top, tile, tile)
                limits = {"xlim": (0, REPORT_TILE_PX), "ylim": (REPORT_TILE_PX, 0)}
                axes.set(xticks=[], yticks=[], facecolor=PAPER_COLOUR, **limits)
                if row == 0:
                    axes.set_title(view.result.frames[n], fontsize=8.5, color=MUTED_COLOUR, pad=4)
                if row < len(rows):
                    draw_over_image(axes, seen, int(n), crops, k)
                else:
                    draw_rendered(axes, seen, int(n), crops, k, from_side=row > len(rows))
        top = head + tiles + between
        half = (width - left - right - 0.75) / 2.0
        _angle_plot(sheet.axes(left, top, half, plots), view)
        _iou_plot(sheet.axes(left + half + 0.75, top, half, plots), view)
    return figure


def _rows_of_views(view: View, metrics: Mapping[str, float]) -> list[tuple[str, View]]:
    """Return the words beside each further view, its name and its mean IOU where known, and what its camera sees."""
    rows = []
    for name, seen in view.in_each_view().items():
        met = metrics.get(f"{IOU_OF_VIEW}{name}")
        met = nan_mean(seen.measured_iou()) if met is None else met
        known = "" if np.isnan(met) else f", IOU {100 * met:.1f} %"
        rows.append((f"{name[:VIEW_NAME_CHARACTERS]}{'...' * (len(name) > VIEW_NAME_CHARACTERS)}{known}", seen))
    return rows


def _draw_report_title(
    figure: Figure, view: View, metrics: Mapping[str, float], x: float, y: float, step: float
) -> None:
    result, clip = view.result, view.clip
    title = figure.text(x, y, clip.name, fontsize=15, fontweight="bold", va="top")
    hand = f"{clip.side} hand" if clip.other_hand is None else "both hands"
    facts = "  ·  ".join([label_of(result.method), view.frames_in_words, hand, *view.size_in_words])
    line = figure.text(x, y - 1.25 * step, facts, color=MUTED_COLOUR, fontsize=9.5, va="top")
    said = "  ·  ".join(filter(None, (result.message, result.looks)))
    figure.text(x, y - 2.0 * step, said, color=INK_COLOUR, fontsize=9.5, va="top")

    numbers = [("IOU", f"{100 * result.mean_iou:.1f} %")]
    if known := result.probabilities:
        frames = ", ".join(f"{where.split()[-1]}{'*' if one.beyond else ''}" for where, one in known.items())
        numbers.append((f"probability: {frames}", ", ".join(format_probability(one.value) for one in known.values())))
    for name, metric in TITLE_METRICS.items():
        if metric.name in metrics:
            unit = "°" if metric.unit == "deg" else f" {metric.unit}"
            numbers.append((name, f"{metric.text(metrics[metric.name])}{unit}"))
    if "total" in result.seconds:
        numbers.append(("time", f"{result.seconds['total']:.2f} s"))
    right = end = 0.98
    for name, number in numbers[::-1]:
        value = figure.text(right, y, number, fontsize=15, va="top", ha="right")
        label = figure.text(right, y - 1.25 * step, name, fontsize=9.5, color=MUTED_COLOUR, va="top", ha="right")
        widest = max(text.get_window_extent().width for text in (value, label))
        end = right - widest / figure.bbox.width - 0.012
        right = min(right - 0.092, end)
    for text, size, room in ((title, 15.0, right - x), (line, 9.5, end - x)):
        too_wide = text.get_window_extent().width / figure.bbox.width / room
        text.set_fontsize(size / max(too_wide, 1.0))
    if result.ambiguous:
        warning = "ambiguous: another pose explains the masks almost as well"
        figure.text(0.98, y - 2.0 * step, warning, color=RESULT_COLOUR, fontsize=9.5, va="top", ha="right")


def _style_time_axes(axes: Axes, title: str) -> None:
    axes.set_title(title, loc="left", fontsize=9.5, color=INK_COLOUR, pad=6)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    axes.grid(axis="y", color=LINE_COLOUR, linewidth=0.6)
    axes.tick_params(length=0)
    axes.set_xlabel("time [s]")
    axes.margins(x=0.01)


def _angle_plot(axes: Axes, view: View) -> None:
    t, curve = result_times(view), angle_curve(view)
    _style_time_axes(axes, f"{curve.title} [°]")
    if curve.true is not None:
        true = np.degrees(curve.true)
        axes.plot(t, true, color=TRUTH_COLOUR, linewidth=1.4, linestyle=(0, (4, 2)), label="ground truth")
    axes.plot(t, np.degrees(curve.found), color=AXIS_COLOUR, linewidth=2.0, label="reconstructed")
    if curve.true is not None:
        axes.legend(frameon=False, ncols=2, loc="lower right", bbox_to_anchor=(1.0, 0.98), borderpad=0.0)


def _iou_plot(axes: Axes, view: View) -> None:
    _style_time_axes(axes, "overlap of the object with its mask (IOU)")
    t, iou = result_times(view), view.result.iou
    axes.axhline(view.result.mean_iou, color=LINE_COLOUR, linewidth=1.2)
    axes.plot(t, iou, color=RESULT_COLOUR, linewidth=2.0)
    sampled = view.result.frames_of("sampled")
    if len(sampled) < len(t):
        axes.plot(t[sampled], iou[sampled], ".", color=RESULT_COLOUR, markersize=5, label="fitted together")
        axes.legend(frameon=False, loc="lower right", bbox_to_anchor=(1.0, 0.98), borderpad=0.0)
    axes.set_ylim(min(0.8, float(np.floor(10.0 * np.nanmin(iou)) / 10.0)), 1.0)
