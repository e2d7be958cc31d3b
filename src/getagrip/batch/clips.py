"""``getagrip reconstruct``: many clips, with a bar that moves and a line for each clip."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from getagrip.batch.job import Job, Outcome, plan, reconstruct_one, settled
from getagrip.batch.pool import DIED, cores, in_processes
from getagrip.errors import UsageError
from getagrip.io.terminal import progress_bar, show_stage

if TYPE_CHECKING:
    from rich.progress import Progress

    from getagrip.fitting.options import Options

FEW = 3
"""Up to so many clips are done in this process: others take longer to start."""


def reconstruct_clips(
    paths: Sequence[Path],
    out: Path,
    options: Options,
    workers: int | None,
    overwrite: bool,
    debug: bool,
    strict: bool = False,
) -> int:
    """Reconstruct clips into ``out/<clip name>/`` and print the outcome of each; 1 if any failed, else 0.

    With ``strict`` also 1 where a check has found something serious. Raises ``UsageError`` where there is nothing to
    do, or where two clips have the same name.
    """
    if not paths:
        raise UsageError("CLIP: name at least one clip")
    if workers is not None and workers < 1:
        raise UsageError(f"--workers: got {workers}, expected 1 or more")
    jobs, failed = plan(paths, out, options, overwrite)
    for outcome in failed:
        print_outcome(outcome, debug)
    counts, doubtful = {"done": 0, "kept": 0, "failed": len(failed)}, list[str]()
    right: dict[str, float] = {}
    with progress_bar() as bar:
        for outcome in _outcomes(jobs, workers, bar):
            print_outcome(outcome, debug)
            counts[outcome.state] += 1
            doubtful += [outcome.name] * any(finding.serious for finding in outcome.findings)
            if outcome.probability_right is not None:
                right[outcome.name] = outcome.probability_right.value
    if len(jobs) + len(failed) > 1:
        print(f"{counts['done']} done, {counts['kept']} already done, {counts['failed']} failed")
        if doubtful:
            print(f"{len(doubtful)} with serious findings: {', '.join(sorted(doubtful))}")
        if right:
            print(expected(right))
    return 1 if counts["failed"] or (strict and doubtful) else 0


def expected(right: Mapping[str, float]) -> str:
    """How many results are probably right, and which are rather wrong, by the probability of each that it is right."""
    wrong = sorted((name for name in right if right[name] < 0.5), key=lambda name: right[name])
    named = f"; rather wrong than right, the worst first: {', '.join(wrong)}" if wrong else ""
    return f"about {sum(right.values()):.0f} of {len(right)} are right, by their probabilities{named}"


def _outcomes(jobs: Sequence[Job], workers: int | None, bar: Progress) -> Iterator[Outcome]:
    """What becomes of each job, while the bar shows it: first of those that need no work."""
    clips = bar.add_task("clips", total=len(jobs), visible=len(jobs) > 1)
    remaining = []
    for job in jobs:
        before = settled(job)
        if before is None:
            remaining.append(job)
        else:
            yield before
            bar.advance(clips)
    if workers is None:
        workers = min(len(remaining), cores()) if len(remaining) > FEW else 1
    elsewhere = set()
    for outcome in _in_turn(remaining, bar) if workers == 1 else _side_by_side(remaining, workers):
        if outcome.state == "elsewhere":
            elsewhere.add(outcome.name)
            continue
        yield outcome
        bar.advance(clips)
    for job in remaining:  # what another run was at work on: its result, or, where it has ended early, our own
        if job.name in elsewhere:
            yield reconstruct_one(job)
            bar.advance(clips)


def _in_turn(jobs: Sequence[Job], bar: Progress) -> Iterator[Outcome]:
    """The outcomes of jobs done in this process, with a bar for the one at work."""
    stage = bar.add_task("", total=1.0, visible=bool(jobs))
    for job in jobs:
        yield reconstruct_one(job, partial(show_stage, bar, stage, job.name), wait=False)


def _side_by_side(jobs: Sequence[Job], workers: int) -> Iterator[Outcome]:
    """The outcomes of jobs done in processes, as they finish."""
    for job, outcome in in_processes(_unless_elsewhere, jobs, workers):
        yield outcome or Outcome(job.name, "failed", DIED)


def _unless_elsewhere(job: Job) -> Outcome:
    """In a process of its own."""
    return reconstruct_one(job, wait=False)


def print_outcome(outcome: Outcome, debug: bool) -> None:
    """One line about a clip, and one for each finding: failures on stderr, the rest on stdout."""
    failed = outcome.state == "failed"
    parts = ["failed"] * failed + [outcome.name] * bool(outcome.name) + [outcome.message]
    print(": ".join(parts), file=sys.stderr if failed else sys.stdout)
    for finding in outcome.findings:
        print(f"  {finding}")
    if failed and debug:
        print(outcome.trace, file=sys.stderr)
