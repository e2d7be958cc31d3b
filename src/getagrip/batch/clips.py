"""``getagrip reconstruct``: many clips, with a bar that moves and a line for each clip."""

from __future__ import annotations

import shlex
import sys
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from getagrip.batch.engine import Engine
from getagrip.batch.job import Job, Outcome, preload_solver, reconstruct_one
from getagrip.batch.ledger import Ledger, ledger_folder
from getagrip.batch.plan import ClipPlan
from getagrip.batch.streamed import StreamedJob, reconstruct_streamed
from getagrip.batch.summary import failed_path_entry, outcome_entry, write_summary
from getagrip.errors import UsageError, escape_unprintable
from getagrip.io import leftovers
from getagrip.io.storage import Place, RemotePath
from getagrip.io.terminal import print_note, print_result

if TYPE_CHECKING:
    from getagrip.batch.keep import KeepOptions
    from getagrip.batch.share import BatchOptions
    from getagrip.fitting.options import Options


def reconstruct_clips(paths: Sequence[Place], out: Place, options: Options, batch: BatchOptions, debug: bool) -> int:
    """Reconstruct clips into ``out/<clip name>/`` and print the outcome of each; 1 if any failed, else 0.

    Several calls may share a folder, at the same time or one after another: its ledger says who does what. Of more
    than one clip a summary is written, also after an interrupt. With ``strict`` also 1 where a check has found
    something serious or a result is improbable. Raises ``UsageError`` where there is nothing to do, or no
    result can be kept, ``GetagripError`` where the ledger cannot be written.
    """
    if not paths:
        raise UsageError("missing CLIP: name at least one clip")
    batch.keep.check(options)
    share = batch.share
    with ClipPlan(paths, share.shard) as plan:
        for outcome in plan.failed:
            print_outcome(outcome, debug)
        if not len(plan) or (share.fail_fast and plan.failed):
            return 1 if plan.failed else 0
        with Ledger(ledger_folder(out, share.ledger)) as ledger:
            if ledger.path.parent != out:
                print_note(f"{out}: its ledger is {ledger.path}")
            for folder in leftovers.remove_stale_folders(out) if isinstance(out, Path) else ():
                print_note(f"{folder}: removed, unfinished work of a process that has died")
            ledger.expect((name for name, _ in plan), map(failed_path_entry, plan.failed))
            many = len(plan) + len(plan.failed) > 1
            try:
                tally = _run_jobs(plan, ledger, out, options, batch, debug)
            except KeyboardInterrupt:
                if many:
                    _summarise(ledger, out, batch.keep)
                where = (
                    f"{shlex.quote(str(out))}{f' --ledger {shlex.quote(str(share.ledger))}' if share.ledger else ''}"
                )
                print_note(f"progress: getagrip status {where}")
                raise
            if many:
                _summarise(ledger, out, batch.keep)
    tally.counts["failed"] += len(plan.failed)
    if len(tally) > 1:
        tally.print()
    if tally.verdicts and batch.keep.keep is not None:
        print(batch.keep.summary(tally.verdicts))
    if sys.stdout.isatty() and tally.counts["done"] + tally.counts["kept"]:
        print(f"look at it with: getagrip view {shlex.quote(str(out))}, or getagrip report")
    return 1 if tally.counts["failed"] or (batch.strict and not tally.passes(batch.min_probability)) else 0


def _summarise(ledger: Ledger, out: Place, keep: KeepOptions) -> None:
    for path in write_summary(ledger, out, keep):
        print_result(str(path))


