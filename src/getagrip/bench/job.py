"""The base of every benchmark: a trial of each clip, in any process, and the page of the scores."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

from getagrip.batch.job import Outcome, failed_outcome
from getagrip.batch.ledger import LedgerEntry
from getagrip.bench.sources import Sample
from getagrip.io import files
from getagrip.io.files import Json
from getagrip.io.terminal import console

if TYPE_CHECKING:
    from rich.table import Table

    from getagrip.bench.comparison import ComparisonTable


@dataclass(frozen=True)
class ClipScores:
    """The scores of a clip."""

    name: str
    failure: str = field(default="", kw_only=True)
    """Reason for missing scores."""
    trace: str = field(default="", kw_only=True)
    again: str = field(default="", kw_only=True)
    """Reason why an earlier record was invalid."""


S = TypeVar("S", bound=ClipScores)


@dataclass(frozen=True)
class Trial(Generic[S]):
    """The work of a benchmark on one clip."""

    sample: Sample
    results: Path
    """Folder that keeps results and records, by clip name."""
    overwrite: bool

    @property
    def name(self) -> str:
        """Name of the clip."""
        return self.sample.name

    def scores(self) -> S:
        """Score the clip, whose folder exists; valid earlier work is reused. Raises any error."""
        raise NotImplementedError

    def failed(self, why: str, trace: str = "") -> S:
        """Make the scores of a clip that failed."""
        raise NotImplementedError


def run_trial(trial: Trial[S]) -> S:
    """Score a clip, which is made first if it is missing; errors become failed scores. Raises nothing."""
    sample = trial.sample
    try:
        if sample.make is not None and not sample.folder.exists():
            sample.make(sample.folder)
        return trial.scores()
    except Exception as error:  # an error in one clip must not end the others
        outcome = failed_outcome(sample.name, error)
        return trial.failed(outcome.message, outcome.trace)


def failure_of(trial: Trial[S], why: str) -> S:
    """Make the scores of a clip whose process died or was killed."""
    return trial.failed(why)


class Benchmark(Generic[S]):
    """A benchmark: the trial of every clip, and the page of the scores. It checks its options before reading clips."""

    def trials(self, samples: Sequence[Sample], results: Path, overwrite: bool) -> list[Trial[S]]:
        """Make a trial for each clip."""
        raise NotImplementedError

    def page(self, scores: Sequence[S]) -> BenchmarkPage | None:
        """Make the page of all clips' scores; None without scores."""
        raise NotImplementedError

    def failures(self, scores: S) -> list[Outcome]:
        """Return the failures of a clip."""
        return [Outcome(scores.name, "failed", scores.failure, scores.trace)] if scores.failure else []

    def line(self, scores: S) -> str:
        """Describe the trial of a clip in a line; empty for nothing to say."""
        return f"{scores.name}: done again, since {scores.again}" if scores.again else ""

    def entry(self, scores: S) -> LedgerEntry:
        """Make the ledger's entry of a clip."""
        return LedgerEntry("", "failed" if scores.failure else "done", scores.failure)


@dataclass(frozen=True)
class BenchmarkPage:
    """Tables for the terminal and as files."""

    name: str
    """Start of the files' names."""
    shown: str | Table
    texts: Mapping[str, str]
    """Texts by the end of their files' names, such as ".md"."""
    rows: Mapping[str, Sequence[Sequence[object]]]
    """Rows of CSV files, the heading first, unrounded, by the end of their files' names."""
    content: Json
    """Every number, for --json."""
    plotted: tuple[ComparisonTable, str] | None = None
    """Table of a plot, and its title."""

    def write(self, out: Path, json: Path | None) -> list[Path]:
        """Print the page, write its files into ``out``, and the numbers into ``json``; returns the paths."""
        if isinstance(self.shown, str):
            print(self.shown, end="")
        else:
            console().print(self.shown)
        written = []
        for end, lines in self.rows.items():
            written.append(out / f"{self.name}{end}")
            files.write_csv(written[-1], lines)
        for end, text in self.texts.items():
            written.append(out / f"{self.name}{end}")
            files.write_text(written[-1], text)
        if self.plotted is not None:
            from getagrip.bench.comparison import plot_ablation

            written.append(out / f"{self.name}.png")
            plot_ablation(*self.plotted, written[-1])
        if json is not None:
            files.write_json(json, self.content)
            written.append(json)
        return written
