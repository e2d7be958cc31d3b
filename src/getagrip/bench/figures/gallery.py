"""The best and the worst results of many clips by a metric, after the paper's gallery."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from getagrip.bench.figures.kind import Count, Fail, FigureKind, describe_findings, list_assumptions
from getagrip.errors import GetagripError, InputError, UsageError
from getagrip.fitting.methods import label_of
from getagrip.metrics.contact import ContactDefinition
from getagrip.metrics.evaluate import evaluate
from getagrip.metrics.evaluate.metric import ADD_MM, ADD_SYM_MM, IOU, ROTATION_SYM, SCA, Metric
from getagrip.report.pictures.panels import (
    AXIS_COLOUR,
    INK_COLOUR,
    MUTED_COLOUR,
    RESULT_COLOUR,
    SHEET_TITLE_INCHES,
    Sheet,
    draw_over_image,
    draw_rendered,
    input_windows,
)
from getagrip.report.pictures.stored_results import StoredResult

if TYPE_CHECKING:
    from matplotlib.figure import Figure

GALLERY_SCA_CONTACT = ContactDefinition("object", 0.010)
GALLERY_METRICS: dict[str, tuple[str, Metric]] = {
    "iou": ("crop IOU", IOU),
    "sca": (f"SCA within {GALLERY_SCA_CONTACT.distance}", SCA),
    "add": ("ADD", ADD_MM),
    "add-sym": ("ADD sym.", ADD_SYM_MM),
    "rotation-sym": ("rotation sym.", ROTATION_SYM),
}
"""Metrics to order results by, with their names in the figure. Larger shares and smaller errors are better."""
GALLERY_COLUMNS, MAX_GALLERY_RESULTS = 3, 60
GALLERY_TILE_INCHES, GALLERY_GAP_INCHES, GALLERY_HEADING_INCHES, GALLERY_CAPTION_INCHES = 1.5, 0.18, 0.34, 0.42
"""Side of a tile, gap between clips, height of a group's heading and of a clip's caption [in]."""


@dataclass(frozen=True)
class _ScoredResult:
    """A readable result, its value of the metric, and its worst frame."""

    stored: StoredResult
    value: float
    worst: int


@dataclass(frozen=True, kw_only=True)
class Gallery(FigureKind):
    """The worst and the best results of many clips by a metric: the worst frame of each, over the image and turned."""

    by: Literal["iou", "sca", "add", "add-sym", "rotation-sym"] = "iou"
    """The metric. Results that lack its ground truth are left out."""
    show: Literal["both", "worst", "best"] = "both"
    """The worst N and the best N, or only those."""
    n: Count = 6
    """Results in a group."""

    def check(self) -> None:
        super().check()
        if not 1 <= self.n <= MAX_GALLERY_RESULTS:
            raise UsageError(f"--n must be 1 to {MAX_GALLERY_RESULTS} (got {self.n})")

    def draw(self, results: Sequence[StoredResult], fail: Fail) -> Figure:
        name, metric = GALLERY_METRICS[self.by]
        scored = self._scored(results, fail)
        order = sorted(scored, key=lambda one: one.value, reverse=metric.unit != "%")  # the worst first
        groups = self._groups(order)
        rows = sum(-(-len(group) // GALLERY_COLUMNS) for _, group in groups)
        row_height = GALLERY_CAPTION_INCHES + GALLERY_TILE_INCHES + 0.1
        height = SHEET_TITLE_INCHES + len(groups) * GALLERY_HEADING_INCHES + rows * row_height + 0.42
        columns = max(2, min(GALLERY_COLUMNS, max(len(group) for _, group in groups)))
        sheet = Sheet.of(0.25 + columns * (2 * GALLERY_TILE_INCHES + GALLERY_GAP_INCHES) + 0.1, height, self.dpi)
        values = np.array([one.value for one in scored])
        middle = f"median {metric.text(float(np.median(values)))} {_metric_unit_symbol(metric)}"
        by = " by IOU" if metric is SCA else ""
        sheet.title(f"{len(scored)} results by {name}", f"{middle}  ·  the worst frame of each{by}")
        top = SHEET_TITLE_INCHES
        for heading, group in groups:
            sheet.text(0.25, top + 0.03, heading, fontsize=11, fontweight="bold", color=INK_COLOUR)
            top += GALLERY_HEADING_INCHES
            for k, one in enumerate(group):
                x = 0.25 + k % GALLERY_COLUMNS * (2 * GALLERY_TILE_INCHES + GALLERY_GAP_INCHES)
                y = top + k // GALLERY_COLUMNS * row_height
                try:
                    self._clip(sheet, x, y, one, f"{name} {metric.text(one.value)} {_metric_unit_symbol(metric)}")
                except (GetagripError, OSError) as error:  # an unreadable image
                    fail(error)
            top += -(-len(group) // GALLERY_COLUMNS) * row_height
        axis = (AXIS_COLOUR, "latent axis, if any; pale where hidden")
        sheet.legend(0.25, height - 0.34, [(RESULT_COLOUR, "contour of the posed object"), axis])
        return sheet.figure

    def _scored(self, results: Sequence[StoredResult], fail: Fail) -> list[_ScoredResult]:
        """Score the results with a value of the metric, one at a time in memory, since masks are large."""
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

    def _score(self, stored: StoredResult) -> _ScoredResult:
        """Compute a result's metric and its worst frame. Raises ``InputError`` where the metric is undefined."""
        metric, view = GALLERY_METRICS[self.by][1], stored.read()
        if metric.needs_truth and view.clip.truth is None:
            raise InputError(view.clip.origin / "truth.npz", "", "no ground truth", f"some, for --by {self.by}")
        if metric is IOU and view.masks is None:
            raise InputError(view.clip.origin / "masks", "", "no masks", f"some, for --by {self.by}")
        scores = evaluate(view.result, view.clip, view.masks, [GALLERY_SCA_CONTACT], [metric])
        key = metric.key(GALLERY_SCA_CONTACT)
        value = float(scores.metrics.get(key, np.nan))
        if np.isnan(value):
            raise InputError(stored.folder, "", f"a result without {self.by}", "one that has it: two frames or more")
        errors = np.array(scores.per_frame.get(key, view.result.iou), dtype=float)
        if key not in scores.per_frame or metric.unit == "%":  # larger is better
            errors = -errors
        return _ScoredResult(stored, value, int(np.nanargmax(errors)) if not np.isnan(errors).all() else 0)

    def _groups(self, order: Sequence[_ScoredResult]) -> list[tuple[str, Sequence[_ScoredResult]]]:
        """Return headings and results, each result once."""
        if self.show == "worst" or len(order) == 1:
            return [("worst first", order[: self.n])]
        if self.show == "best":
            return [("best first", order[::-1][: self.n])]
        worst = min(self.n, len(order) // 2)
        best = min(self.n, len(order) - worst)
        return [("worst", order[:worst]), ("best", order[::-1][:best])]

    def _clip(self, sheet: Sheet, x: float, y: float, one: _ScoredResult, words: str) -> None:
        view, n = one.stored.read(), one.worst
        label = label_of(view.result.method)
        sheet.text(x, y + 0.02, view.clip.name, 2 * GALLERY_TILE_INCHES, fontsize=8.5, fontweight="bold")
        facts = [words, label, *list_assumptions(view), *describe_findings(view), f"frame {view.result.frames[n]}"]
        sheet.text(x, y + 0.20, "  ·  ".join(facts), 2 * GALLERY_TILE_INCHES, fontsize=8, color=MUTED_COLOUR)
        crops = input_windows([view], np.array([n]), sheet.pixels(GALLERY_TILE_INCHES))
        left, right = (
            sheet.tile(tile_x, y + GALLERY_CAPTION_INCHES, GALLERY_TILE_INCHES)
            for tile_x in (x, x + GALLERY_TILE_INCHES)
        )
        draw_over_image(left, view, n, crops, 0)
        draw_rendered(right, view, n, crops, 0, from_side=True)


def _metric_unit_symbol(metric: Metric) -> str:
    return {"deg": "°"}.get(metric.unit, metric.unit)
