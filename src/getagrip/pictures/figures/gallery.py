"""Results of many clips, the best and the worst by a metric: successes and failures, after the paper's gallery."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from getagrip.errors import GetagripError, InputError, UsageError
from getagrip.evaluation import evaluate
from getagrip.evaluation.metric import ADD_MM, ADD_SYM_MM, IOU, ROTATION_SYM, SCA, Metric
from getagrip.fitting.methods import label_of
from getagrip.metrics.contact import ContactDefinition
from getagrip.pictures.figures.kind import Count, Fail, Kind, guesses, warnings
from getagrip.pictures.sheet import HEAD, Sheet
from getagrip.pictures.stored_results import StoredResult
from getagrip.pictures.style import AXIS, FAINT, FOUND, INK
from getagrip.pictures.tiles import input_windows, over_image, rendered

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CONTACT = ContactDefinition("object", 0.010)
"""Definition of contact of SCA."""
METRICS: dict[str, tuple[str, Metric]] = {
    "iou": ("crop IOU", IOU),
    "sca": (f"SCA within {CONTACT.distance}", SCA),
    "add": ("ADD", ADD_MM),
    "add-sym": ("ADD sym.", ADD_SYM_MM),
    "rotation-sym": ("rotation sym.", ROTATION_SYM),
}
"""Metrics that results are ordered by, and their names in the figure. Shares are better if larger, errors if
smaller."""
COLUMNS, SIDE, GAP, HEADING, LINES = 3, 1.5, 0.18, 0.34, 0.42
"""Clips beside one another; a tile, between clips, over a group of clips and over a clip [in]."""
MOST = 60


@dataclass(frozen=True)
class _Scored:
    """A result that can be read, its value of the metric, and the frame to show: its worst."""

    stored: StoredResult
    value: float
    worst: int


@dataclass(frozen=True, kw_only=True)
class Gallery(Kind):
    """The worst and the best results of many clips by a metric: the worst frame of each, over the image and turned."""

    by: Literal["iou", "sca", "add", "add-sym", "rotation-sym"] = "iou"
    """The metric. Results that lack its ground truth are left out."""
    show: Literal["both", "worst", "best"] = "both"
    """The worst N and the best N, or only those."""
    n: Count = 6
    """Results in a group."""

    def check(self) -> None:
        super().check()
        if not 1 <= self.n <= MOST:
            raise UsageError(f"--n must be 1 to {MOST} (got {self.n})")

    def draw(self, results: Sequence[StoredResult], fail: Fail) -> Figure:
        name, metric = METRICS[self.by]
        scored = self._scored(results, fail)
        order = sorted(scored, key=lambda one: one.value, reverse=metric.unit != "%")  # the worst first
        groups = self._groups(order)
        rows = sum(-(-len(group) // COLUMNS) for _, group in groups)
        height = HEAD + len(groups) * HEADING + rows * (LINES + SIDE + 0.1) + 0.42
        columns = max(2, min(COLUMNS, max(len(group) for _, group in groups)))
        sheet = Sheet.of(0.25 + columns * (2 * SIDE + GAP) + 0.1, height, self.dpi)
        values = np.array([one.value for one in scored])
        middle = f"median {metric.text(float(np.median(values)))} {_unit(metric)}"
        by = " by IOU" if metric is SCA else ""
        sheet.title(f"{len(scored)} results by {name}", f"{middle}  ·  the worst frame of each{by}")
        top = HEAD
        for heading, group in groups:
            sheet.text(0.25, top + 0.03, heading, fontsize=11, fontweight="bold", color=INK)
            top += HEADING
            for k, one in enumerate(group):
                x = 0.25 + k % COLUMNS * (2 * SIDE + GAP)
                y = top + k // COLUMNS * (LINES + SIDE + 0.1)
                try:
                    self._clip(sheet, x, y, one, f"{name} {metric.text(one.value)} {_unit(metric)}")
                except (GetagripError, OSError) as error:  # an image that cannot be read
                    fail(error)
            top += -(-len(group) // COLUMNS) * (LINES + SIDE + 0.1)
        lines = [
            (FOUND, "contour of the posed object"),
            (AXIS, "latent axis, if any; pale where hidden"),
        ]
        sheet.legend(0.25, height - 0.34, lines)
        return sheet.figure

    def _scored(self, results: Sequence[StoredResult], fail: Fail) -> list[_Scored]:
        """Score the results that have a value of the metric; one at a time in memory, since masks are large."""
        out, errors = [], []
        for stored in results:
            try:
                out.append(self._score(stored))
            except (GetagripError, OSError) as error:
                errors.append(error)
        if not out:
            raise errors[0]
        for problem in errors:
            fail(problem)
        return out

    def _score(self, stored: StoredResult) -> _Scored:
        """Return a result's value of the metric, and its worst frame. Raises ``InputError`` where it has none."""
        metric, view = METRICS[self.by][1], stored.read()
        if metric.needs_truth and view.clip.truth is None:
            raise InputError(view.clip.origin / "truth.npz", "", "no ground truth", f"some, for --by {self.by}")
        if metric is IOU and view.masks is None:
            raise InputError(view.clip.origin / "masks", "", "no masks", f"some, for --by {self.by}")
        made, key = evaluate(view.result, view.clip, view.masks, [CONTACT], [metric]), metric.key(CONTACT)
        value = float(made.metrics.get(key, np.nan))
        if np.isnan(value):
            raise InputError(stored.folder, "", f"a result without {self.by}", "one that has it: two frames or more")
        errors = np.array(made.per_frame.get(key, view.result.iou), dtype=float)
        if key not in made.per_frame or metric.unit == "%":  # more is better
            errors = -errors
        return _Scored(stored, value, int(np.nanargmax(errors)) if not np.isnan(errors).all() else 0)

    def _groups(self, order: Sequence[_Scored]) -> list[tuple[str, Sequence[_Scored]]]:
        """Headings and results, none of them twice."""
        if self.show == "worst" or len(order) == 1:
            return [("worst first", order[: self.n])]
        if self.show == "best":
            return [("best first", order[::-1][: self.n])]
        worst = min(self.n, len(order) // 2)
        best = min(self.n, len(order) - worst)
        return [("worst", order[:worst]), ("best", order[::-1][:best])]

    def _clip(self, sheet: Sheet, x: float, y: float, one: _Scored, words: str) -> None:
        view, n = one.stored.read(), one.worst
        label = label_of(view.result.method)
        sheet.text(x, y + 0.02, view.clip.name, 2 * SIDE, fontsize=8.5, fontweight="bold")
        facts = [words, label, *guesses(view), *warnings(view), f"frame {view.result.frames[n]}"]
        sheet.text(x, y + 0.20, "  ·  ".join(facts), 2 * SIDE, fontsize=8, color=FAINT)
        crops = input_windows([view], np.array([n]), sheet.pixels(SIDE))
        over_image(sheet.tile(x, y + LINES, SIDE), view, n, crops, 0)
        rendered(sheet.tile(x + SIDE, y + LINES, SIDE), view, n, crops, 0, from_side=True)


def _unit(metric: Metric) -> str:
    return {"deg": "°"}.get(metric.unit, metric.unit)
