"""Tables of comparisons (Markdown, CSV, LaTeX, terminal, JSON), beside published numbers; and of datasets' grasps."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from getagrip.bench.ablations import Variant
from getagrip.bench.comparison import CONFIDENCE_LEVEL, ComparisonRow, ComparisonTable, GraspClipScores, MeanEstimate
from getagrip.errors import InputError
from getagrip.io.terminal import format_count, make_table, markdown_table
from getagrip.readers.datasets.epic.epic_tables import EpicGrasp, numbering_rate, subject_of
from getagrip.stable_grasps.grasp_lists import CLIP_NAME_SEPARATOR, ListedGrasp

if TYPE_CHECKING:
    from rich.table import Table as RichTable


@dataclass(frozen=True)
class MarkupStyle:
    """The markup of the best value, the second best, and an interval."""

    best: str
    second: str
    interval: str
    symbols: Mapping[str, str] = field(default_factory=dict)
    """Replacements of characters with a meaning in the markup."""

    def cell(self, value: str, rank: int, interval: str) -> str:
        """Return a value with the markup of its rank and interval."""
        marked = {1: self.best, 2: self.second}.get(rank, "{}").format(self.text(value))
        return marked + (self.interval.format(interval) if interval else "")

    def text(self, text: str) -> str:
        """Escape plain text."""
        return "".join(self.symbols.get(letter, letter) for letter in text)


LATEX_SYMBOLS = {
    "_": r"\_", "%": r"\%", "&": r"\&", "#": r"\#", "°": r"$^\circ$", "λ": r"$\lambda$", "₂": "$_2$", "₃": "$_3$",
    "−": "$-$", "–": "--",
}  # fmt: skip
MARKDOWN_STYLE = MarkupStyle("**{}**", "<u>{}</u>", " <sub>{}</sub>")
LATEX_STYLE = MarkupStyle(r"\textbf{{{}}}", r"\underline{{{}}}", r" {{\tiny {}}}", LATEX_SYMBOLS)
TERMINAL_STYLE = MarkupStyle("[bold]{}[/]", "[u]{}[/]", "\n[dim]{}[/]")

ALL_PARTS_LABEL = "all"
"""Row of the mean over all parts."""
Fps = Literal["paper", "true"]
PAPER_FPS = 50.0
"""Frame rate by which the paper divides all of EPIC-Grasps' durations."""
ALL_CATEGORIES_ROW = "All"
SETTINGS_TITLE = "How it was made, and how to read it"
DIFFERENCES_TITLE = "Differences, clip by clip; the intervals are of single cells, not corrected for their number"
MEDIANS_TITLE = (
    "Right in the camera (ADD sym.); medians over clips; results marked ambiguous, of all and of those whose pose is "
    "wrong (ADD sym.)"
)
FINDINGS_TITLE = "Results with serious findings, the right ones among them, and the checks"
CATEGORIES_TITLE = "Each category"
"""Titles of folded parts of a page."""
ROW_COUNTS = (
    "medians", "ambiguous", "wrong", "wrong_ambiguous", "serious", "flagged", "flagged_right", "noted", "seconds",
    "failed",
)  # fmt: skip
"""Fields of a row in JSON, besides its estimates."""
FAILED_CELL = "failed"
"""Cell of a method that failed on every clip."""


def _format_number(number: float, digits: int = 1) -> str:
    return "–" if math.isnan(number) else f"{number:.{digits}f}"


def _format_interval(value: MeanEstimate) -> str:
    """Format the interval of a share, in per cent; empty for NaN."""
    return "" if math.isnan(value.low) else f"[{100.0 * value.low:.0f}, {100.0 * value.high:.0f}]"


def _format_difference(share: float) -> str:
    """Format a difference of shares, in per cent, with its sign."""
    return "–" if math.isnan(share) else f"{100.0 * share:+.1f}".replace("-", "−")


def _table_body(table: ComparisonTable, style: MarkupStyle) -> list[list[str]]:
    """Return the rows of a table as texts: label, columns, seconds."""
    ranks = {column.label: table.ranks(column) for column in table.columns}
    rows = []
    for n, row in enumerate(table.rows):
        cells = [style.text(row.variant.label + (f" ({row.failed} failed)" if row.failed else ""))]
        for column in table.columns:
            value = row.values[column.label]
            shown = FAILED_CELL if row.has_failed else _format_number(100.0 * value.mean)
            cells.append(style.cell(shown, ranks[column.label][n], _format_interval(value)))
        rows.append([*cells, _format_number(row.seconds, 2)])
    return rows


