"""Results of one clip in rows, each with the same frames over the image and from the side, and with its metrics.

``Methods`` compares methods, after the paper's qualitative comparison; ``Hands`` compares hand estimators, after its
figure of HaMeR and FrankMocap.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Int
from numpy import ndarray

from getagrip.bench.figures.kind import (
    Count,
    Fail,
    FigureKind,
    Millimetres,
    describe_findings,
    describe_view,
    evenly_spaced_indices,
    read_readable_results,
    summarise_view,
)
from getagrip.clip import input_sha256
from getagrip.errors import InputError, UsageError
from getagrip.fitting.methods import label_of
from getagrip.metrics.contact import ContactDefinition, contact_definitions_at
from getagrip.metrics.evaluate import evaluate
from getagrip.metrics.evaluate.metric import ADD_MM, ADD_SYM_MM, IOU, SCA
from getagrip.report.pictures.panels import (
    AXIS_COLOUR,
    HAND_LINE_COLOUR,
    MUTED_COLOUR,
    RESULT_COLOUR,
    SHEET_TITLE_INCHES,
    TRUTH_COLOUR,
    Sheet,
    draw_over_image,
    draw_rendered,
    input_windows,
)
from getagrip.report.pictures.result_view import View
from getagrip.report.pictures.stored_results import StoredResult, at_common_frames, distinct_path_parts

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ROW_TILE_INCHES, ROW_GAP_INCHES, ROW_LABEL_INCHES = 1.55, 0.06, 1.75
"""Side of a tile, gap between tiles, and width of a row's label [in]."""


@dataclass(frozen=True)
class FigureRow:
    """A result with its label and formatted metrics."""

    name: str
    numbers: Sequence[str]
    view: View


@dataclass(frozen=True, kw_only=True)
class RowsFigure(FigureKind):
    """Results of one clip under one another."""

    frames: Count = 3
    """Frames to draw."""
    contact: Millimetres = 10.0
    """Points of the object within MM of the hand's surface are in contact, in SCA."""


@dataclass(frozen=True, kw_only=True)
class Methods(RowsFigure):
    """Results of several methods for one clip: frames over the image and from the side; IOU, SCA and ADD."""

    truth: bool = True
    """Draw the ground truth as the last row, where it is known."""

    def draw(self, results: Sequence[StoredResult], fail: Fail) -> Figure:
        (contact,) = contact_definitions_at([self.contact])
        read = read_readable_results(results, fail)
        views = at_common_frames(read)
        _check_equal_inputs(read)
        labels = [label_of(view.result.method) for view in views]
        folders = distinct_path_parts([value for value, _ in read])
        names = [f"{a}\n{b}" if Counter(labels)[a] > 1 else a for a, b in zip(labels, folders, strict=True)]
        rows = [FigureRow(name, row_metrics(view, contact), view) for name, view in zip(names, views, strict=True)]
        if self.truth and (true := views[0].true()) is not None:
            rows.append(FigureRow("ground truth", row_metrics(true, contact)[:2], true))
        under = "  ·  ".join([*describe_view(views[0]), f"SCA: {contact.description}"])
        return draw_rows(rows, views[0].clip.name, under, self.frames, self.dpi, with_hand=False)


@dataclass(frozen=True, kw_only=True)
class Hands(RowsFigure):
    """Results for one clip with the hands of several estimators: the input hand and the object that was found with it.

    Results of bench --hands, or each with its own clip folder, with the same clip's name and frames but other hands.
    Rows are named after the part in which the paths of the results differ.
    """

    def draw(self, results: Sequence[StoredResult], fail: Fail) -> Figure:
        (contact,) = contact_definitions_at([self.contact])
        read = read_readable_results(results, fail)
        views = at_common_frames(read)
        methods = {view.result.method for view in views}
        if len(methods) > 1:
            raise UsageError(f"RESULT must be of one method (got {' and '.join(sorted(methods))}); see methods")
        names = [name.rpartition("+hands-")[2] for name in distinct_path_parts([value for value, _ in read])]
        rows = [FigureRow(name, row_metrics(view, contact), view) for name, view in zip(names, views, strict=True)]
        under = "  ·  ".join([summarise_view(views[0]), f"SCA: {contact.description}"])
        return draw_rows(rows, views[0].clip.name, under, self.frames, self.dpi, with_hand=True)


