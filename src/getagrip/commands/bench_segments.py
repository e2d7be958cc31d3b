"""``getagrip bench dexycb-segments``: grasps found in whole sequences without 3D labels of the object."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict

import numpy as np

from getagrip.batch.clips import print_outcome
from getagrip.commands.bench_sequences import Plan, scored
from getagrip.datasets.tracks import subject_of
from getagrip.experiments.segment_scores import Matched, Summary, summary
from getagrip.experiments.segment_trials import (
    DEFINITION,
    DIRECTIONS,
    WAYS,
    SequenceScores,
    SequenceTrial,
    run_sequence,
)
from getagrip.experiments.sources import samples
from getagrip.experiments.stamp import stamp
from getagrip.experiments.statistics import resamples
from getagrip.io import files
from getagrip.io.counts import counted
from getagrip.io.csv_tables import CsvTable

HEADINGS = ("", "sequences", "grasps", "tIoU", "F1@.5", "F1@.7", "start", "end", "missed", "false")
DRAWS = 400
"""Bootstrap resamples of F1, which is no mean."""


def bench_segments(plan: Plan, debug: bool) -> int:
    """Find the grasps of every sequence and write the table; 1 if a sequence failed, else 0.

    Raises ``UsageError`` where the call is wrong or there are no sequences.
    """
    found, bad = samples(plan.source, plan.out / "clips", plan.count, debug, plan.share)
    for outcome in bad:
        print_outcome(outcome, debug)
    if not found:
        return 1
    plan.out.mkdir(parents=True, exist_ok=True)
    noise = plan.source.preset
    results = files.folder_inside(plan.out, "results", noise)
    trials = [
        SequenceTrial(sample, noise, plan.options, results, plan.overwrite)
        for sample in found
        if sample.name in plan.share.shard
    ]
    scores = scored(run_sequence, SequenceScores, trials, plan, debug)
    if scores:
        _write(plan, scores)
    return 1 if bad or len(scores) < len(trials) else 0


def _write(plan: Plan, scores: Sequence[SequenceScores]) -> None:
    """The table, on the screen and as files, and every sequence's numbers."""
    text = _markdown(plan, scores)
    print(text, end="")
    name = plan.source.preset
    written = [plan.out / f"{name}.md", plan.out / f"{name}-sequences.csv"]
    files.write_text(written[0], text)
    with files.new_text(written[1]) as stream:
        table = CsvTable(stream)
        table.write_row(("sequence", "direction", "way", "true", "found", "tiou", "start", "end"))
        for one in scores:
            for (direction, way), of in one.by.items():
                rows = of.matches or (None,)
                for match in rows:
                    numbers = ("", "", "") if match is None else (match.tiou, match.start, match.end)
                    table.write_row((one.name, direction, way, len(of.matches), of.found, *numbers))
    if plan.json is not None:
        summaries = {label: asdict(summary(rows)) for label, rows in _rows(scores).items()}
        files.write_json(plan.json, {"noise": plan.source.preset, "rows": summaries})
        written.append(plan.json)
    print(*written, sep="\n")


def _rows(scores: Sequence[SequenceScores]) -> dict[str, list[Matched]]:
    """The rows of the table: every way, in each direction and in both."""
    out = {}
    for way, label in WAYS.items():
        for directions in (DIRECTIONS[:1], DIRECTIONS[1:], DIRECTIONS):
            words = "both" if len(directions) > 1 else directions[0]
            out[f"{label}, {words}"] = [one.by[direction, way] for one in scores for direction in directions]
    return out


def _markdown(plan: Plan, scores: Sequence[SequenceScores]) -> str:
    """The table, and how it was made."""
    lines = ["# Grasps found without 3D labels", "", f"| {' | '.join(HEADINGS)} |"]
    lines.append(f"|---{'|---:' * (len(HEADINGS) - 1)}|")
    for label, rows in _rows(scores).items():
        subjects = [subject_of(one.name) for one in scores for _ in range(len(rows) // len(scores))]
        lines.append(f"| {' | '.join((label, *_cells(rows, subjects)))} |")
    about = [
        f"{plan.source.title}: {counted(len(scores), 'sequence')}; noise of hands and masks: {plan.source.preset}",
        f"a stable grasp: {DEFINITION.description}",
        "tIoU: mean over true grasps, missed ones 0; F1: grasps with a tIoU of at least .5, .7; start, end: mean "
        "absolute errors of those that something overlaps, in frames; false: sequences without a grasp in which one "
        "is found",
        f"in brackets: 95 % intervals from {DRAWS} bootstrap resamples of the subjects",
        f"{np.median([one.seconds for one in scores]):.1f} s of CPU per sequence and direction (median)",
        f"made {stamp()}",
    ]
    return "\n".join([*lines, "", *(f"- {line}" for line in about), ""])


def _cells(rows: Sequence[Matched], subjects: Sequence[str]) -> tuple[str, ...]:
    """A row's numbers as text."""
    all_ = summary(rows)
    low, high = _interval(rows, subjects, lambda s: s.tiou)
    low1, high1 = _interval(rows, subjects, lambda s: s.f1[0])
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


def _interval(
    rows: Sequence[Matched], subjects: Sequence[str], statistic: Callable[[Summary], float]
) -> tuple[float, float]:
    """Of a statistic, when subjects are drawn anew with all their sequences."""
    values = []
    for weights in resamples(subjects)[:DRAWS]:
        values.append(statistic(summary([row for row, n in zip(rows, weights, strict=True) for _ in range(int(n))])))
    low, high = np.nanquantile(values, [0.025, 0.975])
    return float(low), float(high)