def _table_headings(table: ComparisonTable) -> list[str]:
    return ["", *(column.label for column in table.columns), "s"]


def _difference_rows(table: ComparisonTable, style: MarkupStyle) -> list[list[str]]:
    """Return headings and rows of paired differences, unmarked: intervals are not corrected for their number."""
    columns = [column for column in table.columns if column.ranked]
    rows = [["", *(column.label for column in columns)]]
    for row in table.rows:
        if row.differences:
            cells = [style.text(f"{row.variant.label} − {row.variant.against}")]
            for column in columns:
                value = row.differences[column.label]
                ends = f"[{_format_difference(value.low)}, {_format_difference(value.high)}]"
                cells.append(style.cell(_format_difference(value.mean), 0, "" if math.isnan(value.low) else ends))
            rows.append(cells)
    return rows


def _error_rows(table: ComparisonTable, style: MarkupStyle) -> list[list[str]]:
    """Return headings and rows of folded means, medians, and counts of ambiguous results."""
    labels = [label for label in table.rows[0].medians if not all(math.isnan(row.medians[label]) for row in table.rows)]
    rows = [["", *(f"{column.label}, %" for column in table.folded), *labels, "ambiguous", "of wrong poses"]]
    for row in table.rows:
        means = [row.values[column.label] for column in table.folded]
        shares = [
            style.cell(FAILED_CELL if row.has_failed else _format_number(100.0 * mean.mean), 0, _format_interval(mean))
            for mean in means
        ]
        medians = [FAILED_CELL if row.has_failed else _format_number(row.medians[label]) for label in labels]
        marked = [f"{row.ambiguous} of {table.clips}", f"{row.wrong_ambiguous} of {row.wrong}"]
        rows.append([style.text(row.variant.label), *shares, *medians, *marked])
    return rows


def _finding_rows(table: ComparisonTable, style: MarkupStyle) -> list[list[str]]:
    """Return headings and rows of the number of findings of each check (docs/checks.md)."""
    rows = [["", "flagged", "right ones", "serious findings", "notes"]]
    for row in table.rows:
        known = any(not math.isnan(median) for median in row.medians.values())
        right = str(row.flagged_right) if known else "–"
        named = [", ".join(f"{name} {count}" for name, count in of.items()) or "–" for of in (row.serious, row.noted)]
        rows.append([style.text(row.variant.label), f"{row.flagged} of {table.clips}", right, *named])
    return rows


def comparison_markdown(
    tables: Sequence[ComparisonTable], title: str, about: Sequence[str], settings: Sequence[str]
) -> str:
    """Make a page of means over all clips; settings, differences, medians, findings and categories are folded."""
    lines = [f"# {title}", "", *(f"- {line}" for line in about), ""]
    for table in tables[:1]:
        lines += _means_markdown(table)
        lines += _details_block(SETTINGS_TITLE, [f"- {line}" for line in settings])
        differences = _difference_rows(table, MARKDOWN_STYLE)
        if len(differences) > 1:
            lines += _details_block(DIFFERENCES_TITLE, markdown_table(differences))
        lines += _details_block(MEDIANS_TITLE, markdown_table(_error_rows(table, MARKDOWN_STYLE)))
        lines += _details_block(FINDINGS_TITLE, markdown_table(_finding_rows(table, MARKDOWN_STYLE)))
    if tables[1:]:
        categories = [line for table in tables[1:] for line in _means_markdown(table)]
        lines += _details_block(CATEGORIES_TITLE, categories[:-1])
    return "\n".join(lines).rstrip() + "\n"


def _means_markdown(table: ComparisonTable) -> list[str]:
    grid = [_table_headings(table), *_table_body(table, MARKDOWN_STYLE)]
    return [f"{_table_title(table)}:", "", *markdown_table(grid), ""]


def _details_block(title: str, lines: list[str]) -> list[str]:
    """Return lines folded under a title; Markdown needs the blank lines around them."""
    return [f"<details><summary>{title}</summary>", "", *lines, "", "</details>", ""]


