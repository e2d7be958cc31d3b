"""Results of one clip under one another: the same frames over the image, and turned, with numbers beside each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Int
from numpy import ndarray

from getagrip.evaluation import evaluate
from getagrip.evaluation.metric import ADD_MM, ADD_SYM_MM, IOU, SCA
from getagrip.metrics.contact import ContactDefinition
from getagrip.pictures.figures.kind import doubts, evenly
from getagrip.pictures.sheet import HEAD, Sheet
from getagrip.pictures.shown import View
from getagrip.pictures.style import AXIS, FAINT, FOUND, HAND_LINE, TRUE
from getagrip.pictures.tiles import input_windows, over_image, rendered

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SIDE, GAP, LABEL = 1.55, 0.06, 1.75
"""Of a tile, between tiles, and of the words beside a row [in]."""


@dataclass(frozen=True)
class Row:
    """A result, what it is called, and numbers about it."""

    name: str
    numbers: Sequence[str]
    view: View


def numbers(view: View, contact: ContactDefinition) -> list[str]:
    """Crop IOU and stable contact area; where ground truth is known, ADD, also up to symmetries; how many findings."""
    shown = {"crop IOU": IOU, "SCA": SCA, "ADD": ADD_MM, "ADD sym.": ADD_SYM_MM}
    known = evaluate(view.result, view.clip, view.masks, [contact], tuple(shown.values())).metrics
    texts = []
    for name, metric in shown.items():
        if (key := metric.key(contact)) in known:
            texts.append(f"{name} {metric.text(known[key])} {metric.unit}")
    return texts + doubts(view)


def draw_rows(rows: Sequence[Row], title: str, under: str, frames: int, dpi: int, with_hand: bool) -> Figure:
    """The figure. ``rows`` show the same frames, of which ``frames`` are drawn; the hand's contour where wanted."""
    chosen = np.array(evenly(frames, len(rows[0].view.result.frames)))
    width = LABEL + 2 * len(chosen) * (SIDE + GAP) + 0.25 + 0.1
    top = HEAD + 0.45
    sheet = Sheet.of(max(width, 7.0), top + len(rows) * (SIDE + GAP) + 0.45, dpi)
    sheet.title(title, under)
    turned = LABEL + len(chosen) * (SIDE + GAP) + 0.25
    _headings(sheet, rows[0].view, chosen, turned)
    crops = input_windows([row.view for row in rows], chosen, sheet.pixels(SIDE))
    for r, row in enumerate(rows):
        y = top + r * (SIDE + GAP)
        words = [part for line in row.name.splitlines() for part in wrap(line, 16)][:3]
        sheet.text(0.25, y + 0.08, "\n".join(words), fontsize=10, fontweight="bold", linespacing=1.2)
        sheet.text(0.25, y + 0.16 + 0.17 * len(words), "\n".join(row.numbers), linespacing=1.5)
        for k, n in enumerate(chosen):
            step = k * (SIDE + GAP)
            over_image(sheet.tile(LABEL + step, y, SIDE), row.view, int(n), crops, k, with_hand)
            rendered(sheet.tile(turned + step, y, SIDE), row.view, int(n), crops, k, from_side=True)
    lines = [(FOUND, "contour of the posed object")] + [(HAND_LINE, "of the hand")] * with_hand
    if any(row.view.result.axis is not None for row in rows):
        lines.append((AXIS, "latent axis, pale where hidden"))
    sheet.legend(0.25, sheet.height - 0.36, lines)
    return sheet.figure


def _headings(sheet: Sheet, view: View, chosen: Int[ndarray, "n"], turned: float) -> None:
    """What the tiles show, and the frames' names."""
    for x, words in (
        (LABEL, "over the masks" if view.image_file(0) is None else "over the image"),
        (turned, "from the side"),
    ):
        sheet.text(x, HEAD + 0.02, words, color=TRUE, fontsize=9.5)
        for k, n in enumerate(chosen):
            sheet.text(
                x + k * (SIDE + GAP) + SIDE / 2, HEAD + 0.25, view.result.frames[n], color=FAINT, ha="center"
            )  # fmt: skip
