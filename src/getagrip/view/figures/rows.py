"""Results of one clip under one another: the same frames over the image, and turned, with numbers beside each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Int
from numpy import ndarray

from getagrip.errors import InputError
from getagrip.evaluation import evaluate
from getagrip.evaluation.metric import ADD_MM, ADD_SYM_MM, IOU, SCA
from getagrip.metrics.contact import ContactDefinition
from getagrip.view.figures.kind import GivenResult, doubts, evenly
from getagrip.view.sheet import HEAD, Sheet
from getagrip.view.shown import View
from getagrip.view.style import AXIS, FAINT, FOUND, HAND_LINE, TRUE
from getagrip.view.tiles import input_windows, over_image, rendered

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


def at_common_frames(results: Sequence[tuple[GivenResult, View]]) -> list[View]:
    """The results at the frames that all of them have. Raises ``InputError`` where they are not of one clip."""
    first, one = results[0]
    for given, view in results[1:]:
        if view.clip.name != one.clip.name:
            expected = f"{one.clip.name!r}, as of {first.folder}: results of one clip"
            raise InputError(given.folder / "result.json", "clip", repr(view.clip.name), expected)
        if view.clip.size != one.clip.size:
            width, height = one.clip.size
            raise InputError(view.clip.origin / "clip.json", "size", f"{view.clip.size}", f"{width} x {height}")
    common = reduce(set.intersection, (set(view.result.frames) for _, view in results))
    if not common:
        of = " and ".join(str(given.folder) for given, _ in results[1:])
        raise InputError(of, "frames", f"none of those of {first.folder}", "results that share frames")
    names = [name for name in one.result.frames if name in common]
    return [view.at(names) for _, view in results]


def distinct(results: Sequence[GivenResult]) -> list[str]:
    """What tells the folders of results apart: their paths without what all begin and end with."""
    paths = [given.folder.resolve().parts for given in results]
    if len(paths) == 1:
        return [paths[0][-1]]
    begin = _same(paths)
    end = min(_same([path[::-1] for path in paths]), *(len(path) - begin - 1 for path in paths))
    return ["/".join(path[begin : len(path) - end]) for path in paths]


def _same(paths: Sequence[Sequence[str]]) -> int:
    """Parts that all begin with."""
    alike = (len(set(parts)) == 1 for parts in zip(*paths, strict=False))
    return next((n for n, same in enumerate(alike) if not same), min(map(len, paths)))


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