def _table_title(table: ComparisonTable) -> str:
    contacts = {row.variant.contact.description for row in table.rows}
    contact = f", contact: {contacts.pop()}" if len(contacts) == 1 else ""
    return f"{table.title[:1].upper()}{table.title[1:]}: {format_count(table.clips, 'clip')}{contact}"


def comparison_latex(tables: Sequence[ComparisonTable], title: str, about: Sequence[str]) -> str:
    """Make the tables in LaTeX (needs the package booktabs)."""
    lines = [f"% {title}", *(f"% {line}" for line in about)]
    for table in tables:
        headings = [LATEX_STYLE.text(heading) for heading in _table_headings(table)]
        lines += [
            "", r"\begin{table}", r"\centering", rf"\begin{{tabular}}{{l|{'c' * (len(headings) - 1)}}}",
            r"\toprule", " & ".join(headings) + r" \\", r"\midrule",
            *(" & ".join(row) + r" \\" for row in _table_body(table, LATEX_STYLE)), r"\bottomrule", r"\end{tabular}",
            rf"\caption{{{LATEX_STYLE.text(f'{title}. {_table_title(table)}.')}}}", r"\end{table}",
        ]  # fmt: skip
    return "\n".join(lines) + "\n"


def comparison_csv_rows(tables: Sequence[ComparisonTable]) -> list[list[object]]:
    """Return the headings, and one line for each table, row and column, unrounded, shares from 0 to 1."""
    numbers = ("mean", "low", "high", "clips")
    heads = ["table", "row", "column", *numbers, "rank", "against", *(f"difference_{key}" for key in numbers)]
    lines: list[list[object]] = [[*heads]]
    for table in tables:
        for column in (*table.columns, *table.folded):
            for row, rank in zip(table.rows, table.ranks(column), strict=True):
                value, difference = _estimate_cells(row.values[column.label]), row.differences.get(column.label)
                compared = [""] * 5 if difference is None else [row.variant.against, *_estimate_cells(difference)]
                lines.append([table.title, row.variant.label, column.label, *value, rank or "", *compared])
        for row in table.rows:
            for label, median in (*row.medians.items(), ("seconds", row.seconds)):
                lines.append([table.title, row.variant.label, f"{label} (median)", median, *[""] * 9])
    return lines


def _estimate_cells(estimate: MeanEstimate) -> list[float | int]:
    return [estimate.mean, estimate.low, estimate.high, estimate.clips]


def clips_csv_rows(scores: Sequence[GraspClipScores], variants: Sequence[Variant]) -> list[list[object]]:
    """Return the headings, and one line for each clip and variant with every metric, unrounded."""
    by_folder = {variant.folder: variant for variant in variants}
    keys = list(dict.fromkeys(key for clip in scores for score in clip.scores for key in score.metrics))
    about = (
        "clip", "category", "subject", "method", "setting", "seconds", "energy", "ambiguous", "probability_right",
        "probability_right_in_camera", "keep", "keep_in_camera", "findings", "status",
    )  # fmt: skip
    lines: list[list[object]] = [[*about, *keys]]
    for clip in scores:
        if clip.failure:
            lines.append([clip.name, *[""] * (len(about) - 2), f"failed: {clip.failure}", *[""] * len(keys)])
        for score in clip.scores:
            variant = by_folder[score.variant]
            status = f"failed: {score.status}" if score.failed else score.status
            found = " ".join((*score.serious, *score.noted))
            probable = [score.probability_right, score.probability_right_in_camera, score.keep, score.keep_in_camera]
            how = [score.seconds, score.energy, score.ambiguous, *probable, found, status]
            metrics = [score.metrics.get(key, "") for key in keys]
            what = [clip.name, clip.category, clip.subject, variant.method, variant.step]
            lines.append([*what, *how, *metrics])
    return lines


def terminal_table(table: ComparisonTable, below: Sequence[str] = ()) -> RichTable:
    """Make the table over all clips for the terminal, with lines below it."""
    out = make_table(title=_table_title(table), title_justify="left")
    out.caption, out.caption_justify = "\n".join(below), "left"
    out.add_column("")
    for heading in _table_headings(table)[1:]:
        out.add_column(heading.replace(" ", "\n").replace("SCA-", "SCA-\n", 1), justify="right", no_wrap=True)
    for row in _table_body(table, TERMINAL_STYLE):
        out.add_row(*row)
    return out