class _Tally:
    """The counts of a call's clips, by outcome."""

    def __init__(self) -> None:
        self.counts = Counter[str]()
        self.flagged: list[str] = []
        """Names of those with serious findings."""
        self.right: dict[str, float] = {}
        self.right_in_camera: dict[str, float] = {}
        """The probability of each that it is right."""
        self.looks: dict[str, str] = {}
        """How each with an assumed mesh probably looks."""
        self.verdicts: dict[str, str] = {}
        """The verdict of ``--keep`` on each: kept or dropped."""

    def add(self, outcome: Outcome, keep: KeepOptions) -> None:
        if outcome.state != "failed":
            self.verdicts[outcome.name] = keep.verdict(outcome.probability_right, outcome.probability_right_in_camera)
        self.counts[outcome.state] += 1
        self.flagged += [outcome.name] * any(finding.serious for finding in outcome.findings)
        if outcome.probability_right is not None:
            self.right[outcome.name] = outcome.probability_right.value
            if by_eye := outcome.probability_right.by_eye:
                self.looks[outcome.name] = by_eye
        if outcome.probability_right_in_camera is not None:
            self.right_in_camera[outcome.name] = outcome.probability_right_in_camera.value

    def __len__(self) -> int:
        return self.counts.total()

    def passes(self, min_probability: float) -> bool:
        """Return whether no result has a serious finding, or a probability below the least one."""
        return not self.flagged and all(right >= min_probability for right in self.right.values())

    def print(self) -> None:
        print(f"{self.counts['done']} done, {self.counts['kept']} already done, {self.counts['failed']} failed")
        if self.flagged:
            print(f"{len(self.flagged)} with serious findings: {', '.join(sorted(self.flagged))}")
        for by_eye, count in sorted(Counter(self.looks.values()).items()):
            named = ", ".join(name for name in self.looks if self.looks[name] == by_eye)
            print(f"{count} of {len(self.looks)} with an assumed mesh: {by_eye}: {named}")
        for where, right in (("hand", self.right), ("camera", self.right_in_camera)):
            if known := {name: value for name, value in right.items() if name not in self.looks}:
                print(expected_right_message(known, f"right in the {where}"))


def _run_jobs(plan: ClipPlan, ledger: Ledger, out: Place, options: Options, batch: BatchOptions, debug: bool) -> _Tally:
    """Do the clips, printing what becomes of each."""
    streamed = isinstance(out, RemotePath) or plan.remote
    make: Callable[..., Job | StreamedJob] = StreamedJob if streamed else Job
    work: Callable[..., Outcome] = reconstruct_streamed if streamed else reconstruct_one
    per_clip = {"options": options, "overwrite": batch.overwrite, "threads": batch.threads}
    jobs = (make(name, clip, out / name, **per_clip) for name, clip in plan)
    engine: Engine[Job | StreamedJob, Outcome] = Engine(
        work=work, lost=_lost_clip_outcome, entry=partial(outcome_entry, method=options.method, seed=options.seed),
        options=asdict(options), prepare=preload_solver,
    )  # fmt: skip
    tally = _Tally()
    with closing(batch.share.ended(engine, jobs, len(plan), ledger, "clips", stages=True)) as outcomes:
        for outcome in outcomes:
            print_outcome(outcome, debug)
            tally.add(outcome, batch.keep)
            if batch.share.fail_fast and outcome.state == "failed":
                print_note("--fail-fast: the other clips are skipped")
                break
    return tally


def _lost_clip_outcome(job: Job | StreamedJob, why: str) -> Outcome:
    return Outcome(job.name, "failed", why)


def expected_right_message(right: Mapping[str, float], what: str = "right in the hand") -> str:
    """Count the results that are probably right, and name those likely wrong, by the probability of each."""
    wrong = sorted((name for name in right if right[name] < 0.5), key=lambda name: right[name])
    named = f"; likely wrong, worst first: {', '.join(wrong)}" if wrong else ""
    return f"about {sum(right.values()):.0f} of {len(right)} are {what}, by their probabilities{named}"


def print_outcome(outcome: Outcome, debug: bool) -> None:
    """Print one line about a clip, and one for each finding: failures on stderr, the rest on stdout."""
    failed = outcome.state == "failed"
    parts = ["failed"] * failed + [outcome.name] * bool(outcome.name) + [outcome.message]
    print(escape_unprintable(": ".join(parts)), file=sys.stderr if failed else sys.stdout)
    for finding in outcome.findings:
        print(f"  {finding}")
    if failed and debug:
        print(escape_unprintable(outcome.trace, "\n"), file=sys.stderr)
