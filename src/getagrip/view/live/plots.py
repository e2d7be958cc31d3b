"""Curves over the frames as SVG, with a line at the frame that is shown; a press on a curve jumps there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from getagrip.view.style import FAINT, INK, LINE

WIDTH, HEIGHT = 400, 102
LEFT, RIGHT, TOP, BOTTOM = 36, 8, 22, 14
"""Margins of the field in which curves are drawn [px]."""
MOST_NUMBERS = 4
"""Beside a plot's title."""
COLOURS = ("#2a7f9e", "#c8553d", "#7b5ea7", "#d19a2a", "#4f8a4f", "#a0466f")
"""Of the columns, in their order."""


@dataclass(frozen=True, eq=False)
class Curve:
    """A number of each frame; NaN where it is not known. ``colour`` is any of SVG; a faint curve is dashed."""

    name: str
    values: Float[ndarray, "T"]
    colour: str
    faint: bool = False


@dataclass(frozen=True, eq=False)
class Plot:
    """Curves in one field, of one unit."""

    title: str
    unit: str
    curves: Sequence[Curve]
    limits: tuple[float, float] | None = None
    """The lowest and the highest value shown; otherwise all values are."""

    def svg(self, n: int, press: str = "") -> str:
        """The plot with frame ``n`` marked. ``press`` is JavaScript run where it is pressed, the frame in ``frame``."""
        low, high = self._limits()
        T = len(self.curves[0].values)
        x = LEFT + np.arange(T) / max(T - 1, 1) * (WIDTH - LEFT - RIGHT)

        def y(value: Float[ndarray, "..."]) -> Float[ndarray, "..."]:
            share = (np.clip(value, low, high) - low) / (high - low)
            return np.asarray(HEIGHT - BOTTOM - share * (HEIGHT - TOP - BOTTOM))

        parts = [_text(LEFT, 12, self.title, INK, "start", 11.5)]
        for value in (low, high):
            height = float(y(np.array(value)))
            parts.append(f'<path d="M{LEFT} {height:.1f}H{WIDTH - RIGHT}" stroke="{LINE}"/>')
            parts.append(_text(LEFT - 4, height + 3.5, f"{value:.3g}", FAINT, "end"))
        if low < 0.0 < high:
            parts.append(f'<path d="M{LEFT} {float(y(np.array(0.0))):.1f}H{WIDTH - RIGHT}" stroke="{LINE}"/>')
        parts.append(f'<path d="M{x[n]:.1f} {TOP - 4}V{HEIGHT - BOTTOM}" stroke="{INK}" stroke-opacity="0.55"/>')
        for curve in self.curves:
            dashes = ' stroke-dasharray="4 3"' if curve.faint else ""
            path = _path(x, y(curve.values))
            parts.append(f'<path d="{path}" fill="none" stroke="{curve.colour}" stroke-width="1.6"{dashes}/>')
            if np.isfinite(curve.values[n]):
                dot = f'cx="{x[n]:.1f}" cy="{y(curve.values)[n]:.1f}" r="3"'
                parts.append(f'<circle {dot} fill="{curve.colour}"/>')
        parts.append(self._numbers(n))
        parts.append(
            _text(LEFT, HEIGHT - 3, "frame 1", FAINT, "start") + _text(WIDTH - RIGHT, HEIGHT - 3, str(T), FAINT)
        )
        at = f"(event.clientX-b.left)/b.width*{WIDTH}-{LEFT}"
        share = f"Math.min(Math.max(({at})/{WIDTH - LEFT - RIGHT},0),1)"
        script = f"const b=this.getBoundingClientRect(),frame=1+Math.round({share}*{T - 1});{press}"
        return (
            f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" style="display:block;width:100%;cursor:pointer;touch-action:none" '
            f'font-family="sans-serif" onpointerdown="{escape(script)}">{"".join(parts)}</svg>'
        )

    def _limits(self) -> tuple[float, float]:
        if self.limits is not None:
            return self.limits
        known = np.concatenate([curve.values[np.isfinite(curve.values)] for curve in self.curves])
        low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
        return (low, high) if high - low > 1e-6 else (low - 0.5, high + 0.5)

    def _numbers(self, n: int) -> str:
        """The values in frame ``n``, each in its colour; of many, there is no room for any."""
        if len(self.curves) > MOST_NUMBERS:
            return ""
        spans = [
            f'<tspan fill="{curve.colour}" dx="7">{curve.values[n]:.1f}</tspan>'
            for curve in self.curves
            if np.isfinite(curve.values[n])
        ]
        unit = f'<tspan fill="{FAINT}" dx="3">{escape(self.unit)}</tspan>' if spans else ""
        return f'<text x="{WIDTH - RIGHT}" y="12" font-size="11" text-anchor="end">{"".join(spans)}{unit}</text>'


def legend(curves: Sequence[Curve]) -> str:
    """The curves' names in their colours, as HTML."""
    names = [f'<span style="color:{c.colour}">{"╌" if c.faint else "━"} {escape(c.name)}</span>' for c in curves]
    style = "font:12px sans-serif;padding:2px 0 6px;display:flex;gap:14px;flex-wrap:wrap"
    return f'<div style="{style}">{"".join(names)}</div>'


def _path(x: Float[ndarray, "T"], y: Float[ndarray, "T"]) -> str:
    """A line through the points that are known, broken where one is not."""
    words, pen = [], "M"
    for a, b in zip(x, y, strict=True):
        if not np.isfinite(b):
            pen = "M"
            continue
        words.append(f"{pen}{a:.1f} {b:.1f}")
        pen = "L"
    return "".join(words) or "M0 0"


def _text(x: float, y: float, words: str, colour: str, anchor: str = "end", size: float = 9.5) -> str:
    at = f'x="{x:.1f}" y="{y:.1f}" font-size="{size}" fill="{colour}" text-anchor="{anchor}"'
    return f"<text {at}>{escape(words)}</text>"
