"""The base of every benchmark: a trial of each clip, in any process, and the page of their scores."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar

from getagrip.batch.entries import LedgerEntry
from getagrip.batch.job import Outcome, failed_outcome
from getagrip.experiments.sources import Sample
from getagrip.io import files
from getagrip.io.files import Json
from getagrip.io.terminal import console

if TYPE_CHECKING:
    from rich.table import Table

    from getagrip.experiments.comparison import ComparisonTable


@dataclass(frozen=True)
class ClipScores:
    """The scores of a clip; ``failed_outcome`` says why there are none."""

    name: str
    failure: str = field(default="", kw_only=True)
    trace: str = field(default="", kw_only=True)
    again: str = field(default="", kw_only=True)
    """Why it was made again, where what was there is no longer good."""


S = TypeVar("S", bound=ClipScores)


@dataclass(frozen=True)
class Trial(Generic[S]):
    """A clip of a benchmark, and what is done with it."""

    sample: Sample
    results: Path
    """The folder that keeps what is made, by its name in it."""
    overwrite: bool

    @property
    def name(self) -> str:
        """The clip's."""
        return self.sample.name

    def scores(self) -> S:
        """Do it, as far as that has not been done by the same code; the clip is there. Raises any error."""
        raise NotImplementedError

    def failed(self, why: str, trace: str = "") -> S:
        """Make the scores of a clip that could not be done."""
        raise NotImplementedError


def run_trial(trial: Trial[S]) -> S:
    """Score a clip, which is made where it is not there yet; failures are returned, not raised. Raises nothing."""
    sample = trial.sample
    try:
        if sample.make is not None and not sample.folder.exists():
            sample.make(sample.folder)
        return trial.scores()
    except Exception as error:  # one clip's trouble must not end the others
        outcome = failed_outcome(sample.name, error)
        return trial.failed(outcome.message, outcome.trace)


def failure_of(trial: Trial[S], why: str) -> S:
    """Make the scores of a clip that no process could do."""
    return trial.failed(why)


class Benchmark(Generic[S]):
    """A benchmark: the trial of every clip, and the page of the scores.

    Made before anything is read: calls are checked.
    """

    def trials(self, samples: Sequence[Sample], results: Path, overwrite: bool) -> list[Trial[S]]:
        """Make a trial for each clip."""
        raise NotImplementedError

    def page(self, scores: Sequence[S]) -> BenchmarkPage | None:
        """Make the page of all clips' scores; None where there are none."""
        raise NotImplementedError

    def failures(self, scores: S) -> list[Outcome]:
        """Return the failures of a clip."""
        return [Outcome(scores.name, "failed", scores.failure, scores.trace)] if scores.failure else []

    def line(self, scores: S) -> str:
        """Describe the trial of a clip in words; empty where that needs none."""
        return f"{scores.name}: done again, since {scores.again}" if scores.again else ""

    def entry(self, scores: S) -> LedgerEntry:
        """Make the ledger's entry of a clip."""
        return LedgerEntry("", "failed" if scores.failure else "done", scores.failure)


@dataclass(frozen=True)
class BenchmarkPage:
    """Tables on the screen and as files."""

    name: str
    """How the files' names begin."""
    shown: str | Table
    texts: Mapping[str, str]
    """By the end of a file's name, as ".md"."""
    rows: Mapping[str, Sequence[Sequence[object]]]
    """Rows of CSV files, the heading first, unrounded; by the end of a file's name."""
    content: Json
    """Every number, for --json."""
    plotted: tuple[ComparisonTable, str] | None = None
    """Table of a plot, and its title."""

    def write(self, out: Path, json: Path | None) -> list[Path]:
        """Show it, and write its files into a folder, and ``json``; returns them."""
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
            from getagrip.experiments.plots import plot_ablation

            written.append(out / f"{self.name}.png")
            plot_ablation(*self.plotted, written[-1])
        if json is not None:
            files.write_json(json, self.content)
            written.append(json)
        return written
