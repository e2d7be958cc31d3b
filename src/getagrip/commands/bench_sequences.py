"""What the benchmarks of whole sequences share: what to run, and running it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Protocol, TypeVar

from getagrip.batch.clips import print_outcome
from getagrip.batch.engine import Engine, Named
from getagrip.batch.entries import Entry
from getagrip.batch.job import Outcome
from getagrip.batch.share import Share
from getagrip.experiments.sources.timelines import Timelines
from getagrip.fitting.options import Options
from getagrip.io.terminal import report


class Scores(Protocol):
    """Of a sequence; ``failure`` says why there are none, ``again`` why older ones are no longer good."""

    def __init__(self, name: str, *, failure: str) -> None: ...
    @property
    def name(self) -> str: ...
    @property
    def failure(self) -> str: ...
    @property
    def trace(self) -> str: ...
    @property
    def again(self) -> str: ...


T = TypeVar("T", bound=Named)
S = TypeVar("S", bound=Scores)


@dataclass(frozen=True)
class Plan:
    """What to run."""

    source: Timelines
    out: Path
    options: Options
    count: int | None
    share: Share
    overwrite: bool
    json: Path | None


def scored(run: Callable[[T], S], kind: type[S], trials: Sequence[T], plan: Plan, debug: bool) -> list[S]:
    """The scores, of a ``kind``, of the sequences that did not fail, by name; those that did are printed."""
    engine = Engine(
        work=run, lost=lambda trial, why: kind(trial.name, failure=why),
        entry=lambda one: Entry("", "failed" if one.failure else "done", one.failure), options=asdict(plan.options),
    )  # fmt: skip
    scores = list[S]()
    with closing(plan.share.ended(engine, trials, plan.out, "sequences", few=0)) as ended:
        for one in ended:
            if not one.failure:
                scores.append(one)
                if one.again:
                    report(f"{one.name}: done again, since {one.again}")
                continue
            print_outcome(Outcome(one.name, "failed", one.failure, one.trace), debug)
            if plan.share.fail_fast:
                report("--fail-fast: no other sequence is begun")
                break
    return sorted(scores, key=lambda one: one.name)
