"""One sequence of a benchmark of segments: its grasps found without its truth, forwards and in reverse, and scored.

``getagrip bench dexycb-segments``: grasps found in whole sequences without 3D labels of the object.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from getagrip.batch.freshness import load_or_compute, provenance_of
from getagrip.bench.comparison import bootstrap_resamples
from getagrip.bench.job import Benchmark, BenchmarkPage, ClipScores, Trial
from getagrip.bench.sources import Sample
from getagrip.bench.sources.recorded import DexYcbSequences
from getagrip.clip import Clip, Masks, read_clip, read_masks
from getagrip.fitting.options import Options
from getagrip.io import files
from getagrip.io.files import Json
from getagrip.io.plugins import date_and_commit
from getagrip.io.terminal import format_count, markdown_page
from getagrip.readers.datasets.tracks import subject_from_clip_name
from getagrip.stable_grasps.definition import Definition
from getagrip.synthetic.noise import NOISE_PRESETS, perturbed

TIME_DIRECTIONS = ("forwards", "in reverse")
SEGMENT_GRASP_DEFINITION = Definition(contact=0.010)
"""Definition of a stable grasp, as that of the truth (``readers.datasets.dexycb.dexycb_clips``)."""
SEGMENT_VARIANTS = {"fits": "fits and Eq. 2", "motion": "first to last motion"}
"""How grasps are found: ours; and what the image motion alone says, with no fit."""
SEGMENT_CODE = ("timelines/detect", "bench/segments.py")
"""Code that what is found depends on, besides that of a reconstruction."""
Span = tuple[int, int]
"""First and last frame, both included."""


@dataclass(frozen=True)
class SequenceScores(ClipScores):
    """The scores of a sequence."""

    by: dict[tuple[str, str], MatchedSegments] = field(default_factory=dict)
    """By direction and variant; empty where it failed."""
    seconds: float = 0.0
    """Time of the process for one direction [s]; the mean of both."""


@dataclass(frozen=True)
class SequenceTrial(Trial[SequenceScores]):
    """A sequence to find the grasps of; a file for it goes into ``results``."""

    noise: str
    """Key of ``NOISE_PRESETS``: the noise of hands and masks."""
    options: Options

    def failed(self, why: str, trace: str = "") -> SequenceScores:
        return SequenceScores(self.name, failure=why, trace=trace)

    def scores(self) -> SequenceScores:
        by, seconds = {}, []
        of = provenance_of(self.sample.folder, self.options, *SEGMENT_CODE)
        record, again = load_or_compute(
            self.results / f"{self.name}.json", of, self.overwrite, partial(_find_in_both_directions, self)
        )
        for direction in TIME_DIRECTIONS:
            here = record[direction]
            seconds.append(float(here["seconds"]))
            for variant in SEGMENT_VARIANTS:
                by[direction, variant] = match_segments(_parse_spans(here["true"]), _parse_spans(here[variant]))
        return SequenceScores(self.name, by, float(np.mean(seconds)), again=again)


def reversed_in_time(clip: Clip, masks: Masks) -> tuple[Clip, Masks]:
    """Reverse a clip in time; its truth goes with it, its segments do not."""
    index = np.arange(len(clip))[::-1]
    back = clip.take(index)
    return replace(back, frames=clip.frames, times=None, segments=(), name=f"{clip.name}--reversed"), masks.take(index)


def reverse_spans(spans: list[Span], frames: int) -> list[Span]:
    """Return the intervals of a sequence, in its reverse."""
    return [(frames - 1 - last, frames - 1 - first) for first, last in reversed(spans)]


def _find_in_both_directions(trial: SequenceTrial) -> Json:
    """Return the true and the found segments, by direction."""
    from getagrip.timelines.detect.detect_segments import find_segments, moving_runs

    clip = read_clip(trial.sample.folder)
    masks = read_masks(clip)
    true = [(s.first, s.last) for s in clip.segments if s.state == "grasp"]
    clip, masks = perturbed(clip, masks, NOISE_PRESETS[trial.noise], [0, *clip.name.encode()])
    out = {}
    for direction in TIME_DIRECTIONS:
        if direction == "in reverse":
            (clip, masks), true = reversed_in_time(clip, masks), reverse_spans(true, len(clip))
        since = time.process_time()
        found = find_segments(clip, masks, SEGMENT_GRASP_DEFINITION, trial.options)
        seconds = time.process_time() - since
        runs = [run for run in moving_runs(clip, masks) if run[1] + 1 - run[0] >= SEGMENT_GRASP_DEFINITION.shortest]
        whole = [(min(first for first, _ in runs), max(last for _, last in runs))] if runs else []
        out[direction] = {
            "true": true,
            "fits": found.grasps,
            "motion": whole,
            "segments": [asdict(one) for one in found.segments],
            "seconds": seconds,
        }
    return out


def _parse_spans(value: list[list[int]]) -> list[Span]:
    return [(first, last) for first, last in value]


@dataclass(frozen=True)
class SegmentMatch:
    """A true interval, and the found one that overlaps it most; each found one is matched once.

    Attributes:
        tiou: intersection over union of their frames; 0 where nothing overlaps it.
        start, end: found minus true frame; None where nothing overlaps it.
    """

    tiou: float
    start: int | None
    end: int | None


@dataclass(frozen=True)
class MatchedSegments:
    """The intervals of a sequence."""

    matches: tuple[SegmentMatch, ...]
    """One for each true interval."""
    found: int
    """How many were found."""


@dataclass(frozen=True)
class SegmentSummary:
    """Over sequences. NaN where there is nothing to average.

    Attributes:
        tiou: mean over true intervals, 0 for those that nothing overlaps.
        f1: of intervals that count as found from a tIoU of .5 and .7 on, over all sequences together.
        start, end: mean absolute errors of those that something overlaps [frames].
        missed: true intervals that nothing overlaps.
        false: sequences without a true interval in which some were found, and how many have none.
    """

    sequences: int
    true: int
    tiou: float
    f1: tuple[float, float]
    start: float
    end: float
    missed: int
    false: tuple[int, int]


def span_iou(a: Span, b: Span) -> float:
    """Compute the intersection over union of two intervals of frames."""
    both = min(a[1], b[1]) - max(a[0], b[0]) + 1
    return max(both, 0) / (max(a[1], b[1]) - min(a[0], b[0]) + 1) if both > 0 else 0.0


def match_segments(true: Sequence[Span], found: Sequence[Span]) -> MatchedSegments:
    """Match true and found intervals, those that overlap most first."""
    pairs = sorted(((span_iou(a, b), i, j) for i, a in enumerate(true) for j, b in enumerate(found)), reverse=True)
    partner: dict[int, int] = {}
    for overlap, i, j in pairs:
        if overlap > 0.0 and i not in partner and j not in partner.values():
            partner[i] = j
    out = []
    for i, a in enumerate(true):
        if i not in partner:
            out.append(SegmentMatch(0.0, None, None))
            continue
        b = found[partner[i]]
        out.append(SegmentMatch(span_iou(a, b), b[0] - a[0], b[1] - a[1]))
    return MatchedSegments(tuple(out), len(found))


def summarise_segments(sequences: Sequence[MatchedSegments]) -> SegmentSummary:
    """Summarise the intervals of all sequences together."""
    matches = [match for one in sequences for match in one.matches]
    overlaps = np.array([match.tiou for match in matches])
    found = sum(one.found for one in sequences)
    right = [int((overlaps >= least).sum()) for least in (0.5, 0.7)]
    total = len(matches) + found
    f1 = [2.0 * n / total if total else float("nan") for n in right]
    empty = [one for one in sequences if not one.matches]
    return SegmentSummary(
        sequences=len(sequences),
        true=len(matches),
        tiou=_mean_or_nan(overlaps),
        f1=(f1[0], f1[1]),
        start=_mean_or_nan(np.abs([match.start for match in matches if match.start is not None])),
        end=_mean_or_nan(np.abs([match.end for match in matches if match.end is not None])),
        missed=sum(match.start is None for match in matches),
        false=(sum(one.found > 0 for one in empty), len(empty)),
    )


def _mean_or_nan(values: np.ndarray) -> float:
    return float(np.mean(values)) if len(values) else float("nan")


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