def comparison_json(tables: Sequence[ComparisonTable], scores: Sequence[GraspClipScores]) -> dict[str, object]:
    """Return every number of the tables and of each clip, unrounded."""
    return {
        "level": CONFIDENCE_LEVEL,
        "tables": [
            {"table": table.title, "clips": table.clips, "rows": [_row_json(row) for row in table.rows]}
            for table in tables
        ],
        "clips": [
            {
                "clip": clip.name,
                "category": clip.category,
                "subject": clip.subject,
                "failure": clip.failure or None,
                "results": [vars(score) for score in clip.scores],
            }
            for clip in scores
        ],
    }


def _row_json(row: ComparisonRow) -> dict[str, object]:
    about = {"row": row.variant.label, "method": row.variant.method, "contact": row.variant.contact.key}
    estimates = {
        "values": {key: vars(value) for key, value in row.values.items()},
        "against": row.variant.against if row.differences else None,
        "differences": {key: vars(value) for key, value in row.differences.items()},
    }
    return {**about, **{key: getattr(row, key) for key in ROW_COUNTS}, **estimates}


@dataclass(frozen=True)
class PublishedResults:
    """A system's printed numbers, in per cent."""

    given: str
    """Inputs of the system, and the evaluated frames."""
    source: str
    columns: Sequence[str]
    """Labels of our columns with the same meaning."""
    rows: Mapping[str, Sequence[float | None]]
    """Numbers by part, in the order of the columns, and by ``ALL_PARTS_LABEL``."""

    def number(self, row: str, column: str) -> float:
        """Return a printed number; NaN if missing."""
        printed = dict(zip(self.columns, self.rows.get(row, ()), strict=False)).get(column)
        return math.nan if printed is None else printed


def read_published_results(name: str) -> dict[str, PublishedResults]:
    """Read the published results of a file in ``bench.sources``, by system."""
    text = resources.files("getagrip.bench.sources").joinpath(name).read_text("utf-8")
    return {system: PublishedResults(**fields) for system, fields in json.loads(text).items()}


def published_grid(systems: Mapping[str, PublishedResults], ours: Mapping[str, ComparisonTable]) -> list[list[str]]:
    """Make a grid with the parts as columns; each printed metric has our rows, then the systems'.

    ``ours`` are tables by part; the mean over all is shown only for the same parts as the printed mean.
    """
    parts = sorted({*(part for system in systems.values() for part in system.rows), *ours} - {ALL_PARTS_LABEL})
    tables = {part: table for part, table in ours.items() if part != ALL_PARTS_LABEL or {*parts} <= {*ours}}
    rows = next(iter(ours.values())).rows if ours else ()
    lines = [["", *parts, ALL_PARTS_LABEL]]
    for column in dict.fromkeys(column for system in systems.values() for column in system.columns):
        found = {
            row.variant.label: [_mean_percent(tables.get(p), n, column) for p in (*parts, ALL_PARTS_LABEL)]
            for n, row in enumerate(rows)
        }
        for name, system in systems.items():
            if column in system.columns:
                found[name] = [system.number(part, column) for part in (*parts, ALL_PARTS_LABEL)]
        lines += [[f"{column}: {name}", *map(_format_number, numbers)] for name, numbers in found.items()]
    return lines


def _mean_percent(table: ComparisonTable | None, row: int, column: str) -> float:
    """Return our mean in per cent; NaN where unknown."""
    estimate = None if table is None else table.rows[row].values.get(column)
    return math.nan if estimate is None else 100.0 * estimate.mean


def published_markdown(systems: Mapping[str, PublishedResults], ours: Mapping[str, ComparisonTable]) -> list[str]:
    """Make the Markdown of ``published_grid``, and the inputs of each system."""
    sources = [f"- {name}: {system.given}. Source: {system.source}" for name, system in systems.items()]
    return [*markdown_table(published_grid(systems, ours)), "", *sources]


@dataclass(frozen=True)
class GraspDuration:
    """The duration of a stable grasp."""

    category: str
    side: str
    duration: float
    """Duration [s]."""


