"""What the benchmarks of whole sequences share: what to run, and running it over processes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeVar

from getagrip.batch.clips import print_outcome
from getagrip.batch.job import Outcome
from getagrip.batch.pool import DIED, cores, in_processes
from getagrip.errors import UsageError
from getagrip.experiments.sources import Sample
from getagrip.experiments.sources.timelines import Timelines
from getagrip.fitting.options import Options
from getagrip.io.terminal import progress_bar


class Trial(Protocol):
    """A sequence to run."""

    @property
    def sample(self) -> Sample: ...


class Scores(Protocol):
    """Of a sequence; ``failure`` says why there are none."""

    @property
    def name(self) -> str: ...
    @property
    def failure(self) -> str: ...
    @property
    def trace(self) -> str: ...


T = TypeVar("T", bound=Trial)
S = TypeVar("S", bound=Scores)


@dataclass(frozen=True)
class Plan:
    """What to run."""

    source: Timelines
    out: Path
    options: Options
    count: int | None
    workers: int | None
    overwrite: bool
    json: Path | None

    def __post_init__(self) -> None:
        if self.workers is not None and self.workers < 1:
            raise UsageError(f"--workers: got {self.workers}, expected 1 or more")


def scored(run: Callable[[T], S], trials: Sequence[T], workers: int | None, debug: bool) -> list[S]:
    """The scores of the sequences that did not fail, by name; those that did are printed."""
    scores = []
    with progress_bar(counted=True) as bar:
        shown = bar.add_task("sequences", total=len(trials))
        for trial, one in _done(run, trials, workers or cores()):
            if one is None:
                print_outcome(Outcome(trial.sample.name, "failed", DIED), debug)
            elif one.failure:
                print_outcome(Outcome(one.name, "failed", one.failure, one.trace), debug)
            else:
                scores.append(one)
            bar.advance(shown)
    return sorted(scores, key=lambda one: one.name)


def _done(run: Callable[[T], S], trials: Sequence[T], workers: int) -> Iterator[tuple[T, S | None]]:
    """Each trial with its scores, as they are ready; None where its process died."""
    return ((trial, run(trial)) for trial in trials) if workers == 1 else in_processes(run, trials, workers)
