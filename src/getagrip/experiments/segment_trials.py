"""One sequence of a benchmark of segments: its grasps found without its truth, forwards and in reverse, and scored."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial

import numpy as np

from getagrip.batch.validity import load_or_compute, provenance_of
from getagrip.clip import Clip, Masks, read_clip, read_masks
from getagrip.datasets.synthetic.noise import NOISE_PRESETS, perturbed
from getagrip.experiments.trial import ClipScores, Trial
from getagrip.fitting.options import Options
from getagrip.grasps.definition import Definition
from getagrip.io.files import Json

TIME_DIRECTIONS = ("forwards", "in reverse")
SEGMENT_GRASP_DEFINITION = Definition(contact=0.010)
"""Definition of a stable grasp, as that of the truth (``datasets.dexycb.reader``)."""
SEGMENT_VARIANTS = {"fits": "fits and Eq. 2", "motion": "first to last motion"}
"""How grasps are found: ours; and what the image motion alone says, with no fit."""
SEGMENT_CODE = ("segmentation", "experiments/segment_trials.py")
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
    from getagrip.segmentation.found import find_segments, moving_runs

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
