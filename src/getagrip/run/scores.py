"""``getagrip evaluate`` and ``getagrip report``: results against their clips."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from getagrip import files
from getagrip.errors import InputError, UsageError
from getagrip.evaluate import evaluate, evaluate_result, read_evaluated, summary, tables
from getagrip.run.batch import FEW, progress_bar, tell
from getagrip.run.job import Outcome, failure
from getagrip.run.pool import cores, in_processes


@dataclass(frozen=True)
class Job:
    """A result to evaluate."""

    place: int
    """Among those that were asked for."""
    folder: Path
    clips: Path | None


def evaluate_results(paths: Sequence[Path], clips: Path | None, json: Path | None, debug: bool) -> int:
    """Print the metrics of results, and write them to a file; 1 if any result could not be evaluated, else 0.

    A path is a result, or a folder of results. Raises ``UsageError`` where there is nothing to do.
    """
    if not paths:
        raise UsageError("RESULT: name at least one result")
    folders: list[Path] = []
    failures = 0
    for path in paths:
        try:
            folders += results_in(path)
        except (InputError, OSError) as error:
            tell(failure("", error), debug)
            failures += 1
    found: dict[int, dict[str, Any]] = {}
    with progress_bar() as bar:
        task = bar.add_task("results", total=len(folders))
        for job, made in _evaluated([Job(place, folder, clips) for place, folder in enumerate(folders)]):
            if isinstance(made, Outcome):
                tell(made, debug)
                failures += 1
            else:
                found[job.place] = made
            bar.advance(task)
    evaluations = [found[place] for place in sorted(found)]
    if evaluations:
        from rich.console import Console

        # A pipe has no width: give tables the one they need there.
        console = Console() if sys.stdout.isatty() else Console(width=200)
        for table in tables(evaluations):
            console.print(table)
    if json is not None:
        files.write_json(json, summary(evaluations))
    return 1 if failures else 0


def _evaluated(jobs: Sequence[Job]) -> Iterator[tuple[Job, dict[str, Any] | Outcome]]:
    """Each job with its metrics or why there are none, many jobs over processes."""
    if len(jobs) <= FEW or cores() == 1:
        yield from ((job, evaluate_one(job)) for job in jobs)
        return
    for job, made in in_processes(evaluate_one, jobs, min(len(jobs), cores())):
        yield job, made or Outcome(str(job.folder), "failed", "its process died twice; out of memory?")


def evaluate_one(job: Job) -> dict[str, Any] | Outcome:
    """The metrics of a result, or why there are none. Raises nothing."""
    try:
        return evaluate_result(job.folder, job.clips)
    except Exception as error:  # one result's trouble must not end the others
        return failure("" if isinstance(error, InputError) else str(job.folder), error)


def results_in(path: Path) -> list[Path]:
    """The result folders that a path stands for. Raises ``InputError`` where it holds none."""
    if (path / "result.json").exists():
        return [path]
    if not path.is_dir():
        raise InputError(path, "", "no such folder", "a result, or a folder of results")
    results = sorted(found.parent for found in path.glob("*/result.json"))
    if not results:
        raise InputError(path, "", "no result.json in it or in its folders", "a result, or a folder of results")
    return results


def report_result(folder: Path) -> int:
    """Draw ``report.png`` into a result folder."""
    from getagrip.view.report import write_report

    result, clip, masks = read_evaluated(folder)
    metrics = evaluate(result, clip, masks)["metrics"]
    print(write_report(clip, masks, result, folder / "report.png", metrics))
    return 0
