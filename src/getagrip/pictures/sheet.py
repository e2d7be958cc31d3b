"""A figure that is laid out in inches from its top left corner, with titles, square tiles and a legend."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from getagrip.pictures.style import INK_COLOUR, LINE_COLOUR, MUTED_COLOUR, PAPER_COLOUR

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SHEET_TITLE_INCHES = 0.78
"""Height of the title and the line under it [in]."""


@dataclass(frozen=True, eq=False)
class Sheet:
    """A figure and its size [in]; ``dpi`` pixels an inch."""

    figure: Figure
    width: float
    height: float
    dpi: int

    @staticmethod
    def of(width: float, height: float, dpi: int) -> Sheet:
        """Make an empty sheet; its size is rounded up to whole pixels."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        width, height = np.ceil(width * dpi) / dpi, np.ceil(height * dpi) / dpi
        figure = Figure(figsize=(width, height), dpi=dpi, facecolor="white")
        FigureCanvasAgg(figure)
        return Sheet(figure, width, height, dpi)

    def pixels(self, inches: float) -> int:
        """Return the pixels of a length."""
        return round(inches * self.dpi)

    def axes(self, x: float, top: float, width: float, height: float) -> Axes:
        """Add axes at a place."""
        return self.figure.add_axes(
            (x / self.width, 1.0 - (top + height) / self.height, width / self.width, height / self.height)
        )

    def tile(self, x: float, top: float, side: float) -> Axes:
        """Add square axes without ticks, which count pixels."""
        size, axes = self.pixels(side), self.axes(x, top, side, side)
        axes.set(xticks=[], yticks=[], xlim=(0, size), ylim=(size, 0), facecolor=PAPER_COLOUR)
        return axes

    def text(self, x: float, top: float, words: str, within: float = np.inf, **style: Any) -> None:
        """Write words at a place, as they are: a dollar sign in a name begins no formula.

        Words that are wider than ``within`` [in] are shortened in the middle: names of clips differ at their ends.
        """
        style = {"va": "top", "color": INK_COLOUR} | style
        text = self.figure.text(x / self.width, 1.0 - top / self.height, words, parse_math=False, **style)
        kept = len(words)
        while kept > 1 and text.get_window_extent().width > within * self.dpi:
            kept -= 1
            text.set_text(f"{words[: (kept + 1) // 2].rstrip()}...{words[len(words) - kept // 2 :].lstrip()}")

    def title(self, words: str, under: str) -> None:
        """Write the title, and a line under it; ``SHEET_TITLE_INCHES`` is their height."""
        self.text(0.25, 0.17, words, self.width - 0.4, fontsize=13, fontweight="bold")
        self.text(0.25, 0.47, under, self.width - 0.4, fontsize=9.5, color=MUTED_COLOUR)

    def legend(self, x: float, top: float, entries: Sequence[tuple[str, str]], style: str = "line") -> None:
        """Draw colours and the meaning of each, side by side: as lines, dots or squares."""
        from matplotlib.lines import Line2D

        drawn = {
            "line": partial(Line2D, linewidth=2.0),
            "dots": partial(Line2D, linewidth=2.0, linestyle=(0, (1, 1.2))),
            "square": partial(Line2D, linewidth=0.0, marker="s", markersize=8.0),
        }
        handles = [drawn[style]([], [], color=colour) for colour, _ in entries]
        axes = self.axes(x, top, self.width - x - 0.1, 0.22)
        axes.set_axis_off()
        axes.legend(
            handles, [words for _, words in entries], loc="center left", bbox_to_anchor=(0.0, 0.5), ncols=len(entries),
            frameon=False, borderpad=0.0, borderaxespad=0.0, handlelength=1.6, columnspacing=1.6,
        )  # fmt: skip


def draw_border(axes: Axes, colour: str = LINE_COLOUR, width: float = 0.8) -> None:
    """Draw a border of a colour around axes."""
    for spine in axes.spines.values():
        spine.set(edgecolor=colour, linewidth=width)