def _check_equal_inputs(read: Sequence[tuple[StoredResult, View]]) -> None:
    """Refuse results that were made with different hands, masks or meshes."""
    first, clip = read[0][0], read[0][1].clip
    for value, view in read[1:]:
        if view.clip.origin != clip.origin and input_sha256(view.clip.origin) != input_sha256(clip.origin):
            expected = f"those of {first.folder}; the figure hands compares hands"
            raise InputError(value.folder, "", f"a result of other hands or masks, in {view.clip.origin}", expected)


def row_metrics(view: View, contact: ContactDefinition) -> list[str]:
    """Return crop IOU, stable contact area, ADD (with ground truth, also up to symmetries) and findings, as texts."""
    shown = {"crop IOU": IOU, "SCA": SCA, "ADD": ADD_MM, "ADD sym.": ADD_SYM_MM}
    known = evaluate(view.result, view.clip, view.masks, [contact], tuple(shown.values())).metrics
    keys = {name: metric.key(contact) for name, metric in shown.items()}
    texts = [f"{name} {shown[name].text(known[k])} {shown[name].unit}" for name, k in keys.items() if k in known]
    return texts + describe_findings(view)


def draw_rows(
    rows: Sequence[FigureRow], title: str, under: str, frames: int, dpi: int, with_hand: bool,
    among: Int[ndarray, "m"] | None = None,
) -> Figure:  # fmt: skip
    """Draw a figure of rows.

    All rows have the same frames; ``frames`` of them are drawn, evenly spaced over ``among`` (None: all), optionally
    with the hand's contour.
    """
    among = np.arange(len(rows[0].view.result.frames)) if among is None else among
    chosen = among[evenly_spaced_indices(frames, len(among))]
    width = ROW_LABEL_INCHES + 2 * len(chosen) * (ROW_TILE_INCHES + ROW_GAP_INCHES) + 0.25 + 0.1
    top = SHEET_TITLE_INCHES + 0.45
    sheet = Sheet.of(max(width, 7.0), top + len(rows) * (ROW_TILE_INCHES + ROW_GAP_INCHES) + 0.45, dpi)
    sheet.title(title, under)
    turned = ROW_LABEL_INCHES + len(chosen) * (ROW_TILE_INCHES + ROW_GAP_INCHES) + 0.25
    _draw_row_headings(sheet, rows[0].view, chosen, turned)
    crops = input_windows([row.view for row in rows], chosen, sheet.pixels(ROW_TILE_INCHES))
    for r, row in enumerate(rows):
        y = top + r * (ROW_TILE_INCHES + ROW_GAP_INCHES)
        words = [part for line in row.name.splitlines() for part in wrap(line, 16)][:3]
        sheet.text(0.25, y + 0.08, "\n".join(words), fontsize=10, fontweight="bold", linespacing=1.2)
        sheet.text(0.25, y + 0.16 + 0.17 * len(words), "\n".join(row.numbers), linespacing=1.5)
        for k, n in enumerate(chosen):
            step = k * (ROW_TILE_INCHES + ROW_GAP_INCHES)
            tile = sheet.tile(ROW_LABEL_INCHES + step, y, ROW_TILE_INCHES)
            draw_over_image(tile, row.view, int(n), crops, k, with_hand)
            draw_rendered(sheet.tile(turned + step, y, ROW_TILE_INCHES), row.view, int(n), crops, k, from_side=True)
    lines = [(RESULT_COLOUR, "contour of the posed object")] + [(HAND_LINE_COLOUR, "of the hand")] * with_hand
    if any(row.view.result.axis is not None for row in rows):
        lines.append((AXIS_COLOUR, "latent axis, pale where hidden"))
    sheet.legend(0.25, sheet.height - 0.36, lines)
    return sheet.figure


def _draw_row_headings(sheet: Sheet, view: View, chosen: Int[ndarray, "n"], turned: float) -> None:
    front = "over the masks" if view.image_file(0) is None else "over the image"
    for left, words in ((ROW_LABEL_INCHES, front), (turned, "from the side")):
        sheet.text(left, SHEET_TITLE_INCHES + 0.02, words, color=TRUTH_COLOUR, fontsize=9.5)
        for k, n in enumerate(chosen):
            x = left + k * (ROW_TILE_INCHES + ROW_GAP_INCHES) + ROW_TILE_INCHES / 2
            sheet.text(x, SHEET_TITLE_INCHES + 0.25, view.result.frames[n], color=MUTED_COLOUR, ha="center")