@dataclass(frozen=True)
class CategoryDurations:
    """Statistics of the grasps of one category, or of all."""

    category: str
    mean: float
    std: float
    """Standard deviation, with divisor n [s]."""
    longest: float
    clips: int
    left: int
    right: int


def durations_by_category(grasps: Sequence[GraspDuration]) -> list[CategoryDurations]:
    """Return a row for each category in alphabetical order, then one for all; empty without grasps."""
    categories = sorted({grasp.category for grasp in grasps})
    groups = {category: [grasp for grasp in grasps if grasp.category == category] for category in categories}
    groups |= {ALL_CATEGORIES_ROW: list(grasps)} if grasps else {}
    return [_category_durations(category, group) for category, group in groups.items()]


def _category_durations(category: str, grasps: Sequence[GraspDuration]) -> CategoryDurations:
    seconds = np.array([grasp.duration for grasp in grasps])
    sides = [grasp.side for grasp in grasps]
    counts = (len(grasps), sides.count("left"), sides.count("right"))
    return CategoryDurations(category, float(seconds.mean()), float(seconds.std()), float(seconds.max()), *counts)


def epic_durations(grasps: Sequence[EpicGrasp], fps: Fps = "paper") -> list[GraspDuration]:
    """List the durations of EPIC-Grasps, at 50 frames/s (``paper``) or at each video's rate of numbering (``true``)."""
    return [
        GraspDuration(one.category, one.side, one.frames / (PAPER_FPS if fps == "paper" else numbering_rate(one.video)))
        for one in grasps
    ]


def grasp_list_durations(path: Path, grasps: Sequence[ListedGrasp]) -> list[GraspDuration]:
    """List the durations of a list of grasps. Raises ``InputError`` where one is missing."""
    for n, grasp in enumerate(grasps):
        if grasp.duration is None:
            raise InputError(path, f"grasp {n + 1}, duration", "none", "how long it lasts, in seconds")
    return [GraspDuration(grasp.object, grasp.side, grasp.duration or 0.0) for grasp in grasps]


@dataclass(frozen=True)
class DatasetCounts:
    """Numbers of a dataset's contents; None where its files do not state them."""

    environments: int | None
    """Number of videos, which the paper calls environments."""
    subjects: int | None
    categories: int
    instances: int | None
    """Number of objects; in EPIC-Grasps, a category in a video is one, as in the paper."""
    grasps: int
    left: int
    right: int
    masks: int | None
    """Number of masks of hand and object in EPIC-Grasps' table (``n_unfiltered_masks``); in a folder, of the object."""


def count_epic_grasps(grasps: Sequence[EpicGrasp]) -> DatasetCounts:
    """Count the contents of EPIC-Grasps' table."""
    masks = [grasp.masks for grasp in grasps if grasp.masks is not None]
    sides = [grasp.side for grasp in grasps]
    return DatasetCounts(
        environments=len({grasp.video for grasp in grasps}),
        subjects=len({subject_of(grasp.video) for grasp in grasps}),
        categories=len({grasp.category for grasp in grasps}),
        instances=len({(grasp.video, grasp.category) for grasp in grasps}),
        grasps=len(grasps),
        left=sides.count("left"),
        right=sides.count("right"),
        masks=sum(masks) if len(masks) == len(grasps) else None,
    )


def count_grasp_list(grasps: Sequence[ListedGrasp], folder: Path | None) -> DatasetCounts:
    """Count the contents of a list of grasps, and the masks of the clips in ``folder``.

    Subjects are known if all sequences are named as imports name them, ``<subject>--...``.
    """
    named = all(CLIP_NAME_SEPARATOR in grasp.sequence for grasp in grasps)
    sides = [grasp.side for grasp in grasps]
    return DatasetCounts(
        environments=None,
        subjects=len({grasp.sequence.partition(CLIP_NAME_SEPARATOR)[0] for grasp in grasps}) if named else None,
        categories=len({grasp.object for grasp in grasps}),
        instances=None,
        grasps=len(grasps),
        left=sides.count("left"),
        right=sides.count("right"),
        masks=None if folder is None else sum(1 for _ in folder.glob("*/masks/object/*.png")),
    )
