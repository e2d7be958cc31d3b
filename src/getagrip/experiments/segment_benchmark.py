"""``getagrip bench dexycb-segments``: grasps found in whole sequences without 3D labels of the object."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from getagrip.datasets.tracks import subject_from_clip_name
from getagrip.experiments.comparison import bootstrap_resamples
from getagrip.experiments.segment_trials import (
    SEGMENT_GRASP_DEFINITION,
    SEGMENT_VARIANTS,
    TIME_DIRECTIONS,
    MatchedSegments,
    SegmentSummary,
    SequenceScores,
    SequenceTrial,
    summarise_segments,
)
from getagrip.experiments.sources import Sample
from getagrip.experiments.sources.recorded import DexYcbSequences
from getagrip.experiments.trial import Benchmark, BenchmarkPage, Trial
from getagrip.fitting.options import Options
from getagrip.io import files
from getagrip.io.code import date_and_commit
from getagrip.io.tables import markdown_page
from getagrip.io.terminal import format_count

SEGMENT_TABLE_HEADINGS = ("", "sequences", "grasps", "tIoU", "F1@.5", "F1@.7", "start", "end", "missed", "false")
SEGMENT_CSV_COLUMNS = ("sequence", "direction", "variant", "true", "found", "tiou", "start", "end")
"""Columns of the table of sequences."""
N_F1_RESAMPLES = 400
"""Bootstrap resamples of F1, which is no mean."""


@dataclass(frozen=True)
class SegmentBenchmark(Benchmark[SequenceScores]):
    """A benchmark that finds the grasps of every sequence."""

    source: DexYcbSequences
    options: Options

    def trials(self, samples: Sequence[Sample], results: Path, overwrite: bool) -> list[Trial[SequenceScores]]:
        noise = self.source.preset
        folder = files.folder_inside(results, noise)
        return [SequenceTrial(sample, folder, overwrite, noise, self.options) for sample in samples]

    def page(self, scores: Sequence[SequenceScores]) -> BenchmarkPage | None:
        scores = [one for one in scores if not one.failure]
        if not scores:
            return None
        rows = _matched_by_variant(scores)
        grid: list[Sequence[str]] = [SEGMENT_TABLE_HEADINGS]
        for label, matched in rows.items():
            subjects = [subject_from_clip_name(one.name) for one in scores for _ in range(len(matched) // len(scores))]
            grid.append((label, *_segment_cells(matched, subjects)))
        about = [
            f"{self.source.title}: {format_count(len(scores), 'sequence')}; noise of hands and masks: {self.source.preset}",
            f"a stable grasp: {SEGMENT_GRASP_DEFINITION.description}",
            "tIoU: mean over true grasps, missed ones 0; F1: grasps with a tIoU of at least .5, .7; start, end: mean "
            "absolute errors of those that something overlaps, in frames; false: sequences without a grasp in which "
            "one is found",
            f"in brackets: 95 % intervals from {N_F1_RESAMPLES} bootstrap resamples of the subjects",
            f"{np.median([one.seconds for one in scores]):.1f} s of CPU per sequence and direction (median)",
            f"made {date_and_commit()}",
        ]
        text = markdown_page("Grasps found without 3D labels", grid, about)
        content = {
            "noise": self.source.preset,
            "rows": {label: asdict(summarise_segments(own)) for label, own in rows.items()},
        }
        return BenchmarkPage(
            self.source.preset, text, {".md": text}, {"-sequences.csv": _segment_csv_rows(scores)}, content
        )


def _segment_csv_rows(scores: Sequence[SequenceScores]) -> list[Sequence[object]]:
    """Every sequence's numbers, the headings first."""
    lines: list[Sequence[object]] = [SEGMENT_CSV_COLUMNS]
    for one in scores:
        for (direction, variant), of in one.by.items():
            for match in of.matches or (None,):
                numbers = ("", "", "") if match is None else (match.tiou, match.start, match.end)
                lines.append((one.name, direction, variant, len(of.matches), of.found, *numbers))
    return lines


def _matched_by_variant(scores: Sequence[SequenceScores]) -> dict[str, list[MatchedSegments]]:
    """Return the rows of the table: every variant, in each direction and in both."""
    out = {}
    for variant, label in SEGMENT_VARIANTS.items():
        for directions in (TIME_DIRECTIONS[:1], TIME_DIRECTIONS[1:], TIME_DIRECTIONS):
            words = "both" if len(directions) > 1 else directions[0]
            out[f"{label}, {words}"] = [one.by[direction, variant] for one in scores for direction in directions]
    return out


def _segment_cells(rows: Sequence[MatchedSegments], subjects: Sequence[str]) -> tuple[str, ...]:
    """Return a row's numbers as text."""
    all_ = summarise_segments(rows)
    low, high = _bootstrap_interval(rows, subjects, lambda s: s.tiou)
    low1, high1 = _bootstrap_interval(rows, subjects, lambda s: s.f1[0])
    return (
        str(all_.sequences),
        str(all_.true),
        f"{all_.tiou:.3f} [{low:.3f}, {high:.3f}]",
        f"{all_.f1[0]:.3f} [{low1:.3f}, {high1:.3f}]",
        f"{all_.f1[1]:.3f}",
        f"{all_.start:.1f}",
        f"{all_.end:.1f}",
        str(all_.missed),
        f"{all_.false[0]} of {all_.false[1]}",
    )


def _bootstrap_interval(
    rows: Sequence[MatchedSegments], subjects: Sequence[str], statistic: Callable[[SegmentSummary], float]
) -> tuple[float, float]:
    """Return the interval of a statistic when subjects are resampled with all their sequences."""
    values = []
    for weights in bootstrap_resamples(subjects)[:N_F1_RESAMPLES]:
        values.append(
            statistic(summarise_segments([row for row, n in zip(rows, weights, strict=True) for _ in range(int(n))]))
        )
    low, high = np.nanquantile(values, [0.025, 0.975])
    return float(low), float(high)
