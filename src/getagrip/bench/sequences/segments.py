"""``getagrip bench dexycb-segments``: detect grasps in uncut sequences without 3D labels, forwards and in reverse."""

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
"""Definition of a stable grasp, equal to the truth's (``readers.datasets.dexycb.dexycb_clips``)."""
SEGMENT_VARIANTS = {"fits": "fits and Eq. 2", "motion": "first to last motion"}
"""Ways to detect grasps: ours; and a baseline by image motion alone, without a fit."""
SEGMENT_CODE = ("timelines/detect", "bench/sequences/segments.py")
"""Code, besides a reconstruction's, that detected segments depend on."""
SEGMENT_TABLE_HEADINGS = ("", "sequences", "grasps", "tIoU", "F1@.5", "F1@.7", "start", "end", "missed", "false")
SEGMENT_CSV_COLUMNS = ("sequence", "direction", "variant", "true", "found", "tiou", "start", "end")
N_F1_RESAMPLES = 400
"""Number of bootstrap resamples of F1, which is not a mean."""
Span = tuple[int, int]
"""First and last frame, both included."""


@dataclass(frozen=True)
class SequenceScores(ClipScores):
    """The scores of a sequence."""

    by: dict[tuple[str, str], MatchedSegments] = field(default_factory=dict)
    """Matches by direction and variant; empty where the sequence failed."""
    seconds: float = 0.0
    """CPU time of one direction, mean of both [s]."""


@dataclass(frozen=True)
class SequenceTrial(Trial[SequenceScores]):
    """A sequence whose grasps are to be detected; its record goes into ``results``."""

    noise: str
    """Key of ``NOISE_PRESETS``: the noise of hands and masks."""
    options: Options

    def failed(self, why: str, trace: str = "") -> SequenceScores:
        return SequenceScores(self.name, failure=why, trace=trace)

    def scores(self) -> SequenceScores:
        path, of = self.results / f"{self.name}.json", provenance_of(self.sample.folder, self.options, *SEGMENT_CODE)
        record, again = load_or_compute(path, of, self.overwrite, partial(_find_in_both_directions, self))
        by = {
            (direction, variant): match_segments(*(_parse_spans(record[direction][key]) for key in ("true", variant)))
            for direction in TIME_DIRECTIONS
            for variant in SEGMENT_VARIANTS
        }
        seconds = [float(record[direction]["seconds"]) for direction in TIME_DIRECTIONS]
        return SequenceScores(self.name, by, float(np.mean(seconds)), again=again)


def reversed_in_time(clip: Clip, masks: Masks) -> tuple[Clip, Masks]:
    """Reverse a clip with its truth in time, without its segments."""
    index = np.arange(len(clip))[::-1]
    back = clip.take(index)
    return replace(back, frames=clip.frames, times=None, segments=(), name=f"{clip.name}--reversed"), masks.take(index)


def reverse_spans(spans: list[Span], frames: int) -> list[Span]:
    """Return the intervals of a sequence in its reverse."""
    return [(frames - 1 - last, frames - 1 - first) for first, last in reversed(spans)]


def _find_in_both_directions(trial: SequenceTrial) -> Json:
    """Return the true and the detected intervals by direction, as a record holds them."""
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
    """A true interval, matched with the detected one of the largest overlap; each detected one is matched once.

    Attributes:
        tiou: intersection over union of their frames; 0 without a match.
        start, end: detected minus true frame; None without a match.
    """

    tiou: float
    start: int | None
    end: int | None


@dataclass(frozen=True)
class MatchedSegments:
    """The intervals of a sequence."""

    matches: tuple[SegmentMatch, ...]
    """A match for each true interval."""
    found: int
    """Number of detected intervals."""


@dataclass(frozen=True)
class SegmentSummary:
    """Scores over all sequences; NaN without values.

    Attributes:
        tiou: mean over true intervals, 0 without a match.
        f1: F1 of detection over all sequences together, at tIoU thresholds of .5 and .7.
        start, end: mean absolute errors over matches [frames].
        missed: number of true intervals without a match.
        false: number of sequences with false detections, and of all sequences without true intervals.
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
    """Match true and detected intervals greedily, the largest overlap first."""
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


@dataclass(frozen=True)
class SegmentBenchmark(Benchmark[SequenceScores]):
    """A benchmark that detects the grasps of every sequence."""

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
        preset = self.source.preset
        about = [
            f"{self.source.title}: {format_count(len(scores), 'sequence')}; noise of hands and masks: {preset}",
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
            "noise": preset,
            "rows": {label: asdict(summarise_segments(own)) for label, own in rows.items()},
        }
        return BenchmarkPage(preset, text, {".md": text}, {"-sequences.csv": _segment_csv_rows(scores)}, content)


def _segment_csv_rows(scores: Sequence[SequenceScores]) -> list[Sequence[object]]:
    lines: list[Sequence[object]] = [SEGMENT_CSV_COLUMNS]
    for one in scores:
        for (direction, variant), matched in one.by.items():
            for match in matched.matches or (None,):
                numbers = ("", "", "") if match is None else (match.tiou, match.start, match.end)
                lines.append((one.name, direction, variant, len(matched.matches), matched.found, *numbers))
    return lines


def _matched_by_variant(scores: Sequence[SequenceScores]) -> dict[str, list[MatchedSegments]]:
    """Return the rows of the table: every variant in each direction, and in both."""
    out = {}
    for variant, label in SEGMENT_VARIANTS.items():
        for directions in (TIME_DIRECTIONS[:1], TIME_DIRECTIONS[1:], TIME_DIRECTIONS):
            words = "both" if len(directions) > 1 else directions[0]
            out[f"{label}, {words}"] = [one.by[direction, variant] for one in scores for direction in directions]
    return out


def _segment_cells(rows: Sequence[MatchedSegments], subjects: Sequence[str]) -> tuple[str, ...]:
    s = summarise_segments(rows)
    tiou = "{:.3f} [{:.3f}, {:.3f}]".format(s.tiou, *_bootstrap_interval(rows, subjects, lambda each: each.tiou))
    f1 = "{:.3f} [{:.3f}, {:.3f}]".format(s.f1[0], *_bootstrap_interval(rows, subjects, lambda each: each.f1[0]))
    errors = (f"{s.start:.1f}", f"{s.end:.1f}", str(s.missed), f"{s.false[0]} of {s.false[1]}")
    return (str(s.sequences), str(s.true), tiou, f1, f"{s.f1[1]:.3f}", *errors)


def _bootstrap_interval(
    rows: Sequence[MatchedSegments], subjects: Sequence[str], statistic: Callable[[SegmentSummary], float]
) -> tuple[float, float]:
    """Return the bootstrap interval of a statistic; subjects are resampled with all their sequences."""
    values = []
    for weights in bootstrap_resamples(subjects)[:N_F1_RESAMPLES]:
        resample = [row for row, n in zip(rows, weights, strict=True) for _ in range(int(n))]
        values.append(statistic(summarise_segments(resample)))
    low, high = np.nanquantile(values, [0.025, 0.975])
    return float(low), float(high)
