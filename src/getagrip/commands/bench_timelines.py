"""``getagrip bench dexycb-timelines``, ``hot3d-timelines``: from table to hand, reconstructed by true segments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from getagrip.batch.clips import print_outcome
from getagrip.commands.bench_sequences import Plan, scored
from getagrip.datasets.tracks import subject_of
from getagrip.errors import UsageError
from getagrip.experiments.sources import samples
from getagrip.experiments.stamp import stamp
from getagrip.experiments.statistics import estimate
from getagrip.experiments.timeline_trials import ALL, LEVELS, TimelineScores, TimelineTrial, run_timeline
from getagrip.io import files
from getagrip.io.counts import counted

HEADINGS = ("hands", "", "static", "between", "grasp", "grasp, ADD", "mugs, grasp", "jump, mm", "SCA", "s")


def bench_timelines(plan: Plan, debug: bool) -> int:
    """Reconstruct every timeline every way and write the table; 1 if one failed, else 0.

    Raises ``UsageError`` where the call is wrong or no timeline has both a static segment and a stable grasp.
    """
    found, bad = samples(plan.source, plan.out / "clips", plan.count, debug, plan.share)
    for outcome in bad:
        print_outcome(outcome, debug)
    if not found:
        return 1
    plan.out.mkdir(parents=True, exist_ok=True)
    preset, results = plan.source.preset, plan.out / "results"
    levels = tuple(LEVELS) if preset == ALL else (preset,)
    trials = [
        TimelineTrial(sample, levels, plan.options, results, plan.overwrite)
        for sample in found
        if sample.name in plan.share.shard
    ]
    scores = scored(run_timeline, TimelineScores, trials, plan, debug)
    whole = [one for one in scores if one.by]
    if scores and not whole:
        given = f"{counted(len(scores), 'timeline')}, none with both a static segment and a stable grasp"
        raise UsageError(f"{plan.source.dataset}: got {given}, expected one at least")
    if whole:
        text = _markdown(plan, whole, len(scores))
        print(text, end="")
        written = [plan.out / f"{preset}.md"]
        written[0].write_text(text, "utf-8")
        if plan.json is not None:
            files.write_json(plan.json, {one.name: one.by for one in whole})
            written.append(plan.json)
        print(*written, sep="\n")
    return 1 if bad or len(scores) < len(trials) else 0


def _markdown(plan: Plan, scores: Sequence[TimelineScores], sequences: int) -> str:
    """The table, and how it was made."""
    lines = ["# Timelines", "", f"| {' | '.join(HEADINGS)} |", f"|---|---{'|---:' * (len(HEADINGS) - 2)}|"]
    for level in scores[0].by:
        for way in scores[0].by[level]:
            lines.append(f"| {level} | {way} | {' | '.join(_cells(scores, level, way))} |")
    about = [
        f"{plan.source.title}: {len(scores)} of {sequences} sequences, those with a static segment and a stable grasp",
        "static, between, grasp: per cent of segments whose mean ADD up to symmetries, in the camera frame, is below "
        "10 % of the diameter; grasp, ADD: without symmetries; a way that fails scores 0",
        "hands: exact, moderate and strong noise, masks exact; ragged: strong noise, and masks off by 1 px",
        "jump: median over links of how far the object moves from one segment to the next beyond its true motion",
        "SCA: mean over grasps, object vertices within 10 mm of the hand that was found",
        "s: median seconds of CPU for a timeline, reading not included",
        "in brackets: 95 % intervals by Student's t over the subjects",
        f"{plan.options.inits} initial poses, seed {plan.options.seed}; made {stamp()}",
    ]
    return "\n".join([*lines, "", *(f"- {line}" for line in about), ""])


def _cells(scores: Sequence[TimelineScores], level: str, way: str) -> list[str]:
    """A row's numbers as text."""
    found: list[tuple[TimelineScores, dict[str, Any]]] = [(one, one.by[level][way]) for one in scores]
    cells = [_share(found, kind, "right_sym") for kind in ("static", "between", "grasp")]
    cells.append(_share(found, "grasp", "right"))
    cells.append(_share([(one, of) for one, of in found if "mug" in one.category], "grasp", "right_sym"))
    gaps = [jump for _, of in found for jump in of.get("jumps", [])]
    sca = [s["sca"] for _, of in found for s in of.get("segments", []) if s["sca"] is not None]
    seconds = [of["seconds"] for _, of in found]
    cells += [f"{1e3 * np.median(gaps):.1f}" if gaps else "–", f"{100 * np.mean(sca):.1f}" if sca else "–"]
    return [*cells, f"{np.median(seconds):.1f}"]


def _share(found: Sequence[tuple[TimelineScores, dict[str, Any]]], kind: str, key: str) -> str:
    """Per cent of the segments of a kind, with an interval; a failed timeline counts as one wrong segment."""
    values, subjects = [], []
    for one, of in found:
        right = [float(s[key]) for s in of.get("segments", []) if s["kind"] == kind] if "segments" in of else [0.0]
        values += right
        subjects += [subject_of(one.name)] * len(right)
    if not values:
        return "–"
    value = estimate(np.array(values), subjects)
    interval = "" if np.isnan(value.low) else f" [{100 * value.low:.0f}, {100 * value.high:.0f}]"
    return f"{100 * value.mean:.1f}{interval} (n = {value.clips})"
