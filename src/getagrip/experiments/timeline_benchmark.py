"""``getagrip bench dexycb-timelines``, ``hot3d-timelines``: from table to hand, reconstructed by true segments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from getagrip.datasets.tracks import subject_from_clip_name
from getagrip.errors import UsageError
from getagrip.experiments.comparison import estimate_mean
from getagrip.experiments.sources import Sample
from getagrip.experiments.sources.recorded import TimelineSource
from getagrip.experiments.timeline_trials import (
    ALL_NOISE_LEVELS,
    TIMELINE_NOISE_LEVELS,
    TimelineScores,
    TimelineTrial,
    VariantScores,
)
from getagrip.experiments.trial import Benchmark, BenchmarkPage, Trial
from getagrip.fitting.options import Options
from getagrip.io import files
from getagrip.io.code import date_and_commit
from getagrip.io.tables import markdown_page
from getagrip.io.terminal import format_count

TIMELINE_TABLE_HEADINGS = (
    "hands",
    "",
    "static",
    "between",
    "grasp",
    "grasp, ADD",
    "mugs, grasp",
    "jump, mm",
    "SCA",
    "s",
)


@dataclass(frozen=True)
class TimelineBenchmark(Benchmark[TimelineScores]):
    """A benchmark that reconstructs every timeline with every variant."""

    source: TimelineSource
    options: Options

    def trials(self, samples: Sequence[Sample], results: Path, overwrite: bool) -> list[Trial[TimelineScores]]:
        preset = self.source.preset
        levels = tuple(TIMELINE_NOISE_LEVELS) if preset == ALL_NOISE_LEVELS else (preset,)
        for level in levels:
            files.folder_inside(results, level)
        return [TimelineTrial(sample, results, overwrite, levels, self.options) for sample in samples]

    def page(self, scores: Sequence[TimelineScores]) -> BenchmarkPage | None:
        """Make the page; raise ``UsageError`` where no timeline has both a static segment and a stable grasp."""
        done = [one for one in scores if not one.failure]
        whole = [one for one in done if one.by]
        if done and not whole:
            lacking = "a timeline with both a static segment and a stable grasp"
            raise UsageError(
                f"missing {lacking} in {self.source.dataset}: none of {format_count(len(done), 'timeline')}"
            )
        if not whole:
            return None
        grid: list[Sequence[str]] = [TIMELINE_TABLE_HEADINGS]
        grid += [
            (level, variant, *_timeline_cells(whole, level, variant))
            for level, variants in whole[0].by.items()
            for variant in variants
        ]
        about = [
            f"{self.source.title}: {len(whole)} of {len(done)} sequences, those with a static segment and a stable "
            "grasp",
            "static, between, grasp: per cent of segments whose mean ADD up to symmetries, in the camera frame, is "
            "below 10 % of the diameter; grasp, ADD: without symmetries; a variant that fails scores 0",
            "hands: exact, moderate and strong noise, masks exact; ragged: strong noise, and masks off by 1 px",
            "jump: median over links of how far the object moves from one segment to the next beyond its true motion",
            "SCA: mean over grasps, object vertices within 10 mm of the hand that was found",
            "s: median seconds of CPU for a timeline, reading not included",
            "in brackets: 95 % intervals by Student's t over the subjects",
            f"{self.options.inits} initial poses, seed {self.options.seed}; made {date_and_commit()}",
        ]
        text = markdown_page("Timelines", grid, about, words=2)
        return BenchmarkPage(self.source.preset, text, {".md": text}, {}, {one.name: one.by for one in whole})


def _timeline_cells(scores: Sequence[TimelineScores], level: str, variant: str) -> list[str]:
    """Return a row's numbers as text."""
    found = [(one, one.by[level][variant]) for one in scores]
    cells = [_segment_percentage(found, kind, "right_sym") for kind in ("static", "between", "grasp")]
    cells.append(_segment_percentage(found, "grasp", "right"))
    cells.append(_segment_percentage([(one, of) for one, of in found if "mug" in one.category], "grasp", "right_sym"))
    gaps = [jump for _, of in found for jump in of.get("jumps", [])]
    sca = [s["sca"] for _, of in found for s in of.get("segments", []) if s["sca"] is not None]
    seconds = [of["seconds"] for _, of in found]
    cells += [f"{1e3 * np.median(gaps):.1f}" if gaps else "–", f"{100 * np.mean(sca):.1f}" if sca else "–"]
    return [*cells, f"{np.median(seconds):.1f}"]


def _segment_percentage(found: Sequence[tuple[TimelineScores, VariantScores]], kind: str, key: str) -> str:
    """Per cent of the segments of a kind, with an interval; a failed timeline counts as one wrong segment."""
    values, subjects = [], []
    for one, of in found:
        right = [float(s[key]) for s in of.get("segments", []) if s["kind"] == kind] if "segments" in of else [0.0]
        values += right
        subjects += [subject_from_clip_name(one.name)] * len(right)
    if not values:
        return "–"
    value = estimate_mean(np.array(values), subjects)
    interval = "" if np.isnan(value.low) else f" [{100 * value.low:.0f}, {100 * value.high:.0f}]"
    return f"{100 * value.mean:.1f}{interval} (n = {value.clips})"
